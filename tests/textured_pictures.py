"""Pictures with detail everywhere, the noise of a sensor, and a textured wall that several cameras see."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest

from decogs.formats.cameras import Camera, camera_centre


@pytest.fixture(scope="session")
def texture() -> np.ndarray:
    """A picture (120, 160, 3) uint8 with detail at several sizes and colours, from 40 to 200."""
    random = np.random.default_rng(3)
    picture = np.zeros((120, 160, 3), np.float32)
    for size in (4, 8, 16, 40):
        small = random.normal(0, 1, (120 // size + 2, 160 // size + 2, 3)).astype(np.float32)
        picture += cv2.resize(small, (160, 120), interpolation=cv2.INTER_CUBIC)
    return np.clip(120 + 25 * picture, 40, 200).astype(np.uint8)


@pytest.fixture(scope="session")
def with_noise() -> Callable[..., np.ndarray]:
    """Adds sensor noise of ``deviation`` levels to a picture, another for every ``seed``."""

    def noisy(picture: np.ndarray, seed: int, deviation: float = 1.2) -> np.ndarray:
        noise = np.random.default_rng(seed).normal(0, deviation, picture.shape)
        return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)

    return noisy


PLANE_SIZE = (352, 264)


@pytest.fixture(scope="session")
def plane_views() -> Callable[..., tuple[list[Camera], list[np.ndarray]]]:
    """Cameras on an arc that see a matte, flat, textured wall, exactly; some lenses may bend beyond the calibration."""
    random = np.random.default_rng(11)
    wall = np.zeros((1200, 1600, 3), np.float32)
    for size in (6, 12, 30, 80, 200):
        small = random.normal(0, 1, (1200 // size + 2, 1600 // size + 2, 3)).astype(np.float32)
        wall += cv2.resize(small, (1600, 1200), interpolation=cv2.INTER_CUBIC)
    wall = cv2.GaussianBlur(np.clip(120 + 25 * wall, 10, 245), (0, 0), 3.0)

    def views(**k1: float) -> tuple[list[Camera], list[np.ndarray]]:
        cameras = [_on_arc(index) for index in range(5)]
        return cameras, [_seen(wall, camera, k1.get(camera.name, 0.0), random) for camera in cameras]

    return views


def _on_arc(index: int) -> Camera:
    """Two units before a wall at z = 0.5, 12 degrees apart, up and down by turns."""
    angle, width, height = np.radians(-24 + 12 * index), *PLANE_SIZE
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = [0, 0.2 * (-1) ** index, 2]
    return Camera(f"cam{index:02d}", width, height, 300.0, 300.0, width / 2, height / 2, pose)


def _seen(wall: np.ndarray, camera: Camera, k1: float, random: np.random.Generator) -> np.ndarray:
    """The wall's pixels on the rays of the camera's, 4 units wide; a lens bends as OpenCV's k1 does."""
    across, down = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    bent = np.stack([(across - camera.cx) / camera.fx, (down - camera.cy) / camera.fy], axis=-1)
    straight = bent
    for _ in range(20):
        straight = bent / (1 + k1 * (straight**2).sum(axis=-1, keepdims=True))
    rays = np.concatenate([straight, np.ones((*across.shape, 1))], axis=-1) @ camera.world_to_camera[:3, :3]
    centre = camera_centre(camera)
    point = centre + rays * ((0.5 - centre[2]) / rays[..., 2:])
    column, row = (400 * point[..., k] + (800, 600)[k] - 0.5 for k in (0, 1))
    picture = cv2.remap(wall, column.astype(np.float32), row.astype(np.float32), cv2.INTER_CUBIC)
    return np.clip(np.rint(picture + random.normal(0, 1.2, picture.shape)), 0, 255).astype(np.uint8)
