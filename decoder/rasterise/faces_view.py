"""An `IncrementalView` of a very wide pinhole: those of its faces, of which only what changed is put together anew."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats

from .faces import Face, faces_of
from .incremental_view import IncrementalView


def incremental_view(
    camera: Camera, background: tuple[float, float, float], *, threads: int = 0
) -> IncrementalView | FacesView:
    """What keeps the picture of the pinhole ``camera`` up to date."""
    faces = faces_of(camera)
    if not faces:
        return IncrementalView(camera, background, threads=threads)
    return FacesView(camera, faces, background, threads=threads)


class FacesView:
    """As `IncrementalView`, of the ``faces`` of a wide ``camera``."""

    def __init__(
        self, camera: Camera, faces: Sequence[Face], background: tuple[float, float, float], *, threads: int = 0
    ) -> None:
        self._faces = [(face, IncrementalView(face.camera, background, threads=threads)) for face in faces]
        size = camera.height, camera.width
        self.image: FloatArray = np.zeros((*size, 3), np.float32)
        self.alpha: FloatArray = np.zeros(size, np.float32)
        self.depth: FloatArray = np.zeros(size, np.float32)

    def allow(self, max_pairs: int) -> None:
        """As `IncrementalView.allow`, of each face."""
        for _, view in self._faces:
            view.allow(max_pairs)

    def set_scene(self, scene: Splats) -> None:
        """As `IncrementalView.set_scene`."""
        for _, view in self._faces:
            view.set_scene(scene)

    def change(self, *changes: Any, **options: Any) -> None:
        """As `IncrementalView.change`."""
        for _, view in self._faces:
            view.change(*changes, **options)

    def redraw(self) -> int:
        """As `IncrementalView.redraw`, of all faces together."""
        redrawn = 0
        for face, view in self._faces:
            tiles = view.redraw()
            if tiles:
                face.put_all(view, self)
            redrawn += tiles
        return redrawn
