"""A stream played through a fixed camera: frame after frame, only what changed is rendered again.

Gaussians that a delta does not name keep their bits, so that the camera's picture of them is kept as well: their
ellipses, the tiles they meet, and every tile that nothing touched. The pixels are those of ``render_view``.
"""

from __future__ import annotations

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import Correction
from decogs.codec.packets.deltas import Delta, rows_after
from decogs.codec.scene.state import Rows, State, same_scene
from decogs.formats.cameras import Camera

from ..cameras.corrections import with_recorded_colours
from ..rasterise import Rendering
from ..rasterise.faces_view import incremental_view
from ..reading.frame import DecodedFrame
from .views import behind_subject, correction_of, max_pairs, through_lens, view_plan


class PlayedView:
    """What one camera sees of a stream's frames, shown one after the other; options as in ``render_view``.

    Any frame may come next: after a seek or at a keyframe the whole picture is rendered, otherwise what changed, unless
    the camera was turned in between. A camera of the rig shows what it recorded, or the scene's own colours through its
    calibrated pose when ``drift_free``.
    """

    def __init__(
        self,
        header: StreamHeader,
        view: str | Camera,
        *,
        scale: float = 1.0,
        background: tuple[float, float, float] | None = None,
        undistorted: bool = False,
        threads: int = 0,
        drift_free: bool = False,
        max_memory: int | None = None,
    ) -> None:
        self._header, self._wanted, self._drift_free, self._max_memory = header, view, drift_free, max_memory
        self._scale, self._undistorted, self._threads = scale, undistorted, threads
        self._background = header.background if background is None else background
        self._shown: State | None = None
        self._correction: Correction | None = None
        self._seen: Rendering | None = None
        self._rendering: Rendering | None = None
        self._stand()
        self.redrawn = 0
        """How many tiles the last frame shown had rendered again."""

    def show(self, frame: DecodedFrame) -> Rendering:
        """The picture of a frame; its arrays are read-only and may change when the next one is shown.

        It is the very object of the frame shown before when no pixel can have changed.
        """
        before, self._correction = self._correction, self._correction_in(frame)
        if _turned(self._correction) != _turned(before):
            self._stand()
        shown, self._shown = self._shown, None  # a refused scene leaves nothing to go on from
        self._follow(shown, frame)
        self._shown = frame.state
        self.redrawn = self._view.redraw()
        if self._seen is None or self.redrawn:
            seen = Rendering(self._view.image, self._view.alpha, self._view.depth)
            self._seen, self._rendering = through_lens(self._plan, seen, self._background), None
        if self._rendering is None or self._correction != before:
            self._rendering = self._coloured(self._seen)
        return self._rendering

    def _correction_in(self, frame: DecodedFrame) -> Correction | None:
        return None if self._drift_free else correction_of(self._header, self._wanted, frame.corrections)

    def _coloured(self, seen: Rendering) -> Rendering:
        if self._correction is None:
            return seen
        behind = behind_subject(self._header, self._background)
        recorded = with_recorded_colours(seen, self._plan.camera, self._correction, behind)
        recorded.image.flags.writeable = False
        return recorded

    def _stand(self) -> None:
        """Begins anew with the camera as it stands in this frame."""
        self._plan = view_plan(
            self._header,
            self._wanted,
            scale=self._scale,
            undistorted=self._undistorted,
            correction=self._correction,
            max_memory=self._max_memory,
        )
        self._view = incremental_view(self._plan.render_camera, self._background, threads=self._threads)
        self._shown = self._seen = self._rendering = None

    def _follow(self, shown: State | None, frame: DecodedFrame) -> None:
        """Brings the view's scene from what it has shown to that of the frame."""
        if shown is not None and same_scene(shown, frame.state):
            return
        self._view.allow(max_pairs(self._header, len(frame.state), self._plan, self._max_memory))
        delta = None if shown is None else frame.delta_from(shown)
        if shown is None or delta is None:
            self._view.set_scene(frame.splats)
        else:
            self._change(shown, delta, frame)

    def _change(self, before: State, delta: Delta, frame: DecodedFrame) -> None:
        after = frame.state
        touched = np.zeros(len(before), bool)
        touched[delta.rows] = touched[delta.removed] = True
        detached = np.flatnonzero(touched)
        touched[delta.removed] = False
        added = np.arange(len(after) - len(delta.added), len(after))
        changed = np.concatenate([rows_after(delta.removed, np.flatnonzero(touched)), added])
        self._view.change(
            detached,
            frame.splats_of(changed),
            changed,
            population=len(after),
            renumbered=_renumbered(len(before), delta.removed) if len(delta.removed) else None,
        )


def _turned(correction: Correction | None) -> tuple[int, int, int]:
    return (0, 0, 0) if correction is None else (correction.yaw, correction.pitch, correction.roll)


def _renumbered(population: int, removed: Rows) -> Rows:
    """Every row's new one, -1 for removed ones."""
    stays = np.ones(population, np.int64)
    stays[removed] = 0
    renumbered: Rows = np.cumsum(stays) - 1
    renumbered[removed] = -1
    return renumbered
