"""Decodes a range of frames to pictures of a view."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

from decogs.codec.header import StreamHeader
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.frame_ranges import Frames

from .following import DEFAULT_IDLE, GrowingStream, follow_stream
from .frame import DecodedFrame
from .frame_choice import OnWarning, check_output, coming_frames, damage_to, open_chosen
from .free_camera import read_free_cameras
from .limits import DEFAULT_MAX_MEMORY
from .picture_output import open_sink
from .views import camera_of, render_view, scaled_view

if TYPE_CHECKING:
    from .rasterise import Rendering

Colour = tuple[float, float, float]
OnFrame = Callable[[int, int], None]


@dataclass(frozen=True)
class DecodeReport:
    """What was written: the output as given, the view's name, frames, and the pictures' size in pixels."""

    output: Path
    view: str
    frame_count: int
    width: int
    height: int


def decode(
    stream: str | os.PathLike[str] | BinaryIO,
    output: str | os.PathLike[str],
    *,
    view: str | None = None,
    camera: str | os.PathLike[str] | Camera | Sequence[Camera] | None = None,
    frames: Frames = None,
    scale: float = 1.0,
    background: Colour | None = None,
    undistorted: bool = False,
    canonical: bool = False,
    threads: int = 0,
    strict: bool = False,
    max_memory: int = DEFAULT_MAX_MEMORY,
    follow: bool = False,
    idle: float = DEFAULT_IDLE,
    on_frame: OnFrame | None = None,
    on_warning: OnWarning | None = None,
) -> DecodeReport:
    """Writes the pictures of one view of a stream, one per encoded frame.

    ``view`` names a camera of the rig; ``camera`` is a pose file, a Camera, or a list of them with one per frame of the
    stream. ``output`` chooses the kind of file, see ``decogs.decoder.picture_output``. ``frames``:
    consecutive ones, as a slice or a range; None for all. ``background``: display-referred RGB in 0..1, the stream's
    when None. ``undistorted``: without the rig camera's lens distortion. ``canonical``: in the scene's own colours and
    through the calibrated pose, where the stream signals exposure, white balance or shake of the camera; otherwise what
    it recorded. ``strict`` and ``max_memory`` (bytes) are those of ``open_stream``: without ``strict``, damaged frames
    show the last good one.
    ``on_frame(done, all)`` reports progress, ``all`` being 0 while nobody knows, and ``on_warning(text)`` damage.

    ``follow``: each picture as soon as its packet is complete in the file that an encoder is writing as ``stream``
    (``decogs.decoder.following``), until the stream ends or nothing came for ``idle`` seconds; files of single pictures
    then appear one by one. A ``stream`` that is an open file, such as a pipe, is read in that way, too.

    Raises UsageError, StreamError or OSError; nothing is then left under the output's name, but for pictures that
    appeared one by one.
    """
    _check_colour(background)
    check_output(output, stream=stream, camera=camera)
    show = _Show(scale, background, undistorted, threads, canonical, max_memory)
    if follow or not isinstance(stream, (str, os.PathLike)):
        on_damage = damage_to(on_warning)
        with follow_stream(stream, idle=idle, strict=strict, on_damage=on_damage, max_memory=max_memory) as growing:
            views = _views(growing.header, view, camera)
            return _decode_growing(growing, output, views, coming_frames(frames), show, on_frame, on_warning)
    with open_chosen(stream, frames, strict=strict, max_memory=max_memory, on_warning=on_warning) as (opened, chosen):
        views = _views(opened.header, view, camera)
        first = scaled_view(camera_of(opened.header, views[0]), scale)
        with open_sink(output, view=first.name, frames=len(chosen), fps=opened.header.fps) as sink:
            coming = opened.frames(chosen.start, chosen.stop)
            for done, (frame, picture) in enumerate(_pictures(opened.header, coming, views, show), start=1):
                sink.write(frame.index, picture)
                if on_frame is not None:
                    on_frame(done, len(chosen))
    return DecodeReport(Path(output), first.name, len(chosen), first.width, first.height)


@dataclass(frozen=True)
class _Show:
    """How pictures are rendered, whatever they show."""

    scale: float
    background: Colour | None
    undistorted: bool
    threads: int
    canonical: bool
    max_memory: int


def _decode_growing(
    stream: GrowingStream,
    output: str | os.PathLike[str],
    views: Sequence[str | Camera],
    chosen: slice,
    show: _Show,
    on_frame: OnFrame | None,
    on_warning: OnWarning | None,
) -> DecodeReport:
    first, done = scaled_view(camera_of(stream.header, views[0]), show.scale), 0
    with open_sink(output, view=first.name, frames=None, fps=stream.header.fps) as sink:
        coming = islice(stream.frames(), chosen.start, chosen.stop)
        for frame, picture in _pictures(stream.header, coming, views, show):
            sink.write(frame.index, picture)
            done += 1
            if on_frame is not None:
                on_frame(done, 0)
        if not done:
            where = "its first keyframe" if not stream.frame_count else f"frame {stream.frame_count}"
            cut = f"; the stream stops {stream.unfinished_bytes} bytes into {where}" if stream.unfinished_bytes else ""
            raise UsageError(f"{stream.name}: nothing to decode, no such frame came{cut}")
    if on_warning is not None and not stream.ended and (chosen.stop is None or chosen.start + done < chosen.stop):
        on_warning(f"{stream.name}: nothing more came, and no end packet; {done} pictures were written")
    return DecodeReport(Path(output), first.name, done, first.width, first.height)


def _pictures(
    header: StreamHeader, frames: Iterator[DecodedFrame], views: Sequence[str | Camera], show: _Show
) -> Iterator[tuple[DecodedFrame, Rendering]]:
    """Frame by frame what the camera sees; of a fixed camera's picture, only what changed is rendered again."""
    from .played_view import PlayedView

    how = {name: value for name, value in vars(show).items() if name != "canonical"}
    fixed = PlayedView(header, views[0], **vars(show)) if len(views) == 1 else None
    for frame in frames:
        if fixed is not None:
            yield frame, fixed.show(frame)
        else:
            yield frame, render_view(header, frame.splats, _view_of(views, frame.index), **how)


def _view_of(path: Sequence[str | Camera], frame: int) -> str | Camera:
    if frame >= len(path):
        raise UsageError(
            f"the camera path has {len(path)} cameras and none for frame {frame}; "
            "list one per frame of the stream, or a single one for all"
        )
    return path[frame]


def _views(
    header: StreamHeader, view: str | None, camera: str | os.PathLike[str] | Camera | Sequence[Camera] | None
) -> Sequence[str | Camera]:
    """The rig camera's name, the free camera, or the camera path asked for."""
    if (view is None) == (camera is None):
        names = ", ".join(rig_camera.name for rig_camera in header.cameras[:40])
        raise UsageError(f"choose one view: a camera of the rig ({names}), or a free camera from a pose file")
    if view is not None:
        return (view,)
    if isinstance(camera, Camera):
        return (camera,)
    if isinstance(camera, (str, os.PathLike)):
        return read_free_cameras(camera)
    if not camera:
        raise UsageError("the camera path is empty; list one camera per frame")
    return tuple(camera)


def _check_colour(colour: Colour | None) -> None:
    if colour is not None and not (len(colour) == 3 and all(0 <= channel <= 1 for channel in colour)):
        raise UsageError(f"the background {colour} is no colour; give red, green and blue from 0 to 1, such as 1,1,1")
