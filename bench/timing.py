"""A rig played in another timing, which the encoder takes like any other: every k-th frame, there and back, faster.

Chosen: an order of the recorded frames, so that one rig covers slow and fast, steady and turning motion with the same
pictures and the same truth. Rejected: rendered variants of each rig (other pictures, so that rows do not compare).
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, replace

from decogs.formats.pictures.reading import Picture
from decogs.formats.rigs import Rig
from decogs.formats.rigs.sources import SourceOfAnother


def _there_and_back(frames: range) -> list[int]:
    """Every second frame, then back over those in between: as many as there are, and motion turns half way."""
    return [*frames[::2], *frames[::-1][len(frames) % 2 :: 2]]


def _ever_faster(frames: range) -> list[int]:
    """Steps of 1, 1, 2, 2, 3, 3, ... frames: motion accelerates steadily."""
    order, step = [frames.start], 2
    while order[-1] + step // 2 < frames.stop:
        order.append(order[-1] + step // 2)
        step += 1
    return order


TIMINGS: Mapping[str, Callable[[range], list[int]]] = {
    "there-and-back": _there_and_back,
    "ever-faster": _ever_faster,
}
"""Orders of frames by name; each begins with the first."""


@dataclass(frozen=True)
class RetimedSource(SourceOfAnother):
    """One camera's frames up to the first of ``order`` as they are, and from there those of ``order``."""

    order: tuple[int, ...]
    fps: float | None

    @property
    def frame_count(self) -> int:
        return self.order[0] + len(self.order)

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """Frames ``start`` to ``stop``, counted as they are shown; pictures wait in memory where the order turns."""
        wanted = [self._index(shown) for shown in range(start, stop, step)]
        waiting: dict[int, Picture] = {}
        due = 0
        for index, picture in enumerate(self.source.read(min(wanted), max(wanted) + 1), min(wanted)) if wanted else ():
            if index in wanted[due:]:
                waiting[index] = picture
            while due < len(wanted) and wanted[due] in waiting:
                shown, due = wanted[due], due + 1
                yield waiting[shown] if shown in wanted[due:] else waiting.pop(shown)

    def _index(self, shown: int) -> int:
        first = self.order[0]
        return shown if shown < first else self.order[shown - first]


def retimed(rig: Rig, order: Sequence[int]) -> Rig:
    """The rig with only the frames of ``order`` from the first of them on.

    That one keeps its number, so that a keyframe of it fits; frames before it stay. The rate falls with the first step.
    """
    if list(order) == list(range(order[0], rig.frame_count)):
        return rig
    step = order[1] - order[0] if len(order) > 1 else 1
    fps = None if rig.fps is None else rig.fps / step
    sources = tuple(RetimedSource(source, tuple(order), fps) for source in rig.sources)
    return replace(rig, sources=sources, frame_count=sources[0].frame_count, fps=fps)
