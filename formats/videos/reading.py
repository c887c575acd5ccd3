"""Reads a video in sequence, as FFmpeg decodes it (PyAV), each frame by its time of presentation.

Opening lists the container's packets, which gives the frame count and every time without decoding. Then it decodes the
first frame, one at some keyframes, and those from the last keyframe on: what no decoder shows, a stream that ends early
and frames flagged interlaced are found before training starts. What is found later stops the reading, with the frame;
after damage reading can begin again at the next keyframe.
"""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import av
import numpy as np
from av.codec.context import Flags
from av.sidedata.sidedata import Type as SideData
from av.stream import Disposition
from numpy.typing import NDArray

from ..colours.ycbcr import Siting, chroma_siting, colours_of, to_rgb
from ..errors import RigError
from ..pictures.reading import MAX_PIXELS, Picture
from ..splats import FloatArray
from .clean_aperture import NO_EDGES, Edges, edges_of_track
from .readouts import stated_readout

if TYPE_CHECKING:
    from av import VideoFrame
    from av.container import InputContainer
    from av.video.stream import VideoStream

DEMUXERS = {
    "mov": (".mp4", ".m4v", ".mov", ".3gp"),
    "matroska": (".mkv", ".webm"),
    "avi": (".avi",),
    "mpegts": (".ts", ".mts", ".m2ts"),
    "mpeg": (".mpg", ".mpeg", ".vob"),
    "mxf": (".mxf",),
    "yuv4mpegpipe": (".y4m",),
}
"""FFmpeg's readers of containers, and the endings of files that they read; a playlist, whatever its name, is none."""

VIDEO_SUFFIXES = frozenset(suffix for suffixes in DEMUXERS.values() for suffix in suffixes)

# From PyAV 19 on there is no such option: bytes that are no text are escaped.
ANY_TEXT: dict[str, Any] = {} if int(av.__version__.split(".")[0]) >= 19 else {"metadata_errors": "replace"}
"""How files are opened whose titles and comments may be in any encoding; nobody reads them."""

_BOXED_SUFFIXES = frozenset(DEMUXERS["mov"])
_FIRST_BOXES = frozenset({b"ftyp", b"styp", b"moov", b"mdat", b"free", b"skip", b"wide", b"pnot"})
_PICTURE_BOXES = frozenset({b"moov", b"moof", b"mdat"})

_MAX_FRAMES = 1 << 22
"""Of a video: five hours at 240 frames per second."""
_KEYFRAMES_SEEN = 8
"""Of which a frame is decoded when a video is opened, spread over it."""
_PIXELS_SEEN = 1 << 26
"""At most so many, in the frames from the last keyframe on, are decoded when a video is opened: a tenth of a second."""

_RATE_TOLERANCE = 0.5
"""A frame may last this share longer or shorter than usual: rounded time stamps (1 ms in Matroska) pass, a dropped or
doubled frame does not."""


@dataclass(frozen=True)
class VideoSource:
    """The frames of one camera in a video file.

    Width and height in pixels, as shown; fps None if the file does not say. ``times``: presentation time of every frame
    in the track's own unit, (frame_count,) int64, or None if the container has no usable times; ``keyframes``: those of
    frames that decoding can begin with, their numbers where there are no times. ``dropped``: frames that repeat the one
    before. ``edges``: pixels of the decoded frames that are not shown. ``turn``: see ``_turn``, after that.
    ``readout``: seconds from the exposure of a picture's first row to that of its last, below 0 where it is read from
    below, as the camera wrote it, else 0. ``warnings``: what shows in its pictures.
    """

    path: Path
    width: int
    height: int
    frame_count: int
    fps: float | None
    times: NDArray[np.int64] | None = field(default=None, repr=False, compare=False)
    keyframes: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64), repr=False, compare=False)
    dropped: frozenset[int] = field(default=frozenset(), repr=False)
    siting: Siting = (True, False)
    edges: Edges = NO_EDGES
    turn: tuple[int, int, int, int] = (1, 0, 0, 1)
    readout: float = 0.0
    warnings: tuple[str, ...] = ()

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """Every step-th frame from start (inclusive) to stop (exclusive), RGB uint8; others are passed over.

        A far start is sought. Raises RigError if the video ends early, drops a frame, changes its size, or has a frame
        that is interlaced, damaged, or predicted from a damaged one.
        """
        with closing(self._frames_from(start)) as frames:
            for index in range(start, stop):
                frame = next(frames, None)
                if frame is None:
                    raise _ended(self.path, index, self.frame_count)
                if (index - start) % step == 0:
                    yield self.picture(frame, index)

    def readable_after(self, index: int) -> int:
        """The first frame after a damaged one that is not predicted from it: the next keyframe."""
        if self.times is None:
            later = self.keyframes[self.keyframes > index]
        else:
            later = np.searchsorted(self.times, self.keyframes[self.keyframes > self.times[index]])
        return int(later[0]) if later.size else self.frame_count

    def _frames_from(self, start: int) -> Generator[VideoFrame, None, None]:
        """The decoded frames from ``start`` on, each by its own time."""
        for begin in self._beginnings(start):
            following, last = start, None
            with opened_video(self.path) as (container, stream):
                if begin is not None and not _seek(container, stream, begin):
                    continue
                for index, frame, damage in self._numbered(container, stream, start, is_sought=begin is not None):
                    while last is not None and following < index and following in self.dropped:
                        yield last
                        following += 1
                    if index > following or (index == following and damage is not None):
                        if begin is not None and following == start:
                            break  # what was sought lies further on, or needs what lies before
                        raise damage if index == following and damage is not None else _missing(self.path, following)
                    if index == following:
                        yield frame
                        following += 1
                    last = frame if damage is None else None
            if following > start:
                return

    def _numbered(
        self, container: InputContainer, stream: VideoStream, start: int, *, is_sought: bool
    ) -> Iterator[tuple[int, VideoFrame, RigError | None]]:
        """Decoded frames with their numbers, -1 before the first, and damage in each or in what it is predicted from.

        ``start``: the number of the frame that is looked for. ``is_sought``: not from the beginning on. MPEG-TS also
        goes to packets that are no keyframes, and decoders of MPEG-4 show them.
        """
        damage, before = _missing(self.path, start) if is_sought else None, -1
        for position, frame in enumerate(_decoded(self.path, container, stream, passes_errors=self.times is not None)):
            index = position if self.times is None else self._index_of(frame, max(start, before + 1))
            lacks = before >= 0 and not self.dropped.issuperset(range(before + 1, index))
            if frame.is_corrupt or lacks:
                damage = _damaged(self.path, index)
            elif frame.key_frame:
                damage = None
            before = index
            yield index, frame, damage

    def _beginnings(self, start: int) -> list[int | None]:
        """Times of keyframes to decode from, the nearest first, and None for the video's beginning.

        After a seek, pictures that are shown before the keyframe may be lost: then the keyframe before it is tried.
        """
        if self.times is None or not 0 < start < self.frame_count:
            return [None]
        before = self.keyframes[(self.keyframes <= self.times[start]) & (self.keyframes > self.times[0])]
        return [*before[-2:][::-1].tolist(), None]

    def _index_of(self, frame: VideoFrame, following: int) -> int:
        """The frame's number by its time; -1 before the first one."""
        assert self.times is not None
        if frame.pts is None:
            raise _missing(self.path, following)
        usual = (self.times[-1] - self.times[0]) / max(self.frame_count - 1, 1)
        around = np.searchsorted(self.times, frame.pts) + np.array([-1, 0])
        near = np.clip(around, 0, len(self.times) - 1)
        nearest = int(near[np.abs(self.times[near] - frame.pts).argmin()])
        if abs(self.times[nearest] - frame.pts) > _RATE_TOLERANCE * usual:
            if frame.pts < self.times[0]:
                return -1
            raise _missing(self.path, following)
        return nearest

    def picture(self, frame: VideoFrame, index: int) -> NDArray[np.uint8]:
        """A decoded frame as it is shown. Raises RigError for one that is interlaced, damaged or of another size."""
        left, top, right, bottom = self.edges
        width, height = (self.width, self.height) if self.turn[0] else (self.height, self.width)
        _check_kind(self.path, frame, index, (left + width + right, top + height + bottom))
        if frame.is_corrupt:
            raise _damaged(self.path, index)
        try:
            whole = to_rgb(frame, self.siting)
            return _turned(whole[top : top + height, left : left + width], self.turn)
        except (ValueError, av.FFmpegError) as error:
            raise RigError(f"{self.path}: colours coded as {error} are not read; convert it to BT.709") from None

    def whole(self) -> VideoSource:
        """The same frames with their edges."""
        across, down = self.edges[0] + self.edges[2], self.edges[1] + self.edges[3]
        if not self.turn[0]:
            across, down = down, across
        return replace(self, width=self.width + across, height=self.height + down, edges=NO_EDGES)


@dataclass(frozen=True)
class _Listing:
    """What a container says of a track: times of its frames (sorted; None if there are no usable ones) and of its
    keyframes, in the track's own ``unit`` of seconds, the number of its packets, and frames per second.

    ``in_coded_order``: the times are those of decoding, as AVI and most of MXF have no others, and frames may be shown
    in another order. ``dropped``: the times of frames that have no picture of their own.
    """

    times: NDArray[np.int64] | None
    keyframes: NDArray[np.int64]
    packets: int
    unit: float
    stated_fps: float
    in_coded_order: bool = False
    dropped: frozenset[int] = frozenset()


def open_video(path: Path) -> VideoSource:
    """Size, frame count and rate of a video, and what shows in its pictures.

    Raises RigError if the file is missing, is no video, cannot be decoded, ends early, is interlaced, or has no frames
    or a variable frame rate.
    """
    if not path.is_file():
        lacks = "is no regular file" if os.path.exists(path) else "the video is missing"
        raise RigError(f"{path}: {lacks}; put the video back or take its camera out of the calibration")
    _check_whole(path)
    listing = _list_packets(path)
    if not listing.packets:
        raise RigError(f"{path}: the video holds no frames; record or export it again")
    with opened_video(path) as (container, stream):
        first = next(_decoded(path, container, stream), None)
        if first is None:
            raise RigError(f"{path}: no frame of it can be decoded ({stream.codec_context.name}); re-encode the video")
        context = stream.codec_context
        colours = colours_of(int(context.color_trc), int(context.color_primaries))
        # Pictures shown before the first one that a decoder shows: a cut at an open GOP leaves their packets.
        times = None if listing.times is None else listing.times[listing.times >= (first.pts or 0)]
        if times is not None:
            _check_constant_rate(path, times * (1000 * listing.unit))
        fps = _rate(listing.stated_fps, None if times is None else times * listing.unit)
        keyframes = listing.keyframes
        if times is None or listing.in_coded_order:
            times = None
            count, keyframes = _count(path, first)
        else:
            count = times.size
            _look_through(path, container, stream, times, keyframes, first)
        shown = presentation_of(path, first, stream.index)
        at = [] if times is None else np.searchsorted(times, sorted(listing.dropped)).tolist()
        video = replace(shown, frame_count=count, fps=fps, times=times, keyframes=keyframes, dropped=frozenset(at))
        video.picture(first, 0)
        readout = stated_readout(container) * video.turn[3]
    return replace(video, readout=readout, warnings=(_warning(colours),) if colours else ())


def presentation_of(path: Path, first: VideoFrame, track: int = 0) -> VideoSource:
    """How a video's frames are shown, by its first one: size, turn, edges, siting; its frames are not known."""
    turn, edges = _turn(path, first), edges_of_track(path, track, (first.width, first.height))
    width, height = first.width - edges[0] - edges[2], first.height - edges[1] - edges[3]
    if not turn[0]:
        width, height = height, width
    return VideoSource(path, width, height, 0, None, siting=chroma_siting(first), edges=edges, turn=turn)


def _warning(colours: str) -> str:
    return f"coded as {colours}, and taken for sRGB's, so that they come out flat or pale; convert to BT.709 before"


def _check_whole(path: Path) -> None:
    """The top-level boxes of an mp4 or mov file end before the file ends. Source: ISO 14496-12, section 4.2."""
    if path.suffix.lower() not in _BOXED_SUFFIXES:
        return
    try:
        with path.open("rb") as file:
            end, at = path.stat().st_size, 0
            while at <= end - 8:
                file.seek(at)
                size, kind, long_size = struct.unpack(">I4sQ", file.read(16).ljust(16, b"\0"))
                size = end - at if size == 0 else long_size if size == 1 else size
                if (
                    size < 8
                    or (at == 0 and kind not in _FIRST_BOXES)
                    or (size > end - at and kind not in _PICTURE_BOXES)
                ):
                    return  # not made of boxes, or no more: some cameras append notes of their own
                if size > end - at:
                    raise RigError(f"{path}: the video file is truncated; copy it again from its source")
                at += size
    except OSError as error:
        raise _not_opened(path, error.errno, error.strerror) from None


@contextmanager
def opened_video(path: Path) -> Iterator[tuple[InputContainer, VideoStream]]:
    """The container and its track of pictures. Raises RigError."""
    # The path is absolute and local, or "concat:" and "http:" would be FFmpeg's own language.
    only = {"protocol_whitelist": "file", "format_whitelist": ",".join(DEMUXERS)}
    try:
        container = av.open(f"file:{path.absolute()}", container_options=only, **ANY_TEXT)
    except av.FFmpegError as error:
        if error.errno in (errno.EMFILE, errno.ENFILE, errno.EACCES, errno.EPERM):
            raise _not_opened(path, error.errno, error.strerror) from None
        raise _no_video(path) from None
    with container:
        yield container, pictures_of(path, container)


def pictures_of(path: Path, container: InputContainer) -> VideoStream:
    """The track of pictures, ready to be decoded: the largest, else the default one; never a cover. Raises RigError."""
    covers = Disposition.attached_pic | Disposition.timed_thumbnails
    tracks = [track for track in container.streams.video if not track.disposition & covers]
    decodable = [track for track in tracks if track.codec_context is not None]
    if not decodable:
        raise _not_decoded(path, tracks) if tracks else _no_video(path)
    stream = max(
        decodable, key=lambda track: (track.width * track.height, bool(track.disposition & Disposition.default))
    )
    context = stream.codec_context
    if context.width < 1 or context.height < 1 or context.width * context.height > MAX_PIXELS:
        raise RigError(
            f"{path}: frames of {context.width} x {context.height} pixels cannot be read; re-encode the video"
        )
    # A rig has tens of videos, which are read side by side: every further thread would hold another frame.
    context.thread_count = 1
    context.options = {"max_pixels": str(MAX_PIXELS)}
    context.flags |= Flags.unaligned  # or columns that the stream crops would show on the left
    return stream


def _list_packets(path: Path) -> _Listing:
    most = min(path.stat().st_size, _MAX_FRAMES)  # a frame has a byte at least
    with opened_video(path) as (container, stream):
        try:
            packets = []
            is_cut = False
            for packet in container.demux(stream):
                if packet.size and not packet.is_discard:
                    packets.append((packet.pts, packet.dts, packet.is_keyframe))
                    is_cut = packet.is_corrupt
                if len(packets) > most:
                    raise RigError(f"{path}: the video claims more than {most} frames; re-encode the video")
        except av.FFmpegError as error:
            raise _undecodable(path, "its packets", error) from None
        if is_cut:
            raise RigError(f"{path}: the video file is truncated or damaged; copy it again from its source")
        reorders, is_avi = stream.codec_context.has_b_frames, container.format.name == "avi"
        unit, stated = float(stream.time_base or 0), float(stream.average_rate or stream.guessed_rate or 0)
    if any(time is None for time, _, _ in packets):
        return _Listing(None, np.zeros(0, np.int64), len(packets), unit, stated)
    # Without times of presentation FFmpeg fills in those of decoding; in AVI a little later ones, and wrong ones where
    # a chunk holds two frames and another one none (XviD's packed bitstream).
    in_coded_order = reorders and (is_avi or all(shown == decoded for shown, decoded, _ in packets))
    times = np.sort(np.array([time for time, _, _ in packets], np.int64))
    keyframes = np.sort(np.array([time for time, _, is_key in packets if is_key], np.int64))
    usable = times.size == 1 or bool(times.size and np.diff(times).min() > 0)
    dropped = _dropped(times) if usable and is_avi and not in_coded_order else frozenset()
    times = np.sort(np.append(times, np.array(sorted(dropped), np.int64)))
    return _Listing(times if usable else None, keyframes, len(packets), unit, stated, in_coded_order, dropped)


def _dropped(times: NDArray[np.int64]) -> frozenset[int]:
    """The times of frames that the recorder of an AVI dropped: it has an empty chunk for each, and a constant rate.

    None where the ``times`` lie at other distances, or few of the frames are there.
    """
    lasting = np.diff(times)
    usual = int(np.median(lasting)) if lasting.size else 0
    if not usual or (lasting % usual).any() or lasting.sum() >= 2 * usual * times.size:
        return frozenset()
    return frozenset(np.setdiff1d(np.arange(times[0], times[-1], usual), times).tolist())


def _look_through(
    path: Path,
    container: InputContainer,
    stream: VideoStream,
    times: NDArray[np.int64],
    keyframes: NDArray[np.int64],
    first: VideoFrame,
) -> None:
    """Decodes a frame at some keyframes, and all from the last keyframe on where those are few.

    Damage to single frames is left to whoever reads them.
    """
    shown = keyframes[keyframes >= times[0]]
    if not shown.size:
        return
    for begin in shown[:: max(1, shown.size // _KEYFRAMES_SEEN)].tolist():
        if not _seek(container, stream, begin):
            return
        frame = next(_decoded(path, container, stream, passes_errors=True), None)
        if frame is not None and frame.pts is not None:
            _check_kind(path, frame, int(np.searchsorted(times, frame.pts)), (first.width, first.height))
    last = int(shown[-1])
    if (times >= last).sum() * stream.width * stream.height > _PIXELS_SEEN or not _seek(container, stream, last):
        return
    index = None
    for frame in _decoded(path, container, stream, passes_errors=True):
        if frame.pts is None or frame.pts < last:
            continue
        index = int(np.searchsorted(times, frame.pts))
        _check_kind(path, frame, index, (first.width, first.height))
    # A last frame that alone is damaged is left to whoever reads it, too.
    if index is not None and index + 2 < times.size:
        raise _ended(path, index + 1, times.size)


def _count(path: Path, first: VideoFrame) -> tuple[int, NDArray[np.int64]]:
    """Frames of a video whose times do not tell them apart, and the numbers of those that decoding can begin with."""
    count, keyframes = 0, []
    with opened_video(path) as (container, stream):
        for frame in _decoded(path, container, stream):
            _check_kind(path, frame, count, (first.width, first.height))
            if frame.key_frame and not frame.is_corrupt:
                keyframes.append(count)
            count += 1
    return count, np.array(keyframes, np.int64)


def _decoded(
    path: Path, container: InputContainer, stream: VideoStream, *, passes_errors: bool = False
) -> Iterator[VideoFrame]:
    """The frames as they are shown; ``passes_errors``: without those that cannot be decoded."""
    passed = [av.InvalidDataError] if passes_errors else []
    try:
        for packet in container.demux(stream):
            with suppress(*passed):
                yield from packet.decode()
    except av.FFmpegError as error:
        raise _undecodable(path, f"a frame of it ({stream.codec_context.name})", error) from None


def _seek(container: InputContainer, stream: VideoStream, time: int) -> bool:
    """Goes to the keyframe at or before a time; False if the container cannot."""
    try:
        container.seek(time, stream=stream)
    except av.FFmpegError:
        return False
    return True


def _check_kind(path: Path, frame: VideoFrame, index: int, size: tuple[int, int]) -> None:
    """Raises RigError for a frame that is interlaced, or not of this width and height, as coded."""
    if frame.interlaced_frame:
        raise RigError(
            f"{path}: frame {index} is flagged interlaced; deinterlace the video (ffmpeg -vf bwdif), or, where its "
            "pictures are whole, take the flag away (ffmpeg -vf setfield=prog)"
        )
    if (frame.width, frame.height) != size:
        raise RigError(
            f"{path}: frame {index} is {frame.width} x {frame.height} pixels, the video started with {size[0]} x "
            f"{size[1]}; re-encode it to one size"
        )


def _turn(path: Path, frame: VideoFrame) -> tuple[int, int, int, int]:
    """Signs of a, b, c, d of the display matrix: a pixel at (x, y) is shown at (a x + c y, b x + d y).

    Raises RigError for one that is neither quarter turns nor mirrors. Source: ISO 14496-12, section 8.3.2.
    """
    stated: Any = frame.side_data.get(SideData.DISPLAYMATRIX)
    if stated is None:
        return (1, 0, 0, 1)
    a, b, _, c, d, *_ = struct.unpack("=9i", bytes(stated))
    largest = max(abs(a), abs(b), abs(c), abs(d))
    signs = [round(value / largest) if largest else 0 for value in (a, b, c, d)]
    if sorted(map(abs, signs)) != [0, 0, 1, 1] or abs(signs[0]) != abs(signs[3]):
        raise RigError(f"{path}: is shown at an angle that is no quarter turn; re-encode the video as it is shown")
    return (signs[0], signs[1], signs[2], signs[3])


def _turned(picture: NDArray[np.uint8], turn: tuple[int, int, int, int]) -> NDArray[np.uint8]:
    a, b, c, d = turn
    across, down = (a, d) if a else (c, b)
    upright = picture if a else picture.transpose(1, 0, 2)
    return np.ascontiguousarray(upright[::down, ::across])


def _no_video(path: Path) -> RigError:
    return RigError(f"{path}: the file is no video that can be read, or is damaged; re-encode it (H.264 in mp4)")


def _not_decoded(path: Path, tracks: list[VideoStream]) -> RigError:
    names = ", ".join(str(getattr(track, "name", None) or "of an unknown name") for track in tracks)
    return RigError(f"{path}: the codec {names} is not decoded here; re-encode the video (H.264 in mp4)")


def _not_opened(path: Path, number: int | None, reason: str | None) -> RigError:
    remedy = "allow more, by ulimit -n" if number == errno.EMFILE else "fix its rights"
    return RigError(f"{path}: cannot be read ({reason}); {remedy}")


def _undecodable(path: Path, what: str, error: av.FFmpegError) -> RigError:
    return RigError(f"{path}: {what} cannot be decoded ({error.strerror}); re-encode the video")


def _ended(path: Path, index: int, announced: int) -> RigError:
    return RigError(
        f"{path}: the video ends or is damaged at frame {index} although it announces {announced} frames; re-encode "
        f"it, or stop before frame {index}"
    )


def _damaged(path: Path, index: int) -> RigError:
    return RigError(f"{path}: frame {index} is damaged; re-encode the video")


def _missing(path: Path, index: int) -> RigError:
    return RigError(f"{path}: frame {index} is damaged or missing; re-encode the video")


def _check_constant_rate(path: Path, times: FloatArray) -> None:
    """``times`` in milliseconds."""
    if times.size < 3:
        return
    lasting = np.diff(times)
    usual = float(np.median(lasting))
    odd = np.flatnonzero(np.abs(lasting - usual) > _RATE_TOLERANCE * usual)
    if odd.size:
        raise RigError(
            f"{path}: variable frame rate or missing frames (frame {odd[0]} lasts {lasting[odd[0]]:.1f} ms, most "
            f"last {usual:.1f} ms); convert all videos of the rig to one constant rate, e.g. with ffmpeg -fps_mode cfr"
        )


def _rate(stated: float, times: FloatArray | None) -> float | None:
    """Frames per second: as stated, unless the times (in seconds) contradict."""
    stated_is_usable = bool(np.isfinite(stated)) and 0 < stated < 10_000
    if times is None or times.size < 2:
        return float(stated) if stated_is_usable else None
    measured = float((times.size - 1) / (times[-1] - times[0]))
    return float(stated) if stated_is_usable and abs(stated - measured) <= 0.05 * measured else measured
