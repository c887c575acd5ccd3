"""Ray-traces a stage with performers: a rig to encode, with the true mattes of what moves.

python tests/stages/make.py grey FOLDER [--frames 6] [--size 240x320] [--seed 0]
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path[:0] = [str(Path(__file__).parents[1])] * (str(Path(__file__).parents[1]) not in sys.path)

from decogs.formats.cameras import Camera, camera_centre, project, ray_slopes  # noqa: E402
from stages.ray import Array, Body, exits, light, turned  # noqa: E402
from stages.scenes import (  # noqa: E402
    CEILING,
    FPS,
    HALF_ROOM,
    HELD_OUT,
    LAMPS,
    STAGES,
    SWEEP_RADIUS,
    WALL_RADIUS,
    Stage,
    cameras,
    cyclorama,
    on_stage,
)

GRID = 2  # samples along a side of a pixel
NOISE = 1.2  # 8-bit steps
MIDDLE = np.array([[0], [0], [1.2]], np.float32)
"""The map of light on the backdrop is by direction from here, with twice as many columns as rows."""


@dataclass(frozen=True)
class View:
    """A camera, its rays, and what of the backdrop they meet: depth (N,), albedo (3, N), place in the map of light."""

    camera: Camera
    origin: Array
    ways: Array
    depth: Array
    albedo: Array
    place: tuple[Array, Array]


def look(camera: Camera, stage: Stage) -> View:
    """Rays (3, N) row by row, GRID x GRID a pixel, one unit deep."""
    x, y = ((np.arange(side * GRID) + 0.5) / GRID for side in (camera.width, camera.height))
    u, v = (slope.ravel() for slope in ray_slopes(camera, *np.meshgrid(x, y)))
    ways = turned(
        camera.world_to_camera[:3, :3].T.astype(np.float32), np.stack([u, v, np.ones_like(u)]).astype(np.float32)
    )
    origin = camera_centre(camera).astype(np.float32)[:, None]
    depth = exits(stage.room, origin, ways)
    points = origin + depth * ways
    x, y, z = points - MIDDLE
    shape = (camera.height * GRID, camera.width * GRID)
    across = (np.arctan2(y, x) / np.pi + 1) * camera.height - 0.5
    down = np.arccos(z / np.sqrt(x * x + y * y + z * z)) / np.pi * camera.height - 0.5
    place = across.reshape(shape).astype(np.float32), down.reshape(shape).astype(np.float32)
    return View(camera, origin, ways, depth, stage.albedo(points, stage.room(points)[1]), place)


def light_on_backdrop(stage: Stage, bodies: Sequence[Body], rows: int) -> NDArray[np.float32]:
    """The map of light (rows, 2 rows, 3), which all views of that height share."""
    around, down = np.meshgrid((np.arange(2 * rows) + 0.5) / rows - 1, (np.arange(rows) + 0.5) / rows)
    ways = np.stack([np.cos(np.pi * around), np.sin(np.pi * around), 1 / np.tan(np.pi * down)]).astype(np.float32)
    ways = ways.reshape(3, -1)
    points = MIDDLE + exits(stage.room, MIDDLE, ways) * ways
    return light(points, stage.room(points)[1], LAMPS, bodies).T.reshape(rows, 2 * rows, 3)


def render(
    view: View, bodies: Sequence[Body], backdrop: NDArray[np.float32], bounce: Sequence[float]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Linear RGB (H, W, 3) and matte (H, W) of what moves."""
    height, width = view.place[0].shape
    lit = cv2.remap(backdrop, *view.place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    image = view.albedo * lit.reshape(-1, 3).T
    nearest, owner = _nearest(view, bodies)
    seen = np.flatnonzero(owner >= 0)
    seen = seen[np.argsort(owner[seen], kind="stable")]
    points = view.origin + nearest[seen] * view.ways[:, seen]
    colours, normals = np.empty_like(points), np.empty_like(points)
    for body, part in zip(bodies, _runs(owner[seen], len(bodies)), strict=True):
        normals[:, part], colours[:, part] = (
            body.normals(points[:, part]),
            body.paint.colours(body.own(points[:, part])),
        )
    reflected = np.asarray(bounce, np.float32)[:, None] * (0.5 - 0.4 * normals[2])
    image[:, seen] = colours * (light(points, normals, LAMPS, bodies) + reflected)
    moving = np.array([*(body.moves for body in bodies), False])[owner]
    return _pixels(image.T.reshape(height, width, 3)), _pixels(moving.reshape(height, width, 1))[..., 0]


def _runs(sorted_owners: NDArray[np.int32], count: int) -> list[slice]:
    ends = np.searchsorted(sorted_owners, np.arange(count + 1))
    return [slice(*pair) for pair in pairwise(ends)]


def _nearest(view: View, bodies: Sequence[Body]) -> tuple[Array, NDArray[np.int32]]:
    """Depth of what each ray meets first, and the index of the body, -1 for the backdrop."""
    nearest, owner = view.depth.copy(), np.full(view.depth.shape, -1, np.int32)
    for index, body in enumerate(bodies):
        rays = _rays_near(view, body)
        depth = body.entry(view.origin, view.ways[:, rays])
        closer = depth < nearest[rays]
        nearest[rays[closer]], owner[rays[closer]] = depth[closer], index
    return nearest, owner


def _rays_near(view: View, body: Body) -> NDArray[np.intp]:
    """Of a rectangle that holds the body's picture; none of a body beside or behind the camera."""
    camera, shape = view.camera, view.place[0].shape
    u, v, depth = (value.item() for value in project(camera, body.centre[None]))
    if depth < body.reach:
        return np.empty(0, np.intp)
    margin = 1.3 * camera.fx * body.reach / (depth - 0.99 * body.reach) + 1
    spans = []
    for middle, side in ((v, shape[0]), (u, shape[1])):
        first, stop = (int(np.clip(GRID * (middle + reach), 0, side)) for reach in (-margin, margin))
        spans.append(np.arange(first, stop))
    return np.asarray((spans[0][:, None] * shape[1] + spans[1]).ravel())


def _pixels(samples: NDArray[np.generic]) -> NDArray[np.float32]:
    height, width, channels = samples.shape
    return np.asarray(samples.reshape(height // GRID, GRID, width // GRID, GRID, channels).mean((1, 3)), np.float32)


def coded(linear: NDArray[np.float32], random: np.random.Generator) -> NDArray[np.uint8]:
    """sRGB with a sensor's noise, 8 bits."""
    linear = np.clip(linear, 0, 1)
    curve = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.clip(np.rint(255 * curve + random.normal(0, NOISE, curve.shape)), 0, 255).astype(np.uint8)


def write_stage(name: str, folder: Path, views: Sequence[Camera], frames: int, seed: int = 0) -> Path:
    """rig.json, camNN/FFFF.png, truth/mattes/camNN/FFFF.png and scene.json; the same bits for the same seed."""
    stage = STAGES[name]
    looking = [look(camera, stage) for camera in views]
    gains = 1 + stage.gains * np.random.default_rng(seed).uniform(-1, 1, len(views))
    for frame in range(frames):
        acting = on_stage(frame, stage.clothes)
        bodies = [*acting, *stage.props]
        backdrop = light_on_backdrop(stage, acting, views[0].height)
        for index, view in enumerate(looking):
            image, matte = render(view, bodies, backdrop, stage.bounce)
            picture = coded(image * np.float32(gains[index]), np.random.default_rng((seed, index, frame)))
            _write(folder / view.camera.name / f"{frame:04d}.png", picture[..., ::-1])
            _write(folder / "truth/mattes" / view.camera.name / f"{frame:04d}.png", np.rint(255 * matte))
    (folder / "rig.json").write_text(json.dumps(_calibration(views)))
    (folder / "scene.json").write_text(json.dumps(_told(name, stage, frames, seed, gains), indent=1))
    return folder


def _write(path: Path, picture: NDArray[np.generic]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), picture.astype(np.uint8)), path


def _calibration(views: Sequence[Camera]) -> dict[str, object]:
    names = ("name", "width", "height", "fx", "fy", "cx", "cy")
    entries = [
        {name: getattr(view, name) for name in names}
        | {"file": view.name, "distortion_model": "none", "world_to_camera": view.world_to_camera.tolist()}
        for view in views
    ]
    return {"fps": FPS, "pixel_convention": "(0.5,0.5)", "length_unit": "metre", "source": "made", "cameras": entries}


def _told(name: str, stage: Stage, frames: int, seed: int, gains: NDArray[np.float64]) -> dict[str, object]:
    walls: dict[str, object] = {"walls": "square", "half_width": HALF_ROOM}
    if stage.room is cyclorama:
        walls = {"walls": "upright cylinder", "wall_radius": WALL_RADIUS, "sweep_radius": SWEEP_RADIUS}
    backdrop = {"floor_height": 0.0, "axis": [0.0, 0.0], "up": [0, 0, 1], "ceiling": CEILING, **walls}
    return {
        "name": name,
        "frames": frames,
        "seed": seed,
        "held_out": list(HELD_OUT),
        "gains": gains.tolist(),
        "backdrop": backdrop,
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=STAGES)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--size", default="240x320")
    parser.add_argument("--seed", type=int, default=0)
    told = parser.parse_args()
    width, height = (int(side) for side in told.size.split("x"))
    write_stage(told.scene, told.folder, cameras((width, height)), told.frames, told.seed)


if __name__ == "__main__":
    main()
