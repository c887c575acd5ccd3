"""Small synthetic rigs in every layout, and where the optional shared data lies."""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

WIDTH, HEIGHT, FRAMES = 64, 48, 5
FOCAL = 60.0


def look_at(position: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Camera-to-world, OpenCV axes, (4, 4)."""
    forward = (target - position) / np.linalg.norm(target - position)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, position], axis=1)
    return pose


def camera_to_world(index: int) -> np.ndarray:
    """The synthetic rig: cameras on an arc, all looking at (0.1, 0.2, 0.3)."""
    angle = -0.6 + 0.3 * index
    return look_at(np.array([2 * np.sin(angle), -2 * np.cos(angle), 0.5 + 0.1 * index]), np.array([0.1, 0.2, 0.3]))


def write_video(path: Path, *, frames: int = FRAMES, size: tuple[int, int] = (WIDTH, HEIGHT), fps: float = 30) -> None:
    """Frame k is a flat grey of 30 + 20 k, and red is brighter than blue by 20."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"mp4v"), fps, size)
    assert writer.isOpened()
    for k in range(frames):
        grey = 30 + 20 * k
        writer.write(np.full((size[1], size[0], 3), (grey - 10, grey, grey + 10), np.uint8))
    writer.release()


def write_pictures(
    folder: Path, *, frames: int = FRAMES, suffix: str = ".png", size: tuple[int, int] = (WIDTH, HEIGHT)
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for k in range(frames):
        picture = np.full((size[1], size[0], 3), (20 + 20 * k, 30 + 20 * k, 40 + 20 * k), np.uint8)
        assert cv2.imwrite(str(folder / f"{k:04d}{suffix}"), picture)


def poses_bounds_row(index: int, *, size: tuple[int, int] = (WIDTH, HEIGHT), focal: float = FOCAL) -> np.ndarray:
    """LLFF: columns down, right, backwards, position, (height, width, focal); then near and far."""
    right, down, forward, position = camera_to_world(index)[:3].T
    matrix = np.stack([down, right, -forward, position, np.array([size[1], size[0], focal])], axis=1)
    return np.concatenate([matrix.ravel(), (0.5, 9.0)])


def write_n3dv(folder: Path, *, cameras: int = 3, name: str = "cam{:02d}", **calibration: Any) -> Path:
    for i in range(cameras):
        write_video(folder / f"{name.format(i)}.mp4")
    np.save(folder / "poses_bounds.npy", np.stack([poses_bounds_row(i, **calibration) for i in range(cameras)]))
    return folder


def quaternion(rotation: np.ndarray) -> np.ndarray:
    """wxyz of a rotation matrix, through OpenCV's rotation vector."""
    vector = cv2.Rodrigues(rotation)[0].ravel()
    angle = float(np.linalg.norm(vector))
    axis = vector / angle if angle > 0 else vector
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * axis)])


LENSES: dict[str, tuple[int, tuple[float, ...]]] = {
    "SIMPLE_PINHOLE": (0, (60.0, 31.0, 25.0)),
    "PINHOLE": (1, (60.0, 61.0, 31.0, 25.0)),
    "SIMPLE_RADIAL": (2, (60.0, 31.0, 25.0, 0.1)),
    "RADIAL": (3, (60.0, 31.0, 25.0, 0.1, -0.02)),
    "OPENCV": (4, (60.0, 61.0, 31.0, 25.0, 0.1, -0.02, 0.003, -0.004)),
    "OPENCV_FISHEYE": (5, (60.0, 61.0, 31.0, 25.0, 0.1, -0.02, 0.003, -0.004)),
    "FULL_OPENCV": (6, (60.0, 61.0, 31.0, 25.0, 0.1, -0.02, 0.003, -0.004, 0.005, 0.006, 0.007, 0.008)),
    "FOV": (7, (60.0, 61.0, 31.0, 25.0, 0.5)),
}
POINTS = [((0.25, -0.5, 1.0), (255, 0, 7)), ((1.5, 2.0, -3.0), (1, 2, 3))]


def write_colmap_model(
    model: Path, names: list[str], *, text: bool, lens: str = "PINHOLE", indices: list[int] | None = None
) -> None:
    """A model with one camera entry for all images, two feature points per image (none for the first), two points."""
    model.mkdir(parents=True, exist_ok=True)
    number, parameters = LENSES[lens]
    poses = [np.linalg.inv(camera_to_world(i)) for i in (indices or range(len(names)))]
    entries = [(quaternion(pose[:3, :3]), pose[:3, 3], name) for pose, name in zip(poses, names, strict=True)]
    if text:
        words = " ".join(repr(p) for p in parameters)
        (model / "cameras.txt").write_text(f"# comment\n7 {lens} {WIDTH} {HEIGHT} {words}\n")
        lines = ["# comment"]
        for i, (q, t, name) in enumerate(entries):
            lines.append(" ".join([str(i + 1), *(repr(float(v)) for v in (*q, *t)), "7", name]))
            lines.append("1.5 2.5 -1 3.5 4.5 1" if i else "")
        (model / "images.txt").write_text("\n".join(lines) + "\n")
        rows = [" ".join(map(str, (i, *xyz, *rgb, 0.5, 1, 0, 2, 1))) for i, (xyz, rgb) in enumerate(POINTS)]
        (model / "points3D.txt").write_text("# comment\n" + "\n".join(rows) + "\n")
        return
    head = struct.pack("<QIiQQ", 1, 7, number, WIDTH, HEIGHT)
    (model / "cameras.bin").write_bytes(head + struct.pack(f"<{len(parameters)}d", *parameters))
    data = struct.pack("<Q", len(entries))
    for i, (q, t, name) in enumerate(entries):
        features = [(1.5, 2.5, 2**64 - 1), (3.5, 4.5, 1)] if i else []
        data += struct.pack("<I7dI", i + 1, *q, *t, 7) + name.encode() + b"\0" + struct.pack("<Q", len(features))
        data += b"".join(struct.pack("<2dQ", *feature) for feature in features)
    (model / "images.bin").write_bytes(data)
    data = struct.pack("<Q", len(POINTS))
    for i, (xyz, rgb) in enumerate(POINTS):
        data += struct.pack("<Q3d3BdQ4I", i, *xyz, *rgb, 0.5, 2, 1, 0, 2, 1)
    (model / "points3D.bin").write_bytes(data)


def write_colmap(folder: Path, *, text: bool, cameras: int = 3, lens: str = "PINHOLE") -> Path:
    for i in range(cameras):
        write_video(folder / f"cam{i:02d}.mp4")
    write_colmap_model(folder / "sparse" / "0", [f"cam{i:02d}.png" for i in range(cameras)], text=text, lens=lens)
    return folder


def rig_json_values(cameras: int = 3) -> dict[str, Any]:
    return {
        "pixel_convention": "OpenCV: x right, y down, the centre of the top-left pixel is (0,0)",
        "fps": 30,
        "frame_count": FRAMES,
        "source": "synthetic",
        "licence": "none",
        "cameras": [
            {
                "name": f"cam{i:02d}",
                "file": f"cam{i:02d}.mp4",
                "width": WIDTH,
                "height": HEIGHT,
                "fx": 60.0,
                "fy": 61.0,
                "cx": 30.5,
                "cy": 24.5,
                "distortion_model": "opencv",
                "distortion": [0.1, -0.02, 0.003, -0.004],
                "world_to_camera": np.linalg.inv(camera_to_world(i)).tolist(),
            }
            for i in range(cameras)
        ],
    }


def write_rig_json(folder: Path, values: dict[str, Any] | None = None, *, cameras: int = 3) -> Path:
    for i in range(cameras):
        write_video(folder / f"cam{i:02d}.mp4")
    (folder / "rig.json").write_text(json.dumps(rig_json_values(cameras) if values is None else values))
    return folder


def transforms_values(paths: list[str], *, indices: list[int] | None = None) -> dict[str, Any]:
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    return {
        "camera_model": "OPENCV",
        "fl_x": 60.0,
        "fl_y": 61.0,
        "cx": 31.0,
        "cy": 25.0,
        "w": WIDTH,
        "h": HEIGHT,
        "k1": 0.1,
        "k2": -0.02,
        "p1": 0.003,
        "p2": -0.004,
        "frames": [
            {"file_path": path, "transform_matrix": (camera_to_world(i) @ flip).tolist()}
            for i, path in zip(indices or range(len(paths)), paths, strict=True)
        ],
    }


def write_nerfstudio(folder: Path, values: dict[str, Any] | None = None, *, cameras: int = 3) -> Path:
    names = [f"cam{i:02d}.mp4" for i in range(cameras)]
    for name in names:
        write_video(folder / name)
    (folder / "transforms.json").write_text(json.dumps(transforms_values(names) if values is None else values))
    return folder


def with_frame_durations(mp4: bytes, durations: list[int]) -> bytes:
    """The file with the entries of its time-to-sample table replaced; its ``moov`` has to come last."""
    entries = struct.pack(">II", 0, len(durations)) + b"".join(struct.pack(">II", 1, d) for d in durations)
    return _replace_box(mp4, [b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stts"], entries)


def _replace_box(data: bytes, path: list[bytes], content: bytes) -> bytes:
    out, at = b"", 0
    while at < len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        body = data[at + 8 : at + size]
        if kind == path[0]:
            body = content if len(path) == 1 else _replace_box(body, path[1:], content)
        out += struct.pack(">I4s", len(body) + 8, kind) + body
        at += size
    return out


class RigMaker:
    """The writers above, for tests (test modules are imported on their own and cannot import this file)."""

    width, height, frames, focal = WIDTH, HEIGHT, FRAMES, FOCAL
    points = POINTS
    lenses = LENSES
    camera_to_world = staticmethod(camera_to_world)
    video = staticmethod(write_video)
    pictures = staticmethod(write_pictures)
    poses_bounds_row = staticmethod(poses_bounds_row)
    n3dv = staticmethod(write_n3dv)
    colmap = staticmethod(write_colmap)
    colmap_model = staticmethod(write_colmap_model)
    rig_json = staticmethod(write_rig_json)
    rig_json_values = staticmethod(rig_json_values)
    nerfstudio = staticmethod(write_nerfstudio)
    transforms_values = staticmethod(transforms_values)
    with_frame_durations = staticmethod(with_frame_durations)


@pytest.fixture(scope="session")
def make() -> type[RigMaker]:
    return RigMaker


@pytest.fixture(scope="session")
def shared_data() -> Callable[[str], Path]:
    """``shared_data("rigs/workbench")``: that folder of the optional shared data; skips the test where it is absent."""
    root = Path(os.environ.get("DECOGS_SHARED", Path(__file__).resolve().parents[2].parent / "shared")) / "data"

    def find(name: str) -> Path:
        if not (root / name).exists():
            pytest.skip(f"no shared data at {root / name}")
        return root / name

    return find
