"""Cameras that are still recording: pictures in folders, videos that grow, cameras that send.

A TOML file names a rig of the same cameras, calibrated before, and where each camera's pictures come from. A frame
begins when one camera has it. The reader waits ``late`` seconds for the others. A camera without a whole picture by
then has dropped the frame: its last picture is given again, and the encoder leaves that view out. After three dropped
frames in a row the reader no longer waits for that camera, until the last of them has arrived. After ``end`` seconds
without a new frame the recording has ended.
"""

from __future__ import annotations

import math
import os
import re
import time
from collections.abc import Callable, Generator, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from ..cameras import Camera
from ..errors import RecordingEnded, RigError
from ..files.unicode_forms import composed
from ..pictures.reading import PICTURE_KINDS, PICTURE_SUFFIXES, Picture
from ..videos.reading import VIDEO_SUFFIXES
from .connections import GrowingVideo, SendingCamera, check_address
from .detection import reader_at
from .feeds import Feed, FolderFeed
from .fields import Fields, read_toml
from .rig import Rig, assemble_rig
from .sender_times import SharedClock
from .sources import FrameSource
from .steps import in_step
from .video_feed import Connection, VideoFeed

LAYOUT = "live"
_LATE, _END, _QUEUE = 0.5, 10.0, 10.0
"""Seconds, where the file does not say."""
_LONGEST = 86400.0
_POLL = 0.01
"""Seconds between looks for a picture; the delay that this adds to a frame."""
_DEAD_AFTER = 3
"""Frames that a camera has dropped in a row from which it is not waited for."""
_MAX_FRAMES = 10_000_000
"""Frames of a live rig, whose recording ends before: four days at 30 a second."""
_MAX_EVERY = 1000
_ROUNDED = 0.02
"""Share of a frame's time that a budget may be above it: 0.34 for three frames a second takes each of them."""
_REMEMBERED = 1000
_NUMBER = re.compile(r"\{(?::0([1-9])d)?\}")
_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]*://")

OpenFeed = Callable[[Camera], Feed]


@dataclass(frozen=True)
class _Recording:
    """How the feed of each camera is opened, and for how long it is waited for; ``every``: the frames that are taken.

    ``feeds``: those that are open. ``ended``: cameras that have waited ``end`` seconds for a frame that none had.
    ``dropped``: by frame and camera, why there was no picture, of the last ones.
    """

    opened: Mapping[str, OpenFeed]
    fps: float
    late: float
    end: float
    every: int
    feeds: dict[str, Feed] = field(default_factory=dict, compare=False)
    ended: set[str] = field(default_factory=set, compare=False)
    dropped: dict[int, dict[str, str]] = field(default_factory=dict, compare=False)

    def has(self, frame: int, *, but: str) -> bool:
        """Whether another camera has a frame."""
        return any(feed.reached(frame) for name, feed in list(self.feeds.items()) if name != but)

    def note(self, frame: int, camera: str, why: str) -> None:
        """A camera has dropped a frame."""
        self.dropped.setdefault(frame, {})[camera] = why
        if len(self.dropped) > _REMEMBERED:  # by whoever asks for none of it
            self.dropped.pop(min(self.dropped), None)


@dataclass(frozen=True)
class LiveSource:
    """The frames of one camera as they come; ``read`` waits for them and raises RecordingEnded after the last one."""

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
        """Of the frames that are taken."""
        return self.recording.fps / self.recording.every

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """The pictures of these frames, each when it is whole. Raises RecordingEnded after the last one.

        The camera is followed from now on, before the first is asked for. RigError where the first does not come, or
        has another size.
        """
        name = self.camera.name
        self.recording.ended.discard(name)
        feed = self.recording.feeds[name] = self.recording.opened[name](self.camera)
        return self._pictures(_Follower(self, feed), range(start, stop, step))

    def readable_after(self, index: int) -> int:
        """The next one, though only the first is not given: for a later one there is the one before."""
        return index + 1

    def _pictures(self, follower: _Follower, frames: range) -> Generator[Picture, None, None]:
        try:
            for index in frames:
                yield follower.next(index * self.recording.every)
        finally:
            follower.feed.close()


class _Follower:
    """The way of one camera through its recording: the last picture, and whether the camera is waited for."""

    def __init__(self, source: LiveSource, feed: Feed) -> None:
        self.feed, self._source, self._recording = feed, source, source.recording
        self._last: Picture | None = None
        self._lacking: list[int] = []  # the frames before that were dropped

    def next(self, frame: int) -> Picture:
        """The picture of a frame, or the one before it where the camera has dropped the frame."""
        if self._lacking and self.feed.reached(self._lacking[-1]):
            self._lacking.clear()
        try:
            picture, why = self._awaited(frame), ""
        except RecordingEnded:
            raise
        except RigError as error:
            if self._last is None:
                raise
            picture, why = None, str(error)
        if picture is not None:
            self._last = picture
            self._lacking.clear()
            return picture
        assert self._last is not None
        self._recording.note(frame, self._source.camera.name, why or self.feed.why(frame))
        self._lacking = [*self._lacking, frame][-_DEAD_AFTER:]
        return self._last

    def _awaited(self, frame: int) -> Picture | None:
        """The picture of a frame when it is there; None where the camera has dropped it."""
        recording, name, feed = self._recording, self._source.camera.name, self.feed
        began, due = time.monotonic(), None
        patience = recording.late if len(self._lacking) < _DEAD_AFTER else 0.0
        later = frame + max(1, round(recording.late * recording.fps))
        while (picture := feed.take(frame)) is None:
            now = time.monotonic()
            if recording.feeds.get(name) is not feed:
                raise RecordingEnded(f"{self._source.path}: nobody waits for it any more")
            missed = feed.is_over(frame) or recording.has(later if feed.holds(frame) else frame, but=name)
            missed = missed and self._last is not None
            if not missed and now > began + recording.end:
                recording.ended.add(name)
            holds_back = bool(recording.ended) and feed.finish()
            if missed and not holds_back:
                due = now + patience if due is None else due
                if now >= due or feed.is_over(frame) or recording.has(later, but=name):
                    return None
            elif recording.ended and not holds_back:
                raise self._ended()
            time.sleep(_POLL)
        return picture

    def _ended(self) -> RigError:
        end = self._recording.end
        if self._last is None:
            return RigError(f"{self.feed.origin}: did not appear in {end:g} s; {self.feed.advice}, or raise 'end'")
        return RecordingEnded(f"{self._source.path}: no new frame for {end:g} s; the recording has ended")


def open_live(file: str | os.PathLike[str], *, seconds_per_frame: float | None = None) -> Rig:
    """The rig of a TOML file of cameras that are recording. Raises RigError.

    ``seconds_per_frame``: what a frame will take; as many frames are passed over as come meanwhile, unless the file
    says how many.
    """
    path = Path(file)
    fields = read_toml(path)
    calibrated = reader_at(fields.path("calibration", path.parent))()
    values = fields.values.get("cameras")
    if not isinstance(values, dict) or not values:
        raise fields.wrong("cameras", "is no table of where each camera's pictures come from")
    cameras = Fields({composed(name): value for name, value in values.items()}, f"{path}, [cameras]")
    by_name = {camera.name: camera for camera in calibrated.cameras}
    unknown = [name for name in cameras.values if name not in by_name]
    if unknown:
        raise cameras.wrong(unknown[0], f"is no camera of {calibrated.path}, which has {', '.join(by_name)}")
    terms = _terms(fields)
    places = {name: _feed_of(cameras, name, path.parent, terms) for name in cameras.values}
    recording = _Recording(
        {name: opened for name, (_, opened) in places.items()},
        terms.fps,
        _positive(fields, "late", _LATE),
        _positive(fields, "end", _END),
        _every(fields, terms.fps, seconds_per_frame),
    )
    pairs = [(by_name[name], LiveSource(at, by_name[name], recording)) for name, (at, _) in places.items()]
    rig = in_step(
        assemble_rig(
            path.parent,
            LAYOUT,
            pairs,
            [path, *calibrated.calibration],
            resizable=False,
            fps=terms.fps / recording.every,
            points=calibrated.points,
            source_text=calibrated.source_text,
            licence=calibrated.licence,
            length_unit=calibrated.length_unit,
        ),
        {},
    )
    return rig if recording.every == 1 else replace(rig, warnings=(*rig.warnings, _warning_of(path, recording)))


def is_live(rig: Rig) -> bool:
    """Whether the rig's cameras are recording, so that no frame is read twice."""
    return any(isinstance(source, LiveSource) for source in rig.sources)


def dropped_in(rig: Rig, index: int) -> dict[str, str]:
    """Of a live rig's frame that was read, each camera without a picture of it, and why; told once."""
    recording = next((source.recording for source in rig.sources if isinstance(source, LiveSource)), None)
    return {} if recording is None else recording.dropped.pop(index * recording.every, {})


def stop_waiting(sources: Iterable[FrameSource]) -> None:
    """Ends what is being read of live sources, at once; they may be read again."""
    for source in sources:
        if isinstance(source, LiveSource):
            source.recording.feeds.pop(source.camera.name, None)


def _every(fields: Fields, fps: float, seconds_per_frame: float | None) -> int:
    """Every how many frames one is taken."""
    if "every" in fields:
        every = fields.integer("every")
        if not 0 < every <= _MAX_EVERY:
            raise fields.wrong("every", f"is {every}, not from 1 to {_MAX_EVERY}")
        return every
    needed = 1 if seconds_per_frame is None else math.ceil(seconds_per_frame * fps * (1 - _ROUNDED))
    return min(max(1, needed), _MAX_EVERY)


def _warning_of(path: Path, recording: _Recording) -> str:
    """How many frames are passed over."""
    return (
        f"{path}: one of {recording.every} frames is encoded, so that the stream has "
        f"{recording.fps / recording.every:.4g} a second"
    )


def _positive(fields: Fields, key: str, default: float | None) -> float:
    value = fields.number(key, default)
    if not 0 < value <= _LONGEST:
        raise fields.wrong(key, f"is {value:g}, not above 0 and at most {_LONGEST:g}")
    return value


@dataclass(frozen=True)
class _Terms:
    """What all feeds of a recording share: its rate, the number in the first picture's name, packets in a queue."""

    fps: float
    first: int
    queue: int
    clock: SharedClock = field(default_factory=SharedClock)

    def of_video(self, connection: Connection) -> OpenFeed:
        """Opens the feed of a video."""
        return partial(VideoFeed, connection=connection, clock=self.clock, fps=self.fps, most=self.queue)


def _terms(fields: Fields) -> _Terms:
    fps, first = fields.rate("fps"), fields.integer("first") if "first" in fields else 0
    if first < 0:
        raise fields.wrong("first", "is below 0")
    return _Terms(fps, first, math.ceil(_positive(fields, "queue", _QUEUE) * fps) + 1)


def _feed_of(cameras: Fields, name: str, folder: Path, terms: _Terms) -> tuple[Path, OpenFeed]:
    """Where a camera's pictures come from, and how its feed is opened."""
    text = cameras.label(name)
    if _ADDRESS.match(text):
        check_address(text, f"{cameras.where}: {name!r}")
        sender = SendingCamera(text, terms.fps)
        return Path(sender.origin), terms.of_video(sender)
    path = cameras.path(name, folder)
    if path.suffix.lower() in VIDEO_SUFFIXES:
        return path, terms.of_video(GrowingVideo(path))
    parts = _NUMBER.split(str(path))
    if len(parts) != 3:
        raise cameras.wrong(
            name, "is no video, no address, and has not one place for the frame's number, such as {} or {:06d}"
        )
    if path.suffix.lower() not in PICTURE_SUFFIXES:
        raise cameras.wrong(name, f"ends in {path.suffix}, which is not read; record {PICTURE_KINDS}, or a video")
    before, digits, after = parts[0], int(parts[1] or 1), parts[2]
    return path.parent, partial(FolderFeed, before=before, digits=digits, after=after, first=terms.first)
