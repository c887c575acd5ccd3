"""Where the selected Gaussians have gone since the frame before, by the optical flow in the views.

Each view's flow leads from its rendering of the scene before to its new picture. A Gaussian's displacement is the one
whose projections fit the flow wherever the views see it: robust least squares, and then the median over neighbours,
which what no two views tell takes from others. Where a picture did not change, its flow is none: the flow's patches
carry what moves onto what is still beside it.

Chosen: flow from the rendering, so that errors do not add up and nothing is remembered. Rejected: the neighbourhood's
last displacement, which knows nothing of what starts, turns or speeds up; flow from the picture before, a second round
from where the first one leads, Gaussians turned as their neighbourhoods turn (no gain, all three); staying wherever
that explains the new picture better than the flow does (loses where things of one colour move).
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import in_picture, project
from decogs.formats.splats import FloatArray
from decogs.rig.numerics import bilinear, floats, nearest
from decogs.rig.parallel import side_by_side
from decogs.rig.pictures.optical_flow import MAX_APART_PIXELS, flow_and_back

from .frame_training import FrameTraining
from .working_set import WorkingSet

_NEIGHBOUR_GAUSSIANS = 8
"""Nearest Gaussians with a displacement whose median is taken. Sixteen: the same."""
_WIDTH = 320
"""Pixels across, about, of pictures that are halved, thirded and so on for flow: larger ones gain nothing."""
_AROUND_PIXELS, _LEAST_PIXELS = 24, 24
"""Of a region of interest that flow may need; of pictures' sides, below which there is none."""
_SURFACE_DEPTHS = 0.03
"""Of its depth, by which a Gaussian may lie behind what a view shows there and still be seen."""
_FIT_PIXELS, _FIT_SHARE = 1.0, 0.15
"""Errors that a view's flow usually has: so much, and more by a share of itself."""
_FIT_SLACK = (4.0, 2.0, 1.0)
"""Times these errors at which a view counts a quarter, round by round."""
_LEAST_VIEWS = 2
_DAMPING = 1e-3
"""Of the mean certainty: two views say little of what goes away from both."""


class _Flow(NamedTuple):
    """What a view tells of the Gaussians ``rows`` (R,): ``flow`` (R, 2) in pixels, ``slopes`` (R, 2, 3) by position."""

    rows: NDArray[np.int64]
    slopes: NDArray[np.float64]
    flow: NDArray[np.float64]


def followed(training: FrameTraining, work: WorkingSet) -> FloatArray:
    """The means (M, 3) of ``work``, moved on by the share ``warm_start`` of what the views' flow says.

    The views show the scene before. What light alone changes stays, and so do a backdrop, over which shadows move, and
    everything where light changes most.
    """
    means, share = work.values.means, np.float32(training.settings.warm_start)
    may_move = np.ones(len(means), bool)
    if training.frame.light_only is not None:
        may_move &= ~training.frame.light_only[work.rows]
    if training.frame.stage is not None:
        may_move &= ~training.frame.stage.on_backdrop(means)
    if not share or training.frame.relit or not may_move.any():
        return means
    places, sigmas = means[may_move], np.exp(work.values.log_scales[may_move]).max(axis=1)
    with side_by_side(training.context.threads) as each:
        flows = list(each(lambda index: _flow_of(training, index, places, sigmas), training.used))
    displacements, known = _fitted(flows, len(places))
    if not known.any():
        return means
    moved: FloatArray = means.copy()
    moved[may_move] += share * shared_displacements(places[known], displacements[known], _NEIGHBOUR_GAUSSIANS, places)
    return moved


def _flow_of(training: FrameTraining, index: int, means: FloatArray, sigmas: FloatArray) -> _Flow:
    """What one view tells of the Gaussians that it sees in its region of interest, where its flow is sure."""
    view, focus = training.context.static_views[index], training.focus(index)
    camera = training.context.views[index].pinhole
    u, v, depth = project(camera, means)
    rows = np.flatnonzero(in_picture(camera, u, v, depth))
    at = v[rows].astype(np.int64), u[rows].astype(np.int64)
    surface = view.depth[at] / np.maximum(view.alpha[at], 1e-3)
    is_seen = focus[at] & (depth[rows] - sigmas[rows] <= (1 + _SURFACE_DEPTHS) * surface)
    rows, is_still = rows[is_seen], ~training.frame.masks[index].raw[at][is_seen]
    told, is_sure = _flow_at(view.rgb, training.frame.pictures[index], focus, u[rows], v[rows])
    told[is_still] = 0
    rows, told = rows[is_sure | is_still], told[is_sure | is_still]
    z, slopes = depth[rows], np.zeros((len(rows), 2, 3))
    slopes[:, 0, 0], slopes[:, 0, 2] = camera.fx / z, (camera.cx - u[rows]) / z
    slopes[:, 1, 1], slopes[:, 1, 2] = camera.fy / z, (camera.cy - v[rows]) / z
    return _Flow(rows, slopes @ camera.world_to_camera[:3, :3].astype(np.float64), told)


def _flow_at(
    before: FloatArray, after: FloatArray, focus: NDArray[np.bool_], u: NDArray[np.float64], v: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Flow (P, 2), pixels, between two pictures (3, H, W) at places of their ``focus`` (H, W), and where it is sure."""
    if not len(u) or min(focus.shape) < _LEAST_PIXELS:
        return np.zeros((len(u), 2)), np.zeros(len(u), bool)
    shrink = max(1, round(max(focus.shape) / _WIDTH))
    part = _around(focus, shrink * _AROUND_PIXELS)
    first, second = (_grey(picture[:, part[0], part[1]], shrink) for picture in (before, after))
    there, back = flow_and_back(first, second, smooth=False)
    across, down = (u - part[1].start) / shrink, (v - part[0].start) / shrink
    flow = bilinear(there, across, down)
    returned = bilinear(back, across + flow[:, 0], down + flow[:, 1])
    return shrink * flow.astype(np.float64), np.linalg.norm(flow + returned, axis=1) <= MAX_APART_PIXELS


def _around(focus: NDArray[np.bool_], pixels: int) -> tuple[slice, slice]:
    """The rectangle around a region (H, W), and so many pixels more."""
    sides = (np.flatnonzero(focus.any(axis=axis)) for axis in (1, 0))
    down, across = (slice(max(0, int(at[0]) - pixels), int(at[-1]) + 1 + pixels) for at in sides)
    return down, across


def _grey(picture: FloatArray, shrink: int) -> FloatArray:
    """The mean of a picture's channels (3, H, W), and of ``shrink`` by ``shrink`` pixels."""
    grey = floats(picture.mean(axis=0))
    if shrink == 1:
        return grey
    height, width = (side // shrink for side in grey.shape)
    return floats(cv2.resize(grey[: height * shrink, : width * shrink], (width, height), interpolation=cv2.INTER_AREA))


def _fitted(flows: list[_Flow], count: int) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Displacements (M, 3) that fit the views' flow, and which of them two views or more agree on."""
    displacements, agreeing = np.zeros((count, 3)), np.zeros(count, np.int64)
    for number in range(1 + len(_FIT_SLACK)):
        matrix, vector = np.zeros((count, 3, 3)), np.zeros((count, 3))
        agreeing[:] = 0
        for rows, slopes, flow in flows:
            weights = np.ones(len(rows))
            if number:
                misses = np.linalg.norm(np.einsum("nij,nj->ni", slopes, displacements[rows]) - flow, axis=1)
                usual = (_FIT_PIXELS + _FIT_SHARE * np.linalg.norm(flow, axis=1)) * _FIT_SLACK[number - 1]
                weights = 1 / np.square(1 + np.square(misses / usual))
                agreeing[rows] += misses < 2 * usual
            matrix[rows] += weights[:, None, None] * np.einsum("nki,nkj->nij", slopes, slopes)
            vector[rows] += weights[:, None] * np.einsum("nki,nk->ni", slopes, flow)
        certainty = np.trace(matrix, axis1=1, axis2=2)
        matrix += (_DAMPING * certainty + np.finfo(np.float64).tiny)[:, None, None] * np.eye(3)
        displacements[:] = np.linalg.solve(matrix, vector[..., None])[..., 0]
    return displacements, agreeing >= _LEAST_VIEWS


def shared_displacements(
    means: FloatArray, displacements: NDArray[np.floating], neighbours: int, places: FloatArray | None = None
) -> FloatArray:
    """The median displacement of the nearest ``neighbours`` among ``means`` to each of ``places`` (P, 3) or means.

    ``means`` and ``displacements``: (M, 3), world units. A mean is its own nearest.
    """
    if not len(means):
        return floats(displacements)
    around, _ = nearest(means, min(neighbours, len(means)), places)
    return np.asarray(np.median(displacements[around], axis=1), np.float32)
