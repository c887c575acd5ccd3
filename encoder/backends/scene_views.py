"""Views of a scene, redrawn only where it changed: the pictures that masks, selection and training use."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats

from .late_view import LateView, PictureClock
from .protocol import FixedView, TrainingKernel


class SceneViews(Sequence[FixedView]):
    """One fixed view for each of the ``cameras``, made when first needed.

    A scene's pictures are asked for by scene: it is drawn unless the views have it already. ``clocks``: of cameras
    whose pictures are not taken at their instant. ``recorded``: by camera, where its pictures were, None meaning
    everywhere.
    """

    def __init__(
        self,
        kernel: TrainingKernel,
        cameras: Callable[[], Sequence[Camera]],
        clocks: Mapping[str, PictureClock] | None = None,
        recorded: Mapping[str, NDArray[np.bool_] | None] | None = None,
    ) -> None:
        self._kernel, self._cameras, self._clocks, self._recorded = kernel, cameras, clocks or {}, recorded or {}
        self._views: list[FixedView] = []
        self._drawn: Splats | None = None

    def __len__(self) -> int:
        return len(self._views)

    def __getitem__(self, index: int) -> FixedView:  # type: ignore[override]
        return self._views[index]

    def of(self, scene: Splats) -> SceneViews:
        """The views, with this scene drawn in all of them."""
        if not self._views:
            self._views += [self._view(camera) for camera in self._cameras()]
        if self._drawn is not scene:
            for view in self._views:
                view.set_scene(scene)
                view.refresh()
            self._drawn = scene
        return self

    def _view(self, camera: Camera) -> FixedView:
        view = self._kernel.fixed_view(camera, self._recorded.get(camera.name))
        clock = self._clocks.get(camera.name)
        return view if clock is None else LateView(view, clock)

    def pictures(self, scene: Splats) -> list[FloatArray]:
        """This scene through the views, (3, H, W) each."""
        return [view.rgb for view in self.of(scene)]

    def detach(self, rows: NDArray[np.int64]) -> None:
        """Takes Gaussians out of the static part, to train them; the views then have no whole scene."""
        self._drawn = None
        for view in self._views:
            view.detach(rows)

    def update(
        self, scene: Splats, trained: NDArray[np.int64], before: NDArray[np.int64], after: NDArray[np.int64]
    ) -> None:
        """Updates the views to ``scene``, in which only the rows ``trained`` (M,) of the scene before training differ.

        ``before``, ``after``: the Gaussians' ids, ascending, in that scene and in this one.
        """
        renumbered = np.searchsorted(after, before)
        renumbered[~np.isin(before, after, assume_unique=True)] = -1
        new = np.flatnonzero(~np.isin(after, before, assume_unique=True))
        rows = np.concatenate([np.setdiff1d(renumbered[trained], [-1]), new])
        for view in self._views:
            view.commit(scene, rows, renumbered)
            view.refresh()
        self._drawn = scene

    def release(self) -> None:
        """Frees the views; the next scene that is asked for makes them again."""
        self._views.clear()
        self._drawn = None
