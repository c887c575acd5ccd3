"""Reads one frame's Gaussians from a stranger's .ply or .spz.

Files from strangers are hostile: numbers of Gaussians are compared with the bytes that are there and with a limit
before anything is allocated, and what is unpacked is never more than they say.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import UsageError
from ..splats import Splats, take_splats
from .ply import parse_ply
from .spz import parse_spz

_MAX_BYTES_EACH = 1024
"""Of a Gaussian in a file: four times what 3DGS writes, for properties that mean nothing here."""
_LARGEST_HEADER = 1 << 20

_PARSERS: Mapping[str, Callable[[bytes, int], tuple[Splats, bool]]] = {".ply": parse_ply, ".spz": parse_spz}
READABLE: tuple[str, ...] = tuple(_PARSERS)
"""The endings of files that are read, each with its dot."""

_UPS: Mapping[str, Literal["Y", "-Y"]] = {".ply": "-Y", ".spz": "Y"}


@dataclass(frozen=True)
class SplatFile:
    """What a file holds: finite Gaussians in the file's order.

    ``compensated``: whether the file says that they are drawn with Mip-Splatting's compensation of opacity. ``up``:
    the axis that files of this format have for up. ``left_out``: Gaussians with a value that is not finite.
    """

    splats: Splats
    compensated: bool
    up: Literal["Y", "-Y"]
    left_out: int


def read_splats(path: str | os.PathLike[str], *, max_gaussians: int) -> SplatFile:
    """The Gaussians of a .ply or .spz file.

    Gaussians with a value that is not finite are left out. Raises UsageError for a file that cannot be read, is
    damaged, holds none or more than ``max_gaussians``.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _PARSERS:
        raise UsageError(f"{path}: Gaussians are read from {' and '.join(READABLE)}; give such a file")
    data = _bytes_of(path, max_gaussians * _MAX_BYTES_EACH + _LARGEST_HEADER)
    try:
        splats, compensated = _PARSERS[suffix](data, max_gaussians)
        finite = _finite(splats)
        if not finite.any():
            raise UsageError("holds no Gaussian whose values are finite; export it again")
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
    left_out = int(len(finite) - finite.sum())
    return SplatFile(take_splats(splats, finite) if left_out else splats, compensated, _UPS[suffix], left_out)


def _bytes_of(path: Path, max_bytes: int) -> bytes:
    try:
        if not path.is_file():
            raise UsageError(f"{path}: is no file; give a .ply or .spz")
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if size > max_bytes:
                raise UsageError(f"{path}: has {size} bytes, and at most {max_bytes} are read; remove Gaussians")
            return file.read(size)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; give a .ply or .spz that can be read") from error


def _finite(splats: Splats) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    finite = np.ones(len(splats), bool)
    for values in vars(splats).values():
        finite &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    return finite
