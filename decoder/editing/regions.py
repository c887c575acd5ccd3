"""Regions of the world, as users write them: ``box LOW HIGH``, ``sphere CENTRE RADIUS``, ``polygon CORNER CORNER ...``.

``depth(points)`` is how far inside a point (N, 3) lies, in world units, negative outside: exact inside and near a face,
edge or border.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from decogs.formats.errors import UsageError

Points = NDArray[np.floating[Any]]
Depths = NDArray[np.float64]
_AXES = "xyz"


class Region(Protocol):
    """A part of the world."""

    def depth(self, points: Points) -> Depths:
        """How far inside each point lies, (N,), in world units."""


@dataclass(frozen=True)
class Box:
    """Between two corners, along the world's axes."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def depth(self, points: Points) -> Depths:
        """To the nearest face; outside to the nearest point of the box."""
        return _within(np.maximum(np.subtract(self.low, points), np.subtract(points, self.high)))


@dataclass(frozen=True)
class Sphere:
    """Within ``radius`` of ``centre``."""

    centre: tuple[float, float, float]
    radius: float

    def depth(self, points: Points) -> Depths:
        """To the surface."""
        return np.asarray(self.radius - np.linalg.norm(np.subtract(points, self.centre), axis=1))


@dataclass(frozen=True)
class Polygon:
    """A plan drawn out along ``axis`` from ``low`` to ``high``; ``corners`` are in the other two axes, in their order.

    Corners go round it either way; where its lines cross, what is encircled twice is outside.
    """

    corners: tuple[tuple[float, float], ...]
    axis: str = "y"
    low: float = -np.inf
    high: float = np.inf

    def depth(self, points: Points) -> Depths:
        """To the nearest wall, floor or ceiling; outside to the nearest point."""
        along = _AXES.index(self.axis)
        walls = -self._plan_depth(np.delete(points, along, axis=1).astype(np.float64))
        level = points[:, along]
        return _within(np.stack([walls, np.maximum(self.low - level, level - self.high)], axis=1))

    def _plan_depth(self, points: NDArray[np.float64]) -> Depths:
        """Distance to the nearest side, negative outside."""
        corners = np.asarray(self.corners, np.float64)
        nearest, inside = np.full(len(points), np.inf), np.zeros(len(points), bool)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            side, to = b - a, points - a
            along = np.clip(to @ side / max(float(side @ side), 1e-300), 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(to - along[:, None] * side, axis=1))
            # A ray to the right meets the side: the rule of even and odd.
            crosses = (a[1] > points[:, 1]) != (b[1] > points[:, 1])
            with np.errstate(divide="ignore", invalid="ignore"):
                inside ^= crosses & (points[:, 0] < a[0] + (points[:, 1] - a[1]) / side[1] * side[0])
        return np.where(inside, nearest, -nearest)


def region_of(words: Sequence[str]) -> Region:
    """The region that words describe: its kind, then points such as ``-1,0,2``, numbers, and ``axis=y``, ``from=0``.

    Raises UsageError for words that describe none.
    """
    kind, *rest = words
    if kind == "box" and len(rest) == 2:
        low, high = _point(rest[0], 3), _point(rest[1], 3)
        if not all(a < b for a, b in zip(low, high, strict=True)):
            raise UsageError(f"box {' '.join(rest)}: holds nothing; give its lower corner, then its upper one")
        return Box(_three(low), _three(high))
    if kind == "sphere" and len(rest) == 2:
        (radius,) = _point(rest[1], 1)
        if radius <= 0:
            raise UsageError(f"sphere {' '.join(rest)}: holds nothing; give its centre, then a radius above 0")
        return Sphere(_three(_point(rest[0], 3)), radius)
    if kind == "polygon":
        return _polygon(rest)
    raise UsageError(
        f"{' '.join(words)}: is no region; write box X,Y,Z X,Y,Z (two corners), sphere X,Y,Z RADIUS, or "
        "polygon X,Z X,Z X,Z ... [axis=y] [from=LOW] [to=HIGH]"
    )


REGION_HELP = (
    "box X,Y,Z X,Y,Z (two corners); sphere X,Y,Z RADIUS; polygon X,Z X,Z X,Z ... (a plan) [axis=x, y or z, along which "
    "it is drawn out; y by default] [from=LOW] [to=HIGH]"
)


def _polygon(words: Sequence[str]) -> Polygon:
    corners = tuple(_point(word, 2) for word in words if "=" not in word)
    named = dict(word.split("=", 1) for word in words if "=" in word)
    axis = named.pop("axis", "y")
    (low,), (high,) = _point(named.pop("from", "-inf"), 1), _point(named.pop("to", "inf"), 1)
    if named or axis not in tuple(_AXES) or not low < high or len(corners) < 3:
        raise UsageError(
            f"polygon {' '.join(words)}: give three corners or more, then axis=x, y or z, and from below to, if at all"
        )
    return Polygon(tuple((a, b) for a, b in corners), axis, low, high)


def _point(text: str, count: int) -> tuple[float, ...]:
    """``count`` numbers between commas; raises UsageError for anything else. Only a single one may be infinite."""
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or np.isnan(numbers).any() or (count > 1 and not np.isfinite(numbers).all()):
        what = "a number" if count == 1 else f"{count} numbers with commas between, such as {','.join('123'[:count])}"
        raise UsageError(f"{text!r} is not {what}")
    return numbers


def _three(numbers: tuple[float, ...]) -> tuple[float, float, float]:
    x, y, z = numbers
    return x, y, z


def _within(beyond: NDArray[np.float64]) -> Depths:
    """Depth in what all of several bounds hold, from how far beyond each a point is, (N, bounds)."""
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=1)
    return np.asarray(np.where(outside > 0, -outside, -beyond.max(axis=1)))
