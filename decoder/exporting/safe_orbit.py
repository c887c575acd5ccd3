"""How viewers of an export may circle what it shows, from where its cameras stood."""

from __future__ import annotations

import numpy as np

from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.geometry.similarity import Similarity
from decogs.formats.splat_files.spz import SafeOrbit

from ..cameras.moves import looked_at

_MARGIN = np.deg2rad(12)
"""Above and below all cameras, as the player's limits have it."""
_NEAREST_SHARE = 0.6
"""Of the nearest camera's distance: nearer, what a view holds was not measured."""


def safe_orbit(cameras: tuple[Camera, ...], similarity: Similarity) -> SafeOrbit | None:
    """About as high as the cameras stand around what they look at, and not much nearer, in the world of a file whose up
    is Y, after the ``similarity``; None where no camera stands away from there."""
    if not cameras:
        return None
    target = looked_at(cameras)
    away = np.array([camera_centre(camera) - target for camera in cameras]) @ similarity.rotation.T
    distances = np.linalg.norm(away, axis=1)
    if not distances.all():
        return None
    elevations = np.arcsin(np.clip(away[:, 1] / distances, -1, 1))
    least, most = elevations.min() - _MARGIN, elevations.max() + _MARGIN
    bounds = max(float(least), -np.pi / 2), min(float(most), np.pi / 2)
    return SafeOrbit(bounds, _NEAREST_SHARE * similarity.scale * float(distances.min()))
