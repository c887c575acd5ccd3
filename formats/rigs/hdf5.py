"""Numbers in an HDF5 file: by hard links only, of bounded size, never from another file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RigError
from ..system.extras import install

_DAMAGED = (KeyError, OSError, RuntimeError, TypeError, ValueError)
"""What h5py raises for files that are damaged, here and there."""


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """The file's root group. Raises RigError where h5py is missing, or for another kind of file."""
    try:
        import h5py
    except ImportError:
        raise RigError(f"{path}: is HDF5, which needs the package h5py; {install('h5')}") from None
    try:
        file = h5py.File(path, "r")
    except OSError:
        raise RigError(f"{path}: no HDF5 file, or truncated; download it again") from None
    with file:
        yield file


def child(group: Any, name: str, path: Path) -> Any:
    """What a group holds under a name, not by a link into another file or dataset."""
    import h5py

    try:
        item = group[name] if isinstance(group.get(name, getlink=True), h5py.HardLink) else None
    except _DAMAGED:
        item = None
    if item is None:
        raise RigError(f"{path}: {group.name}/{name} is missing or damaged; download the file again")
    return item


def values(group: Any, name: str, path: Path, largest: int) -> NDArray[Any]:
    """A dataset's values, of at most so many bytes; never from another file."""
    import h5py

    data = child(group, name, path)
    try:
        is_plain = isinstance(data, h5py.Dataset) and data.dtype.kind in "fiu" and not data.external
        if not is_plain or data.is_virtual or data.size is None:
            raise ValueError
        if data.size * data.dtype.itemsize > largest:
            raise RigError(f"{path}: {group.name}/{name} is larger than {largest} bytes; download the file again")
        return np.asarray(data[()])
    except _DAMAGED:
        raise RigError(f"{path}: {group.name}/{name} holds no plain numbers; download the file again") from None
