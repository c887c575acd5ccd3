"""Guessed points where views have none, so that training starts with points everywhere.

Two kinds: continued ones on planes of confirmed points that go on beyond them, as dense as these; and sparse ones at
depths that are possible.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from .agreement import depth_ratio
from .cloud import Cloud, ViewDepths, empty_cloud, join, look_from_all, take, too_near
from .depth_filling import continues, fill_depths
from .frusta import DepthRange, rig_size
from .views import Array, SweepView, inside, pixel_rays, project

CELL_PIXELS = 8
"""Side, in pixels, of picture cells, each of which gets a point."""
_GUESS_SPACING = 2.4
"""Distance between guesses over that between confirmed points: more of them would not know their places better."""
_SCARCE_GUESS_SPACING, _SCARCE_FRACTION = 0.045, 0.15
"""Least distance between guesses in a rig whose views confirm nothing, in units of a picture's size (the root of its
pixels), and share of the pixels confirmed from which there is none: where few cameras leave room for many guesses,
these are fog for any other camera. Left-out cameras of rigs with up to .05 gain 2 to 4 dB; fourteen around a room, with
.22, would lose .5."""
_SWEEP_DEPTH_FRACTION = 0.5
"""Share of the guesses at the unconfirmed depth of the view's own sweep, where it is plausible."""
_SCATTER, _WIDE_SCATTER = 0.02, 0.5
"""Relative standard deviation of the depth of the other guesses around that of known points near them: in a view in
which enough is confirmed, and in one in which nothing is."""
_SUFFICIENT_FRACTION = 0.4
"""Sufficient share of confirmed pixels."""
_GUESS_CONFIDENCE = 0.05
_OWN_DEPTHS_FRACTION = 0.01
"""Share of a view's pixels with confirmed depths below which points of other views give its depths."""
_GUESSES_WITHOUT_POINTS = 20_000
"""Total number of guesses without any confirmed point."""
_CONTINUED_SCATTER = 0.003
"""Relative standard deviation of the depth of continued points."""
_CONTINUED_PER_CELL = 16.0
"""Continued points in a cell, at most."""
_BORDER_WIDTHS, _BEFORE_SURFACE = 0.1, 0.8
"""Width of the border of what a lens recorded, in widths of the picture, where nothing is guessed nearer than such a
share of the depth at which a surface goes on in some view: rays there lead far to the side, where no other picture of
the same place contradicts what would hang before a free viewpoint."""
_MIN_DEPTH_FRACTION = 0.9
"""Share of the nearest confirmed depth of any view that sees it at which a guess must lie at least."""


def guess_points(
    cloud: Cloud, all_depths: Sequence[ViewDepths], pixels: float, random: np.random.Generator
) -> tuple[Cloud, NDArray[np.bool_]]:
    """Points where views have none of ``cloud``: near known points, or anywhere in the frusta without these.

    ``pixels``: distance between the points of ``cloud`` in a picture. Also which ones are continued, (P,).
    """
    clouds, continued = [empty_cloud()], [np.zeros(0, np.bool_)]
    if not len(cloud):
        size = rig_size([view_depths.view for view_depths in all_depths]) or 1.0
        each = max(1, _GUESSES_WITHOUT_POINTS // len(all_depths))
        for view_depths in all_depths:
            depths = view_depths.depths or DepthRange(size / 2, size * 5)
            clouds.append(random_in_frustum(view_depths.view, depths, each, random))
        guesses = join(clouds)
        return guesses, np.zeros(len(guesses), np.bool_)
    known = np.mean([np.count_nonzero(_known_depths(each, cloud)) / each.view.pixels for each in all_depths])
    least_spacing = _SCARCE_GUESS_SPACING * max(0.0, 1 - float(known) / _SCARCE_FRACTION)
    has_lenses = any(view_depths.view.recorded is not None for view_depths in all_depths)
    surfaces = [(each, fill_depths(_known_depths(each, cloud))) for each in all_depths if has_lenses]
    for view_depths in all_depths:
        going_on, others = fill_empty_cells(view_depths, join([cloud, *clouds]), pixels, least_spacing, random)
        guess = join([going_on, others])
        right = ~((look_from_all(guess, all_depths).through > 0) | too_near(guess, all_depths, _MIN_DEPTH_FRACTION))
        if view_depths.view.recorded is not None:
            others_surfaces = [surface for surface in surfaces if surface[0] is not view_depths]
            right &= ~(_at_border(view_depths.view, guess) & _hangs_before(guess, others_surfaces))
        clouds.append(take(guess, right))
        continued.append((np.arange(len(guess)) < len(going_on))[right])
    return join(clouds), np.concatenate(continued)


def cell_counts(view: SweepView, xyz: NDArray[np.float64]) -> NDArray[np.int64]:
    """Points per picture cell of 8 x 8 pixels, (rows, columns), without regard to occlusion."""
    u, v, _ = project(view, xyz)
    visible = inside(view, u, v)
    columns, rows = -(-view.width // CELL_PIXELS), -(-view.height // CELL_PIXELS)
    cell = (
        np.round(v[visible]).astype(np.int64) // CELL_PIXELS * columns
        + np.round(u[visible]).astype(np.int64) // CELL_PIXELS
    )
    return np.bincount(cell, minlength=rows * columns).reshape(rows, columns)


def projected_depths(view: SweepView, xyz: NDArray[np.float64]) -> Array:
    """Inverse depths (H, W) of the nearest point in every pixel, 0 where there is none."""
    u, v, depth = project(view, xyz)
    visible = inside(view, u, v) & (depth > 0)
    column, row, depth = np.round(u[visible]).astype(np.int64), np.round(v[visible]).astype(np.int64), depth[visible]
    far_first = np.argsort(-depth, kind="stable")
    inverse = np.zeros((view.height, view.width), np.float32)
    inverse[row[far_first], column[far_first]] = 1 / depth[far_first]
    return inverse


def random_in_frustum(view: SweepView, depths: DepthRange, count: int, random: np.random.Generator) -> Cloud:
    """Random points of the view's colours, evenly over its picture and over inverse depth."""
    column, row = random.integers(0, view.width, count), random.integers(0, view.height, count)
    return _guess(view, column, row, random.uniform(1 / depths.far, 1 / depths.near, count), _GUESS_SPACING)


def _recorded_cells(view: SweepView) -> NDArray[np.bool_]:
    """Picture cells, (rows, columns), of which something was recorded."""
    if view.recorded is None:
        return np.ones((), np.bool_)
    padded = np.pad(view.recorded, [(0, -size % CELL_PIXELS) for size in view.recorded.shape])
    rows, columns = (size // CELL_PIXELS for size in padded.shape)
    return np.asarray(padded.reshape(rows, CELL_PIXELS, columns, CELL_PIXELS).any(axis=(1, 3)))


def _known_depths(view_depths: ViewDepths, cloud: Cloud) -> Array:
    """Inverse depths (H, W) of a view, 0 where unknown: its own ones, or those of ``cloud`` if these are too few."""
    view, confirmed = view_depths.view, view_depths.confirmed
    if confirmed is None or np.count_nonzero(confirmed) < _OWN_DEPTHS_FRACTION * view.pixels:
        return projected_depths(view, cloud.xyz)
    return confirmed


def _at_border(view: SweepView, cloud: Cloud) -> NDArray[np.bool_]:
    """Which of a view's own points (P,) lie at the border of what its lens recorded."""
    assert view.recorded is not None
    framed = np.pad(view.recorded.astype(np.uint8), 1)
    distance = cv2.distanceTransform(framed, cv2.DIST_C, cv2.DIST_MASK_3)[1:-1, 1:-1]
    column, row = (np.round(each).astype(np.int64) for each in project(view, cloud.xyz)[:2])
    return np.asarray(distance[row, column] <= _BORDER_WIDTHS * view.width)


def _hangs_before(cloud: Cloud, surfaces: Sequence[tuple[ViewDepths, Array]]) -> NDArray[np.bool_]:
    """Points (P,) well before the surface of some view: inverse depths (H, W), known and continued; 0 without any."""
    before = np.zeros(len(cloud), np.bool_)
    for view_depths, inverse_depths in surfaces:
        before |= depth_ratio(view_depths.view, inverse_depths, cloud.xyz)[0] < _BEFORE_SURFACE
    return before


def fill_empty_cells(
    view_depths: ViewDepths, cloud: Cloud, pixels: float, least_spacing: float, random: np.random.Generator
) -> tuple[Cloud, Cloud]:
    """Points for the cells of a view in which no point of ``cloud`` falls: continued ones, and sparse ones elsewhere.

    ``least_spacing``: of the sparse ones, in units of the picture's size. Planes are trusted to go on (`continues`) in
    views in which enough is confirmed.
    """
    view = view_depths.view
    empty = np.argwhere((cell_counts(view, cloud.xyz) == 0) & _recorded_cells(view))
    if not len(empty):
        return empty_cloud(), empty_cloud()
    inverse_depths = _known_depths(view_depths, cloud)
    filled = fill_depths(inverse_depths)
    doubt = 1 - min(1.0, np.count_nonzero(inverse_depths) / (_SUFFICIENT_FRACTION * view.pixels))
    spacing = max(_GUESS_SPACING, least_spacing * view.pixels**0.5 / pixels)
    goes_on = continues(inverse_depths) if doubt == 0 else np.zeros(inverse_depths.shape, np.bool_)
    continued = _continued(view, empty, filled, goes_on, pixels, random) if goes_on.any() else empty_cloud()

    column, row = _pixels_of(view, empty, min((CELL_PIXELS / (spacing * pixels)) ** 2, 4.0), random)
    column, row = column[~goes_on[row, column]], row[~goes_on[row, column]]
    scatter = _SCATTER + (_WIDE_SCATTER - _SCATTER) * doubt
    inverse = filled[row, column] * np.exp(scatter * random.standard_normal(len(row)))
    if view_depths.swept is not None and inverse_depths.any():
        low, high = np.percentile(inverse_depths[inverse_depths > 0], [1, 99])
        own = view_depths.swept[row, column]
        use = (random.random(len(row)) < _SWEEP_DEPTH_FRACTION) & (own > 0.8 * low) & (own < 1.1 * high)
        inverse[use] = own[use]
    return continued, _guess(view, column, row, inverse, spacing)


def _continued(
    view: SweepView,
    empty: NDArray[np.int64],
    filled: Array,
    goes_on: NDArray[np.bool_],
    pixels: float,
    random: np.random.Generator,
) -> Cloud:
    """As dense as confirmed points, spaced ``pixels``, where the planes of ``filled`` go on."""
    column, row = _pixels_of(view, empty, min((CELL_PIXELS / pixels) ** 2, _CONTINUED_PER_CELL), random)
    column, row = column[goes_on[row, column]], row[goes_on[row, column]]
    inverse = filled[row, column] * np.exp(_CONTINUED_SCATTER * random.standard_normal(len(row)))
    return _guess(view, column, row, inverse, 1.0)


def _pixels_of(
    view: SweepView, cells: NDArray[np.int64], each: float, random: np.random.Generator
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns and rows of random pixels in cells (C, 2), on average ``each`` in each."""
    count = int(np.ceil(len(cells) * each))
    cell = cells[random.integers(0, len(cells), count)]
    column = np.minimum(cell[:, 1] * CELL_PIXELS + random.integers(0, CELL_PIXELS, count), view.width - 1)
    return column, np.minimum(cell[:, 0] * CELL_PIXELS + random.integers(0, CELL_PIXELS, count), view.height - 1)


def _guess(
    view: SweepView,
    column: NDArray[np.int64],
    row: NDArray[np.int64],
    inverse: NDArray[np.floating[Any]],
    spacing: float,
) -> Cloud:
    """Points at recorded pixels and inverse depths above 0; ``spacing``: in units of that of confirmed points."""
    good = inverse > 1e-12
    if view.recorded is not None:
        good &= view.recorded[row, column]
    column, row, depth = column[good], row[good], 1 / inverse[good]
    xyz = view.centre + pixel_rays(view, column.astype(np.float64), row.astype(np.float64)) * depth[:, None]
    spacings = (spacing * depth / view.focal).astype(np.float32)
    return Cloud(xyz, view.picture[row, column], spacings, np.full(len(xyz), _GUESS_CONFIDENCE, np.float32))
