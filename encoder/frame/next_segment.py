"""Closed segments: every one starts from the first keyframe's Gaussians, as a closed GOP of a video starts afresh.

A segment then depends on the first keyframe, the first frame's pictures and those of its own frames and of the next
one's first, and on nothing else, so that segments can be encoded independently (`parts`). Gaussians that never
change have the same bits in the whole stream, across all segments. The frames before a start are faded into it, so that
it is not visible: the next segment is trained backwards from its start for a few frames, and `frame.cross_fade` mixes.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from decogs.codec.scene.state import State, changed_between
from decogs.rig.pictures.ingest import RigFrame

from ..backends.scene_views import SceneViews
from ..coding.scene import Scene
from ..settings.encode import EncodeSettings
from .context import Context
from .cross_fade import CrossFade, fade_cameras
from .encode_frame import Encoded, Task, compensate_and_classify, train_and_code
from .events import Kind
from .memory import Memory

_LAST_SHARE = 0.9
"""Share of the next segment in the last frame before it. Below 1, since training lags behind its target."""


def with_following(
    frames: Iterable[RigFrame], first: int, settings: EncodeSettings
) -> Iterator[tuple[RigFrame, Sequence[RigFrame]]]:
    """Every frame, with those up to the start of the next segment if it is faded into that, else none.

    ``first``: the take's first frame. A take's last segment has none after it.
    """
    waiting: deque[RigFrame] = deque()
    for frame in frames:
        waiting.append(frame)
        left = -(frame.index - first) % settings.segment if settings.fading else 0
        while waiting and (not left or left > settings.fading):
            now = waiting.popleft()
            yield now, tuple(waiting)
    while waiting:
        yield waiting.popleft(), ()


@dataclass(frozen=True)
class NextSegment:
    """The closed segment from the rig's frame ``start`` on, encoded backwards over the last frames before it.

    ``origin``: the keyframe's state from which it starts. ``first``: its first frame, encoded; None where that begins
    another scene. ``scenes``: by frame, as far as they show the same one. ``fade_views``: where two segments are
    compared. ``length``: frames of its fade.
    """

    start: int
    origin: State
    first: Encoded | None
    scenes: Mapping[int, Scene]
    fade_views: SceneViews
    length: int

    def fade(self, frame: int, scene: Scene) -> CrossFade | None:
        """The fade of ``frame``; ``scene``: before it. None where the two segments do not show the same scene."""
        mine, origin = scene.state, self.origin
        old = np.isin(mine.ids, origin.ids, assume_unique=True)
        if frame not in self.scenes or not old.any():
            return None
        theirs = self.scenes[frame]
        differ = origin.ids[changed_between(origin, mine) | changed_between(origin, theirs.state)]
        share = _LAST_SHARE * (self.length + 1 - (self.start - frame)) / self.length
        rows = np.flatnonzero(~old | np.isin(mine.ids, differ, assume_unique=True))
        return CrossFade(theirs.splats, share, rows, self.fade_views)


def train_next_segment(context: Context, scene: Scene, memory: Memory, frames: Sequence[RigFrame]) -> NextSegment:
    """Trains the next segment backwards from its start: ``frames`` are those before it and its first one."""
    start, unlogged = frames[-1].index, replace(context, on_loss=None)
    origin = scene.first
    first: Encoded | None = None
    scenes: dict[int, Scene] = {}
    for offset, frame in enumerate(reversed(frames)):
        # Frames are counted on from the start, not back, as an encode expects.
        task = Task(replace(frame, index=start + offset))
        pending = compensate_and_classify(unlogged, scene, memory, task)
        if pending.kind is Kind.CUT:
            break
        if not offset:
            origin = pending.scene.state
        encoded = train_and_code(unlogged, pending, task)
        scene, memory, first = encoded.scene, encoded.memory, first or encoded
        scenes[frame.index] = scene
    views = SceneViews(context.kernel, lambda: fade_cameras([view.pinhole for view in context.ingest.views]))
    return NextSegment(start, origin, first, scenes, views, context.settings.fading)
