"""COLMAP layout: a sparse model (binary or text) with one video, picture folder or picture per camera.

The model is in ``sparse/0``, ``sparse`` or the folder itself. A model image belongs to the camera of its name without
suffix ("cam00.png" -> cam00), or of its folder ("cam00/0000.png") if frames go by that name. Poses are world-to-camera
in OpenCV axes and pixel centres are at .5 already. ``rigs`` and ``frames`` files of COLMAP >= 3.12 are not needed.
Source: COLMAP documentation, "Output Format"; parameter orders from its camera models.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera, DistortionModel
from ..errors import RigError
from ..pictures import PICTURE_SUFFIXES
from ..rotations import rotation_rows
from ..videos import VIDEO_SUFFIXES
from .calibration import calibrated_camera, rigid_pose
from .rig import Points, Rig, assemble_rig
from .sources import GENERIC_FOLDERS, holds_frames, list_folder, open_source

LAYOUT = "colmap"

_MODEL_NAMES = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE",
)  # fmt: skip
"""COLMAP's camera models in the order of their numbers."""

_PARAMETERS = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
}  # fmt: skip
"""The models that can be read, and how many parameters each has."""

_SAME_POSE = 1e-4
"""Several images of one fixed camera may differ by this in rotation, and in position as a share of its distance."""


@dataclass(frozen=True)
class ModelledCamera:
    """One entry of the cameras file: a model name, the picture's size and the model's parameters."""

    model: str
    width: int
    height: int
    parameters: tuple[float, ...]


@dataclass(frozen=True)
class PosedImage:
    """One entry of the images file: world_to_camera is (4, 4), rigid."""

    name: str
    camera_id: int
    world_to_camera: NDArray[np.float64]


def has_model(folder: Path) -> bool:
    """Whether a COLMAP model lies directly in ``folder``."""
    return (folder / "cameras.bin").is_file() or (folder / "cameras.txt").is_file()


def model_files(folder: Path) -> list[Path]:
    """The files of the COLMAP model in ``folder``, if there is one."""
    return [file for file in list_folder(folder) if file.suffix in (".bin", ".txt")] if has_model(folder) else []


def find_model(folder: Path) -> Path | None:
    """The first of sparse/0, sparse and the folder itself that holds a model."""
    return next((model for model in (folder / "sparse" / "0", folder / "sparse", folder) if has_model(model)), None)


def rig_folder_of(model: Path) -> Path:
    """The folder a model belongs to: the one that holds sparse/0 or sparse, or else its own."""
    if model.name == "0" and model.parent.name == "sparse":
        return model.parent.parent
    return model.parent if model.name == "sparse" else model


def read_colmap_rig(folder: Path, model: Path, layout: str = LAYOUT) -> Rig:
    """The rig whose frames are in ``folder``, calibrated by the COLMAP model in ``model``. Raises RigError."""
    lenses, images = _read_lenses(model), _read_images(model)
    if not images:
        raise RigError(f"{model}: the model holds no images; run the reconstruction again")
    frames = _frames_by_name(folder)
    calibrated = _cameras_of(model, lenses, images, frames)
    missing = [name for name in calibrated if name not in frames]
    stray = [name for name, path in frames.items() if path.suffix.lower() in VIDEO_SUFFIXES and name not in calibrated]
    if missing:
        there = f", but {frames[stray[0]].name}, which the model does not know" if stray else ""
        raise RigError(
            f"{folder}: no video, picture folder or picture of camera {missing[0]} of {model}{there}; "
            "give files and model images the same names"
        )
    if stray:
        raise RigError(f"{frames[stray[0]]}: no camera of this name in {model}; calibrate it too or move it away")
    pairs = [(camera, open_source(frames[name])) for name, camera in calibrated.items()]
    return assemble_rig(folder, layout, pairs, model_files(model), resizable=True, points=read_points(model))


def _frames_by_name(folder: Path) -> dict[str, Path]:
    """Where each camera's frames are. Videos and picture folders go before single pictures, which are then the stills
    that the model was made from."""
    found: dict[str, Path] = {}
    bases = [folder, *(folder / name for name in sorted(GENERIC_FOLDERS))]
    entries = [entry for base in bases for entry in list_folder(base)]
    for entry in entries:
        if entry.name.lower() in GENERIC_FOLDERS or not holds_frames(entry):
            continue
        other = found.setdefault(_camera_name(entry), entry)
        if other is not entry:
            raise RigError(f"{folder}: both {other} and {entry} hold frames of one camera; move one away")
    for entry in entries:
        if entry.suffix.lower() in PICTURE_SUFFIXES and entry.is_file():
            found.setdefault(entry.stem, entry)
    return found


def _camera_name(entry: Path) -> str:
    return entry.name if entry.is_dir() else entry.stem


def _cameras_of(
    model: Path, lenses: dict[int, ModelledCamera], images: list[PosedImage], frames: dict[str, Path]
) -> dict[str, Camera]:
    cameras: dict[str, Camera] = {}
    for image in sorted(images, key=lambda image: image.name):
        where = f"{model}, image {image.name!r}"
        lens = lenses.get(image.camera_id)
        if lens is None:
            raise RigError(f"{where}: its camera {image.camera_id} is not in the model; export the model again")
        parts = PurePosixPath(image.name)
        folder = parts.parent.name
        is_folder = folder not in GENERIC_FOLDERS and folder in frames and frames[folder].is_dir()
        name = folder if is_folder else parts.stem
        camera = _camera(name, lens, image.world_to_camera, where)
        if name in cameras and not _same_pose(cameras[name], camera):
            raise RigError(
                f"{where}: camera {name} stands somewhere else in another image; "
                "cameras must be fixed, keep one image of each in the model"
            )
        cameras.setdefault(name, camera)
    return cameras


def _same_pose(one: Camera, other: Camera) -> bool:
    difference = np.abs(one.world_to_camera - other.world_to_camera)
    distance = 1 + float(np.linalg.norm(one.world_to_camera[:3, 3]))
    return bool(difference[:3, :3].max() < _SAME_POSE and difference[:3, 3].max() < _SAME_POSE * distance)


def _camera(name: str, lens: ModelledCamera, world_to_camera: NDArray[np.float64], where: str) -> Camera:
    focal, distortion_model, distortion = lens_parameters(lens.model, lens.parameters)
    size = (lens.width, lens.height)
    return calibrated_camera(name, size, focal, world_to_camera, distortion_model, distortion, where)


def lens_parameters(
    model: str, p: tuple[float, ...]
) -> tuple[tuple[float, float, float, float], DistortionModel, tuple[float, ...]]:
    """(fx, fy, cx, cy), distortion model and coefficients in OpenCV's order, for a readable COLMAP model."""
    if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        radial = p[3:] + (0.0,) * (5 - len(p))
        return (p[0], p[0], p[1], p[2]), "opencv", (*radial, 0.0, 0.0)
    fisheye: DistortionModel = "fisheye" if model == "OPENCV_FISHEYE" else "opencv"
    return (p[0], p[1], p[2], p[3]), fisheye, p[4:]


def _check_model_name(model: str, where: str) -> int:
    if model not in _PARAMETERS:
        raise RigError(
            f"{where}: camera model {model!r} is not supported; undistort with COLMAP's image_undistorter, "
            f"or use one of {', '.join(_PARAMETERS)}"
        )
    return _PARAMETERS[model]


def _pose(quaternion: tuple[float, ...], translation: tuple[float, ...], where: str) -> NDArray[np.float64]:
    """World-to-camera from COLMAP's quaternion (w, x, y, z; any norm) and translation."""
    q = np.array(quaternion, np.float64)
    norm = float(np.linalg.norm(q)) if np.isfinite(q).all() and np.abs(q).max() < 1e100 else 0.0
    if norm < 1e-6:
        raise RigError(f"{where}: the pose is singular (rotation quaternion {quaternion}); export the model again")
    pose = np.eye(4)
    pose[:3, :3] = rotation_rows(*(q / norm))
    pose[:3, 3] = translation
    return rigid_pose(pose, where)


# --- binary ---------------------------------------------------------------------------------------------------------


class _Bytes:
    """A cursor over a little-endian binary file that never reads past its end."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.data = _read_file(path)
        self.at = 0

    def take(self, layout: str) -> tuple[float, ...]:
        size = struct.calcsize(layout)
        self.need(size)
        values = struct.unpack_from(layout, self.data, self.at)
        self.at += size
        return values

    def integers(self, layout: str) -> tuple[int, ...]:
        return tuple(int(value) for value in self.take(layout))

    def count(self, min_bytes: int) -> int:
        """A number of records, each at least so long; refused if the file cannot hold them."""
        (count,) = self.integers("<Q")
        self.need(count * min_bytes)
        return count

    def name(self) -> str:
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise self.truncated()
        name = self.data[self.at : end].decode("utf-8", errors="replace")
        self.at = end + 1
        return name

    def skip(self, size: int) -> None:
        self.need(size)
        self.at += size

    def need(self, size: int) -> None:
        if size > len(self.data) - self.at:
            raise self.truncated()

    def truncated(self) -> RigError:
        return RigError(f"{self.path}: truncated or damaged at byte {self.at}; export the COLMAP model again")


def _read_file(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); export the COLMAP model again") from None


def _binary_lenses(path: Path) -> dict[int, ModelledCamera]:
    file = _Bytes(path)
    lenses = {}
    for _ in range(file.count(24)):
        camera_id, number = file.integers("<Ii")
        width, height = file.integers("<QQ")
        model = _MODEL_NAMES[number] if 0 <= number < len(_MODEL_NAMES) else f"number {number}"
        parameters = file.take(f"<{_check_model_name(model, f'{path}, camera {camera_id}')}d")
        lenses[camera_id] = ModelledCamera(model, width, height, parameters)
    return lenses


def _binary_images(path: Path) -> list[PosedImage]:
    file = _Bytes(path)
    images = []
    for _ in range(file.count(73)):
        file.skip(4)
        numbers = file.take("<7d")
        (camera_id,) = file.integers("<I")
        name = file.name()
        file.skip(24 * file.count(24))
        images.append(PosedImage(name, camera_id, _pose(numbers[:4], numbers[4:], f"{path}, image {name!r}")))
    return images


def _binary_points(path: Path) -> Iterator[tuple[float, ...]]:
    file = _Bytes(path)
    for _ in range(file.count(51)):
        point = file.take("<Q3d3Bd")
        file.skip(8 * file.count(8))
        yield point[1:7]


# --- text -----------------------------------------------------------------------------------------------------------


def _text_lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line numbers from 1 and words; comments are left out, empty lines are not (they mean an image without points)."""
    text = _read_file(path).decode("utf-8", errors="replace")
    for number, line in enumerate(text.split("\n"), start=1):
        if not line.startswith("#"):
            yield number, line.split()


def _malformed(path: Path, number: int) -> RigError:
    return RigError(f"{path}: line {number} is malformed; export the COLMAP model again")


def _text_lenses(path: Path) -> dict[int, ModelledCamera]:
    lenses = {}
    for number, words in _text_lines(path):
        if not words:
            continue
        try:
            camera_id, model, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
            parameters = tuple(float(word) for word in words[4:])
        except (ValueError, IndexError):
            raise _malformed(path, number) from None
        if len(parameters) != _check_model_name(model, f"{path}, camera {camera_id}"):
            raise _malformed(path, number)
        lenses[camera_id] = ModelledCamera(model, width, height, parameters)
    return lenses


def _text_images(path: Path) -> list[PosedImage]:
    images = []
    lines = _text_lines(path)
    for number, words in lines:
        if not words:
            continue
        try:
            numbers = tuple(float(word) for word in words[1:8])
            camera_id, name = int(words[8]), " ".join(words[9:])
        except (ValueError, IndexError):
            raise _malformed(path, number) from None
        if not name:
            raise _malformed(path, number)
        images.append(PosedImage(name, camera_id, _pose(numbers[:4], numbers[4:], f"{path}, image {name!r}")))
        next(lines, None)  # the image's feature points
    return images


def _text_points(path: Path) -> Iterator[tuple[float, ...]]:
    for number, words in _text_lines(path):
        if not words:
            continue
        try:
            point = tuple(float(word) for word in words[1:7])
        except ValueError:
            raise _malformed(path, number) from None
        if len(point) != 6 or not all(0 <= channel <= 255 for channel in point[3:]):
            raise _malformed(path, number)
        yield point


# --- either; binary first, as in COLMAP -----------------------------------------------------------------------------


def _read_lenses(model: Path) -> dict[int, ModelledCamera]:
    binary = model / "cameras.bin"
    return _binary_lenses(binary) if binary.is_file() else _text_lenses(model / "cameras.txt")


def _read_images(model: Path) -> list[PosedImage]:
    binary = model / "images.bin"
    path = binary if binary.is_file() else model / "images.txt"
    images = _binary_images(path) if path == binary else _text_images(path)
    for image in images:
        if not PurePosixPath(image.name).stem or not image.name.isprintable():
            raise RigError(f"{path}: {image.name!r} is no usable image name; export the COLMAP model again")
    return images


def read_points(model: Path) -> Points | None:
    """The model's 3D points, or None if it has none; points at NaN or infinity are left out. Raises RigError."""
    binary, text = model / "points3D.bin", model / "points3D.txt"
    if not binary.is_file() and not text.is_file():
        return None
    rows = list(_binary_points(binary) if binary.is_file() else _text_points(text))
    values = np.array(rows, np.float64).reshape(-1, 6)
    values = values[(np.abs(values[:, :3]) < 1e30).all(axis=1)]
    if len(values) == 0:
        return None
    return Points(values[:, :3].astype(np.float32), np.rint(values[:, 3:]).astype(np.uint8))
