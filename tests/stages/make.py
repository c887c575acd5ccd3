"""Ray-traces a stage with performers: a rig to encode, with the true mattes of what moves.

    python tests/stages/make.py grey FOLDER --frames 6 --size 240x320 --seed 0

A frame of 16 cameras takes some 10 seconds of a core.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

sys.path[:0] = [str(Path(__file__).parents[1])] * (str(Path(__file__).parents[1]) not in sys.path)

from decogs.formats.cameras import Camera, camera_centre, project, ray_slopes  # noqa: E402
from stages import scenes  # noqa: E402
from stages.ray import Array, Body, exits, light, turned  # noqa: E402
from stages.scenes import Stage  # noqa: E402

GRID = 2  # samples along a side of a pixel
NOISE = 1.2  # 8-bit steps
MIDDLE = np.array([[0], [0], [1.2]], np.float32)
"""The map of light on the backdrop is by direction from here, with twice as many columns as rows."""


@dataclass(frozen=True)
class View:
    """A camera, its rays, and what of the stage's backdrop they meet: depth, albedo, place in the map of light."""

    camera: Camera
    stage: Stage
    origin: Array
    ways: Array
    depth: Array
    albedo: Array
    place: tuple[Array, Array]


def look(camera: Camera, stage: Stage) -> View:
    """Rays (3, N) row by row, GRID x GRID a pixel, one unit deep."""
    shape = (camera.height * GRID, camera.width * GRID)
    y, x = ((np.indices(shape) + 0.5) / GRID).reshape(2, -1)
    ways = np.stack([*ray_slopes(camera, x, y), np.ones_like(x)]).astype(np.float32)
    ways = turned(camera.world_to_camera[:3, :3].T.astype(np.float32), ways)
    origin = camera_centre(camera).astype(np.float32)[:, None]
    depth = exits(stage.room, origin, ways)
    points = origin + depth * ways
    x, y, z = points - MIDDLE
    across = (np.arctan2(y, x) / np.pi + 1) * camera.height - 0.5
    down = np.arctan2(np.hypot(x, y), z) / np.pi * camera.height - 0.5
    albedo = stage.albedo(points, stage.room(points)[1])
    return View(camera, stage, origin, ways, depth, albedo, (across.reshape(shape), down.reshape(shape)))


def light_on_backdrop(stage: Stage, acting: Sequence[Body], rows: int) -> NDArray[np.float32]:
    """The map of light (rows, 2 rows, 3), which all views of that height share."""
    around, down = np.meshgrid((np.arange(2 * rows) + 0.5) / rows - 1, (np.arange(rows) + 0.5) / rows)
    ways = np.stack([np.cos(np.pi * around), np.sin(np.pi * around), 1 / np.tan(np.pi * down)]).astype(np.float32)
    points = MIDDLE + exits(stage.room, MIDDLE, ways := ways.reshape(3, -1)) * ways
    return light(points, stage.room(points)[1], stage.lamps, acting).T.reshape(rows, 2 * rows, 3)


def render(
    view: View, acting: Sequence[Body], backdrop: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Linear RGB (H, W, 3) and matte (H, W) of what moves. Only who acts throws shadows, the stage's props do not."""
    (made,) = render_all([view], acting, backdrop)
    return made


def render_all(
    views: Sequence[View], acting: Sequence[Body], backdrop: NDArray[np.float32]
) -> list[tuple[NDArray[np.float32], NDArray[np.float32]]]:
    """``render`` of each view of one stage, lit in one go: that takes half as long as view by view."""
    cloths = _cloths(views, [*acting, *views[0].stage.props])
    lights = light(
        *(np.concatenate([getattr(c, of) for c in cloths], axis=1) for of in ("points", "normals")),
        views[0].stage.lamps,
        acting,
    )
    ends = np.cumsum([len(cloth.seen) for cloth in cloths])[:-1]
    return [
        _finished(view, cloth, lit, backdrop)
        for view, cloth, lit in zip(views, cloths, np.split(lights, ends, axis=1), strict=True)
    ]


@dataclass(frozen=True)
class _Cloth:
    """What a view's rays meet of the bodies: which rays (N,), points, normals and colours (3, N).

    ``moving``: of all rays, whether they meet what moves.
    """

    seen: NDArray[np.intp]
    points: Array
    normals: Array
    colours: Array
    moving: NDArray[np.bool_]


def _cloths(views: Sequence[View], bodies: Sequence[Body]) -> list[_Cloth]:
    moving = np.array([*(body.moves for body in bodies), False])
    made, ends = [], []
    for view in views:
        nearest, owner = first_met(view, bodies)
        seen = np.argsort(owner, kind="stable")[np.count_nonzero(owner < 0) :]
        points = view.origin + nearest[seen] * view.ways[:, seen]
        made.append(_Cloth(seen, points, np.empty_like(points), np.empty_like(points), moving[owner]))
        ends.append(np.searchsorted(owner[seen], np.arange(len(bodies) + 1)))
    for index, body in enumerate(bodies):
        parts = [slice(*each[index : index + 2]) for each in ends]
        points = np.concatenate([cloth.points[:, part] for cloth, part in zip(made, parts, strict=True)], axis=1)
        normals = body.normals(points)
        # Each body has a cloth of its own: a left leg must not match a right one.
        colours = body.paint.colours(body.own(points) + 0.8 * index)
        first = 0
        for cloth, part in zip(made, parts, strict=True):
            stop = first + part.stop - part.start
            cloth.normals[:, part], cloth.colours[:, part] = normals[:, first:stop], colours[:, first:stop]
            first = stop
    return made


def _finished(
    view: View, cloth: _Cloth, lit: Array, backdrop: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    around = cv2.remap(backdrop, *view.place, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
    image = view.albedo * around.reshape(-1, 3).T
    reflected = np.asarray(view.stage.bounce, np.float32)[:, None] * (0.5 - 0.4 * cloth.normals[2])
    image[:, cloth.seen] = cloth.colours * (lit + reflected)
    return _pixels(image, view), _pixels(cloth.moving[None], view)[..., 0]


def first_met(view: View, bodies: Sequence[Body]) -> tuple[Array, NDArray[np.int32]]:
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
    shape = view.place[0].shape
    u, v, depth = (value.item() for value in project(view.camera, body.centre[None]))
    if depth < body.reach:
        return np.empty(0, np.intp)
    margin = 1.3 * view.camera.fx * body.reach / (depth - 0.99 * body.reach) + 1
    spans = []
    for middle, side in ((v, shape[0]), (u, shape[1])):
        first, stop = (int(np.clip(GRID * (middle + reach), 0, side)) for reach in (-margin, margin))
        spans.append(np.arange(first, stop))
    return np.asarray((spans[0][:, None] * shape[1] + spans[1]).ravel())


def _pixels(samples: NDArray[np.generic], view: View) -> NDArray[np.float32]:
    """The means (H, W, C) of samples (C, N)."""
    grid = samples.reshape(-1, view.camera.height, GRID, view.camera.width, GRID)
    return np.asarray(grid.mean((2, 4)), np.float32).transpose(1, 2, 0)


def coded(linear: NDArray[np.float32], random: np.random.Generator) -> NDArray[np.uint8]:
    """sRGB with a sensor's noise, 8 bits."""
    linear = np.clip(linear, 0, 1)
    curve = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.clip(np.rint(255 * curve + random.normal(0, NOISE, curve.shape)), 0, 255).astype(np.uint8)


def write_stage(
    name: str, folder: Path, views: Sequence[Camera], frames: int, seed: int = 0, *, is_empty: bool = False
) -> Path:
    """rig.json, camNN/FFFF.png, truth/mattes/camNN/FFFF.png and scene.json; the same bits for the same seed.

    ``is_empty``: nobody is on stage.
    """
    folder.mkdir(parents=True)
    stage = scenes.STAGES[name]
    looking = [look(camera, stage) for camera in views]
    gains = 1 + stage.gains * np.random.default_rng(seed).uniform(-1, 1, len(views))
    for frame in range(frames):
        acting = [] if is_empty else [*stage.acting(frame, stage.clothes), *stage.more(frame)]
        backdrop = light_on_backdrop(stage, acting, views[0].height)
        rendered = render_all(looking, acting, backdrop)
        for index, (view, (image, matte)) in enumerate(zip(looking, rendered, strict=True)):
            picture = coded(image * np.float32(gains[index]), np.random.default_rng((seed, index, frame)))
            _write(folder / view.camera.name / f"{frame:04d}.png", picture[..., ::-1])
            _write(folder / "truth/mattes" / view.camera.name / f"{frame:04d}.png", np.rint(255 * matte))
    told = {"name": name, "seed": seed, "held_out": scenes.HELD_OUT, "gains": gains.tolist()}
    told["backdrop"] = scenes.ROOMS[stage.room]
    (folder / "scene.json").write_text(json.dumps(told, indent=1))
    (folder / "rig.json").write_text(json.dumps(calibration(views)))
    return folder


def _write(path: Path, picture: NDArray[np.generic]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), picture.astype(np.uint8)), path


def calibration(views: Sequence[Camera]) -> dict[str, object]:
    """The rig.json of cameras in folders of their names."""
    names = ("name", "width", "height", "fx", "fy", "cx", "cy", "distortion_model", "distortion")
    entries = [
        {name: getattr(view, name) for name in names}
        | {"file": view.name, "world_to_camera": view.world_to_camera.tolist()}
        for view in views
    ]
    return {
        "fps": scenes.FPS,
        "pixel_convention": "(0.5,0.5)",
        "length_unit": "metre",
        "source": "made",
        "cameras": entries,
    }


def size(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", choices=scenes.STAGES)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--frames", type=int, default=6)
    parser.add_argument("--size", type=size, default=(240, 320))
    parser.add_argument("--seed", type=int, default=0)
    told = parser.parse_args()
    if told.folder.exists():
        parser.error(f"{told.folder}: is there already; name another folder")
    write_stage(told.scene, told.folder, scenes.cameras(told.size), told.frames, told.seed)


if __name__ == "__main__":
    main()
