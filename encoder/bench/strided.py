"""A rig that shows every k-th frame of another: the frame-rate table's rig, which the encoder takes like any other."""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path

from decogs.formats.pictures import Picture
from decogs.formats.rigs import FrameSource, Rig


@dataclass(frozen=True)
class StridedSource:
    """One camera's frames up to ``first`` as they are, and from there every ``stride``-th."""

    source: FrameSource
    first: int
    stride: int

    @property
    def path(self) -> Path:
        return self.source.path

    @property
    def width(self) -> int:
        return self.source.width

    @property
    def height(self) -> int:
        return self.source.height

    @property
    def frame_count(self) -> int:
        return self.first + -(-(self.source.frame_count - self.first) // self.stride)

    @property
    def fps(self) -> float | None:
        return None if self.source.fps is None else self.source.fps / self.stride

    def read(self, start: int, stop: int) -> Generator[Picture, None, None]:
        """Frames ``start`` to ``stop``, counted as they are shown; those between are decoded and passed over."""
        wanted = [self._index(i) for i in range(start, stop)]
        if wanted:
            for index, picture in enumerate(self.source.read(wanted[0], wanted[-1] + 1), wanted[0]):
                if index in wanted:
                    yield picture

    def _index(self, shown: int) -> int:
        return shown if shown <= self.first else self.first + (shown - self.first) * self.stride


def strided(rig: Rig, first: int, stride: int) -> Rig:
    """The rig with only every ``stride``-th frame from ``first`` on.

    ``first`` keeps its number, so that a keyframe of it fits; frames before it stay.
    """
    if stride == 1:
        return rig
    sources = tuple(StridedSource(source, first, stride) for source in rig.sources)
    return replace(
        rig,
        sources=sources,
        frame_count=sources[0].frame_count,
        fps=None if rig.fps is None else rig.fps / stride,
    )
