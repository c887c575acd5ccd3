"""A tiny rig, rendered from known Gaussians: its variants, and the fixtures that write them."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import Correction
from decogs.codec.scene.lattice import default_lattice
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import Camera
from decogs.formats.splats import SH_C0, Splats, join_splats

WIDTH, HEIGHT, FRAMES, CAMERAS = 64, 48, 4, 5
HELD_OUT = "cam02"
LENS = (0.12, 0.01, 0.002, -0.003)
"""Pincushion: its undistorted picture has unrecorded corners."""


def camera(index: int) -> Camera:
    """Cameras on an arc of 60 degrees, 2 units before the origin; x right, y down, z forward."""
    angle = np.radians(-30 + 15 * index)
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = [0, 0.05 * (-1) ** index, 2]
    return Camera(f"cam{index:02d}", WIDTH, HEIGHT, 55.0, 55.0, WIDTH / 2, HEIGHT / 2, pose)


def patch(centre: tuple[float, float, float], across: int, down: int, spacing: float, seed: int) -> Splats:
    """A textured rectangle of opaque Gaussians that faces the cameras."""
    random = np.random.default_rng(seed)
    x, y = np.meshgrid(np.arange(across) - (across - 1) / 2, np.arange(down) - (down - 1) / 2)
    count = across * down
    means = np.stack([x.ravel() * spacing, y.ravel() * spacing, np.zeros(count)], axis=1) + centre
    log_scales = np.tile(np.log([0.6 * spacing, 0.6 * spacing, 0.05 * spacing]), (count, 1))
    colours = random.uniform(0.1, 0.9, (count, 1, 3))
    values = (means, log_scales, np.tile([1.0, 0, 0, 0], (count, 1)), np.full(count, 5.0), (colours - 0.5) / SH_C0)
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def scene_at(frame: int) -> Splats:
    """A wall that stays; before it a square that moves, except from frame 1 to 2; a small one appears in frame 3."""
    place = 0.1 * (0, 1, 1, 2)[frame]
    scene = join_splats(patch((0, 0, 0.5), 56, 34, 0.11, 1), patch((place - 0.1, 0.05, -0.2), 5, 5, 0.08, 2))
    return join_splats(scene, patch((-0.35, -0.2, -0.2), 2, 2, 0.06, 3)) if frame == 3 else scene


class TinyRig:
    """Writes variants of the rig; test modules are imported on their own and cannot import this file."""

    width, height, frames, cameras, held_out = WIDTH, HEIGHT, FRAMES, CAMERAS, HELD_OUT
    names = tuple(f"cam{i:02d}" for i in range(CAMERAS))
    camera = staticmethod(camera)
    patch = staticmethod(patch)
    scene_at = staticmethod(scene_at)

    @staticmethod
    def write(
        folder: Path,
        *,
        cameras: int = CAMERAS,
        frames: Sequence[int] = range(FRAMES),
        noise: float = 0.0,
        lens: tuple[float, ...] = (),
        faults: Callable[[str, int], Correction] | None = None,
    ) -> Path:
        """rig.json with a folder of PNG per camera; ``frames`` are the moments shown, ``noise`` is in 8-bit steps.

        ``faults``: of a camera in a frame, by name and index.
        """
        random = np.random.default_rng(7)
        views = [camera(i) for i in range(cameras)]
        if lens:
            views = [replace(view, distortion_model="opencv", distortion=lens) for view in views]
        for view in views:
            (folder / view.name).mkdir(parents=True)
            for index, moment in enumerate(frames):
                told = None if faults is None else {view.name: faults(view.name, index)}
                seen = render_view(
                    StreamHeader((view,), default_lattice(1.0)), scene_at(moment), view.name, corrections=told
                )
                clean = to_8bit(seen.image)
                noisy = np.clip(np.rint(clean + random.normal(0, noise, clean.shape)), 0, 255).astype(np.uint8)
                TinyRig.write_png(folder / view.name / f"{index:04d}.png", noisy)
        (folder / "rig.json").write_text(json.dumps(TinyRig.values(views)))
        return folder

    @staticmethod
    def values(views: Sequence[Camera]) -> dict[str, Any]:
        return {
            "pixel_convention": "the centre of the top-left pixel is (0.5, 0.5)",
            "fps": 25,
            "source": "rendered for the tests",
            "licence": "CC0-1.0",
            "length_unit": "metre (rendered)",
            "cameras": [
                {
                    "name": view.name,
                    "file": view.name,
                    "width": view.width,
                    "height": view.height,
                    "fx": view.fx,
                    "fy": view.fy,
                    "cx": view.cx,
                    "cy": view.cy,
                    "distortion_model": view.distortion_model,
                    "distortion": list(view.distortion),
                    "world_to_camera": view.world_to_camera.tolist(),
                }
                for view in views
            ],
        }

    @staticmethod
    def write_png(path: Path, picture: np.ndarray) -> None:
        assert cv2.imwrite(str(path), picture[..., ::-1])

    @staticmethod
    def poisoned(rig: Path, copy: Path, name: str) -> Path:
        """A copy in which every picture of one camera is turned upside down and inverted."""
        shutil.copytree(rig, copy)
        for path in (copy / name).iterdir():
            cv2.imwrite(str(path), 255 - cv2.imread(str(path))[::-1])
        return copy


@pytest.fixture(scope="session")
def tiny_rig() -> type[TinyRig]:
    return TinyRig


@pytest.fixture(scope="session")
def moving_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Motion in frames 1 and 3, nothing new in frame 2, a new object in frame 3."""
    return TinyRig.write(tmp_path_factory.mktemp("rigs") / "moving")


@pytest.fixture(scope="session")
def still_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One moment again and again, with the sensor noise of the shared synthetic rigs (1.2 steps)."""
    return TinyRig.write(tmp_path_factory.mktemp("rigs") / "still", frames=[0] * FRAMES, noise=1.2)


@pytest.fixture(scope="session")
def lens_rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two frames seen through lenses whose undistorted pictures have unrecorded pixels."""
    return TinyRig.write(tmp_path_factory.mktemp("rigs") / "lens", frames=[0, 1], lens=LENS)


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """``shared_data("rigs/still")``: that folder of the optional shared data; skips the test where it is absent."""
    root = Path(os.environ.get("DECOGS_SHARED", Path(__file__).resolve().parents[1].parent / "shared")) / "data"

    def find(name: str) -> Path:
        if not (root / name).exists():
            pytest.skip(f"no shared data at {root / name}")
        return root / name

    return find
