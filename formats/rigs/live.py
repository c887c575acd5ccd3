"""Cameras that are still recording: pictures that appear in folders, a file for each frame.

A TOML file names a rig of the same cameras, calibrated before, and where each camera's pictures appear. A frame is
there when one camera has it. A camera without a whole picture of it is waited for ``late`` seconds, and then has
dropped the frame: its picture before is given again, which the encoder knows for what it is. After ``end`` seconds
without a new frame the recording has ended. Files on disk are the queue: nothing is read ahead of what is asked for.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path

from ..cameras import Camera
from ..errors import RecordingEnded, RigError
from ..pictures import Picture, picture_facts, read_picture
from .detection import reader_at
from .fields import Fields, read_toml
from .in_step import in_step
from .rig import Rig, assemble_rig

LAYOUT = "live"
_LATE, _END = 0.5, 10.0
"""Seconds, where the file does not say."""
_LONGEST = 86400.0
_POLL = 0.01
"""Seconds between looks for a file; the delay that this adds to a frame."""
_MAX_FRAMES = 10_000_000
"""Frames of a live rig, whose recording ends before: four days at 30 a second."""
_NUMBER = re.compile(r"\{(?::0([1-9])d)?\}")


@dataclass(frozen=True)
class _Recording:
    """Where the pictures of each camera appear, ``before``, ``digits`` and ``after`` a frame's number, and for how long
    they are waited for."""

    names: dict[str, tuple[str, int, str]]
    first: int
    fps: float
    late: float
    end: float

    def file(self, camera: str, frame: int) -> Path:
        """The picture of a frame, counted from 0."""
        before, digits, after = self.names[camera]
        return Path(f"{before}{self.first + frame:0{digits}d}{after}")

    def has(self, frame: int, *, but: str) -> bool:
        """Whether another camera has a frame."""
        return any(os.path.exists(self.file(name, frame)) for name in self.names if name != but)


@dataclass(frozen=True)
class LiveSource:
    """The frames of one camera as they appear; ``read`` waits for them and raises RecordingEnded after the last one."""

    path: Path
    camera: Camera
    recording: _Recording
    frame_count: int = _MAX_FRAMES
    warnings: tuple[str, ...] = ()

    @property
    def width(self) -> int:
        """Of every frame, in pixels."""
        return self.camera.width

    @property
    def height(self) -> int:
        """Of every frame, in pixels."""
        return self.camera.height

    @property
    def fps(self) -> float:
        """As the file states it."""
        return self.recording.fps

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """The pictures of these frames, each when it is whole. Raises RecordingEnded after the last one.

        RigError where the first does not come, or one has another size.
        """
        last = None
        for frame in range(start, stop, step):
            last = self._next(frame, last)
            yield last

    def _next(self, frame: int, last: Picture | None) -> Picture:
        recording, began, due = self.recording, time.monotonic(), None
        file = recording.file(self.camera.name, frame)
        later = frame + max(1, round(recording.late * recording.fps))
        while (picture := self._whole(file)) is None:
            now = time.monotonic()
            if last is not None and recording.has(frame, but=self.camera.name):
                due = now + recording.late if due is None else due
                if now > due or recording.has(later, but=self.camera.name):
                    return last
            elif now > began + recording.end:
                if last is None:
                    raise RigError(f"{file}: did not appear in {recording.end:g} s; start the camera, or raise 'end'")
                raise RecordingEnded(f"{self.path}: no new frame for {recording.end:g} s; the recording has ended")
            time.sleep(_POLL)
        return picture

    def _whole(self, file: Path) -> Picture | None:
        """The picture in a file; None while it is not there or not whole."""
        if not os.path.exists(file):
            return None
        try:
            facts = picture_facts(file)
            if (facts.width, facts.height) == (self.width, self.height):
                return read_picture(file)
        except RigError:
            return None
        raise RigError(
            f"{file}: {facts.width} x {facts.height} pixels, but camera {self.camera.name} is calibrated for "
            f"{self.width} x {self.height}; record in that size"
        )


def open_live(file: str | os.PathLike[str]) -> Rig:
    """The rig of a TOML file of cameras that are recording. Raises RigError."""
    path = Path(file)
    fields = read_toml(path)
    calibrated = reader_at(fields.path("calibration", path.parent))()
    values = fields.values.get("cameras")
    cameras = Fields(values, f"{path}, [cameras]") if isinstance(values, dict) else None
    if not cameras or not cameras.values:
        raise fields.wrong("cameras", "is no table of where each camera's pictures appear")
    by_name = {camera.name: camera for camera in calibrated.cameras}
    unknown = [name for name in cameras.values if name not in by_name]
    if unknown:
        raise cameras.wrong(unknown[0], f"is no camera of {calibrated.path}, which has {', '.join(by_name)}")
    recording = _Recording(
        {name: _pattern(cameras, name, path.parent) for name in cameras.values},
        fields.integer("first") if "first" in fields else 0,
        _positive(fields, "fps", None),
        _positive(fields, "late", _LATE),
        _positive(fields, "end", _END),
    )
    if recording.first < 0:
        raise fields.wrong("first", "is below 0")
    chosen = [by_name[name] for name in recording.names]
    pairs = [(camera, LiveSource(recording.file(camera.name, 0).parent, camera, recording)) for camera in chosen]
    return in_step(
        assemble_rig(
            path.parent,
            LAYOUT,
            pairs,
            [path, *calibrated.calibration],
            resizable=False,
            fps=recording.fps,
            points=calibrated.points,
            source_text=calibrated.source_text,
            licence=calibrated.licence,
            length_unit=calibrated.length_unit,
        ),
        {},
    )


def _positive(fields: Fields, key: str, default: float | None) -> float:
    value = fields.number(key, default)
    if not 0 < value <= _LONGEST:
        raise fields.wrong(key, f"is {value:g}, not above 0 and at most {_LONGEST:g}")
    return value


def _pattern(cameras: Fields, name: str, folder: Path) -> tuple[str, int, str]:
    """What is before a frame's number, how many digits that has at least, and what is after it."""
    parts = _NUMBER.split(str(cameras.path(name, folder)))
    if len(parts) != 3:
        raise cameras.wrong(name, "has not one place for the frame's number, such as {} or {:06d}")
    return parts[0], int(parts[1] or 1), parts[2]
