"""Files that hold one frame's Gaussians, one module for each format, found by the ending of their names.

A format joins as one file in this folder: a module with a class of `SplatFormat` that is called ``Format``. What is
common to those of few bits is in ``quantised``. ``reading`` takes strangers' .ply and .spz; the readers of .splat,
.sog and .glb read what their own writer writes, for tests and ``decogs-bench``.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from typing import ClassVar, Literal, Protocol

from ..errors import UsageError
from ..splats import Splats


@dataclass(frozen=True)
class Extremes:
    """What all frames of an export stay within: numbers of Gaussians, the largest coordinate's magnitude, SH degree."""

    smallest: int
    largest: int
    farthest: float
    sh_degree: int


class SplatFormat(Protocol):
    """A file format that holds one frame.

    ``up``: the axis that programs which read such files take for up. ``compensated``: whether the Gaussians are to be
    drawn with Mip-Splatting's compensation of opacity, which the file then states where it can.
    """

    suffix: ClassVar[str]
    up: ClassVar[Literal["Y", "-Y"]]

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
    modules = (import_module(f"{__name__}.{found.name}") for found in pkgutil.iter_modules(__path__))
    formats = [module.Format for module in modules if hasattr(module, "Format")]
    return {one.suffix: one for one in sorted(formats, key=lambda one: str(one.suffix))}


def needs_gaussians(extremes: Extremes, suffix: str) -> None:
    """Raises UsageError where a format without Gaussians is no file to its readers."""
    if not extremes.smallest:
        raise UsageError(f"a frame has no Gaussians, and no program reads a {suffix} without any; write .ply instead")
