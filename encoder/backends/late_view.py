"""A fixed view of a camera whose pictures are taken a part of a frame after the others', or row after row.

What moves is drawn where it is by then, at constant velocity: a Gaussian at x that was at b a frame before is drawn at
x + late (x - b), and its gradient is 1 + late times as large. Without it, cameras half a frame apart pull what moves to
two places, and rolling shutters pull it apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import distort_pixels
from decogs.decoder.rasterise.native import RowArray
from decogs.formats.cameras import Camera, as_pinhole, project
from decogs.formats.rigs.timeline import RowTimes
from decogs.formats.splats import FloatArray, Splats

from .protocol import Drawable, FixedView, LossValue, SplatGradients


@dataclass(frozen=True)
class PictureClock:
    """When a ``camera``, its lens included, records what its pictures show; ``times``: of its rows."""

    times: RowTimes
    camera: Camera

    def late(self, means: FloatArray, motion: FloatArray) -> FloatArray:
        """Frames (N, 1) after the picture's instant at which Gaussians at ``means`` (N, 3) then are recorded.

        ``motion`` (N, 3): what they move in a frame. One row is that at which they are by its own time.
        """
        late = self._late_at(means)
        return late if not self.times.readout else self._late_at(means + late * motion)

    def _late_at(self, xyz: FloatArray) -> FloatArray:
        if not self.times.readout:
            return np.full((len(xyz), 1), self.times.late, np.float32)
        column, row, depth = project(as_pinhole(self.camera), xyz)
        seen = (depth > 0) & np.isfinite(column) & np.isfinite(row)
        pixels = np.where(seen[:, None], np.stack([column, row], axis=1), 0.0)
        share = distort_pixels(self.camera, pixels)[:, 1] / self.camera.height
        share = np.where(seen & np.isfinite(share), np.clip(share, 0, 1), 0.5)
        return np.asarray(self.times.at(share), np.float32)[:, None]


class LateView:
    """A `FixedView` whose pictures are taken at their ``clock``'s times.

    Masks and losses see it as any other: its scene is where it is when its picture is taken. Gaussians under training
    are read into the host's memory for it.
    """

    def __init__(self, view: FixedView, clock: PictureClock) -> None:
        self._view, self._clock = view, clock
        self.camera: Camera = view.camera
        self._scene: Splats | None = None
        self._shown: Splats | None = None
        self._ahead: RowArray = np.zeros(0, np.int64)  # those that are not where the scene has them
        self._drawn: NDArray[np.bool_] = np.zeros(0, np.bool_)
        self._late: FloatArray = np.zeros((0, 1), np.float32)

    @property
    def rgb(self) -> FloatArray:
        return self._view.rgb

    @property
    def alpha(self) -> FloatArray:
        return self._view.alpha

    @property
    def depth(self) -> FloatArray:
        return self._view.depth

    @property
    def met(self) -> NDArray[np.uint8]:
        return self._view.met

    def set_scene(self, scene: Splats) -> None:
        """A scene that is known from ``commit`` goes on as it moved; of another one nothing is known to move."""
        if scene is not self._scene:
            self._scene = self._shown = scene
            self._ahead = np.zeros(0, np.int64)
        assert self._shown is not None
        self._view.set_scene(self._shown)

    def refresh(self) -> None:
        self._view.refresh()

    def redraw(self, marks: NDArray[np.bool_] | None = None) -> FloatArray:
        return self._view.redraw(marks)

    def detach(self, rows: RowArray) -> None:
        self._view.detach(rows)

    def draw(self, moving: Drawable, rows: RowArray, *, depth: bool = False) -> None:
        assert self._scene is not None
        values: Splats = moving if isinstance(moving, Splats) else moving.splats
        before = self._scene.means
        self._drawn = rows < len(before)
        motion = np.zeros_like(values.means)
        motion[self._drawn] = values.means[self._drawn] - before[rows[self._drawn]]
        self._late = self._clock.late(values.means, motion)
        self._view.draw(_moved(values, self._late * motion), rows, depth=depth)

    def loss(
        self,
        target: FloatArray,
        *,
        l1_scale: float,
        ssim_scale: float,
        l1_weight: FloatArray | None = None,
        focus: FloatArray | None = None,
    ) -> LossValue:
        return self._view.loss(target, l1_scale=l1_scale, ssim_scale=ssim_scale, l1_weight=l1_weight, focus=focus)

    def backward(self, v_rgb: FloatArray | None = None, *, out: SplatGradients | None = None) -> SplatGradients:
        gradients = self._view.backward(v_rgb, out=out).host()
        gradients.means[self._drawn] *= 1 + self._late[self._drawn]
        return gradients

    def commit(self, scene: Splats, rows: RowArray, renumbered: RowArray | None = None) -> None:
        """Also what moved up to now and stays, or goes on otherwise, is put where it is at its picture's time."""
        assert self._scene is not None
        before = self._scene.means
        new = np.arange(len(before)) if renumbered is None else renumbered
        stale = self._ahead[new[self._ahead] >= 0]
        self._view.detach(stale)
        old = np.full(len(scene), -1)
        old[new[new >= 0]] = np.flatnonzero(new >= 0)
        known = rows[old[rows] >= 0]
        motion = scene.means[known] - before[old[known]]
        goes = motion.any(axis=1)
        self._ahead, motion = known[goes], motion[goes]
        means = scene.means.copy()
        means[self._ahead] += self._clock.late(means[self._ahead], motion) * motion
        self._scene, self._shown = scene, replace(scene, means=means)
        self._view.commit(self._shown, np.union1d(rows, new[stale]), renumbered)

    def squared_error(self, picture: FloatArray, counted: FloatArray | None = None) -> float:
        return self._view.squared_error(picture, counted)

    def centres(self) -> FloatArray:
        return self._view.centres()


def _moved(splats: Splats, by: FloatArray) -> Splats:
    return replace(splats, means=np.ascontiguousarray(splats.means + by, np.float32))
