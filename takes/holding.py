"""Where a scene holds: the error to be expected for every place around it, as a map from above, and a fence.

A viewer stands at the height of the nearest cameras and looks where these look. What is expected is what these testify
(`witness`), put into dB by what was measured on views that were left out of other rigs (DESIGN.md). It is no promise.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.moves import looking
from decogs.formats.cameras import Camera, as_pinhole, camera_centre
from decogs.rig.check.plan import plan_axes

from .figures import figure
from .witness import F64, Witnessed, Witnesses

SPREAD = 2.5
"""dB from what is expected within which three of four views lie."""
_MORE, _ONE_SIDED, _SIDES = 3.2, 6.0, 0.5
"""dB of a view above its agreement with three cameras' pictures, which errors of depth make worse, and less for what
cameras on one side are beyond a half."""
_LEAST_SEEN = 0.25
"""Of a view, below which nobody can say anything of it."""
_PRIOR = 1.0
"""Left-out cameras, whose mean counts as much as what other rigs say."""
_FENCE_DB = 1.3
"""So far below what is usual among the cameras' own places the fence still admits a view: 2.5 dB would be good, the
rest is for errors."""
_NEAREST_SHARE, _FARTHEST_SHARE = 0.6, 1.4
"""Of the nearest cameras' distance from what they see: nearer and farther, nothing was measured."""
_AMONG = 0.15
"""Of that distance, by which a place among the cameras may be nearer or farther."""
_CELLS = 16
"""Along the longer side of the map."""
_AROUND = 0.15
"""Of the cameras' extent, that the map has beyond them."""
_NEAREST = 3
_LOW_DB, _HIGH_DB = 18.0, 34.0
_SIZE = 560


@dataclass(frozen=True)
class Expected:
    """Of a view: ``psnr`` in dB, None where no camera bears witness; ``is_within``: the fence admits it.

    ``between``: the two cameras next to it, where it stands among them; ``view``: of a camera that stands there.
    """

    psnr: float | None
    is_within: bool
    between: tuple[str, str] | None = None
    view: Camera | None = None


@dataclass(frozen=True, eq=False)
class Holding:
    """``cells`` by row and column of the map, whose corners are ``low`` and ``high`` along its ``axes`` (2, 3).

    ``usual``: dB to be expected at the cameras' own places if they had not been there; ``least``: that the fence
    admits; ``own``: what is expected at each camera's place, by its name; ``doubted``: the picture of the weakest
    place, red where it is likely wrong.
    """

    cells: tuple[tuple[Expected, ...], ...]
    axes: F64
    low: F64
    high: F64
    usual: float
    least: float
    own: dict[str, float | None]
    doubted: NDArray[np.uint8] | None = None

    @property
    def weakest(self) -> Expected | None:
        """The least that is expected as far from the scene as cameras are: where one more would bring most."""
        reached = [cell for row in self.cells for cell in row if cell.between is not None]
        return min(reached, key=lambda cell: -np.inf if cell.psnr is None else cell.psnr, default=None)

    @property
    def share_within(self) -> float:
        """Of the map, that the fence admits."""
        return float(np.mean([cell.is_within for row in self.cells for cell in row]))


def expected_psnr(testimony: Witnessed) -> float | None:
    """dB to be expected of a view; None where hardly any of it was seen."""
    if testimony.seen < _LEAST_SEEN:
        return None
    return testimony.agreement + _MORE - _ONE_SIDED * max(0.0, testimony.one_sided - _SIDES)


def holding(witnesses: Witnesses, cameras: Sequence[Camera], left_out: Mapping[str, tuple[Camera, float]]) -> Holding:
    """The map of a frame whose training ``cameras`` bear witness. Takes some 20 ms a cell.

    ``left_out``: cameras that training did not see, and the dB that they measured: by so much more or less than
    expected, all others are taken to be.
    """
    missed = [
        psnr - expected
        for camera, psnr in left_out.values()
        if (expected := expected_psnr(witnesses.testimony(camera)[0])) is not None and np.isfinite(psnr)
    ]
    offset = sum(missed) / (len(missed) + _PRIOR)

    def expected_of(view: Camera) -> float | None:
        psnr = expected_psnr(witnesses.testimony(view)[0])
        return None if psnr is None else psnr + offset

    own = {camera.name: expected_of(camera) for camera in cameras}
    known = [value for value in own.values() if value is not None]
    usual = float(np.median(known)) if known else float("nan")
    least = usual - _FENCE_DB
    axes = plan_axes(cameras)
    stands = _Stands(cameras, witnesses, axes)
    low, high, columns, rows = _grid(cameras, axes)
    cells = []
    for row in range(rows):
        line = []
        for column in range(columns):
            at = low + (high - low) * (np.array([column, row]) + 0.5) / (columns, rows)
            view, distance = stands.view(at)
            is_measured = _NEAREST_SHARE <= distance <= _FARTHEST_SHARE
            psnr = None if view is None else expected_of(view)
            is_within = is_measured and psnr is not None and psnr >= least
            between = stands.between(at) if abs(distance - 1) <= _AMONG else None
            line.append(Expected(psnr, is_within, between, view))
        cells.append(tuple(line))
    found = Holding(tuple(cells), axes, low, high, usual, least, own)
    if found.weakest is None or found.weakest.view is None:
        return found
    return replace(found, doubted=witnesses.doubted(found.weakest.view))


class _Stands:
    """Viewers on a plan: at the height of the nearest cameras, looking where these look."""

    def __init__(self, cameras: Sequence[Camera], witnesses: Witnesses, axes: F64) -> None:
        self._axes, self._up = axes, np.cross(axes[0], axes[1])
        self._names = [camera.name for camera in cameras]
        self._centres = np.array([camera_centre(camera) for camera in cameras])
        self._on_plan = self._centres @ axes.T
        ways = np.array([camera.world_to_camera[2, :3] for camera in cameras])
        depths = np.array([witnesses.depth_seen(camera.name) for camera in cameras])
        self._targets = self._centres + ways * depths[:, None]
        wide = max(cameras, key=lambda camera: camera.width / camera.fx)
        self._lens = replace(as_pinhole(wide), name="")

    def between(self, at: F64) -> tuple[str, str] | None:
        """The two cameras nearest to a place of the plan; None of a single one."""
        nearest = np.argsort(np.linalg.norm(self._on_plan - at, axis=1), kind="stable")[:2]
        names = sorted(self._names[row] for row in nearest)
        return (names[0], names[1]) if len(names) > 1 else None

    def view(self, at: F64) -> tuple[Camera | None, float]:
        """Who stands at a place of the plan, None where there is nowhere to look; how far away, cameras being at 1."""
        gaps = np.linalg.norm(self._on_plan - at, axis=1)
        near = np.argsort(gaps, kind="stable")[:_NEAREST]
        weights = 1 / (gaps[near] + 1e-6 * (1 + gaps.max()))
        weights /= weights.sum()
        height, target = float(weights @ (self._centres[near] @ self._up)), weights @ self._targets[near]
        place = at @ self._axes + height * self._up
        distance = float(np.linalg.norm(target - place))
        usual = float(weights @ np.linalg.norm(self._targets[near] - self._centres[near], axis=1))
        if distance < 1e-3 * usual:
            return None, 0.0
        camera = replace(self._lens, world_to_camera=looking(place, target, self._up))
        return camera, distance / usual


def _grid(cameras: Sequence[Camera], axes: F64) -> tuple[F64, F64, int, int]:
    """Corners of the map on the plan, and how many cells it has across and down."""
    places = np.array([camera_centre(camera) for camera in cameras]) @ axes.T
    extent = np.ptp(places, axis=0)
    margin = _AROUND * float(extent.max())
    low, high = places.min(axis=0) - margin, places.max(axis=0) + margin
    side = float((high - low).max()) / _CELLS
    columns, rows = (max(1, round(float(length) / side)) for length in high - low)
    return low, high, columns, rows


def drawn(holding: Holding, cameras: Sequence[Camera], held_out: Sequence[str]) -> str:
    """The map, SVG: colours from red to green, what the fence admits framed, cameras as dots."""
    span = holding.high - holding.low
    scale = _SIZE / float(span.max())
    width, height = span * scale
    rows, columns = len(holding.cells), len(holding.cells[0])
    w, h = width / columns, height / rows
    parts = []
    for row, line in enumerate(holding.cells):
        for column, cell in enumerate(line):
            box = f"x='{column * w:.1f}' y='{row * h:.1f}' width='{w:.1f}' height='{h:.1f}'"
            told = "unknown" if cell.psnr is None else f"{cell.psnr:.1f} dB{', within the fence' * cell.is_within}"
            opacity = 0.9 if cell.is_within else 0.35
            parts.append(
                f"<rect {box} fill='{_colour(cell.psnr)}' fill-opacity='{opacity}'><title>{told}</title></rect>"
            )
    for camera in cameras:
        x, y = (camera_centre(camera) @ holding.axes.T - holding.low) * scale
        fill = "#fff" if camera.name in held_out else "#222"
        name = f"<text x='{x + 7:.1f}' y='{y + 4:.1f}'>{escape(camera.name)}</text>"
        parts.append(f"<circle cx='{x:.1f}' cy='{y:.1f}' r='4' fill='{fill}' stroke='#222'/>{name}")
    size = f"viewBox='-10 -10 {width + 80:.0f} {height + 20:.0f}' width='{width + 90:.0f}'"
    return f"<svg xmlns='http://www.w3.org/2000/svg' role='img' {size}>{''.join(parts)}</svg>"


def _colour(psnr: float | None) -> str:
    if psnr is None:
        return "#ccc"
    return f"hsl({120 * float(np.clip((psnr - _LOW_DB) / (_HIGH_DB - _LOW_DB), 0, 1)):.0f} 65% 50%)"


FEW_CAMERAS = 6
_DOUBTED = "From there: red is likely below 20 dB, or was seen by no camera"


def parts(holding: Holding, cameras: Sequence[Camera], held_out: Sequence[str]) -> list[str]:
    """Of a page."""
    known = [cell.psnr for row in holding.cells for cell in row if cell.psnr is not None]
    told = "No camera sees what another one does: nothing can be said of other places."
    if known and np.isfinite(holding.usual):
        told = (
            f"Expected at the cameras' own places, had they not been there: {holding.usual:.1f} dB; three of four "
            f"views lie within {SPREAD:g} dB of what is expected. Strong colours are within the fence: at least "
            f"{holding.least:.1f} dB, as far from the scene as cameras stood; {holding.share_within:.0%} "
            "of the map. Grey: no camera bears witness."
        )
    few = len(cameras) - len(held_out)
    first = f"{few} cameras see little of each other's places: keep near them. " if few <= FEW_CAMERAS else ""
    if (weakest := holding.weakest) is not None and weakest.between is not None:
        there = "nothing is known there" if weakest.psnr is None else f"{weakest.psnr:.1f} dB are expected there"
        told += f" One more camera would bring most between {' and '.join(weakest.between)}: {there}."
    data = json.dumps(document(holding))
    return [
        "<h2>Where it holds</h2>",
        f"<p>{escape(first + told)}</p>",
        drawn(holding, cameras, held_out),
        *([] if holding.doubted is None else [figure([holding.doubted], _DOUBTED)]),
        f"<script type='application/json' id='where-it-holds'>{data}</script>",
    ]


def document(holding: Holding) -> dict[str, Any]:
    """The map for programs, as plain JSON values.

    A place p of the stream's world has on the plan the coordinates ``axes`` p, two of them, and lies in the cell of
    column and row floor((coordinate - low) / (high - low) * (columns, rows)). ``psnr`` and ``within`` are rows of
    cells.
    """
    return {
        "axes": [[round(float(value), 6) for value in axis] for axis in holding.axes],
        "low": [round(float(value), 6) for value in holding.low],
        "high": [round(float(value), 6) for value in holding.high],
        "psnr": [[None if cell.psnr is None else round(cell.psnr, 1) for cell in row] for row in holding.cells],
        "within": [[cell.is_within for cell in row] for row in holding.cells],
    }
