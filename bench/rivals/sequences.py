"""A decoded sequence, and what it takes to keep it in another way."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from decogs.codec.scene.state import Rows
from decogs.formats.splats import Splats


@dataclass(frozen=True, eq=False)
class SceneFrame:
    """One frame as decoded: stored values, and the strictly increasing ids (N,) that identify Gaussians over time."""

    ids: Rows
    splats: Splats


Frames = Callable[[], Iterator[SceneFrame]]
"""The sequence from its beginning, as often as it is asked for: some rivals look at it twice."""

NO_DIRECTIONS = (
    "Keeps SH degree 0 only, and neither pays for the rest nor shows it: compare its PSNR with the row of float32 at "
    "degree 0."
)
"""Of a format without view-dependent colour."""


@dataclass(frozen=True)
class Sizes:
    """Bytes on disk: of the first frame, of all, and what has to be there before the first shows where that is more."""

    first: int
    total: int
    wait: int = 0


class Coder(Protocol):
    """A way to keep a sequence; its ``repr`` shows its settings."""

    def missing(self) -> str | None:
        """Why it cannot be tried here ("not installed"); None when it can."""

    def write(self, frames: Frames, folder: Path) -> Sizes:
        """Keeps the sequence in an empty folder."""

    def read(self, folder: Path) -> Iterator[Splats]:
        """The frames that ``write`` kept there, in order; Gaussians may come in another order."""


class FrameFormat(Protocol):
    """A file format that holds one frame."""

    @property
    def suffix(self) -> str: ...

    def encode(self, splats: Splats) -> bytes: ...

    def decode(self, data: bytes) -> Splats: ...


@dataclass(frozen=True)
class FilePerFrame:
    """Every frame on its own, a file each."""

    format: FrameFormat

    def missing(self) -> str | None:
        return None

    def write(self, frames: Frames, folder: Path) -> Sizes:
        return write_numbered(folder, self.format.suffix, (self.format.encode(frame.splats) for frame in frames()))

    def read(self, folder: Path) -> Iterator[Splats]:
        return (self.format.decode(path.read_bytes()) for path in numbered(folder, self.format.suffix))


@dataclass(frozen=True)
class WithoutDirections:
    """A sequence of which only SH degree 0 is kept: what a format without view-dependent colour would see of it."""

    coder: Coder

    def missing(self) -> str | None:
        return self.coder.missing()

    def write(self, frames: Frames, folder: Path) -> Sizes:
        return self.coder.write(lambda: (SceneFrame(f.ids, _degree_0(f.splats)) for f in frames()), folder)

    def read(self, folder: Path) -> Iterator[Splats]:
        return self.coder.read(folder)


@dataclass(frozen=True)
class Rival:
    """One row of the comparison. ``family``: rows of one family are one line of the plot.

    ``about``: what it cannot carry, and what was done about it; empty when it carries everything.
    """

    name: str
    family: str
    description: str
    coder: Coder
    about: str = ""


def write_numbered(folder: Path, suffix: str, files: Iterator[bytes]) -> Sizes:
    """Writes files one after the other, numbered from 0; the first one shows the first frame."""
    sizes = [(folder / f"frame_{index:06d}{suffix}").write_bytes(data) for index, data in enumerate(files)]
    return Sizes(sizes[0], sum(sizes))


def numbered(folder: Path, suffix: str) -> list[Path]:
    """The files that ``write_numbered`` wrote."""
    return sorted(folder.glob(f"frame_*{suffix}"))


def _degree_0(splats: Splats) -> Splats:
    return Splats(
        splats.means,
        splats.log_scales,
        splats.quaternions,
        splats.opacity_logits,
        np.ascontiguousarray(splats.sh[:, :1]),
    )
