"""Rays against bodies and convex rooms, and the light that bodies block. Vectors are float32 (3, N), in metres."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]
Room = Callable[[Array], tuple[Array, Array]]
"""Of points: distance (N,) to the nearest wall of a convex room, below 0 outside, and that wall's normal.

Well inside, distances may be less than they are and normals zero."""

_SKIN = 2e-3  # metres: how far above a surface its rays of light start


@dataclass(frozen=True)
class Paint:
    """Two colours, linear 0..1, in a pattern of ``width`` metres: "plain", "stripes" or "checks", no two of them alike.

    ``grain``: by how much noise darkens and lightens either colour, 0..1.
    """

    first: tuple[float, float, float]
    second: tuple[float, float, float]
    pattern: str = "plain"
    width: float = 0.1
    grain: float = 0.5

    def colours(self, places: Array) -> Array:
        """Of points (3, N) in metres, in the axes of what is painted."""
        if self.pattern == "plain":
            mix = noise(places / self.width)
        else:
            cells = np.floor(places / self.width + 0.4 * noise(places / 0.15)).astype(np.int32)
            if self.pattern == "stripes":
                cells[:2] = 0
            mix = 0.7 * (cells.sum(0) & 1) + 0.3 * _LATTICE[tuple(cells & 63)]
        mixed = _column(self.first) * (1 - mix) + _column(self.second) * mix
        fine = 0.5 * noise(places / 0.06) + 0.5 * noise(places / 0.03 + 9)
        return np.asarray(mixed * (1 + self.grain * (2 * fine - 1)), np.float32)


@dataclass(frozen=True)
class Body:
    """A stretched capsule: points within 1 of the segment |z| <= ``half``, in ``axes`` (rows) scaled by ``radii``."""

    centre: Array
    axes: Array
    radii: Array
    half: float
    paint: Paint
    moves: bool = True

    @cached_property
    def reach(self) -> float:
        """Radius of a sphere around it."""
        return float(max(self.radii[0], self.radii[1], self.radii[2] * (1 + self.half)))

    def own(self, points: Array) -> Array:
        """World points in its axes, in metres."""
        return turned(self.axes, points - self.centre[:, None])

    def entry(self, origins: Array, ways: Array) -> Array:
        """How many ``ways`` (3, N) from ``origins`` (3, 1 or N) rays enter it, infinite where they do not."""
        scale = 1 / self.radii[:, None]
        o, d = self.own(origins) * scale, turned(self.axes, ways) * scale
        with np.errstate(invalid="ignore", divide="ignore"):
            a, b = d[0] * d[0] + d[1] * d[1], o[0] * d[0] + o[1] * d[1]
            side = (-b - np.sqrt(b * b - a * (o[0] * o[0] + o[1] * o[1] - 1))) / np.maximum(a, np.float32(1e-9))
            z = o[2] + side * d[2]
            oz = o[2] - np.clip(z, -self.half, self.half)
            a, b = a + d[2] * d[2], b + oz * d[2]
            cap = (-b - np.sqrt(b * b - a * (o[0] * o[0] + o[1] * o[1] + oz * oz - 1))) / a
        found = np.where(np.abs(z) <= self.half, side, cap)
        return np.where(found > 0, found, np.float32(np.inf))

    def normals(self, points: Array) -> Array:
        """Outward, of points on it."""
        q = self.own(points) / self.radii[:, None]
        q[2] -= np.clip(q[2], -self.half, self.half)
        return unit(turned(self.axes.T, q / self.radii[:, None]))


@dataclass(frozen=True)
class Lamp:
    """A point that shines towards ``aim`` (3,), less to the sides; ``power`` (3,) is what 1 m before it receives."""

    place: Array
    aim: Array
    power: Array


def exits(room: Room, origins: Array, ways: Array) -> Array:
    """How many ``ways`` rays from inside a room go until they leave it (Newton: the distance is concave on a ray)."""
    reached = np.full(ways.shape[1], 50, np.float32)
    for _ in range(12):
        distances, normals = room(origins + reached * ways)
        slope = np.minimum(dot(normals, ways), np.float32(-1e-3))
        reached = np.maximum(reached - distances / slope, 0)
    return reached


def light(points: Array, normals: Array, lamps: Sequence[Lamp], bodies: Sequence[Body]) -> Array:
    """Linear RGB (3, N) that matt white would show there."""
    total = np.zeros_like(points)
    points = points + np.float32(_SKIN) * normals
    for lamp in lamps:
        ways = lamp.place[:, None] - points
        square = dot(ways, ways)
        facing, leaving = dot(ways, normals), -dot(ways, lamp.aim)
        lit = np.flatnonzero((facing > 0) & (leaving > 0))
        lit = lit[~_blocked(points[:, lit], ways[:, lit], np.sqrt(square[lit]), lamp.place, bodies)]
        total[:, lit] += lamp.power[:, None] * (facing * leaving / (square * square))[lit]
    return total


def _blocked(points: Array, ways: Array, lengths: Array, place: Array, bodies: Sequence[Body]) -> NDArray[np.bool_]:
    shadow = np.zeros(points.shape[1], bool)
    for body in bodies:
        toward = place - body.centre
        least = np.sqrt(max(0.0, float(toward @ toward) - body.reach**2))  # length of the cone that holds it
        near = np.flatnonzero(dot(ways, toward) > np.float32(least) * lengths)
        if near.size:
            shadow[near] |= body.entry(points[:, near], ways[:, near]) < 1
    return shadow


def noise(places: Array) -> Array:
    """Smooth noise in 0..1 with a lattice of 1 (N,), the same everywhere and always."""
    corner = np.floor(places)
    share = places - corner
    share = share * share * (3 - 2 * share)
    x, y, z = corner.astype(np.int32)
    total = np.zeros(places.shape[1], np.float32)
    for i, j, k in np.ndindex(2, 2, 2):
        weight = np.abs(1 - i - share[0]) * np.abs(1 - j - share[1]) * np.abs(1 - k - share[2])
        total += weight * _LATTICE[(x + i) & 63, (y + j) & 63, (z + k) & 63]
    return total


def dot(one: Array, other: Array) -> Array:
    """Of vectors (3, N) with as many, or with one (3,)."""
    return one[0] * other[0] + one[1] * other[1] + one[2] * other[2]


def turned(rotation: Array, vectors: Array) -> Array:
    """``rotation @ vectors``, summed in a fixed order."""
    return rotation[:, 0, None] * vectors[0] + rotation[:, 1, None] * vectors[1] + rotation[:, 2, None] * vectors[2]


def unit(vectors: Array) -> Array:
    return vectors / np.sqrt(dot(vectors, vectors))


def _column(values: Sequence[float]) -> Array:
    return np.asarray(values, np.float32)[:, None]


_LATTICE = np.random.default_rng(1).random((64, 64, 64), np.float32)
