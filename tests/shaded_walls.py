"""A wall as cameras record it, each with a gain and a fall-off of its own."""

from __future__ import annotations

import numpy as np

from decogs.codec.packets.corrections import FALLOFF_STEP, Correction
from decogs.decoder.cameras.corrections import apply_gain, darkening
from decogs.formats.cameras import Camera, ray_slopes
from decogs.rig.pictures.ingest import View

SIZE, FOCAL = (160, 120), 120.0
LOSSES = (0.15, 0.35, 0.0, 0.25, 0.3, 0.2)
"""Of light in the corners, by view."""
CORNER = (80 / FOCAL) ** 2 + (60 / FOCAL) ** 2


def k_of(loss: float) -> float:
    return ((1 - loss) ** -0.5 - 1) / CORNER


def looking(index: int, count: int) -> View:
    """From 3 m before a wall, each at another part of it."""
    aside = np.radians(24 * (index / (count - 1) - 0.5))
    down = np.radians((-6, 7, 0)[index % 3])
    turn = np.array([[np.cos(aside), 0, -np.sin(aside)], [0, 1, 0], [np.sin(aside), 0, np.cos(aside)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(down), -np.sin(down)], [0, np.sin(down), np.cos(down)]])
    pose = np.eye(4)
    pose[:3, :3] = tilt @ turn
    pose[:3, 3] = -pose[:3, :3] @ [1.2 * (index / (count - 1) - 0.5), 0.2 * (index % 2), -3]
    camera = Camera(f"cam{index:02d}", *SIZE, FOCAL, FOCAL, SIZE[0] / 2, SIZE[1] / 2, pose)
    return View(camera, camera, None)


def wall(view: View, gain: float, loss: float, noise: float, seed: int) -> np.ndarray:
    """What the view records of the wall at z = 0: (3, H, W)."""
    camera, random = view.pinhole, np.random.default_rng(seed)
    rows, columns = np.indices((camera.height, camera.width)) + 0.5
    ways = np.stack([*ray_slopes(camera, columns, rows), np.ones_like(rows)], axis=-1) @ camera.world_to_camera[:3, :3]
    centre = -camera.world_to_camera[:3, :3].T @ camera.world_to_camera[:3, 3]
    at = centre + ways * (-centre[2] / ways[..., 2])[..., None]
    shades = [0.5 + 0.2 * np.sin((3 + c) * at[..., 0] + c) * np.cos(4 * at[..., 1] - c) for c in range(3)]
    seen = np.stack(shades, axis=-1)
    dark = darkening(Correction(falloff=round(k_of(loss) / FALLOFF_STEP)), camera)[..., None] if loss else 1.0
    recorded = apply_gain(seen, np.exp(gain) * dark * np.ones(3)) + random.normal(0, noise / 255, seen.shape)
    return np.ascontiguousarray(np.clip(recorded, 0, 1).transpose(2, 0, 1), np.float32)
