"""colmap4d: a COLMAP model with the time of each image, ``times.bin`` or ``times.txt``, of cameras that stand still.

The pictures are those that the model names, ``frame_0000/cam00.png`` or ``cam00/0000.png``: a camera is what has one
picture at each time, its file's name or its folder. Times are whole nanoseconds; the k-th picture of every camera is
one instant. Points with a time (``points_t``) count if it is the first frame's.
Source: colmap4d 1.0.1 (Kiri-Innovation/colmap4d), specification 1.0, sections I.A to I.E.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path, PurePosixPath

from ..errors import RigError
from ..files.unicode_forms import as_it_lies
from .colmap import (
    ModelBytes,
    PosedImage,
    cameras_of,
    malformed,
    model_files,
    read_colmap_rig,
    read_images,
    read_lenses,
    read_points,
    text_lines,
)
from .named_frames import usual_folders
from .rig import Rig, assemble_rig
from .sources import FrameSource, open_listed, other_endings

LAYOUT = "colmap4d"
_SECOND = 1e9
_IMAGE_TIME, _POINT_TIME = "<Iq", "<Qq"


@dataclass(frozen=True)
class _Timed:
    image: PosedImage
    time: int


def has_times(model: Path) -> bool:
    """Whether the images of the COLMAP model in this folder have times."""
    return (model / "times.bin").is_file() or (model / "times.txt").is_file()


def read_colmap4d(folder: Path, model: Path) -> Rig:
    """The rig whose pictures are in ``folder``, with poses and times from ``model``. Raises RigError.

    Where the pictures are not as the model names them, its frames are found as those of other COLMAP models.
    """
    images, times = read_images(model), _times(model, "times", _IMAGE_TIME)
    if not any(as_it_lies(base / images[0].name).is_file() for base in usual_folders(folder)):
        return read_colmap_rig(folder, model, LAYOUT)
    timed = [_Timed(image, times[image.image_id]) for image in images if image.image_id in times]
    cameras = _by_camera(model, timed)
    _check_in_step(model, cameras)
    places = {one.image.name: name for name, group in cameras.items() for one in group}
    calibrated = cameras_of(model, read_lenses(model), [one.image for one in timed], places)
    pairs = [(calibrated[name], _source(folder, model, group)) for name, group in cameras.items()]
    first = next(iter(cameras.values()))
    of_points = _times(model, "points_t", _POINT_TIME)
    points = read_points(model, lambda number: of_points.get(int(number), first[0].time) == first[0].time)
    rig = assemble_rig(folder, LAYOUT, pairs, model_files(model), resizable=True, fps=_rate(first), points=points)
    untimed = len(images) - len(timed)
    warnings = [f"{model}: {untimed} images without a time are left out"] if untimed else []
    return replace(rig, warnings=(*rig.warnings, *warnings))


def _by_camera(model: Path, timed: Sequence[_Timed]) -> dict[str, list[_Timed]]:
    """The images by camera, in the order of time; named by what has one image at a time."""
    for name in _stem, _folder:
        groups: dict[str, list[_Timed]] = {}
        for one in sorted(timed, key=lambda one: one.time):
            groups.setdefault(name(one), []).append(one)
        if groups and all(_has_one_each(group) for group in groups.values()) and "" not in groups:
            return groups
    raise RigError(
        f"{model}: neither the files' names nor their folders give cameras one image at a time; name the images "
        "frame_0000/cam00.png or cam00/0000.png, and give each its time"
    )


def _stem(one: _Timed) -> str:
    return PurePosixPath(one.image.name).stem


def _folder(one: _Timed) -> str:
    return PurePosixPath(one.image.name).parent.name


def _has_one_each(group: Sequence[_Timed]) -> bool:
    return len({one.time for one in group}) == len(group)


def _check_in_step(model: Path, cameras: dict[str, list[_Timed]]) -> None:
    """As many images of each camera, the k-th of all nearer in time than half a frame."""
    first, *others = cameras
    times = [one.time for one in cameras[first]]
    gap = min((after - before for before, after in pairwise(times)), default=0)
    for name in others:
        group = cameras[name]
        if len(group) != len(times):
            raise RigError(
                f"{model}: {len(group)} times of camera {name}, but {len(times)} of {first}; give all the same frames"
            )
        late = max(abs(one.time - time) for one, time in zip(group, times, strict=True))
        if late > gap / 2:
            raise RigError(
                f"{model}: camera {name} is {late / _SECOND:.4f} s out of step with {first}, more than half a frame; "
                "give all cameras the same frames"
            )


def _rate(group: Sequence[_Timed]) -> float | None:
    if len(group) < 2 or group[-1].time <= group[0].time:
        return None
    return (len(group) - 1) * _SECOND / (group[-1].time - group[0].time)


def _source(folder: Path, model: Path, group: Sequence[_Timed]) -> FrameSource:
    names = [one.image.name for one in group]
    outside = next((name for name in names if PurePosixPath(name).is_absolute() or ".." in name.split("/")), None)
    if outside is not None:
        raise RigError(f"{model}: image {outside!r} lies outside the rig's folder; name images relative to it")
    bases = usual_folders(folder)
    base = next((one for one in bases if any(as_it_lies(one / name).is_file() for name in names)), folder)
    files = [as_it_lies(base / name) for name in names]
    missing = next((name for name, file in zip(names, files, strict=True) if not file.is_file()), None)
    if missing is not None:
        raise RigError(
            f"{base / missing}: is missing{other_endings(base / missing)}; put it back or take it out of {model}"
        )
    return open_listed(files[0], files)


def _times(model: Path, name: str, layout: str) -> dict[int, int]:
    """Nanoseconds by the number of an image or point; of a number that is there twice the last, as specified."""
    binary, text = model / f"{name}.bin", model / f"{name}.txt"
    if binary.is_file():
        file = ModelBytes(binary)
        pairs = [file.integers(layout) for _ in range(file.count(struct.calcsize(layout)))]
        return {pair[0]: pair[1] for pair in pairs}
    times: dict[int, int] = {}
    for number, line in text_lines(text) if text.is_file() else ():
        words = line.split()[:2]
        if len(words) < 2 or not all(re.fullmatch("-?[0-9]{1,20}", word) for word in words):
            raise malformed(text, number)
        times[int(words[0])] = int(words[1])
    return times
