"""A wall of Gaussians of which some move, and how like it a part of them is."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key
from decogs.codec.scene.lattice import default_lattice, dequantise, quantise
from decogs.codec.scene.state import State, take_rows
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.backends import training_kernel
from decogs.encoder.backends.psnr import psnr_of, square_error
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats
from decogs.formats.stream.container import PacketKind, StreamWriter

COUNT = 600


def camera(name: str, x: float) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = -x
    return Camera(name, 80, 60, 70.0, 70.0, 40.0, 30.0, pose)


CAMERAS = tuple(camera(f"cam{k}", 0.5 * (k - 1)) for k in range(3))


def wall() -> Splats:
    """Small Gaussians before and behind each other, of colours that change smoothly."""
    random = np.random.default_rng(0)
    means = random.uniform((-2.5, -2, 3.5), (2.5, 2, 4.5), (COUNT, 3))
    colours = np.stack([np.sin(means[:, 0]), np.cos(means[:, 1]), np.sin(means[:, 2])], axis=1)
    quaternions = random.normal(size=(COUNT, 4))
    return Splats(
        means.astype(np.float32),
        np.log(random.uniform(0.08, 0.2, (COUNT, 3))).astype(np.float32),
        (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).astype(np.float32),
        random.uniform(0.0, 3.0, COUNT).astype(np.float32),
        colours[:, None].astype(np.float32),
    )


def moving_wall(path: Path) -> SimpleNamespace:
    """A stream of eight frames in which a fifth of a wall moves, some Gaussians come and some go."""
    lattice = default_lattice(1.0)
    header = StreamHeader(cameras=CAMERAS, lattice=lattice, fps=30.0)
    state, _ = keyframe_state(quantise(wall(), lattice))
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state).payload)
        for frame in range(1, 8):
            rows = np.arange(frame % 2, len(state), 5)
            current = take_rows(state, rows)
            current.means[:, 0] += 40
            added = take_rows(state, np.arange(10 * frame, 10 * frame + 4))
            delta = difference(state, rows, current, removed=np.array([frame, 2 * frame + 50]), added=added)
            writer.write(PacketKind.DELTA, frame, write_delta(state, delta).payload)
            state = apply_delta(state, delta)
        writer.finish()
    return SimpleNamespace(path=path, lattice=lattice)


def likeness(whole: list[State], some: list[State], lattice: object) -> list[float]:
    """PSNR of one against the other, of each frame."""
    kernel = training_kernel("cpu", 1)

    def picture(state: State, camera: Camera) -> np.ndarray:
        return np.clip(kernel.forward(dequantise(state, lattice), camera).rgb, 0, 1).copy()  # type: ignore[arg-type]

    return [
        psnr_of(np.mean([square_error(picture(base, view), picture(all_of_it, view)) for view in CAMERAS]))
        for all_of_it, base in zip(whole, some, strict=True)
    ]


def bases_of(path: Path) -> list[State]:
    with open_stream(path, strict=True, layer="base") as stream:
        return [frame.state for frame in stream.frames()]
