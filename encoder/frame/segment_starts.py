"""Where closed segments start from: the first keyframe, or that of the scene which a cut has begun.

Segments know nothing of each other, and a part may begin in any of them. So the cut from which a segment starts follows
from pictures alone, and its keyframe from those of its frame: whoever asks finds, and trains, the same one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from decogs.codec.scene.state import State
from decogs.formats.rigs import is_live
from decogs.formats.stream.container import Packet
from decogs.rig.pictures.dropouts import BLACK, blankness
from decogs.rig.pictures.ingest import Ingest, RigFrame
from decogs.rig.stage.stage import Stage

from ..change.cuts import shows_another_scene
from ..input.compensation import CorrectionMemory


@dataclass(frozen=True)
class SceneStart:
    """A scene's first frame: its keyframe's state and packet, its pictures, compensated, its corrections and stage."""

    state: State
    packet: Packet
    frame: RigFrame
    corrections: CorrectionMemory | None
    stage: Stage | None


class SegmentStarts:
    """The stream's ``first`` frame; finds the cuts from which segments start, and keeps the last one's keyframe."""

    def __init__(self, ingest: Ingest, segment: int, first: SceneStart) -> None:
        self._ingest, self._segment, self.first = ingest, segment, first
        self._kept: SceneStart | None = None
        self._cuts: dict[int, int] = {}

    def keep(self, made: SceneStart) -> None:
        """Keeps a cut's keyframe, unless that of a later cut was made already."""
        if self._kept is None or self._kept.frame.index < made.frame.index:
            self._kept = made

    def kept(self, frame: int) -> SceneStart | None:
        """The keyframe of a cut in the rig's ``frame``, if it is the one that is kept."""
        return self._kept if self._kept is not None and self._kept.frame.index == frame else None

    def before(self, frame: RigFrame, train: Callable[[RigFrame], SceneStart | None]) -> SceneStart | None:
        """The keyframe from which the segment starts that begins with ``frame``, another scene than in the first one.

        None where that is ``frame`` itself, or none can be trained. ``train``: makes the keyframe of a cut. A recording
        that goes on is not read twice: there it is the cut before.
        """
        if is_live(self._ingest.rig):
            return None if self._kept is None or self._kept.frame.index == frame.index else self._kept
        cut = self._cut_before(frame)
        if cut == frame.index:
            return None
        start = self.kept(cut) or train(self._frame(cut))
        self._kept = start or self._kept
        return start

    def _cut_before(self, frame: RigFrame) -> int:
        """The rig's frame with which the scene of a segment's first ``frame`` began."""
        first, starts, start = self.first.frame, [frame.index], frame
        while start.index not in self._cuts:
            at = start.index - self._segment
            before = first if at == first.index else self._frame(at)
            is_same = not shows_another_scene(start.training, before.training)
            if is_same and shows_another_scene(before.training, first.training):
                start = before
                starts.append(at)
            else:
                self._cuts[start.index] = self._first_like(start, at)
        self._cuts |= dict.fromkeys(starts, self._cuts[start.index])
        return self._cuts[frame.index]

    def _first_like(self, start: RigFrame, after: int) -> int:
        """The first frame ``after`` another one that is unlike the one before it and like ``start``; else that."""
        frames = self._ingest.frames(after, start.index, first=self.first.frame.index)
        before = next(frames)
        for frame in frames:
            is_whole = not frame.lost and BLACK not in map(blankness, frame.training)
            is_other = shows_another_scene(frame.training, before.training)
            if is_whole and is_other and not shows_another_scene(start.training, frame.training):
                return frame.index
            before = frame
        return start.index

    def _frame(self, index: int) -> RigFrame:
        return next(self._ingest.frames(index, index + 1, first=self.first.frame.index))
