"""Four small rigs, rendered from Gaussians that are made up here: what the canary encodes.

Every scene is a function of the frame; pictures have the sensor noise of a quiet camera (one 8-bit step).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.lattice import default_lattice
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import Camera
from decogs.formats.splats import SH_C0, Splats, join_splats

WIDTH, HEIGHT, FRAMES = 88, 66, 4
HELD_OUT = "cam02"
_NOISE = 1.0


@dataclass(frozen=True)
class CanaryRig:
    """Where the cameras stand and what they see in each frame."""

    cameras: tuple[Camera, ...]
    scene: Callable[[int], Splats]


def look_at(name: str, place: Sequence[float], target: Sequence[float], focal: float = 80.0) -> Camera:
    """A camera at ``place``, upright in a world whose y points down."""
    forward = np.subtract(target, place)
    forward = forward / np.linalg.norm(forward)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(place, np.float64)
    return Camera(name, WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, pose)


def arc_cameras() -> tuple[Camera, ...]:
    """Six in two heights on an arc of 70 degrees."""
    angles = np.radians(np.linspace(-35, 35, 6))
    places = [(3 * np.sin(a), -0.4 + 0.5 * (i % 2), -3 * np.cos(a)) for i, a in enumerate(angles)]
    return tuple(look_at(f"cam{i:02d}", place, (0, 0.1, 0.3)) for i, place in enumerate(places))


def ring_cameras() -> tuple[Camera, ...]:
    """Eight all around, looking inwards and a little down."""
    angles = np.radians(np.arange(8) * 45.0)
    places = [(2.6 * np.sin(a), -0.7 - 0.3 * (i % 2), -2.6 * np.cos(a)) for i, a in enumerate(angles)]
    return tuple(look_at(f"cam{i:02d}", place, (0, 0.2, 0)) for i, place in enumerate(places))


def blobs(points: np.ndarray, spacing: float, colours: np.ndarray) -> Splats:
    """Opaque round Gaussians (N, 3), ``spacing`` apart, of ``colours`` (N, 3) in 0..1."""
    count = len(points)
    values = (
        points,
        np.full((count, 3), np.log(0.6 * spacing)),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full(count, 5.0),
        (colours[:, None] - 0.5) / SH_C0,
    )
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def texture(points: np.ndarray, seed: int) -> np.ndarray:
    """Colours (N, 3) that vary smoothly and, less, from point to point."""
    random = np.random.default_rng(seed)
    waves = np.sin(points @ random.normal(0, 3, (3, 3)) + random.uniform(0, 6, 3))
    return np.clip(0.5 + 0.22 * waves + random.uniform(-0.16, 0.16, waves.shape), 0.05, 0.95)


def sheet(across: Sequence[float], down: Sequence[float], depth: float, spacing: float, seed: int) -> Splats:
    """A wall of constant z."""
    x, y = np.meshgrid(np.arange(*across, spacing), np.arange(*down, spacing))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, depth)], 1)
    return blobs(points, spacing, texture(points, seed))


def box(centre: Sequence[float], half: float, spacing: float, seed: int, turn: float = 0.0) -> Splats:
    """The surface of a cube, turned by ``turn`` radians about the vertical; its texture turns with it."""
    steps = np.arange(-half, half + spacing / 2, spacing)
    grid = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(-1, 3)
    points = grid[np.abs(grid).max(1) > half - spacing / 2]
    c, s = np.cos(turn), np.sin(turn)
    placed = points @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T + centre
    return blobs(placed, spacing, texture(points, seed))


def floor_and_walls() -> Splats:
    """A round floor and a cylinder around everything."""
    x, z = np.meshgrid(np.arange(-4, 4, 0.14), np.arange(-4, 4, 0.14))
    ground = np.stack([x.ravel(), np.full(x.size, 0.6), z.ravel()], 1)
    ground = ground[np.hypot(ground[:, 0], ground[:, 2]) < 4]
    angle, y = np.meshgrid(np.arange(0, 2 * np.pi, 0.045), np.arange(-2.0, 0.6, 0.18))
    wall = np.stack([4 * np.sin(angle).ravel(), y.ravel(), 4 * np.cos(angle).ravel()], 1)
    return join_splats(blobs(ground, 0.14, texture(ground, 11)), blobs(wall, 0.18, texture(wall, 12)))


def arc_scene(frame: int) -> Splats:
    """A cube slides and turns before a wall; nothing moves in the third frame."""
    moment = (0, 1, 1, 2)[frame]
    return cube_before_wall(moment)


def cube_before_wall(moment: int) -> Splats:
    return join_splats(WALL, box((-0.35 + 0.09 * moment, 0.15, -0.2), 0.28, 0.07, 2, turn=0.12 * moment))


def dome_scene(frame: int) -> Splats:
    """A cube turns in the middle of a round room, another goes around it."""
    angle = 0.09 * frame
    outer = (0.9 * np.cos(angle), 0.35, 0.9 * np.sin(angle))
    scene = join_splats(ROOM, box((0, 0.2, 0), 0.3, 0.075, 3, turn=0.08 * frame))
    return join_splats(scene, box(outer, 0.2, 0.07, 4))


def light_scene(frame: int) -> Splats:
    """Nothing moves; a lamp on the right grows warmer and brighter, then goes out."""
    return lit_by(cube_before_wall(0), [(0, 0, 0), (0.2, 0.14, 0.05), (0.36, 0.26, 0.1), (0, 0, 0)][frame], 0.8)


def lit_by(scene: Splats, more: Sequence[float], distance: float) -> Splats:
    """The scene with so much ``more`` red, green and blue at a lamp on the right, and less of it at a ``distance``."""
    reach = np.exp(-(((scene.means - [1.0, -0.4, 0.2]) / distance) ** 2).sum(1))
    shown = (scene.sh[:, 0] * SH_C0 + 0.5) * (1 + reach[:, None] * np.array(more))
    lit = Splats(scene.means, scene.log_scales, scene.quaternions, scene.opacity_logits, scene.sh.copy())
    lit.sh[:, 0] = (shown - 0.5) / SH_C0
    return lit


def emergence_scene(frame: int) -> Splats:
    """While a cube slides, a second one is there from the third frame on, and a third one until then."""
    scene = cube_before_wall(frame)
    if frame >= 2:
        return join_splats(scene, box((0.55, -0.25, -0.1), 0.17, 0.068, 5))
    return join_splats(scene, box((0.1, -0.5, 0.1), 0.15, 0.06, 6))


WALL = sheet((-2.2, 2.2), (-1.5, 1.5), 0.7, 0.085, 1)
ROOM = floor_and_walls()

RIGS: dict[str, CanaryRig] = {
    "arc": CanaryRig(arc_cameras(), arc_scene),
    "dome": CanaryRig(ring_cameras(), dome_scene),
    "light": CanaryRig(arc_cameras(), light_scene),
    "emergence": CanaryRig(arc_cameras(), emergence_scene),
}


def write_rig(name: str, folder: Path) -> Path:
    """rig.json and a folder of PNG per camera; the same pixels every time."""
    rig, random = RIGS[name], np.random.default_rng(7)
    for view in rig.cameras:
        (folder / view.name).mkdir(parents=True)
    for frame in range(FRAMES):
        scene = rig.scene(frame)
        for view in rig.cameras:
            clean = to_8bit(render_view(StreamHeader((view,), default_lattice(1.0)), scene, view.name).image)
            noisy = np.clip(np.rint(clean + random.normal(0, _NOISE, clean.shape)), 0, 255).astype(np.uint8)
            assert cv2.imwrite(str(folder / view.name / f"{frame:04d}.png"), noisy[..., ::-1])
    (folder / "rig.json").write_text(json.dumps(rig_document(rig.cameras)))
    return folder


def rig_document(cameras: Sequence[Camera]) -> dict[str, object]:
    entries = [
        {
            "name": view.name,
            "file": view.name,
            "width": view.width,
            "height": view.height,
            "fx": view.fx,
            "fy": view.fy,
            "cx": view.cx,
            "cy": view.cy,
            "world_to_camera": view.world_to_camera.tolist(),
        }
        for view in cameras
    ]
    return {"pixel_convention": "the centre of the top-left pixel is (0.5, 0.5)", "fps": 25, "cameras": entries}
