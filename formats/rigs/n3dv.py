"""Neural 3D Video layout: ``camNN.mp4`` (or folders ``camNN/`` of pictures) and ``poses_bounds.npy``.

Also serves MeetRoom mirrors that carry ``poses_bounds.npy``. The file follows LLFF: per camera a row-major 3 x 5 matrix
with columns down, right, backwards (camera axes in the world), position, (height, width, focal length in pixels of the
full-size video), then near and far depth. Row i belongs to the i-th of the sorted existing cameras; the principal point
is the picture's centre and there is no lens distortion in the file.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera
from ..errors import RigError
from .calibration import calibrated_camera, invert_pose, rigid_pose
from .pickles import refuse_pickles
from .rig import Rig, assemble_rig
from .sources import holds_frames, list_folder, open_source, refuse_unknown_kinds

LAYOUT = "n3dv"
CALIBRATION = "poses_bounds.npy"
CAMERA_NAME = re.compile(r"cam[0-9]+")
_ANY_CAMERA_NAME = re.compile(r"cam_?[0-9]+")
_MAX_BYTES = 16 << 20


def read_n3dv(folder: Path) -> Rig:
    """The rig in ``folder``. Raises RigError."""
    return read_poses_bounds_rig(folder, LAYOUT, CAMERA_NAME)


def read_poses_bounds_rig(folder: Path, layout: str, camera_name: re.Pattern[str]) -> Rig:
    """The rig whose frames match ``camera_name`` and whose poses are in poses_bounds.npy. Raises RigError."""
    entries = camera_entries(folder, camera_name)
    path = folder / CALIBRATION
    if not entries:
        refuse_unknown_kinds(_named_as_cameras(folder, _ANY_CAMERA_NAME))
        raise RigError(f"{folder}: no video or picture folder named cam00, cam01 ... (or cam_0 ...); add the frames")
    rows = _read_rows(path)
    if len(rows) != len(entries):
        stems = {entry.stem for entry in entries}
        refuse_unknown_kinds(entry for entry in _named_as_cameras(folder, camera_name) if entry.stem not in stems)
        raise RigError(
            f"{path}: {len(rows)} poses, but {len(entries)} cameras with frames ({entries[0].name} to "
            f"{entries[-1].name}{_numbering_gap(entries)}); put the missing camera back or remove its row"
        )
    names = [entry.stem for entry in entries]
    cameras = [
        _camera(row, name, f"{path}, row {i} ({name})") for i, (row, name) in enumerate(zip(rows, names, strict=True))
    ]
    sources = [open_source(entry) for entry in entries]
    return assemble_rig(folder, layout, list(zip(cameras, sources, strict=True)), [path], resizable=True)


def camera_entries(folder: Path, camera_name: re.Pattern[str]) -> list[Path]:
    """Videos and picture folders with a camera's name, in natural order. Raises RigError if a name is there twice."""
    entries = [entry for entry in _named_as_cameras(folder, camera_name) if holds_frames(entry)]
    by_name: dict[str, Path] = {}
    for entry in entries:
        other = by_name.setdefault(entry.stem, entry)
        if other is not entry:
            raise RigError(f"{folder}: both {other.name} and {entry.name} hold frames of one camera; move one away")
    return sorted(by_name.values(), key=lambda entry: _number(entry.stem))


def _named_as_cameras(folder: Path, camera_name: re.Pattern[str]) -> list[Path]:
    return [entry for entry in list_folder(folder) if camera_name.fullmatch(entry.stem)]


def _number(name: str) -> int:
    return int(re.findall(r"[0-9]+", name)[-1])


def _numbering_gap(entries: list[Path]) -> str:
    numbers = {_number(entry.stem) for entry in entries}
    gaps = [number for number in range(min(numbers), max(numbers)) if number not in numbers]
    return f"; no number {gaps[0]}" if gaps else ""


def _read_rows(path: Path) -> NDArray[np.float64]:
    refuse_pickles([path])
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise RigError(f"{path}: larger than {_MAX_BYTES >> 20} MiB, which no rig's poses are; check the file")
        # Mapped, so that the claimed shape is compared with the file's length before anything is allocated.
        rows = np.array(np.load(path, mmap_mode="r", allow_pickle=False))
    except RigError:
        raise
    except Exception:  # numpy's header parser raises ValueError, SyntaxError, TypeError, TokenError and others
        raise RigError(f"{path}: not a readable NumPy file, or truncated; copy it again from its source") from None
    if rows.ndim != 2 or rows.shape[1] != 17 or rows.dtype.kind not in "fiu" or len(rows) == 0:
        raise RigError(f"{path}: shape {rows.shape} of {rows.dtype}, expected (cameras, 17) numbers; check the file")
    return rows.astype(np.float64)


def _camera(row: NDArray[np.float64], name: str, where: str) -> Camera:
    """One row as a camera of the full-size video."""
    if not np.isfinite(row[:15]).all():
        raise RigError(f"{where}: the pose holds NaN or infinite values; calibrate the camera again")
    matrix = row[:15].reshape(3, 5)
    down, right, backwards, position, (height, width, focal) = matrix.T
    camera_to_world = rigid_pose(np.stack([right, down, -backwards, position], axis=1), where)
    if not (1 <= width < 1e6 and 1 <= height < 1e6):
        raise RigError(f"{where}: {width:g} x {height:g} pixels is no usable size; check the file")
    size = (round(float(width)), round(float(height)))
    intrinsics = (float(focal), float(focal), size[0] / 2, size[1] / 2)
    return calibrated_camera(name, size, intrinsics, invert_pose(camera_to_world), "none", (), where)
