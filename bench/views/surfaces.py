"""What a scene's surfaces say of a viewpoint: which of its pixels the rig sees, and what hangs in the air before them.

Surfaces are those of a reference: the same frame encoded with every camera, the judged one included. It only measures.
Chosen over the judged scene's own surfaces: what haze hides must count as seen, and two encodes are compared on the
same pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.decoder.cameras.lens import Redistortion
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import Camera, as_pinhole, camera_centre, in_picture, project, ray_slopes, turned
from decogs.formats.splats import Splats, take_splats

from ..measures.metrics import Mask

AGREES = 0.05
"""A camera sees a surface where its own depth there differs by at most this share."""
SPECK = 5
"""Side in pixels of the window whose median a map of what is seen takes: a reference's depths are not exact."""
FREE = 0.9
"""Space is free up to this share of a surface's depth: a Gaussian that ends before it stands in the air."""
SOLID = 0.5
"""A pixel shows a surface where the reference's opacity is at least this."""


@dataclass(frozen=True)
class Air:
    """What stands in free space before a camera.

    ``haze``: alpha before the first surface, mean over the pixels that show one. ``floaters``: Gaussians that make
    it.
    """

    haze: float
    floaters: int


class Surfaces:
    """Depths of a reference scene, seen from any camera; nothing is trained."""

    def __init__(self, header: StreamHeader, scene: Splats, threads: int) -> None:
        self._header, self._scene, self._threads = header, scene, threads
        self._depths: dict[str, NDArray[np.float64]] = {}

    def depth(self, camera: Camera) -> NDArray[np.float64]:
        """(H, W) depth of the surface in every pixel of a pinhole camera, world units; NaN where there is none."""
        seen = render_view(self._header, self._scene, camera, threads=self._threads)
        return np.where(seen.alpha >= SOLID, seen.depth, np.nan).astype(np.float64)

    def seen_by(self, camera: Camera, others: Sequence[Camera]) -> NDArray[np.int64]:
        """(H, W) of ``camera``, lens included: how many of the ``others`` see the surface that a pixel shows."""
        plan = Redistortion(camera)
        pinhole = plan.render_camera
        points = _points(pinhole, self.depth(pinhole))
        count = np.zeros((pinhole.height, pinhole.width), np.int64)
        for other in map(as_pinhole, others):
            if other.name not in self._depths:
                self._depths[other.name] = self.depth(other)
            count += _shows(other, self._depths[other.name], points).reshape(count.shape)
        smooth = cv2.medianBlur(plan.apply(count.astype(np.float32), nearest=True), SPECK)
        return np.asarray(smooth, np.int64)

    def air(self, header: StreamHeader, scene: Splats, camera: Camera) -> Air:
        """What of another ``scene``, of the same rig, hangs before these surfaces as ``camera`` sees them."""
        pinhole = Redistortion(camera).render_camera
        depth = self.depth(pinhole)
        column, row, distance = project(pinhole, scene.means)
        inside = np.flatnonzero(in_picture(pinhole, column, row, distance))
        behind = depth[row[inside].astype(int), column[inside].astype(int)]
        reach = distance[inside] + np.exp(scene.log_scales[inside].max(axis=1))
        floating = take_splats(scene, inside[reach < FREE * behind])
        if not len(floating) or np.isnan(depth).all():
            return Air(0.0, len(floating))
        seen = render_view(header, floating, pinhole, threads=self._threads)
        return Air(float(seen.alpha[~np.isnan(depth)].mean()), len(floating))


def midway(camera: Camera, others: Sequence[Camera]) -> Camera:
    """A viewpoint between a camera and its nearest neighbour, looking as the camera does."""
    own = camera_centre(camera)
    nearest = min((camera_centre(other) for other in others), key=lambda centre: float(np.linalg.norm(centre - own)))
    moved = camera.world_to_camera.copy()
    moved[:3, 3] = -turned(moved[:3, :3], (own + nearest) / 2)
    return replace(as_pinhole(camera), name=f"beside {camera.name}", world_to_camera=moved)


def in_two(count: NDArray[np.int64]) -> Mask:
    """Pixels whose surface at least two cameras see: what can be triangulated."""
    return np.asarray(count >= 2)


def _points(camera: Camera, depth: NDArray[np.float64]) -> NDArray[np.float64]:
    """World points (H * W, 3) of a pinhole's depths; NaN where there is none."""
    row, column = np.indices(depth.shape) + 0.5
    x, y = ray_slopes(camera, column, row)
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    return turned(rotation.T, (np.stack([x * depth, y * depth, depth], axis=-1) - translation).reshape(-1, 3))


def _shows(camera: Camera, depth: NDArray[np.float64], points: NDArray[np.float64]) -> Mask:
    """Whether each point is what the camera sees at its pixel."""
    column, row, distance = project(camera, points)
    inside = in_picture(camera, column, row, distance) & ~np.isnan(distance)
    depths = np.full(len(points), np.nan)
    depths[inside] = depth[row[inside].astype(int), column[inside].astype(int)]
    return np.asarray(np.abs(depths - distance) <= AGREES * distance)
