"""Opens a rig of synchronised, calibrated, fixed cameras in any known layout, and reads its frames in step.

Which layout a folder has is decided by the calibration in it; exactly one of these may be there:

==================== ==========================================================================
``rig.json``         rig.json; a COLMAP model beside it only gives its points
``transforms.json``  nerfstudio
``poses_bounds.npy`` MeetRoom if the cameras are named ``cam_N``, N3DV if ``camNN``
COLMAP model         in ``sparse/0`` (or the next number that has one), ``sparse`` or the folder itself:
                     MeetRoom if the cameras are named ``cam_N``, else COLMAP
==================== ==========================================================================

Where several are, the path of the calibration itself (``rig/poses_bounds.npy``, ``rig/sparse/0``) says which to use.
No other file, such as ground truth lying beside the frames, is opened.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path

from ..cameras import Camera
from ..errors import RigError, UsageError
from ..pictures import PICTURE_SUFFIXES, Picture
from ..threads import processor_count
from ..videos import VIDEO_SUFFIXES
from . import colmap, meetroom, n3dv, nerfstudio, rig_json
from .in_step import in_step
from .rig import Points, Rig
from .sources import FrameSource, PictureSource, holds_frames, list_folder

__all__ = [
    "FrameSource",
    "Points",
    "Rig",
    "files_of",
    "files_with",
    "in_step",
    "open_recordings",
    "open_rig",
    "read_frames",
]

_Reader = Callable[[], Rig]

_NAMED = 8
"""Entries of a folder that a message names."""


def open_rig(path: str | os.PathLike[str]) -> Rig:
    """The rig in a folder, or calibrated by the given calibration file or COLMAP model folder.

    Detects the layout, reads the calibration, and compares frame counts, sizes and rates of all cameras, or brings them
    in step where the calibration states their starts; no frame is decoded, but the first of EXR that have alpha. Raises
    RigError, in one line, on anything that does not fit.
    """
    rig = open_recordings(path)
    return in_step(rig, rig.starts)


def open_recordings(path: str | os.PathLike[str]) -> Rig:
    """The rig as `open_rig` finds it, with whole recordings: their lengths, rates and starts may differ.

    Its frame k is an instant of each camera's own. Raises RigError.
    """
    folder = Path(path)
    if not os.path.exists(folder):
        raise RigError(f"{folder}: there is no such folder; check the path")
    found = _calibrations_at(folder)
    if not found:
        raise RigError(
            f"{folder}: no calibration; expected rig.json, transforms.json, poses_bounds.npy or a COLMAP model in "
            f"sparse/0 (cameras.bin or cameras.txt), but {_contents(folder)}: calibrate the cameras, e.g. with COLMAP"
        )
    if len(found) > 1:
        names = list(found)
        raise RigError(
            f"{folder}: several calibrations ({', '.join(names)}); give the path of the one to use, "
            f"e.g. {folder / names[0]}, or move the others away"
        )
    (read,) = found.values()
    return read()


def files_of(rig: Rig) -> Iterator[tuple[Path, str]]:
    """Every file that nothing may be written over, and what it is: frames, calibration, and those that lie beside."""
    for source in rig.sources:
        for file in source.files if isinstance(source, PictureSource) else (source.path,):
            yield file, "holds frames of the rig"
    model = colmap.find_model(rig.path)
    # Another calibration or camera that lies there was not read, but is the user's all the same.
    beside = [rig.path / name for name in (rig_json.CALIBRATION, nerfstudio.CALIBRATION, n3dv.CALIBRATION)]
    for file in (*rig.calibration, *beside, *(() if model is None else colmap.model_files(model))):
        yield file, "is the rig's calibration"
    for entry in list_folder(rig.path):
        if entry.suffix.lower() in VIDEO_SUFFIXES | PICTURE_SUFFIXES:
            yield entry, "is in the rig's folder, as its frames are"


def files_with(rig: Rig, frames: range) -> Iterator[Path]:
    """The files that hold these frames, camera by camera: their pictures, or whole videos."""
    for source in rig.sources:
        yield from source.files[frames.start : frames.stop] if isinstance(source, PictureSource) else (source.path,)


def _calibrations_at(path: Path) -> dict[str, _Reader]:
    """Readers that fit, by what they were recognised by."""
    if path.is_file():
        return _calibration_file(path)
    if not path.is_dir():
        raise RigError(f"{path}: neither a folder nor a calibration file; give the rig's folder")
    found: dict[str, _Reader] = {}
    for name in (rig_json.CALIBRATION, nerfstudio.CALIBRATION, n3dv.CALIBRATION):
        if (path / name).is_file():
            found |= _calibration_file(path / name)
    model = colmap.find_model(path)
    if model is not None and rig_json.CALIBRATION not in found:
        found[str(model.relative_to(path))] = lambda: _read_colmap(colmap.rig_folder_of(model), model)
    return found


def _contents(folder: Path) -> str:
    """What lies in a folder, in a few words; what holds no frames first, since a calibration may be among it."""
    entries = sorted(list_folder(folder), key=holds_frames)
    if not entries:
        return "it is empty"
    names = [entry.name + "/" * entry.is_dir() for entry in entries[:_NAMED]]
    names = [name if name.isprintable() else ascii(name) for name in names]
    more = f" and {len(entries) - _NAMED} more" if len(entries) > _NAMED else ""
    return f"there are {', '.join(names)}{more}"


def _calibration_file(path: Path) -> dict[str, _Reader]:
    folder = path.parent
    readers: dict[str, _Reader] = {
        rig_json.CALIBRATION: lambda: rig_json.read_rig_json(folder),
        nerfstudio.CALIBRATION: lambda: nerfstudio.read_nerfstudio(folder),
        n3dv.CALIBRATION: lambda: _read_poses_bounds(folder),
        "cameras.bin": lambda: _read_colmap(colmap.rig_folder_of(folder), folder),
        "cameras.txt": lambda: _read_colmap(colmap.rig_folder_of(folder), folder),
    }
    if path.name not in readers:
        raise RigError(f"{path}: not a calibration that can be read; give the rig's folder")
    return {path.name: readers[path.name]}


def _read_poses_bounds(folder: Path) -> Rig:
    is_n3dv = bool(n3dv.camera_entries(folder, n3dv.CAMERA_NAME))
    is_meetroom = bool(n3dv.camera_entries(folder, meetroom.CAMERA_NAME))
    if is_n3dv and is_meetroom:
        raise RigError(f"{folder}: frames named both camNN and cam_N; keep the ones poses_bounds.npy belongs to")
    return meetroom.read_meetroom(folder) if is_meetroom else n3dv.read_n3dv(folder)


def _read_colmap(folder: Path, model: Path) -> Rig:
    names = [entry.stem for entry in list_folder(folder) if holds_frames(entry)]
    if any(meetroom.CAMERA_NAME.fullmatch(name) for name in names):
        return meetroom.read_meetroom(folder, model)
    return colmap.read_colmap_rig(folder, model)


def read_frames(
    rig: Rig, start: int = 0, stop: int | None = None, *, step: int = 1, names: Sequence[str] | None = None
) -> Iterator[tuple[int, list[Picture]]]:
    """Every step-th frame from start (inclusive) to stop (exclusive): its index, a picture of each camera in ``names``.

    Pictures come in the order of ``names`` (default: all cameras); other cameras are never opened. One frame of each
    camera is held at a time; files are read strictly in sequence, also to reach ``start``. Cameras are decoded side by
    side. Raises UsageError for a range or name the rig does not have, RigError naming file and frame while reading.
    """
    stop = rig.frame_count if stop is None else stop
    if not 0 <= start <= stop <= rig.frame_count:
        raise UsageError(f"{rig.path}: frames {start}:{stop} are not within the {rig.frame_count} frames of the rig")
    rows = {camera.name: row for row, camera in enumerate(rig.cameras)}
    wanted = list(rows) if names is None else list(names)
    unknown = [name for name in wanted if name not in rows]
    if unknown:
        raise UsageError(f"{rig.path}: no camera {unknown[0]!r}; there are {', '.join(rows)}")
    chosen = [(rig.cameras[rows[name]], rig.sources[rows[name]]) for name in wanted]
    return _frames_in_step(chosen, range(start, stop, step))


def _frames_in_step(chosen: list[tuple[Camera, FrameSource]], frames: range) -> Iterator[tuple[int, list[Picture]]]:
    readers = [source.read(frames.start, frames.stop, frames.step) for _, source in chosen]
    pool = ThreadPoolExecutor(max_workers=max(1, min(len(chosen), processor_count())))
    pending: list[Future[Picture]] = []
    try:
        for index in frames:
            pending = [
                pool.submit(_next_picture, camera, source, reader, index)
                for (camera, source), reader in zip(chosen, readers, strict=True)
            ]
            yield index, [future.result() for future in pending]
    finally:
        # Waits for decoders in flight: a reader must not be closed while its thread runs. Not for the threads to end:
        # the garbage collector may close this while it holds the lock that joining a thread takes.
        wait(pending)
        pool.shutdown(wait=False)
        for reader in readers:
            reader.close()


def _next_picture(camera: Camera, source: FrameSource, reader: Iterator[Picture], index: int) -> Picture:
    picture = next(reader, None)
    if picture is None:
        raise RigError(f"{source.path}: ends before frame {index}; bring all cameras to the same number of frames")
    if picture.shape != (camera.height, camera.width, 3):
        raise RigError(
            f"{source.path}: frame {index} is {picture.shape[1]} x {picture.shape[0]} pixels, but camera {camera.name} "
            f"has {camera.width} x {camera.height}; bring all frames to one size"
        )
    return picture
