"""DNA-Rendering: ``PERFORMANCE.smc`` with the pictures and ``PERFORMANCE_annots.smc`` with the calibration, both HDF5.

``Camera_Parameter/00`` has ``K``, ``D`` (k1 k2 p1 p2 k3) and ``RT``, camera-to-world in OpenCV axes and metres; the
centre of the first pixel is at (0, 0), as ``cv2.undistort`` is used with them. ``Camera_5mp/0/color/0`` and
``Camera_12mp/48/color/0`` are pictures as JPEG files. The file with pictures may lie in ``main/`` beside
``annotations/``. Needs h5py.
Source: DNA-Rendering/DNA-Rendering, scripts/3DGS/SMCReader.py and dataset_readers.py.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera
from ..errors import RigError
from ..pictures.headers import PNG_SIGNATURE, read_header
from ..pictures.reading import Picture, decode_picture
from .calibration import invert_pose, opencv_camera, rigid_pose
from .hdf5 import child, opened, values
from .rig import Rig, assemble_rig
from .sources import natural_key

LAYOUT = "dna-rendering"
CALIBRATIONS = ("*_annots.smc", "annotations/*_annots.smc")
_ENDING = "_annots.smc"
_GROUPS = ("Camera_5mp", "Camera_12mp")
_MAX_BYTES = 64 << 20
"""Of one picture's file."""


def read_dna_rendering(calibration: Path) -> Rig:
    """The rig whose calibration is in a PERFORMANCE_annots.smc. Raises RigError."""
    recording = _recording(calibration)
    with opened(calibration) as annotations, opened(recording) as pictures:
        sources = {f"{int(source.camera):02d}": source for source in _sources(recording, pictures)}
        _check_in_step(list(sources.values()))
        parameters = child(annotations, "Camera_Parameter", calibration)
        pairs = [
            (_camera(name, source, child(parameters, name, calibration), calibration), source)
            for name, source in sources.items()
        ]
    return assemble_rig(recording.parent, LAYOUT, pairs, [calibration], resizable=False, length_unit="metre")


def _recording(calibration: Path) -> Path:
    """The file with the pictures."""
    name = calibration.name.removesuffix(_ENDING) + ".smc"
    candidates = (calibration.parent / name, calibration.parent.parent / "main" / name)
    file = next((candidate for candidate in candidates if candidate.is_file()), None)
    if calibration.name == name or file is None:
        raise RigError(f"{calibration}: {name} with its pictures is neither beside it nor in ../main; put it there")
    return file


@dataclass(frozen=True)
class SmcSource:
    """The frames of one camera inside an SMC file; ``group`` is where they are, ``frames`` their names in order."""

    path: Path
    group: str
    camera: str
    frames: tuple[str, ...]
    width: int
    height: int
    fps: float | None = None
    warnings: tuple[str, ...] = ()

    @property
    def frame_count(self) -> int:
        """How many pictures there are."""
        return len(self.frames)

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """The pictures of these frames. Raises RigError for one that is damaged."""
        with opened(self.path) as file:
            group = file
            for part in (self.group, self.camera, "color"):
                group = child(group, part, self.path)
            for name in self.frames[start:stop:step]:
                data = _bytes(group, name, self.path)
                yield decode_picture(_named(self.path, self.group, self.camera, name, data), data)

    def readable_after(self, index: int) -> int:
        """The next one: each picture is coded by itself."""
        return index + 1


def _sources(path: Path, file: Any) -> Iterator[SmcSource]:
    """The colour cameras, and the sizes of their first pictures."""
    for group in (group for group in _GROUPS if group in file):
        cameras = child(file, group, path)
        for camera in sorted(cameras, key=natural_key):
            if not camera.isdecimal():
                raise RigError(f"{path}: {group}/{camera!a} is no camera's number; download the file again")
            pictures = child(child(cameras, camera, path), "color", path)
            frames = sorted(pictures, key=natural_key)
            if not frames:
                raise RigError(f"{path}: {group}/{camera} holds no picture; download the file again")
            data = _bytes(pictures, frames[0], path)
            header = read_header(_named(path, group, camera, frames[0], data), data)
            yield SmcSource(path, group, camera, tuple(frames), header.width, header.height)


def _check_in_step(sources: Sequence[SmcSource]) -> None:
    for source in sources:
        lacking = sorted(set(sources[0].frames) ^ set(source.frames), key=natural_key)
        if lacking:
            raise RigError(
                f"{source.path}: only one of cameras {sources[0].camera} and {source.camera} has frame "
                f"{lacking[0]!a:.20}; download the file again"
            )


def _named(path: Path, group: str, camera: str, frame: str, data: bytes) -> Path:
    """What messages call a picture; its ending tells what is inside."""
    return path / group / camera / f"{ascii(frame)[1:21]}{'.png' if data.startswith(PNG_SIGNATURE) else '.jpg'}"


def _camera(name: str, source: SmcSource, parameters: Any, path: Path) -> Camera:
    where = f"{path}, camera {name}"
    pose = invert_pose(rigid_pose(_numbers(parameters, "RT", path, 16).reshape(4, 4), where))
    matrix, lens = _numbers(parameters, "K", path, 9), _numbers(parameters, "D", path, 5)
    return opencv_camera(name, (source.width, source.height), matrix, lens, pose, where)


def _numbers(group: Any, name: str, path: Path, count: int) -> NDArray[np.float64]:
    numbers = values(group, name, path, 1024).astype(np.float64).ravel()
    if numbers.size != count:
        raise RigError(f"{path}: {group.name}/{name} has {numbers.size} numbers, not {count}; download the file again")
    return numbers


def _bytes(group: Any, name: str, path: Path) -> bytes:
    return values(group, name, path, _MAX_BYTES).astype(np.uint8).tobytes()
