"""First points for what a stage's pictures show and the plane sweep misses."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, in_picture, project
from decogs.formats.splats import FloatArray
from decogs.rig.numerics import floats
from decogs.rig.pictures.ingest import View
from decogs.rig.stage.stage import Stage
from decogs.rig.stage.views import stage_view

from ...training.hull_points import hull_points, rule_of, subject_pixels
from . import FirstPoints

_MAX_SHARE = 0.5
"""Of the first points that there may be, the share of those that the hull alone gives."""
_CONFIDENCE = 0.5
_MAX_REACH_PIXELS = 4
"""Of a point's cover in a picture, from its middle."""


def with_missed(
    points: FirstPoints,
    stage: Stage | None,
    views: Sequence[View],
    pictures: Sequence[FloatArray],
    *,
    most: int,
    threads: int,
) -> FirstPoints:
    """The points, with those of a ``stage``'s hull where a view shows subject and its ray meets no point.

    ``pictures`` (3, H, W), one for each of the ``views``; ``most``: points that the keyframe may have.
    """
    rule = rule_of(stage)
    if stage is None or rule is None:
        return points
    seen = [stage_view(*each) for each in zip(views, pictures, strict=True)]
    missing = [
        subject & ~_covered(view.camera, points) for view, subject in zip(seen, subject_pixels(stage), strict=True)
    ]
    more = hull_points(stage, seen, missing, rule, most=round(_MAX_SHARE * most), threads=threads)
    return FirstPoints(
        xyz=np.concatenate([points.xyz, floats(more.xyz)]),
        rgb=np.concatenate([points.rgb, np.clip(more.rgb, 0, 1)]),
        spacing=np.concatenate([points.spacing, more.spacing]),
        confidence=np.concatenate([points.confidence, np.full(len(more), _CONFIDENCE, np.float32)]),
        seen=np.concatenate([points.seen, more.seen], axis=1),
        placed=np.concatenate([points.placed, np.ones(len(more), np.bool_)]),
    )


def _covered(camera: Camera, points: FirstPoints) -> NDArray[np.bool_]:
    """Pixels (H, W) whose rays meet a point or its surroundings, as far as its spacing reaches."""
    u, v, depth = project(camera, points.xyz)
    rows = np.flatnonzero(in_picture(camera, u, v, depth))
    reach = np.clip(np.rint(points.spacing[rows] * camera.fx / depth[rows]), 1, _MAX_REACH_PIXELS)
    covered = np.zeros((camera.height, camera.width), np.uint8)
    for pixels in range(1, _MAX_REACH_PIXELS + 1):
        own = np.zeros_like(covered)
        some = rows[reach == pixels]
        own[v[some].astype(np.int64), u[some].astype(np.int64)] = 1
        covered |= cv2.dilate(own, np.ones((2 * pixels + 1,) * 2, np.uint8)).astype(np.uint8)
    return covered.view(np.bool_)
