"""Ray-traces a furnished room through equidistant fisheyes: a rig to encode, in which nothing was straightened.

    python tests/fisheyes/make.py FOLDER --diagonal 170 --frames 1 --size 240x180

Thirteen cameras stand on an arc in the room and look at two performers.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path[:0] = [str(Path(__file__).parents[1])] * (str(Path(__file__).parents[1]) not in sys.path)

from decogs.formats.cameras import Camera, camera_centre  # noqa: E402
from outdoors.make import Block, standing  # noqa: E402
from stages import scenes  # noqa: E402
from stages.make import calibration, coded, size  # noqa: E402
from stages.ray import Array, Body, Paint, exits, light, noise, turned, unit  # noqa: E402

GRID = 2  # samples along a side of a pixel
CAMERAS, HELD_OUT = 13, ("cam04", "cam08")
HALF, HIGH = 3.6, 3.0  # of the room, metres
AMBIENT, EXPOSURE = 0.35, 1.3

BOARDS = Paint((0.3, 0.17, 0.09), (0.2, 0.1, 0.05), "stripes", 0.15)
PAPER = Paint((0.45, 0.36, 0.25), (0.2, 0.27, 0.3), "stripes", 0.25, 0.3)
CEILING = Paint((0.5, 0.5, 0.48), (0.38, 0.36, 0.33), "checks", 0.6, 0.25)
PLACES = (
    (-3.1, 0.5),
    (3.1, 0.2),
    (-2.6, -1.6),
    (2.7, -1.8),
    (0, 2.9),
    (-2.2, 2.5),
    (2.4, 2.4),
    (0.9, -1.1),
    (-1.5, -0.6),
)


def room(points: Array) -> tuple[Array, Array]:
    """Distance (P,) of points (3, P) in the room to its nearest wall, and that wall's normal (3, P)."""
    gaps = np.stack([HALF - np.abs(points[0]), HALF - np.abs(points[1]), points[2], HIGH - points[2]])
    nearest = gaps.argmin(0) == np.arange(4)[:, None]
    upwards = np.where(nearest[3], -1, np.where(nearest[2], 1, 0))
    normals = np.stack([-np.sign(points[0]) * nearest[0], -np.sign(points[1]) * nearest[1], upwards])
    return gaps.min(0), normals.astype(np.float32)


def walls(points: Array, normals: Array) -> Array:
    """Colours (3, P) of the room: boards, papered walls with pictures on them, a ceiling."""
    along = np.where(np.abs(normals[0]) > 0.5, points[1], points[0])
    paper = PAPER.colours(np.stack([0 * along, points[2], along]).astype(np.float32))
    framed = (np.abs((along + 40) % 1.6 - 0.8) < 0.5) & (np.abs(points[2] - 1.7) < 0.5)
    picture = np.stack([noise((points * 4 + shift).astype(np.float32)) for shift in (0, 17, 31)]) ** 2
    boards = BOARDS.colours(points[[2, 0, 1]] * np.array([[0], [1], [1]], np.float32))
    ceiling = CEILING.colours(points * np.array([[1], [1], [0]], np.float32))
    upright = np.where(framed, picture, paper)
    return np.where(normals[2] > 0.5, boards, np.where(normals[2] < -0.5, ceiling, upright)).astype(np.float32)


def furnished(frame: int) -> list[Body]:
    """Performers, one of whom walks, cupboards, boxes, and what hangs from the ceiling."""
    random = np.random.default_rng(2)
    kinds = (("checks", 0.2), ("stripes", 0.12), ("plain", 0.2), ("checks", 0.3), ("stripes", 0.2))
    paints = [
        Paint(*(tuple(random.uniform(0.05, 0.5, 3)) for _ in range(2)), kind, width, 0.4) for kind, width in kinds
    ]
    bodies = list(standing(frame))
    for index, (x, y) in enumerate(PLACES):
        turn, half = random.uniform(0, 3), np.array([*random.uniform(0.2, 0.5, 2), random.uniform(0.25, 0.9)])
        axes = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]], np.float32)
        place = np.array([x, y, half[2]], np.float32)
        bodies.append(Block(place, axes, half.astype(np.float32), 0, paints[index % len(paints)], False))
    for index in range(6):
        angle, away = random.uniform(0, 2 * np.pi), random.uniform(0.8, 2.6)
        place = (away * np.cos(angle), away * np.sin(angle), 2.6)
        bodies.append(scenes.ellipsoid(place, (0.2, 0.2, 0.15), paints[index % len(paints)], 0, False))
    return bodies


def cameras(size: tuple[int, int], diagonal: float) -> list[Camera]:
    """On an arc of 110 degrees, 2.7 m from the middle; ``size``: width, height; ``diagonal``: degrees that they see."""
    width, height = size
    focal = float(np.hypot(width, height) / np.radians(diagonal))
    random, made = np.random.default_rng(3), []
    for index in range(CAMERAS):
        angle = np.radians(-90 + 110 * (index / (CAMERAS - 1) - 0.5) + random.uniform(-2, 2))
        away = 2.7 + random.uniform(-0.1, 0.1)
        place = np.array([away * np.cos(angle), away * np.sin(angle), (1.1, 1.8, 1.45)[index % 3]])
        forward = unit(np.array([0, 0, 1.2]) + random.uniform(-0.1, 0.1, 3) - place)
        right = unit(np.cross(forward, [0, 0, 1]))
        pose = np.eye(4)
        pose[:3, :3] = [right, np.cross(forward, right), forward]
        pose[:3, 3] = -pose[:3, :3] @ place
        middle = (width / 2, height / 2)
        made.append(Camera(f"cam{index:02d}", width, height, focal, focal, *middle, pose, "fisheye", (0.0,) * 4))
    return made


def render(camera: Camera, bodies: Sequence[Body]) -> NDArray[np.float32]:
    """Linear RGB (H, W, 3)."""
    y, x = ((np.indices((camera.height * GRID, camera.width * GRID)) + 0.5) / GRID).reshape(2, -1)
    x, y = (x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy
    angle = np.hypot(x, y)
    sideways = np.sinc(angle / np.pi)
    ways = np.stack([x * sideways, y * sideways, np.cos(angle)]).astype(np.float32)
    ways = turned(camera.world_to_camera[:3, :3].T.astype(np.float32), ways)
    origin = camera_centre(camera).astype(np.float32)[:, None]
    depth = exits(room, origin, ways)
    owner = np.full(depth.shape, -1)
    for index, body in enumerate(bodies):
        met = body.entry(origin, ways)
        closer = met < depth
        depth[closer], owner[closer] = met[closer], index
    points = origin + depth * ways
    normals, colours = np.empty_like(points), np.empty_like(points)
    for index in range(-1, len(bodies)):
        here = np.flatnonzero(owner == index)
        if here.size and index < 0:
            normals[:, here] = room(points[:, here])[1]
            colours[:, here] = walls(points[:, here], normals[:, here])
        elif here.size:
            body = bodies[index]
            normals[:, here] = body.normals(points[:, here])
            colours[:, here] = body.paint.colours(body.own(points[:, here]) + np.float32(0.8 * index))
    lit = light(points, normals, scenes.few_lamps(), bodies) + np.float32(AMBIENT) * (0.8 + 0.2 * normals[2])
    shape = (3, camera.height, GRID, camera.width, GRID)
    return np.asarray((colours * lit).reshape(shape).mean((2, 4)).transpose(1, 2, 0), np.float32)


def write_fisheyes(folder: Path, views: Sequence[Camera], frames: int, seed: int = 0) -> Path:
    """rig.json and camNN/FFFF.png; the same bits for the same seed."""
    for number, camera in enumerate(views):
        (folder / camera.name).mkdir(parents=True)
        for frame in range(frames):
            picture = coded(EXPOSURE * render(camera, furnished(frame)), np.random.default_rng((seed, frame, number)))
            assert cv2.imwrite(str(folder / camera.name / f"{frame:04d}.png"), picture[..., ::-1])
    (folder / "rig.json").write_text(json.dumps(calibration(views)))
    return folder


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Make a rig of fisheyes in a room.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--diagonal", type=float, default=170.0, help="degrees that each camera sees")
    parser.add_argument("--frames", type=int, default=1)
    parser.add_argument("--size", type=size, default="240x180")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    write_fisheyes(options.folder, cameras(options.size, options.diagonal), options.frames, options.seed)
