"""Opens a rig of synchronised, calibrated, fixed cameras in any known layout, and reads its frames in step."""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import closing
from pathlib import Path

import numpy as np

from ..cameras import Camera
from ..errors import RecordingEnded, RigError, UsageError
from ..pictures.reading import PICTURE_SUFFIXES, Picture
from ..system.threads import processor_count
from ..videos.reading import VIDEO_SUFFIXES
from .detection import calibration_files, reader_at
from .live import LiveSource, dropped_in, stop_waiting
from .rig import Rig
from .sources import FrameSource, PictureSource, files_of_source, list_folder
from .steps import in_step

OnLost = Callable[[int, str, RigError], None]
"""Called with a frame, a camera, and why its picture of that frame cannot be had."""


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
    return reader_at(folder)()


def files_of(rig: Rig) -> Iterator[tuple[Path, str]]:
    """Every file that nothing may be written over, and what it is: frames, calibration, and those that lie beside."""
    for source in rig.sources:
        for file in files_of_source(source):
            yield file, "holds frames of the rig"
    # Another calibration or camera that lies there was not read, but is the user's all the same.
    for file in (*rig.calibration, *calibration_files(rig.path)):
        yield file, "is the rig's calibration"
    for entry in list_folder(rig.path):
        if entry.suffix.lower() in VIDEO_SUFFIXES | PICTURE_SUFFIXES:
            yield entry, "is in the rig's folder, as its frames are"


def files_with(rig: Rig, frames: range) -> Iterator[Path]:
    """The files that hold these frames, camera by camera: their pictures that are there, or whole videos."""
    for source in rig.sources:
        files = files_of_source(source)
        yield from filter(
            Path.exists, files[frames.start : frames.stop] if isinstance(source, PictureSource) else files
        )


def read_frames(
    rig: Rig,
    start: int = 0,
    stop: int | None = None,
    *,
    step: int = 1,
    names: Sequence[str] | None = None,
    on_lost: OnLost | None = None,
) -> Iterator[tuple[int, list[Picture]]]:
    """Every step-th frame from start (inclusive) to stop (exclusive): its index, a picture of each camera in ``names``.

    Pictures come in the order of ``names`` (default: all cameras); other cameras are never opened. One frame of each
    camera is held at a time; files are read strictly in sequence, also to reach ``start``. Cameras are decoded side by
    side. Frames of a recording that goes on (``open_live``) come as they are taken, and end with it. ``on_lost`` is
    called, before its frame comes, for every picture that cannot be had, in whose place there is another one: of a
    recording that goes on the one before, else a black one. It may raise the error. Raises UsageError for a range or
    name the rig does not have; without ``on_lost``, RigError naming file and frame.
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
    return _frames_in_step(rig, chosen, range(start, stop, step), on_lost)


def _frames_in_step(
    rig: Rig, chosen: list[tuple[Camera, FrameSource]], frames: range, on_lost: OnLost | None
) -> Iterator[tuple[int, list[Picture]]]:
    readers = [_Reader(camera.name, source, frames) for camera, source in chosen]
    # Cameras that are recording are waited for, all at once.
    waits = any(isinstance(source, LiveSource) for _, source in chosen)
    pool = ThreadPoolExecutor(max_workers=max(1, len(chosen) if waits else min(len(chosen), processor_count())))
    pending: list[Future[Picture | RigError]] = []
    try:
        for index in frames:
            pending = [pool.submit(reader.next, index) for reader in readers]
            try:
                results = [future.result() for future in pending]
            except RecordingEnded:
                return
            if on_lost is not None:
                for name, why in dropped_in(rig, index).items():
                    on_lost(index, name, RigError(why))
            yield index, [reader.given(index, got, on_lost) for reader, got in zip(readers, results, strict=True)]
    finally:
        stop_waiting(source for _, source in chosen)
        # Waits for decoders in flight: a reader must not be closed while its thread runs. Not for the threads to end:
        # the garbage collector may close this while it holds the lock that joining a thread takes.
        wait(pending)
        pool.shutdown(wait=False)
        for reader in readers:
            reader.close()


def read_repeating(source: FrameSource, frames: range) -> Iterator[Picture]:
    """A recording's pictures of these frames, with the one before in place of one that cannot be had.

    Raises RigError for the first one.
    """
    with closing(_Reader(source.path.stem, source, frames)) as reader:
        before: Picture | RigError | None = None
        for index in frames:
            picture = reader.next(index)
            before = before if isinstance(picture, RigError) and before is not None else picture
            if isinstance(before, RigError):
                raise before
            yield before


class _Reader:
    """The pictures of one camera, frame by frame; those that cannot be had are passed over."""

    def __init__(self, name: str, source: FrameSource, frames: range) -> None:
        self._name, self._source, self._frames = name, source, frames
        self._pictures: Generator[Picture, None, None] | None = source.read(frames.start, frames.stop, frames.step)
        self._error, self._readable = RigError(), frames.start

    def next(self, index: int) -> Picture | RigError:
        """The picture of the next frame, or why there is none."""
        if index < self._readable:
            return self._error
        if self._pictures is None:
            self._pictures = self._source.read(index, self._frames.stop, self._frames.step)
        try:
            return self._checked(index, next(self._pictures, None))
        except RecordingEnded:
            raise
        except RigError as error:
            self.close()
            self._pictures, self._error = None, error
            self._readable = self._source.readable_after(index)
            return error

    def given(self, index: int, result: Picture | RigError, on_lost: OnLost | None) -> Picture:
        """The picture that was found, or a black one where there is none; raises RigError without ``on_lost``."""
        if not isinstance(result, RigError):
            return result
        if on_lost is None:
            raise result
        on_lost(index, self._name, result)
        return np.zeros((self._source.height, self._source.width, 3), np.uint8)

    def close(self) -> None:
        """Closes the camera's files."""
        if self._pictures is not None:
            self._pictures.close()

    def _checked(self, index: int, picture: Picture | None) -> Picture:
        source = self._source
        if picture is None:
            raise RigError(f"{source.path}: ends before frame {index}; bring all cameras to the same number of frames")
        if picture.shape != (source.height, source.width, 3):
            raise RigError(
                f"{source.path}: frame {index} is {picture.shape[1]} x {picture.shape[0]} pixels, but camera "
                f"{self._name} has {source.width} x {source.height}; bring all frames to one size"
            )
        return picture
