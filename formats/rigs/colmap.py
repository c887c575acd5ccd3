"""COLMAP layout: a sparse model (binary or text) with one video, picture folder or picture per camera.

The model is in ``sparse/0`` (or another number), ``sparse`` or the folder itself. Its images are paired with frames
by name (``_key_of``). Poses are world-to-camera in OpenCV axes and pixel centres are at .5 already. ``rigs`` and
``frames`` files of COLMAP >= 3.12 are not needed: images have their whole poses all the same.
Source: COLMAP documentation, "Output Format"; parameter orders from its camera models.
"""

from __future__ import annotations

import codecs
import os
import struct
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera, DistortionModel
from ..errors import RigError
from ..files.regular_files import open_regular
from ..files.unicode_forms import as_it_lies, composed
from ..pictures.reading import PICTURE_SUFFIXES
from ..videos.reading import VIDEO_SUFFIXES
from .calibration import calibrated_camera, quaternion_pose
from .rig import Points, Rig, assemble_rig
from .sources import GENERIC_FOLDERS, holds_frames, list_folder, open_source, refuse_unknown_kinds

LAYOUT = "colmap"
MULTIPLE_VIEW = "sparse_"

_MODEL_NAMES = (
    "SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "OPENCV_FISHEYE", "FULL_OPENCV", "FOV",
    "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "THIN_PRISM_FISHEYE", "RAD_TAN_THIN_PRISM_FISHEYE", "SIMPLE_DIVISION",
    "DIVISION", "SIMPLE_FISHEYE", "FISHEYE", "EUCM", "EQUIRECTANGULAR",
)  # fmt: skip
"""COLMAP's camera models in the order of their numbers."""

_PARAMETERS = {
    "SIMPLE_PINHOLE": 3, "PINHOLE": 4, "SIMPLE_RADIAL": 4, "RADIAL": 5, "OPENCV": 8, "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12, "SIMPLE_RADIAL_FISHEYE": 4, "RADIAL_FISHEYE": 5, "SIMPLE_FISHEYE": 3, "FISHEYE": 4,
}  # fmt: skip
"""The models that can be read, and how many parameters each has."""

_ONE_FOCAL_LENGTH = frozenset(
    {"RADIAL", "RADIAL_FISHEYE", *(name for name in _PARAMETERS if name.startswith("SIMPLE_"))}
)

_SAME_POSE = 1e-4
"""Several images of one fixed camera may differ by this in rotation, and in position as a share of its distance."""
_COPIED_POSE = 1e-9
"""Poses that were calculated apart from each other differ by more."""


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

    image_id: int
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
    """The first of sparse/0, sparse/1 ..., sparse, the folder itself and 4DGaussians' sparse_ that holds a model."""
    sparse = folder / "sparse"
    models = (*_numbered_models(sparse), sparse, folder, folder / MULTIPLE_VIEW)
    return next((model for model in models if has_model(model)), None)


def rig_folder_of(model: Path) -> Path:
    """The folder a model belongs to: the one that holds sparse/0 (or another number) or sparse, or else its own."""
    if model.name.isdecimal() and model.parent.name == "sparse":
        return model.parent.parent
    return model.parent if model.name in ("sparse", MULTIPLE_VIEW) else model


def _numbered_models(sparse: Path) -> list[Path]:
    """COLMAP numbers the models of pictures that it could not join into one."""
    return [entry for entry in list_folder(sparse) if entry.name.isdecimal() and has_model(entry)]


def read_colmap_rig(
    folder: Path, model: Path, layout: str = LAYOUT, renamed: Callable[[str], str] = lambda name: name
) -> Rig:
    """The rig whose frames are in ``folder``, calibrated by the COLMAP model in ``model``. Raises RigError.

    ``renamed``: the name that an image goes by, from its name in the model.
    """
    lenses = read_lenses(model)
    images = [replace(image, name=renamed(image.name)) for image in read_images(model)]
    frames = _frames_below(folder, images)
    keys = {image.name: _key_of(image.name, frames) for image in images}
    unposed = _unposed(frames, set(keys.values()))
    _check_pairs(folder, model, keys, unposed)
    calibrated = cameras_of(model, lenses, images, keys)
    pairs = [(camera, open_source(frames[key])) for key, camera in calibrated.items()]
    rig = assemble_rig(folder, layout, pairs, model_files(model), resizable=True, points=read_points(model))
    if not unposed:
        return rig
    left_out = f"{unposed[0]}{_more(unposed)}: left out, without a pose in {model}{_elsewhere(model)}"
    return replace(rig, warnings=(*rig.warnings, left_out))


def _check_pairs(folder: Path, model: Path, keys: Mapping[str, str | None], unposed: Sequence[Path]) -> None:
    """Every image has frames, every video an image."""
    missing = [name for name, key in keys.items() if key is None]
    if missing:
        named = {part for name in missing for part in _parts(name)}
        inside = (folder, *(entry for entry in list_folder(folder) if entry.name.lower() in GENERIC_FOLDERS))
        refuse_unknown_kinds(entry for each in inside for entry in list_folder(each) if composed(entry.stem) in named)
        what = f"{folder}: no video, picture folder or picture of image {missing[0]!r}{_more(missing)} of {model}"
        if unposed:
            what += (
                f", but {unposed[0].name}, which the model does not know; give files and model images the same names"
            )
        else:
            what += "; put it back, or take the image out of the model (colmap image_deleter)"
        raise RigError(what)
    videos = [path for path in unposed if path.suffix.lower() in VIDEO_SUFFIXES and not path.is_dir()]
    if videos:
        raise RigError(
            f"{videos[0]}{_more(videos)}: no camera of this name in {model}{_elsewhere(model)}; "
            "calibrate it too or move it away"
        )


def _more(items: Sequence[object]) -> str:
    return f" and {len(items) - 1} more" if len(items) > 1 else ""


def _elsewhere(model: Path) -> str:
    """Names the other models that COLMAP made of the same pictures."""
    others = [f"{other.parent.name}/{other.name}" for other in _numbered_models(model.parent) if other != model]
    return f" (perhaps in {', '.join(others)}, whose poses do not fit these)" if others else ""


# --- which frames belong to which image -----------------------------------------------------------------------------


_DEPTH = 8
"""Folders of an image's name that count, from its end."""

_BETWEEN = " _.-"
"""What stands between a camera's name and a frame's number."""


def _parts(name: str) -> list[str]:
    """The folders and the stem of an image's name, but for folders that name no camera."""
    path = PurePosixPath(name)
    folders = [part for part in path.parts[:-1] if part not in ("/", "..") and part.lower() not in GENERIC_FOLDERS]
    return [*folders[-_DEPTH:], path.stem]


def _camera_of(stem: str) -> str:
    """cam00 of cam00_0001 and cam00_frame0001; empty if no frame's number stands apart from the rest."""
    rest = stem.rstrip("0123456789")
    words = rest.rstrip(_BETWEEN)
    word = next((word for word in ("frame", "image", "img") if words.lower().endswith(word)), "")
    camera = words[: len(words) - len(word)].rstrip(_BETWEEN)
    return camera if len(camera) + len(word) < len(rest) < len(stem) else ""


def _frames_below(folder: Path, images: Sequence[PosedImage]) -> dict[str, Path]:
    """Videos, folders of pictures and single pictures by their paths as ``_parts`` has them.

    Looked for in the rig's folder, in folders such as ``images`` there, and below them where the model's images are.
    Videos and picture folders go before single pictures, which are then the stills that the model was made from.
    """
    bases = [folder, *(entry for entry in list_folder(folder) if entry.name.lower() in GENERIC_FOLDERS)]
    names = [_parts(image.name) for image in images]
    groups = {tuple(parts[:depth]) for parts in names for depth in range(len(parts))}
    frames: dict[str, Path] = {}
    stills: dict[str, Path] = {}
    for group in sorted(groups):
        inside = [as_it_lies(base.joinpath(*group)) for base in bases]
        for entry in (entry for each in inside if os.path.isdir(each) for entry in list_folder(each)):
            if entry.name.lower() in GENERIC_FOLDERS:
                continue
            key = "/".join((*group, composed(entry.name if entry.is_dir() else entry.stem)))
            if holds_frames(entry):
                other = frames.setdefault(key, entry)
                if other is not entry:
                    raise RigError(f"{folder}: both {other} and {entry} hold frames of one camera; move one away")
            elif entry.suffix.lower() in PICTURE_SUFFIXES and entry.is_file():
                stills.setdefault(key, entry)
    return {**stills, **frames}


def _key_of(name: str, frames: Mapping[str, Path]) -> str | None:
    """Which frames show what a model's image shows, by its name; folders before the camera's may be missing.

    "rig/cam00.png" and "rig/cam00/0000.png" belong to a video or folder ``rig/cam00`` or ``cam00``,
    "cam00_frame0001.png" to ``cam00``; without, an image is the camera's only frame.
    """
    *folders, stem = _parts(name)
    spelled = [[*folders, stem], folders, [*folders, _camera_of(stem)]]
    keys = ["/".join(parts[first:]) for parts in spelled for first in range(len(parts))]
    matches = [key for key in keys if key in frames]
    streams = [key for key in matches if not _is_still(frames[key])]
    return next(iter(streams or matches), None)


def _is_still(path: Path) -> bool:
    return path.suffix.lower() in PICTURE_SUFFIXES and not path.is_dir()


def _unposed(frames: Mapping[str, Path], posed: set[str | None]) -> list[Path]:
    """Frames that no image of the model belongs to.

    Single pictures count where cameras have single pictures only. A folder does not count in a camera's own, nor where
    its pictures are called as cameras are: it has masks, depths or other sizes of them.
    """
    stills = any(_is_still(frames[key]) for key in posed if key is not None)
    names = {key.rpartition("/")[2] for key in posed if key is not None}
    return [
        path
        for key, path in frames.items()
        if not posed & {key, key.rpartition("/")[0]}
        and (stills if _is_still(path) else not any(composed(entry.stem) in names for entry in list_folder(path)))
    ]


def cameras_of(
    model: Path, lenses: dict[int, ModelledCamera], images: list[PosedImage], keys: Mapping[str, str | None]
) -> dict[str, Camera]:
    """The cameras by the places of their frames."""
    cameras: dict[str, Camera] = {}
    names = Counter(key.rpartition("/")[2] for key in set(keys.values()) if key)
    for image in sorted(images, key=lambda image: image.name):
        where = f"{model}, image {image.name!r}"
        lens = lenses.get(image.camera_id)
        if lens is None:
            raise RigError(f"{where}: its camera {image.camera_id} is not in the model; export the model again")
        key = keys[image.name] or ""
        name = key.rpartition("/")[2]
        camera = _camera(name if names[name] == 1 else key.replace("/", "_"), lens, image.world_to_camera, where)
        if key in cameras and not same_pose(cameras[key], camera):
            raise RigError(
                f"{where}: camera {camera.name} stands somewhere else in another image; cameras must be fixed, and "
                "those of several cameras need a folder each, or lie in images/ with one picture each"
            )
        cameras.setdefault(key, camera)
    _check_apart(model, list(cameras.values()))
    return cameras


def _check_apart(model: Path, cameras: Sequence[Camera]) -> None:
    """No two cameras stand in one place and look one way: frames of one camera would be taken for several of them."""
    poses = np.array([camera.world_to_camera for camera in cameras])
    for number, camera in enumerate(cameras):
        like = np.flatnonzero(np.abs(poses[:number] - poses[number]).max(axis=(1, 2)) < _COPIED_POSE)
        if like.size:
            raise RigError(
                f"{model}: {cameras[like[0]].name} and {camera.name} have one pose, as frames of one camera have; give "
                "each camera a folder of its own for its frames"
            )


def same_pose(one: Camera, other: Camera) -> bool:
    """Whether two calibrations of one fixed camera put it in one place, up to what a reconstruction leaves."""
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
    kind: DistortionModel = "fisheye" if "FISHEYE" in model else "opencv"
    if model in _ONE_FOCAL_LENGTH:
        p = (p[0], *p)
    return (p[0], p[1], p[2], p[3]), kind, p[4:] + (0.0,) * (8 - len(p))


def _check_model_name(model: str, where: str) -> int:
    if model not in _PARAMETERS:
        raise RigError(
            f"{where}: camera model {model!r} is not supported; undistort with COLMAP's image_undistorter, "
            f"or use one of {', '.join(_PARAMETERS)}"
        )
    return _PARAMETERS[model]


# --- binary ---------------------------------------------------------------------------------------------------------


class ModelBytes:
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
        with open_regular(path) as file:
            return file.read()
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); export the COLMAP model again") from None


def _binary_lenses(path: Path) -> dict[int, ModelledCamera]:
    file = ModelBytes(path)
    lenses = {}
    for _ in range(file.count(24)):
        camera_id, number = file.integers("<Ii")
        width, height = file.integers("<QQ")
        model = _MODEL_NAMES[number] if 0 <= number < len(_MODEL_NAMES) else f"number {number}"
        parameters = file.take(f"<{_check_model_name(model, f'{path}, camera {camera_id}')}d")
        lenses[camera_id] = ModelledCamera(model, width, height, parameters)
    return lenses


def _binary_images(path: Path) -> list[PosedImage]:
    file = ModelBytes(path)
    images = []
    for _ in range(file.count(73)):
        (image_id,) = file.integers("<I")
        numbers = file.take("<7d")
        (camera_id,) = file.integers("<I")
        name = file.name()
        file.skip(24 * file.count(24))
        pose = quaternion_pose(numbers[:4], numbers[4:], f"{path}, image {name!r}")
        images.append(PosedImage(image_id, name, camera_id, pose))
    return images


def _binary_points(path: Path) -> Iterator[tuple[float, ...]]:
    file = ModelBytes(path)
    for _ in range(file.count(51)):
        point = file.take("<Q3d3Bd")
        file.skip(8 * file.count(8))
        yield point[:7]


# --- text -----------------------------------------------------------------------------------------------------------


def text_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines and their numbers from 1, without comments and empty ones (an image without points has one or none)."""
    data = _read_file(path)
    is_utf_16 = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))  # as some editors write it
    text = data.decode("utf-16" if is_utf_16 else "utf-8-sig", errors="replace")
    for number, line in enumerate(text.split("\n"), start=1):
        line = line.strip()
        if line and not line.startswith("#"):
            yield number, line


def malformed(path: Path, number: int) -> RigError:
    """The error to raise for a line of a text file, counted from 1."""
    return RigError(f"{path}: line {number} is malformed; export the COLMAP model again")


def _text_lenses(path: Path) -> dict[int, ModelledCamera]:
    lenses = {}
    for number, line in text_lines(path):
        words = line.split()
        try:
            camera_id, model, width, height = int(words[0]), words[1], int(words[2]), int(words[3])
            parameters = tuple(float(word) for word in words[4:])
        except (ValueError, IndexError):
            raise malformed(path, number) from None
        if len(parameters) != _check_model_name(model, f"{path}, camera {camera_id}"):
            raise malformed(path, number)
        lenses[camera_id] = ModelledCamera(model, width, height, parameters)
    return lenses


def _text_images(path: Path) -> list[PosedImage]:
    images = []
    may_be_points = False
    for number, line in text_lines(path):
        if may_be_points and _are_points(line):
            may_be_points = False
            continue
        words = line.split(maxsplit=9)
        try:
            numbers = tuple(float(word) for word in words[1:8])
            image_id, camera_id, name = int(words[0]), int(words[8]), words[9]
        except (ValueError, IndexError):
            raise malformed(path, number) from None
        pose = quaternion_pose(numbers[:4], numbers[4:], f"{path}, image {name!r}")
        images.append(PosedImage(image_id, name, camera_id, pose))
        may_be_points = True
    return images


def _are_points(line: str) -> bool:
    """Whether a line has feature points: x, y and the number of a 3D point or -1, again and again."""
    words = line.split()
    try:
        _ = [int(word) for word in words[2::3]], [float(word) for word in words]
    except ValueError:
        return False
    return len(words) % 3 == 0


def _text_points(path: Path) -> Iterator[tuple[float, ...]]:
    for number, line in text_lines(path):
        words = line.split(maxsplit=7)
        try:
            point = tuple(float(word) for word in words[:7])
        except ValueError:
            raise malformed(path, number) from None
        if len(point) != 7 or not all(0 <= channel <= 255 for channel in point[4:]):
            raise malformed(path, number)
        yield point


# --- either; binary first, as in COLMAP -----------------------------------------------------------------------------


def read_lenses(model: Path) -> dict[int, ModelledCamera]:
    """The cameras file's entries by their numbers. Raises RigError."""
    binary = model / "cameras.bin"
    return _binary_lenses(binary) if binary.is_file() else _text_lenses(model / "cameras.txt")


def read_images(model: Path) -> list[PosedImage]:
    """The images file's entries, at least one; names have "/" between folders. Raises RigError."""
    binary = model / "images.bin"
    path = binary if binary.is_file() else model / "images.txt"
    posed = _binary_images(path) if path == binary else _text_images(path)
    # Windows writes names with backslashes, macOS accents as signs of their own.
    images = [replace(image, name=composed(image.name.replace("\\", "/"))) for image in posed]
    if not images:
        raise RigError(f"{model}: the model holds no images; run the reconstruction again")
    for image in images:
        if not PurePosixPath(image.name).stem or not image.name.isprintable():
            raise RigError(f"{path}: {image.name!r} is no usable image name; export the COLMAP model again")
    return images


def read_points(model: Path, is_wanted: Callable[[float], bool] = lambda _: True) -> Points | None:
    """The model's 3D points whose number is wanted, or None if there is none. Raises RigError.

    Points at NaN or infinity are left out.
    """
    binary, text = model / "points3D.bin", model / "points3D.txt"
    if not binary.is_file() and not text.is_file():
        return None
    rows = list(_binary_points(binary) if binary.is_file() else _text_points(text))
    values = np.array([row[1:] for row in rows if is_wanted(row[0])], np.float64).reshape(-1, 6)
    values = values[(np.abs(values[:, :3]) < 1e30).all(axis=1)]
    if len(values) == 0:
        return None
    return Points(values[:, :3].astype(np.float32), np.rint(values[:, 3:]).astype(np.uint8))
