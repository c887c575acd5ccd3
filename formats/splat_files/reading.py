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
from numpy.typing import NDArray

from ..errors import UsageError
from ..splats import Splats, take_splats
from . import Room
from .ply import parse_ply
from .spz import parse_spz

_MAX_BYTES_EACH = 1024
"""Of a Gaussian in a file: four times what 3DGS writes, for properties that mean nothing here."""
_LARGEST_HEADER = 1 << 20

_OPAQUE, _FLAT = 80.0, -20.0
"""Where opacity logits end, as in `splats.sigmoid`, and log scales begin: at 2e-9 units, of which float32 still holds
the fourth power."""

_PARSERS: Mapping[str, Callable[[bytes, Room], tuple[Splats, bool]]] = {".ply": parse_ply, ".spz": parse_spz}
READABLE: tuple[str, ...] = tuple(_PARSERS)
"""The endings of files that are read, each with its dot."""

_UPS: Mapping[str, Literal["Y", "-Y"]] = {".ply": "-Y", ".spz": "Y"}


@dataclass(frozen=True)
class SplatFile:
    """What a file holds: finite Gaussians in the file's order.

    ``compensated``: whether the file says that they are drawn with Mip-Splatting's compensation of opacity. ``up``:
    the axis that files of this format have for up. ``left_out``: how many Gaussians were, and why, a line each.
    """

    splats: Splats
    compensated: bool
    up: Literal["Y", "-Y"]
    left_out: tuple[str, ...]


def read_splats(path: str | os.PathLike[str], room: Room) -> SplatFile:
    """The Gaussians of a .ply or .spz file.

    Infinite opacity logits are opaque or invisible, log scales of minus infinity are flat: both end at ``_OPAQUE`` and
    ``_FLAT``. Gaussians with another value that is not finite, and rows of zeros, are left out. Raises UsageError for a
    file that cannot be read, is damaged, holds none or more than there is ``room`` for.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _PARSERS:
        raise UsageError(f"{path}: Gaussians are read from {' and '.join(READABLE)}; export it as one of these")
    data = _bytes_of(path, room)
    try:
        splats, compensated = _PARSERS[suffix](data, room)
        del data
        found, _, left_out = finite_splats(splats)
        if not len(found):
            raise UsageError("holds no Gaussian whose values are finite; export it again")
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
    return SplatFile(found, compensated, _UPS[suffix], left_out)


def finite_splats(splats: Splats) -> tuple[Splats, NDArray[np.int64], tuple[str, ...]]:
    """What can be shown of a stranger's Gaussians, their rows, and how many were left out and why, a line each.

    Ends opacities and sizes as `read_splats` does, in place.
    """
    np.clip(splats.opacity_logits, -_OPAQUE, _OPAQUE, out=splats.opacity_logits)
    np.maximum(splats.log_scales, _FLAT, out=splats.log_scales)
    finite, zero = _finite(splats), _zero(splats)
    rows = np.flatnonzero(finite & ~zero)
    counts = {"have values that are not finite": int((~finite).sum()), "are rows of zeros": int(zero.sum())}
    left_out = tuple(f"{count} of its Gaussians {why}, and are left out" for why, count in counts.items() if count)
    return take_splats(splats, rows) if left_out else splats, rows, left_out


def _bytes_of(path: Path, room: Room) -> bytes:
    try:
        if not path.is_file():
            raise UsageError(f"{path}: is no file; give a .ply or .spz")
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            if room.gaussians is not None and size > (most := room.gaussians * _MAX_BYTES_EACH + _LARGEST_HEADER):
                raise UsageError(f"{path}: has {size} bytes, and at most {most} are read; remove Gaussians")
            if room.memory is not None and size > room.memory:
                raise UsageError(f"{path}: has {size} bytes; allow more memory than {room.memory} (`max_memory`)")
            return file.read(size)
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; give a .ply or .spz that can be read") from error


def _finite(splats: Splats) -> NDArray[np.bool_]:
    finite = np.ones(len(splats), bool)
    for values in vars(splats).values():
        finite &= np.isfinite(values).all(axis=tuple(range(1, values.ndim)))
    return finite


def _zero(splats: Splats) -> NDArray[np.bool_]:
    """Rows that were set aside and never written: no Gaussian is without a rotation, at the origin and of size 1."""
    nothing = np.asarray(splats.opacity_logits == 0)
    for values in (splats.means, splats.log_scales, splats.quaternions):
        nothing &= ~values.any(axis=1)
    return nothing
