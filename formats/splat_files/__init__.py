"""Files that hold one frame's Gaussians, one module for each format, found by the ending of their names.

A format joins as one file in this folder: a module with a class of `SplatFormat` that is called ``Format``. What is
common to those of few bits is in ``quantised``. ``reading`` takes strangers' .ply and .spz; the readers of .splat,
.sog and .glb read what their own writer writes, for tests and ``decogs-bench``.
"""

from __future__ import annotations

import math
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import ClassVar, Literal, Protocol

from ..errors import UsageError
from ..splats import Splats

_READING, _PASSING = 2, 260
"""What a Gaussian takes while it is read: so many times its floats, and so many bytes that are there in passing."""


@dataclass(frozen=True)
class Extremes:
    """What all frames of an export stay within: numbers of Gaussians, the largest coordinate's magnitude, SH degree.

    ``clamped``: Gaussians of a frame that have a size outside of the format's, at most.
    """

    smallest: int
    largest: int
    farthest: float
    sh_degree: int
    clamped: int = 0


ANY_SIZE = (-math.inf, math.inf)
"""Logarithms of the sizes that floats hold."""


@dataclass(frozen=True)
class Room:
    """What reading a file may take: numbers of Gaussians, and bytes; None is no limit.

    ``copies``: of its floats that a Gaussian takes at most, later on included.
    """

    gaussians: int | None = None
    memory: int | None = None
    copies: int = _READING

    def check(self, count: int, coefficients: int, held: int) -> None:
        """Raises UsageError, without a file's name, where ``count`` Gaussians are too many.

        ``coefficients``: of SH, per channel. ``held``: bytes of the file, which are there meanwhile.
        """
        if self.gaussians is not None and count > self.gaussians:
            raise UsageError(f"holds {count} Gaussians, and at most {self.gaussians} are read; remove some")
        needed = held + count * (self.copies * 4 * (11 + 3 * coefficients) + _PASSING)
        if self.memory is not None and needed > self.memory:
            raise UsageError(
                f"holds {count} Gaussians, which take {needed >> 20} MiB; remove some, or allow more memory than "
                f"{self.memory >> 20} MiB (`max_memory`)"
            )


class SplatFormat(Protocol):
    """A file format that holds one frame.

    ``up``: the axis that programs which read such files take for up. ``compensated``: whether the Gaussians are to be
    drawn with Mip-Splatting's compensation of opacity, which the file then states where it can. ``log_scales``:
    logarithms of the least and the largest size that it holds.
    """

    suffix: ClassVar[str]
    up: ClassVar[Literal["Y", "-Y"]]
    log_scales: ClassVar[tuple[float, float]]

    @property
    def compensated(self) -> bool:
        """Whether the file states that opacities are compensated for the low-pass filter."""
        ...

    def fitted(self, extremes: Extremes) -> tuple[SplatFormat, list[str]]:
        """The same set to what the frames need, and what it cannot hold and leaves out, a line each.

        Raises UsageError, without a file's name, for frames that it cannot hold at all.
        """

    def encode(self, splats: Splats) -> bytes:
        """The file of one frame."""

    def decode(self, data: bytes) -> Splats:
        """The frame of a file that ``encode`` wrote, as far as the format holds it."""


@cache
def splat_formats() -> Mapping[str, Callable[..., SplatFormat]]:
    """The formats' classes by the ending of their names, with its dot."""
    modules = (import_module(f"{__name__}.{info.name}") for info in pkgutil.iter_modules(__path__))
    formats = [module.Format for module in modules if hasattr(module, "Format")]
    return {one.suffix: one for one in sorted(formats, key=lambda one: str(one.suffix))}


def needs_gaussians(extremes: Extremes, suffix: str) -> None:
    """Raises UsageError where a format without Gaussians is no file to its readers."""
    if not extremes.smallest:
        raise UsageError(f"a frame has no Gaussians, and no program reads a {suffix} without any; write .ply instead")
