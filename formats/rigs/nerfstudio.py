"""nerfstudio / instant-ngp layout: ``transforms.json`` whose entries are the fixed cameras of a rig.

``frames[].file_path`` names a video, a folder of pictures, or one picture per entry; several picture entries with the
same pose are the frames of one camera, ordered by ``time`` and path, whichever folders they are in. Intrinsics (fl_x,
fl_y, cx, cy, w, h, or camera_angle_x) are global or per entry; k1 k2 k3 p1 p2 (k4 k5 k6: the rational model) follow
OpenCV, and k1..k4 with camera_model OPENCV_FISHEYE. transform_matrix is camera-to-world in OpenGL axes (x right, y up,
z backwards). Pixel centres are at .5. DiVa-360 and others share the cameras out: ``transforms_train.json``,
``transforms_val.json`` and ``transforms_test.json`` (brown-ivl/DiVa360, utils/splitJson.py).
"""

from __future__ import annotations

import math
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np

from ..cameras import Camera, DistortionModel
from ..errors import RigError
from ..files.unicode_forms import as_it_lies, composed
from ..pictures.reading import PICTURE_SUFFIXES
from ..videos.readouts import MAX_READOUT
from .calibration import calibrated_camera, invert_pose, rigid_pose
from .fields import Fields, read_json
from .rig import Rig, assemble_rig
from .sources import GENERIC_FOLDERS, FrameSource, natural_key, open_listed, open_pictures, open_source, other_endings

LAYOUT = "nerfstudio"
CALIBRATION = "transforms.json"
SPLITS_LAYOUT = "nerfstudio splits"
SPLITS_CALIBRATION = "transforms_train.json"
_FISHEYE = frozenset({"OPENCV_FISHEYE", "SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"})
_OPENCV = frozenset({"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"})
_COEFFICIENTS = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")
_LENS_NUMBERS = ("fl_x", "fl_y", "cx", "cy", "w", "h", "camera_angle_x", "camera_angle_y", *_COEFFICIENTS)
_OTHER_LENSES = ("ftheta_p0", "latlong", "equirectangular")
"""Lenses of instant-ngp."""
_LIKE_COEFFICIENTS = re.compile("[kpsb][0-9]|skew|distortion_params")
"""Names of what would bend a picture; those that are not among the coefficients are not read."""

_MASK = "mask_path"
"""A picture, black where an entry's pixels are left out of training."""
_CROP = "fisheye_crop_radius"
"""The same, by a circle."""

_READOUT = "rolling_shutter_time"
"""Of SpectacularAI/3dgs-deblur, whose files are nerfstudio's."""

_SAME_POSE = 1e-6
"""Between poses of one camera, in rotation and in position as a share of the rig's size: float32's digits."""
_LEAST_SIZE = 0.01
"""Of a rig, as a share of its distance from the origin: positions far off have fewer digits."""

_MAX_POSES = 1024
"""As many cameras as a stream has (SPEC.md)."""


@dataclass(frozen=True)
class _Entry:
    """One element of frames[]: its own fields over the file's, and where its pictures are."""

    fields: Fields
    path: Path
    time: float


def read_nerfstudio(folder: Path) -> Rig:
    """The rig described by ``folder``/transforms.json. Raises RigError."""
    return _read_transforms(folder, LAYOUT, [folder / CALIBRATION])


def read_splits(folder: Path) -> Rig:
    """The rig whose cameras are shared out over transforms_train.json and those of other splits. Raises RigError.

    An entry that is in several of them, as for validation and test, counts once.
    """
    splits = [folder / f"transforms_{split}.json" for split in ("train", "val", "test")]
    return _read_transforms(folder, SPLITS_LAYOUT, [path for path in splits if path.is_file()])


def _read_transforms(folder: Path, layout: str, paths: Sequence[Path]) -> Rig:
    path = paths[0]
    of_files = [_entries(folder, file) for file in paths]
    listed = {entry.path: entry for entries in reversed(of_files) for entry in entries}
    entries = of_files[0] if len(paths) == 1 else list(listed.values())
    groups = _group_by_camera(path, entries)
    names = _camera_names(groups)
    _check_in_step(path, names, groups)
    for name, group in zip(names, groups, strict=True):
        _check_one_lens(name, group)
    pairs = []
    for name, group in zip(names, groups, strict=True):
        source = _source(group)
        pairs.append((_camera(name, group[0].fields, source), source))
    rig = assemble_rig(folder, layout, pairs, paths, resizable=True)
    shared = {name: group[0].fields for name, group in zip(names, groups, strict=True)}
    readouts = {name: _readout(fields) for name, fields in shared.items() if _READOUT in fields}
    masks = {name: _masks(group, folder) for name, group in zip(names, groups, strict=True)}
    return replace(
        rig,
        timeline=rig.timeline.with_readouts(readouts) if rig.timeline.rate else rig.timeline,
        warnings=(*rig.warnings, *_unused_crop(path, entries), *_unused_readouts(path, rig, readouts)),
        ignore_masks={name: files for name, files in masks.items() if files},
    )


def _entries(folder: Path, path: Path) -> list[_Entry]:
    """The entries of one file, each with what the file says for all of them."""
    fields = read_json(path)
    shared = {key: value for key, value in fields.values.items() if key != "frames"}
    return [_entry(folder, replace(own, values={**shared, **own.values})) for own in fields.records("frames")]


def _entry(folder: Path, fields: Fields) -> _Entry:
    path = fields.path("file_path", folder)
    # Blender-style files leave the suffix out.
    spelled = [path, *(path.parent / (path.name + suffix) for suffix in sorted(PICTURE_SUFFIXES))]
    picture = next((candidate for candidate in map(as_it_lies, spelled) if os.path.exists(candidate)), None)
    if picture is None:
        raise RigError(f"{fields.where}: {path} is missing{other_endings(path)}; put it back or remove its entry")
    return _Entry(fields, picture, fields.number("time", 0.0))


def _masks(group: Sequence[_Entry], folder: Path) -> tuple[Path, ...]:
    """The files that the entries of a camera name as masks, each once."""
    return tuple(dict.fromkeys(entry.fields.path(_MASK, folder) for entry in group if _MASK in entry.fields))


def _unused_crop(path: Path, entries: Sequence[_Entry]) -> Iterator[str]:
    if any(_CROP in entry.fields for entry in entries):
        yield f"{path}: {_CROP} is not used; what it excludes is trained on like everything else"


def _readout(fields: Fields) -> float:
    """Seconds from the exposure of the first row to that of the last, as Spectacular AI's tools write it."""
    seconds = fields.number(_READOUT, 0.0)
    if not 0 <= seconds <= MAX_READOUT:
        raise fields.wrong(_READOUT, f"is {seconds:g} s, not between 0 and {MAX_READOUT:g}")
    return seconds


def _unused_readouts(path: Path, rig: Rig, readouts: Mapping[str, float]) -> Iterator[str]:
    if rig.timeline.rate is None and any(readouts.values()):
        yield f"{path}: {_READOUT} is not used, as pictures have no frame rate; give videos, or a rig.json with 'fps'"


def _group_by_camera(path: Path, entries: Sequence[_Entry]) -> list[list[_Entry]]:
    """Entries of one camera together: single pictures with one pose are its frames."""
    groups: dict[object, list[_Entry]] = {}
    paths: set[Path] = set()
    for entry, number in zip(entries, _numbered_poses(entries), strict=True):
        if entry.path in paths:
            raise RigError(f"{entry.fields.where}: {entry.path} is listed twice; remove one of its entries from {path}")
        paths.add(entry.path)
        is_picture = entry.path.is_file() and entry.path.suffix.lower() in PICTURE_SUFFIXES
        groups.setdefault(number if is_picture else entry.path, []).append(entry)
    return [sorted(group, key=lambda entry: (entry.time, natural_key(str(entry.path)))) for group in groups.values()]


def _numbered_poses(entries: Sequence[_Entry]) -> list[int]:
    """A number for the pose of each entry, the same where they differ by rounding only."""
    poses = np.array([entry.fields.matrix("transform_matrix")[:3] for entry in entries])
    centres = poses[np.isfinite(poses[:, :, 3]).all(axis=1), :, 3]
    if len(centres):
        poses[:, :, 3] /= max(np.ptp(centres, axis=0).max(), _LEAST_SIZE * np.abs(centres).max()) or 1.0
    numbers: dict[bytes, int] = {}
    kept, count = np.empty((min(len(poses), _MAX_POSES), 3, 4)), 0
    for entry, pose in zip(entries, poses, strict=True):
        if pose.tobytes() in numbers:
            continue
        with np.errstate(over="ignore", invalid="ignore"):
            near = np.flatnonzero(np.abs(kept[:count] - pose).max(axis=(1, 2)) <= _SAME_POSE)
        if not near.size and count == len(kept):
            raise _moving(entry.fields.where, f"more than {_MAX_POSES} poses")
        if not near.size:
            rigid_pose(entry.fields.matrix("transform_matrix"), f"{entry.fields.where} ({entry.path.stem})")
            kept[count] = pose
            count += 1
        numbers[pose.tobytes()] = int(near[0]) if near.size else count - 1
    return [numbers[pose.tobytes()] for pose in poses]


def _moving(where: str, what: str) -> RigError:
    return RigError(f"{where}: {what}, as of a moving camera; a rig needs fixed cameras that all see every frame")


def _camera_names(groups: Sequence[Sequence[_Entry]]) -> list[str]:
    """By files, folders, or what the files of a camera have in common: by the first that tells all cameras apart."""
    ways: tuple[Callable[[Sequence[_Entry]], str], ...] = (_file_name, _folder_name, _common_name)
    for name in ways:
        names = [composed(name(group)) for group in groups]
        if all(names) and len(set(names)) == len(names):
            return names
    return [f"cam{i:02d}" for i in range(len(groups))]


def _file_name(group: Sequence[_Entry]) -> str:
    """The name that all have, or none: cam00 of 0000/cam00.png, 0001/cam00.png."""
    return _the_only(entry.path.stem if entry.path.is_file() else entry.path.name for entry in group)


def _folder_name(group: Sequence[_Entry]) -> str:
    """The name of the folder that all are in, or none: cam00 of cam00/images/0000.png, cam00/images/0001.png."""
    folders = (entry.path.parent for entry in group)
    return _the_only(folder.parent.name if folder.name in GENERIC_FOLDERS else folder.name for folder in folders)


def _common_name(group: Sequence[_Entry]) -> str:
    """The words and numbers that all names have: cam00 of cam00_0000.png, cam00_0001.png."""
    split = [re.split("([0-9]+)", entry.path.stem) for entry in group]
    return "".join(parts[0] for parts in zip(*split, strict=False) if len(set(parts)) == 1).strip(" _.-")


def _the_only(names: Iterator[str]) -> str:
    distinct = set(names)
    return distinct.pop() if len(distinct) == 1 else ""


def _check_in_step(path: Path, names: Sequence[str], groups: Sequence[Sequence[_Entry]]) -> None:
    """The pictures of all cameras are of the same instants: times, or else folders where each has one picture."""
    times = [[f"the time {round(entry.time, 9) + 0.0}" for entry in group] for group in groups]
    if len(set(chain(*times))) > 1:
        if len(groups) > 1 and all(len(group) == 1 for group in groups):
            raise _moving(str(path), "every entry has its own pose and time")
        _check_instants(path, names, times)
    elif all(len(_folders(group)) == len(group) > 1 for group in groups):
        folders = [[_instant(entry.path, name) for entry in group] for name, group in zip(names, groups, strict=True)]
        if len(set(chain(*folders))) < sum(map(len, folders)):  # else cameras have none in common
            _check_instants(path, names, folders)


def _instant(path: Path, camera: str) -> str:
    """The folder of a picture, without the camera's own name: t0 of t0/cam00.png and of cam00/t0/rgb.png."""
    folder = path.parent
    return str(folder if path.stem == camera else Path(*(part for part in folder.parts if part != camera)))


def _check_instants(path: Path, names: Sequence[str], instants: Sequence[Sequence[str]]) -> None:
    every = dict.fromkeys(chain(*instants))
    for name, of_camera in zip(names, instants, strict=True):
        counts = Counter(of_camera)
        lacking = [instant for instant in every if instant not in counts]
        if lacking:
            raise RigError(
                f"{path}: camera {name} has no picture of {lacking[0]}, but others have; give all the same frames"
            )
        if len(every) > 1 and len(counts) < len(of_camera):
            instant = counts.most_common(1)[0][0]
            raise RigError(f"{path}: camera {name} has several pictures of {instant}; keep one of them")


def _folders(group: Sequence[_Entry]) -> set[Path]:
    return {entry.path.parent for entry in group}


def _check_one_lens(name: str, group: Sequence[_Entry]) -> None:
    first = group[0].fields
    for fields in (entry.fields for entry in group[1:]):
        for key in _LENS_NUMBERS:
            if not math.isclose(fields.number(key, 0.0), first.number(key, 0.0), rel_tol=_SAME_POSE, abs_tol=1e-9):
                raise fields.wrong(key, f"is not what camera {name} has in its first picture; lenses must be fixed")


def _source(group: Sequence[_Entry]) -> FrameSource:
    if len(group) == 1:
        return open_source(group[0].path)
    files, folders = [entry.path for entry in group], _folders(group)
    if len(folders) == 1:
        is_timed = len({entry.time for entry in group}) > 1
        return (open_listed if is_timed else open_pictures)(files[0].parent, files)
    common = os.path.commonpath([os.path.abspath(folder) for folder in folders])
    return open_listed(Path(common), files)


def _camera(name: str, fields: Fields, source: FrameSource) -> Camera:
    width = fields.integer("w") if "w" in fields else source.width
    height = fields.integer("h") if "h" in fields else source.height
    if "fl_x" in fields or "camera_angle_x" not in fields:
        fx = fields.number("fl_x")
    else:
        fx = _focal(fields, "camera_angle_x", width)
    if "fl_y" in fields or "camera_angle_y" not in fields:
        fy = fields.number("fl_y", fx)
    else:
        fy = _focal(fields, "camera_angle_y", height)
    model, distortion = _distortion(fields)
    opengl = rigid_pose(fields.matrix("transform_matrix"), f"{fields.where} ({name})")
    camera_to_world = opengl @ np.diag([1.0, -1.0, -1.0, 1.0])
    principal = (fields.number("cx", width / 2), fields.number("cy", height / 2))
    world_to_camera = invert_pose(camera_to_world)
    return calibrated_camera(
        name, (width, height), (fx, fy, *principal), world_to_camera, model, distortion, fields.where
    )


def _focal(fields: Fields, key: str, side: int) -> float:
    angle = fields.number(key)
    if not 0 < angle < math.pi:
        raise fields.wrong(key, f"is {angle:g}, not a field of view in radians")
    return side / (2 * math.tan(angle / 2))


def _distortion(fields: Fields) -> tuple[DistortionModel, tuple[float, ...]]:
    is_fisheye = fields.values.get("is_fisheye") is True
    model = fields.label("camera_model", "OPENCV_FISHEYE" if is_fisheye else "OPENCV")
    if is_fisheye and model not in _FISHEYE:
        raise fields.wrong("is_fisheye", f"is true, but 'camera_model' is {model!r}")
    others = [key for key in _OTHER_LENSES if key in fields and fields.values[key] is not False]
    if model not in _FISHEYE | _OPENCV or others:
        key, what = (others[0], "is set") if others else ("camera_model", f"is {model!r}")
        raise fields.wrong(key, f"{what}, which is not supported; undistort the pictures first")
    for key, value in fields.values.items():
        if (
            _LIKE_COEFFICIENTS.fullmatch(key)
            and key not in _COEFFICIENTS
            and (any(value) if isinstance(value, list) else value)
        ):
            raise fields.wrong(key, f"is not read; known are {', '.join(_COEFFICIENTS)}")
    k1, k2, k3, k4, k5, k6, p1, p2 = (fields.number(key, 0.0) for key in _COEFFICIENTS)
    if model in _FISHEYE:
        unknown = [key for key, value in zip(_COEFFICIENTS[4:], (k5, k6, p1, p2), strict=True) if value]
        if unknown:
            raise fields.wrong(unknown[0], f"is no coefficient of {model}, which has k1 to k4")
        return "fisheye", (k1, k2, k3, k4)
    if model == "FULL_OPENCV" or k5 or k6:
        return "opencv", (k1, k2, p1, p2, k3, k4, k5, k6)
    if k4:
        raise fields.wrong("k4", "is a fourth radial coefficient, which OpenCV's lens model does not have")
    return "opencv", (k1, k2, p1, p2, k3)
