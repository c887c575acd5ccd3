"""A small rig written in the layouts of data sets and other programs, each from its own definition of a camera.

Every writer takes an empty folder and cameras as decogs has them, and writes the calibration and the frames.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np

from decogs.formats.cameras import Camera

FRAMES = 5
Writer = Callable[..., None]


def write_video(path: Path, size: tuple[int, int]) -> None:
    """Frame k is a flat grey of 30 + 20 k."""
    path.parent.mkdir(parents=True, exist_ok=True)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter_fourcc(*"mp4v"), 30, size)
    assert writer.isOpened()
    for k in range(FRAMES):
        writer.write(picture(k, size))
    writer.release()


def picture(k: int, size: tuple[int, int]) -> np.ndarray:
    return np.full((size[1], size[0], 3), 30 + 20 * k, np.uint8)


def write_pictures(pattern: Path, size: tuple[int, int], first: int = 0) -> None:
    """``pattern``: a path whose name is formatted with the number of the frame."""
    for k in range(FRAMES):
        path = Path(str(pattern).format(first + k))
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), picture(k, size))


def camera_to_world(index: int) -> np.ndarray:
    """OpenCV axes, (4, 4): cameras on an arc that look at (0.1, 0.2, 0.3)."""
    angle = -0.6 + 0.3 * index
    position = np.array([2 * np.sin(angle), -2 * np.cos(angle), 0.5 + 0.1 * index])
    forward = np.array([0.1, 0.2, 0.3]) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3] = np.stack([right, np.cross(forward, right), forward, position], axis=1)
    return pose


SIZE = (64, 48)


def cameras(lens: str, names: Sequence[str]) -> list[Camera]:
    """The rig, with a principal point off the centre, two focal lengths and a lens that bends."""
    coefficients = {"none": (), "opencv": (0.1, -0.02, 0.003, -0.004, 0.01), "fisheye": (0.1, -0.02, 0.0, 0.0)}[lens]
    return [
        Camera(name, *SIZE, 60.0, 61.0, 31.0, 25.0, np.linalg.inv(camera_to_world(i)), lens, coefficients)  # type: ignore[arg-type]
        for i, name in enumerate(names)
    ]


def matrix(camera: Camera, shift: float) -> list[list[float]]:
    """The camera matrix where the centre of the first pixel is at ``shift``."""
    return [[camera.fx, 0.0, camera.cx - 0.5 + shift], [0.0, camera.fy, camera.cy - 0.5 + shift], [0.0, 0.0, 1.0]]


def rotation_vector(rotation: np.ndarray) -> list[float]:
    return list(map(float, cv2.Rodrigues(rotation)[0].ravel()))


def quaternion(rotation: np.ndarray) -> np.ndarray:
    vector = np.array(rotation_vector(rotation))
    angle = float(np.linalg.norm(vector))
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * vector / angle)])


# --- EasyVolcap -----------------------------------------------------------------------------------------------------


def _yml_matrix(key: str, values: Any) -> str:
    array = np.array(values, np.float64)
    rows, columns = array.reshape(len(array), -1).shape
    data = ", ".join(f"{value:.10f}" for value in array.ravel())
    return f"{key}: !!opencv-matrix\r\n  rows: {rows}\r\n  cols: {columns}\r\n  dt: d\r\n  data: [{data}]\r\n"


def write_easyvolcap(folder: Path, rig: Sequence[Camera], more: str = "") -> None:
    names = "names:\r\n" + "".join(f'  - "{camera.name}"\r\n' for camera in rig)
    intrinsics, poses = "%YAML:1.0\r\n---\r\n" + names, "%YAML:1.0\r\n---\r\n" + names + more
    for camera in rig:
        name, pose = camera.name, camera.world_to_camera
        intrinsics += _yml_matrix(f"K_{name}", matrix(camera, 0.5))
        intrinsics += f"H_{name}: {camera.height:.10f}\r\nW_{name}: {camera.width:.10f}\r\n"
        intrinsics += _yml_matrix(f"D_{name}", [[value] for value in camera.distortion])
        poses += _yml_matrix(f"R_{name}", [[value] for value in rotation_vector(pose[:3, :3])])
        poses += _yml_matrix(f"Rot_{name}", pose[:3, :3]) + _yml_matrix(f"T_{name}", pose[:3, 3:])
        write_pictures(folder / "images" / name / "{:06d}.png", SIZE)
    (folder / "intri.yml").write_text(intrinsics)
    (folder / "extri.yml").write_text(poses)


# --- TOML -----------------------------------------------------------------------------------------------------------


def _table(camera: Camera) -> str:
    pose = camera.world_to_camera
    return (
        f"size = [ {float(camera.width)}, {float(camera.height)},]\nmatrix = {matrix(camera, 0.0)}\n"
        f"distortions = {list(camera.distortion)}\nrotation = {rotation_vector(pose[:3, :3])}\n"
        f"translation = {pose[:3, 3].tolist()}\nfisheye = {str(camera.distortion_model == 'fisheye').lower()}\n\n"
    )


def write_aniposelib(folder: Path, rig: Sequence[Camera]) -> None:
    text = "".join(f'[cam_{i}]\nname = "{camera.name}"\n{_table(camera)}' for i, camera in enumerate(rig))
    (folder / "calibration.toml").write_text(text + "[metadata]\nadjusted = false\nerror = 0.0\n")
    for camera in rig:
        write_video(folder / f"take1_{camera.name}.mp4", SIZE)


def write_caliscope(folder: Path, rig: Sequence[Camera]) -> None:
    text = "".join(f"[cameras.{i}]\ncam_id = {i}\n{_table(camera)}" for i, camera in enumerate(rig))
    (folder / "camera_array.toml").write_text(text)
    for camera in rig:
        write_video(folder / f"{camera.name}.mp4", SIZE)


# --- Qualisys -------------------------------------------------------------------------------------------------------

_LEFT, _TOP = 8, 4
"""Where on its sensor a camera films."""


def write_qualisys(folder: Path, rig: Sequence[Camera]) -> None:
    text = '<?xml version="1.0" encoding="UTF-8"?>\n<calibration type="regular"><cameras>\n'
    text += '<camera model="Miqus M3" serial="9"><transform/></camera>\n'
    for camera in rig:
        centre = np.linalg.inv(camera.world_to_camera)[:3, 3] * 1000
        rows = np.diag([1.0, -1.0, -1.0]) @ camera.world_to_camera[:3, :3]
        turn = " ".join(f'r{row + 1}{column + 1}="{rows[row, column]!r}"' for row in range(3) for column in range(3))
        k1, k2, p1, p2, k3 = camera.distortion
        text += (
            (
                f'<camera model="Miqus Video" serial="{camera.name}">'
                f'<fov_video left="{_LEFT}" top="{_TOP}" right="{_LEFT + camera.width - 1}" '
                f'bottom="{_TOP + camera.height - 1}"/>'
                f'<transform {turn} x="{centre[0]}" y="{centre[1]}" z="{centre[2]}"/>'
                f'<intrinsic focalLengthU="{64 * camera.fx}" focalLengthV="{64 * camera.fy}" skew="0" '
                f'centerPointU="{64 * (camera.cx - 0.5 + _LEFT)}" centerPointV="{64 * (camera.cy - 0.5 + _TOP)}" '
                f'radialDistortion1="{k1}" radialDistortion2="{k2}" radialDistortion3="{k3}" '
                f'tangentalDistortion1="{p1}" tangentalDistortion2="{p2}"/></camera>\n'
            )
            .replace("np.float64(", "")
            .replace(')"', '"')
        )
        write_video(folder / f"Miqus_1_{camera.name}.mp4", SIZE)
    (folder / "take.qca.txt").write_text(text + "</cameras></calibration>\n")


# --- data sets ------------------------------------------------------------------------------------------------------


def write_immersive(folder: Path, rig: Sequence[Camera]) -> None:
    views = [
        {
            "name": camera.name,
            "position": np.linalg.inv(camera.world_to_camera)[:3, 3].tolist(),
            "orientation": rotation_vector(camera.world_to_camera[:3, :3]),
            "focal_length": camera.fx,
            "pixel_aspect_ratio": camera.fy / camera.fx if camera.fx else 1.0,
            "principal_point": [camera.cx, camera.cy],
            "height": float(camera.height),
            "width": float(camera.width),
            "radial_distortion": [*camera.distortion[:2], 0.0],
            "projection_type": "fisheye",
        }
        for camera in rig
    ]
    (folder / "models.json").write_text(json.dumps(views))
    for camera in rig:
        write_video(folder / f"{camera.name}.mp4", SIZE)


def write_technicolor(folder: Path, rig: Sequence[Camera]) -> None:
    lines = ["f cu cv aspect skew qw qx qy qz tx ty tz"]
    for i, camera in enumerate(rig):
        q, t = quaternion(camera.world_to_camera[:3, :3]), camera.world_to_camera[:3, 3]
        aspect = camera.fy / camera.fx if camera.fx else 1.0
        numbers = [camera.fx, camera.cx, camera.cy, aspect, 0.0, *q, *t]
        lines.append("  ".join(f"{number:.12g}" for number in numbers) + " ")
        write_pictures(folder / f"Scene_undist_{{:05d}}_{i:02d}.png", SIZE, first=100)
    (folder / "cameras_parameters.txt").write_text("\n".join(lines) + "\n\n")


def write_panoptic(folder: Path, rig: Sequence[Camera]) -> None:
    records = [
        {
            "name": camera.name,
            "type": "hd",
            "resolution": [camera.width, camera.height],
            "K": matrix(camera, 0.0),
            "distCoef": list(camera.distortion),
            "R": camera.world_to_camera[:3, :3].tolist(),
            "t": camera.world_to_camera[:3, 3:].tolist(),
        }
        for camera in rig
    ]
    others = [{**records[0], "name": "01_01", "type": "vga"}, {**records[0], "name": "00_30"}]
    (folder / "calibration_take.json").write_text(json.dumps({"cameras": records + others}))
    for camera in rig:
        write_video(folder / "hdVideos" / f"hd_{camera.name}.mp4", SIZE)


def write_splits(folder: Path, rig: Sequence[Camera]) -> None:
    opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    entries: list[list[dict[str, Any]]] = [[], [], []]
    for i, camera in enumerate(rig):
        k1, k2, p1, p2, k3 = camera.distortion
        write_pictures(folder / "frames_1" / camera.name / "{:08d}.png", SIZE)
        for k in range(FRAMES):
            entry = {
                "file_path": f"frames_1/{camera.name}/{k:08d}.png",
                "time": k / FRAMES,
                "transform_matrix": (np.linalg.inv(camera.world_to_camera) @ opengl).tolist(),
                **{"fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy},
                **{"w": camera.width, "h": camera.height, "k1": k1, "k2": k2, "k3": k3, "p1": p1, "p2": p2},
            }
            for split in [0] if i else [1, 2]:  # the first camera is for validation and test
                entries[split].append(entry)
    for split, frames in zip(("train", "val", "test"), entries, strict=True):
        (folder / f"transforms_{split}.json").write_text(json.dumps({"frames": frames}))


LENS = ("fx", "fy", "px", "py", "k1", "k2", "k3")


def write_actors_hq(folder: Path, rig: Sequence[Camera]) -> None:
    with (folder / "calibration.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["name", "w", "h", *("r" + axis for axis in "xyz"), *("t" + axis for axis in "xyz"), *LENS])
        for camera in (*rig, replace(rig[0], name="Cam160")):  # the last one has no pictures
            pose, (width, height) = np.linalg.inv(camera.world_to_camera), (camera.width, camera.height)
            focal = (camera.fx / width, camera.fy / height, camera.cx / width, camera.cy / height)
            turn = rotation_vector(pose[:3, :3])
            writer.writerow([camera.name, width, height, *turn, *pose[:3, 3], *focal, *camera.distortion[:2], 0.0])
    for camera in rig:
        write_pictures(folder / "rgbs" / camera.name / f"{camera.name}_rgb{{:06d}}.jpg", SIZE)


def write_dna_rendering(folder: Path, rig: Sequence[Camera]) -> None:
    with (
        h5py.File(folder / "0007_01.smc", "w") as pictures,
        h5py.File(folder / "0007_01_annots.smc", "w") as annotations,
    ):
        for camera in rig:
            kind = "Camera_5mp" if camera.name < "48" else "Camera_12mp"
            for k in range(FRAMES):
                data = cv2.imencode(".jpg", picture(k, SIZE))[1].ravel()
                pictures[f"{kind}/{int(camera.name)}/color/{k}"] = data
            inside = annotations.create_group(f"Camera_Parameter/{camera.name}")
            inside["K"], inside["D"] = np.array(matrix(camera, 0.0)), np.array(camera.distortion)
            inside["RT"] = np.linalg.inv(camera.world_to_camera)


def write_opencv(folder: Path, rig: Sequence[Camera], name: str = "calibration.yml") -> None:
    file = cv2.FileStorage(str(folder / name), cv2.FILE_STORAGE_WRITE)
    file.write("cam_ids", ",".join(camera.name for camera in rig))
    poses = [camera.world_to_camera for camera in rig]
    file.write("rvecs", np.array([rotation_vector(pose[:3, :3]) for pose in poses])[..., None])
    file.write("Ts", np.array([pose[:3, 3:] for pose in poses]))
    file.write("Ks", np.array([matrix(camera, 0.0) for camera in rig]))
    file.write("distortions", np.array([[camera.distortion] for camera in rig]))
    file.write("is_fisheye", np.zeros(len(rig), np.int32))
    file.write("image_sizes", np.array([[camera.width, camera.height] for camera in rig], np.int32))
    file.release()
    for camera in rig:
        write_video(folder / f"{camera.name}.mp4", SIZE)


# --- COLMAP models --------------------------------------------------------------------------------------------------


def write_model(model: Path, images: Sequence[tuple[str, Camera]]) -> None:
    """In text, OPENCV lenses (without k3), one point for each frame."""
    model.mkdir(parents=True)
    lenses, lines = [], []
    for number, (name, camera) in enumerate(images, start=1):
        numbers = [camera.fx, camera.fy, camera.cx, camera.cy, *camera.distortion[:4]]
        lenses.append(f"{number} OPENCV {camera.width} {camera.height} {' '.join(map(repr, map(float, numbers)))}")
        q, t = quaternion(camera.world_to_camera[:3, :3]), camera.world_to_camera[:3, 3]
        lines.append(f"{number} {' '.join(repr(float(v)) for v in (*q, *t))} {number} {name}\n")
    (model / "cameras.txt").write_text("\n".join(lenses) + "\n")
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    points = [f"{k + 1} {k}.0 0 0 10 20 30 0.5" for k in range(FRAMES)]
    (model / "points3D.txt").write_text("\n".join(points) + "\n")


def write_multiple_view(folder: Path, rig: Sequence[Camera]) -> None:
    write_model(folder / "sparse_", [(f"image{i}.jpg", camera) for i, camera in enumerate(rig, start=1)])
    for camera in rig:
        write_pictures(folder / camera.name / "frame_{:05d}.jpg", SIZE, first=1)


def write_colmap4d(folder: Path, rig: Sequence[Camera]) -> None:
    images = [(f"frame_{k:04d}/{camera.name}.png", camera) for k in range(FRAMES) for camera in rig]
    write_model(folder / "sparse" / "0", images)
    times = [k * 40_000_000 + i for k in range(FRAMES) for i in range(len(rig))]  # a nanosecond apart
    text = "# colmap4d times: IMAGE_ID, T_NS (int64 ns)\n"
    (folder / "sparse/0/times.txt").write_text(text + "".join(f"{n} {t}\n" for n, t in enumerate(times, start=1)))
    of_points = "".join(f"{k + 1} {k * 40_000_000}\n" for k in range(FRAMES - 1))  # the last one is always there
    (folder / "sparse/0/points_t.txt").write_text(of_points)
    for camera in rig:
        write_pictures(folder / "frame_{:04d}" / f"{camera.name}.png", SIZE)


def write_frame_folders(folder: Path, rig: Sequence[Camera]) -> None:
    for k in range(FRAMES):
        write_model(folder / f"frame{k:06d}" / "sparse" / "0", [(f"{camera.name}.png", camera) for camera in rig])
    for camera in rig:
        write_pictures(folder / "frame{:06d}" / "images" / f"{camera.name}.png", SIZE)


# --- all ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LayoutCase:
    """How a layout is written, and damaged: ``cut`` is a file, and what to replace in it to leave a number out."""

    layout: str
    write: Writer
    lens: str
    names: tuple[str, ...]
    cut: tuple[str, str, str]
    frames: str
    digits: float = 1e-9
    has_size: bool = True

    def rig(self) -> list[Camera]:
        """The cameras, as the layout can have them."""
        return cameras(self.lens, self.names)


_NUMBERED = ("00", "01", "02")
_CAMS = ("cam01", "cam02", "cam03")
_DATA = (r"data: ?\[ ?[^,]*, ?", "data: [")

CASES = (
    LayoutCase("easyvolcap", write_easyvolcap, "opencv", _NUMBERED, ("extri.yml", *_DATA), "images/00", 1e-6),
    LayoutCase(
        "toml", write_aniposelib, "opencv", ("left", "leftL", "mid"),
        ("calibration.toml", r"rotation = \[[^,]*,", "rotation = ["), "take1_left.mp4",
    ),
    LayoutCase(
        "toml", write_caliscope, "opencv", ("cam_0", "cam_1", "cam_2"),
        ("camera_array.toml", r"translation = \[[^,]*,", "translation = ["), "cam_0.mp4",
    ),
    LayoutCase(
        "qualisys", write_qualisys, "opencv", ("21001", "21002", "21003"),
        ("take.qca.txt", r'r23="[^"]*"', ""), "Miqus_1_21001.mp4",
    ),
    LayoutCase(
        "immersive", write_immersive, "fisheye", ("camera_0001", "camera_0002", "camera_0003"),
        ("models.json", r'"position": \[[^,]*,', '"position": ['), "camera_000*.mp4",
    ),
    LayoutCase(
        "technicolor", write_technicolor, "none", ("cam00", "cam01", "cam02"),
        ("cameras_parameters.txt", r"\n\S+ ", "\n"), "*_00.png", 1e-6, has_size=False,
    ),
    LayoutCase(
        "panoptic", write_panoptic, "opencv", ("00_00", "00_01", "00_05"),
        ("calibration_take.json", r'"t": \[\[[^\]]*\],', '"t": ['), "hdVideos/*.mp4",
    ),
    LayoutCase(
        "nerfstudio splits", write_splits, "opencv", _CAMS,
        ("transforms_train.json", r'"transform_matrix": \[\[[^,]*,', '"transform_matrix": [['), "frames_1/cam01",
    ),
    LayoutCase(
        "actorshq", write_actors_hq, "opencv", ("Cam001", "Cam002", "Cam003"),
        ("calibration.csv", r"Cam001,64,48,[^,]*,", "Cam001,64,48,"), "rgbs/*",
    ),
    LayoutCase(
        "dna-rendering", write_dna_rendering, "opencv", ("00", "01", "48"),
        ("0007_01_annots.smc", "", ""), "0007_01.smc", has_size=False,
    ),
    LayoutCase("opencv", write_opencv, "opencv", _CAMS, ("calibration.yml", *_DATA), "cam01.mp4"),
    LayoutCase(
        "multipleview", write_multiple_view, "opencv", _CAMS, ("sparse_/cameras.txt", r" \S+\n", "\n"), "cam01",
    ),
    LayoutCase(
        "colmap4d", write_colmap4d, "opencv", _CAMS, ("sparse/0/times.txt", "1 0\n", "1\n"), "frame_0000/cam01.png",
    ),
    LayoutCase(
        "frame folders", write_frame_folders, "opencv", _CAMS,
        ("frame000000/sparse/0/images.txt", r"1 \S+ ", "1 "), "frame000001/images/cam01.png",
    ),
)  # fmt: skip
