"""Ray-traces a meadow under the open sky: a rig to encode, with the true depth of every pixel.

    python tests/outdoors/make.py clear FOLDER --arc 110 --frames 3 --seed 0

Thirteen cameras stand on an arc around two performers; trees are 8 to 30 m away, houses up to 60 m.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path[:0] = [str(Path(__file__).parents[1])] * (str(Path(__file__).parents[1]) not in sys.path)

from decogs.formats.cameras import Camera, camera_centre, ray_slopes  # noqa: E402
from stages import scenes  # noqa: E402
from stages.make import calibration, coded, size  # noqa: E402
from stages.ray import Array, Body, Lamp, Paint, light, noise, turned, unit  # noqa: E402

GRID = 2  # samples along a side of a pixel
CAMERAS, HELD_OUT = 13, ("cam03", "cam06", "cam10")
FPS = 30

GRASS = Paint((0.10, 0.17, 0.04), (0.22, 0.25, 0.08), width=0.5, grain=0.9)
BARK = Paint((0.16, 0.11, 0.08), (0.08, 0.06, 0.05), "stripes", 0.05)
LEAVES = (
    Paint((0.05, 0.12, 0.03), (0.13, 0.22, 0.05), width=0.35, grain=0.9),
    Paint((0.08, 0.12, 0.05), (0.2, 0.22, 0.07), width=0.5, grain=0.9),
)
WALLS = (
    Paint((0.55, 0.5, 0.42), (0.42, 0.36, 0.3), "checks", 0.7, 0.3),
    Paint((0.45, 0.2, 0.15), (0.3, 0.13, 0.1), "checks", 0.4, 0.4),
)
TILES = Paint((0.3, 0.12, 0.08), (0.2, 0.09, 0.07), "stripes", 0.4, 0.4)


@dataclass(frozen=True)
class Block(Body):
    """A box: ``radii`` are half its sides."""

    def entry(self, origins: Array, ways: Array) -> Array:
        scale = 1 / self.radii[:, None]
        o, d = self.own(origins) * scale, turned(self.axes, ways) * scale
        with np.errstate(divide="ignore", invalid="ignore"):
            sides = np.sort(np.stack([(-1 - o) / d, (1 - o) / d]), axis=0)
        first, last = sides[0].max(0), sides[1].min(0)
        return np.where((first < last) & (first > 0), first, np.float32(np.inf))

    def normals(self, points: Array) -> Array:
        q = self.own(points) / self.radii[:, None]
        out = np.where(np.abs(q) == np.abs(q).max(0), np.sign(q), 0).astype(np.float32)
        return unit(turned(self.axes.T, out))


SUN = unit(np.array([[0.5], [-0.45], [0.75]], np.float32))[:, 0]
LOW_SUN = unit(np.array([[0.3], [0.8], [0.33]], np.float32))[:, 0]
"""Behind the cameras, and where they look."""


def clear(ways: Array, frame: int, sun: Array = SUN) -> Array:
    """Blue, paler towards the horizon, brightest around the sun."""
    lift = np.clip(ways[2], 0, 1)
    glow = np.clip(turned(np.stack([sun] * 3), ways)[0], 0, 1) ** 6
    low, high = _column(0.55, 0.68, 0.85), _column(0.14, 0.3, 0.68)
    return np.asarray(low + (high - low) * lift**0.6 + 0.12 * glow, np.float32)


def low_sun(ways: Array, frame: int) -> Array:
    """A clear sky with the sun in it, which clips, as does what is beside it."""
    beside = np.clip(turned(np.stack([LOW_SUN] * 3), ways)[0], 0, 1)
    return np.asarray(
        clear(ways, frame, LOW_SUN) + 0.5 * beside**60 + 30.0 * (beside > np.cos(np.deg2rad(0.7))), np.float32
    )


def clouds(ways: Array, frame: int) -> Array:
    """Broken clouds on a layer that drifts."""
    layer = ways / np.maximum(ways[2], np.float32(0.06))
    shift = np.asarray([[0.02 * frame], [0], [0]], np.float32)
    at = np.stack([layer[0], layer[1], np.zeros_like(layer[0])]) + shift
    cover = 0.55 * noise(at / 1.6) + 0.3 * noise(at / 0.7 + 5) + 0.15 * noise(at / 0.3 + 11)
    share = np.clip((cover - 0.42) / 0.22, 0, 1) * np.clip(ways[2] / 0.08, 0, 1)
    white = _column(0.8, 0.8, 0.82) * (0.75 + 0.25 * noise(at / 0.5 + 3))
    return np.asarray(clear(ways, frame) * (1 - share) + white * share, np.float32)


def overcast(ways: Array, frame: int) -> Array:
    """An even, bright grey."""
    return np.asarray(_column(0.74, 0.76, 0.8) * (0.82 + 0.18 * np.clip(ways[2], 0, 1)), np.float32)


def steady(frame: int) -> float:
    """Light that stays."""
    return 1.0


def falling(frame: int) -> float:
    """Light that falls to a half in five frames, as a cloud comes before the sun."""
    return 1 - 0.1 * min(frame, 5)


Sky = Callable[[Array, int], Array]
"""Linear RGB (3, N) of directions (3, N), in a frame."""


@dataclass(frozen=True)
class Weather:
    """How a ``sky`` looks, how much light comes from its ``sun`` and from all of it, and the ``share`` in a frame."""

    sky: Sky
    sun: float
    ambient: float
    toward: Array = field(default_factory=lambda: SUN)
    share: Callable[[int], float] = steady


SKIES = {
    "clear": Weather(clear, 1.0, 0.3),
    "clouds": Weather(clouds, 0.8, 0.35),
    "overcast": Weather(overcast, 0.0, 0.75),
    "sun": Weather(low_sun, 1.0, 0.3, LOW_SUN),
    "falling": Weather(clouds, 0.8, 0.35, share=falling),
}


def meadow(seed: int) -> list[Body]:
    """Trees and houses behind the middle, as seen from the arc of cameras at -y."""
    random = np.random.default_rng(seed)
    made: list[Body] = []
    for index in range(11):
        angle, distance = np.deg2rad(random.uniform(15, 165)), random.uniform(8, 30)
        place, height = distance * np.array([np.cos(angle), np.sin(angle)]), random.uniform(3, 7)
        made += tree(place, height, LEAVES[index % 2], random)
    for angle, distance, paint in ((60, 36, WALLS[0]), (100, 48, WALLS[1]), (135, 58, WALLS[0]), (82, 60, WALLS[1])):
        place = distance * np.array([np.cos(np.deg2rad(angle)), np.sin(np.deg2rad(angle))])
        made += house(place, random.uniform(0, np.pi), random.uniform(4, 6), paint)
    return made


def tree(place: NDArray[np.float64], height: float, leaves: Paint, random: np.random.Generator) -> list[Body]:
    up = np.array([0, 0, 1], np.float32)
    foot = np.array([*place, 0], np.float32)
    made = [
        scenes.capsule(
            foot, foot + 0.6 * height * up, (0.03 * height,) * 3, BARK, np.array([1, 0, 0], np.float32), False
        )
    ]
    for _ in range(9):
        out = random.normal(0, 0.17 * height, 3) * [1, 1, 0.8]
        radius = height * random.uniform(0.1, 0.2)
        made.append(scenes.ellipsoid(foot + 0.75 * height * up + out, (radius, radius, 0.8 * radius), leaves, 0, False))
    return made


def house(place: NDArray[np.float64], turn: float, half: float, paint: Paint) -> list[Body]:
    """Walls, and a box on its edge for the roof."""
    c, s = np.cos(turn), np.sin(turn)
    axes = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]], np.float32)
    height, r = 0.9 * half, np.float32(np.sqrt(0.5))
    lean = np.array([[1, 0, 0], [0, r, r], [0, -r, r]], np.float32)
    centre = np.array([*place, height / 2], np.float32)
    wall = Block(centre, axes, np.array([half, 0.7 * half, height / 2], np.float32), 0, paint, False)
    side = 0.7 * half * r
    ridge = Block(
        np.array([*place, height], np.float32), lean @ axes, np.array([half, side, side], np.float32), 0, TILES, False
    )
    return [wall, ridge]


def standing(frame: int) -> list[Body]:
    """Two performers, one of whom walks, and a stool."""
    time = frame / FPS
    walking = scenes.performer((0.4 + 0.5 * time, 0.3), 0.2, 7 * time + 1, 0.1, scenes.SHIRT, scenes.JEANS)
    gesturing = scenes.performer((-0.45, -0.1), -1.2, 0.5 * np.sin(4 * time), 0.9, scenes.JUMPER, scenes.TARTAN)
    return [*walking, *gesturing, *scenes.stool()]


def cameras(size: tuple[int, int], arc: float) -> list[Camera]:
    """On an arc of so many degrees, 4 m from the middle, at -y; ``size``: width, height."""
    width, height = size
    random, made = np.random.default_rng(3), []
    for index in range(CAMERAS):
        angle = np.deg2rad(-90 + arc * (index / (CAMERAS - 1) - 0.5) + random.uniform(-1, 1))
        place = np.array([4 * np.cos(angle), 4 * np.sin(angle), (1.4, 1.9, 1.6)[index % 3]])
        forward = unit(np.array([0, 0, 1.35]) + random.uniform(-0.05, 0.05, 3) - place)
        right = unit(np.cross(forward, [0, 0, 1]))
        pose = np.eye(4)
        pose[:3, :3] = [right, np.cross(forward, right), forward]
        pose[:3, 3] = -pose[:3, :3] @ place
        focal = 0.72 * width
        made.append(Camera(f"cam{index:02d}", width, height, focal, focal, width / 2, height / 2, pose))
    return made


def render(
    camera: Camera, bodies: Sequence[Body], sky: str, frame: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Linear RGB (H, W, 3), and depth (H, W), infinite in the sky, of the middle of each pixel's first sample."""
    weather = SKIES[sky]
    share = np.float32(weather.share(frame))
    shape = (camera.height * GRID, camera.width * GRID)
    y, x = ((np.indices(shape) + 0.5) / GRID).reshape(2, -1)
    ways = np.stack([*ray_slopes(camera, x, y), np.ones_like(x)]).astype(np.float32)
    ways = turned(camera.world_to_camera[:3, :3].T.astype(np.float32), ways)
    origin = camera_centre(camera).astype(np.float32)[:, None]
    with np.errstate(divide="ignore"):
        nearest = np.where(ways[2] < -1e-4, -origin[2] / ways[2], np.float32(np.inf)).astype(np.float32)
    nearest[nearest > 400] = np.inf
    owner = np.where(np.isfinite(nearest), -1, -2)
    for index, body in enumerate(bodies):
        toward = (body.centre[:, None] - origin)[:, 0]
        reach = float(np.linalg.norm(body.radii)) * (1 + body.half)
        length, along = np.sqrt((ways**2).sum(0)), toward @ ways
        rays = np.flatnonzero(along > length * np.sqrt(max(float(toward @ toward) - reach**2, 0.0)))
        depth = body.entry(origin, ways[:, rays])
        closer = depth < nearest[rays]
        nearest[rays[closer]], owner[rays[closer]] = depth[closer], index
    image = weather.sky(unit(ways), frame) * share
    strength = np.full(3, share * weather.sun * 300.0**2, np.float32)
    lamp = [Lamp((300 * weather.toward).astype(np.float32), -weather.toward, strength)] if weather.sun else []
    order = np.argsort(owner, kind="stable")[np.count_nonzero(owner == -2) :]
    points = origin + nearest[order] * ways[:, order]
    normals, colours = np.empty_like(points), np.empty_like(points)
    ends = np.searchsorted(owner[order], np.arange(-1, len(bodies) + 1))
    for index, (first, stop) in enumerate(pairwise(ends), start=-1):
        met = points[:, first:stop]
        if index < 0:
            normals[:, first:stop], colours[:, first:stop] = [[0], [0], [1]], GRASS.colours(met)
        elif first < stop:
            body = bodies[index]
            normals[:, first:stop] = body.normals(met)
            colours[:, first:stop] = body.paint.colours(body.own(met) + 0.8 * index)
    lit = light(points, normals, lamp, bodies)
    ambient = share * np.float32(weather.ambient)
    image[:, order] = colours * (lit + ambient * (0.6 + 0.4 * normals[2]) * _column(0.95, 1.0, 1.08))
    grid = image.reshape(3, camera.height, GRID, camera.width, GRID)
    return grid.mean((2, 4)).transpose(1, 2, 0), nearest.reshape(shape)[::GRID, ::GRID]


def write_meadow(sky: str, folder: Path, views: Sequence[Camera], frames: int, seed: int = 0) -> Path:
    """rig.json, camNN/FFFF.png, truth/depth/camNN.npy of the first frame and scene.json."""
    folder.mkdir(parents=True)
    far = meadow(seed)
    for frame in range(frames):
        bodies = [*standing(frame), *far]
        for index, camera in enumerate(views):
            image, depth = render(camera, bodies, sky, frame)
            picture = coded(image, np.random.default_rng((seed, index, frame)))
            path = folder / camera.name / f"{frame:04d}.png"
            path.parent.mkdir(exist_ok=True)
            assert cv2.imwrite(str(path), picture[..., ::-1]), path
            if frame == 0:
                (folder / "truth/depth").mkdir(parents=True, exist_ok=True)
                np.save(folder / f"truth/depth/{camera.name}.npy", depth)
    (folder / "scene.json").write_text(json.dumps({"name": sky, "seed": seed, "held_out": HELD_OUT}))
    (folder / "rig.json").write_text(json.dumps(calibration(views)))
    return folder


def _column(*values: float) -> Array:
    return np.asarray(values, np.float32)[:, None]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sky", choices=SKIES)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--arc", type=float, default=110)
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--size", type=size, default=(240, 180))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if options.folder.exists():
        parser.error(f"{options.folder}: exists already; name another folder")
    write_meadow(options.sky, options.folder, cameras(options.size, options.arc), options.frames, options.seed)


if __name__ == "__main__":
    main()
