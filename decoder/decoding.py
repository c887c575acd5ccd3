"""Decodes a range of frames to pictures of a view."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Union

from decogs.codec.header import StreamHeader
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.frame_ranges import Frames

from .camera_path import CameraPath, camera_of_frame, shown_frames
from .following import DEFAULT_IDLE, GrowingStream, follow_stream
from .frame import DecodedFrame
from .frame_choice import (
    OnWarning,
    check_output,
    chosen_frames,
    chosen_pictures,
    coming_frames,
    damage_to,
    frames_in_any_order,
    open_chosen,
)
from .free_camera import read_free_cameras
from .limits import DEFAULT_MAX_MEMORY
from .picture_output import open_sink
from .stream import Stream
from .views import camera_of, render_view, scaled_view

if TYPE_CHECKING:
    from .rasterise import Rendering

Cameras = Union[str, "os.PathLike[str]", Camera, Sequence[Camera], CameraPath]
"""A file of cameras, one camera for every frame, one per frame, or a path."""

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
    camera: Cameras | None = None,
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
    """Writes the pictures of one view of a stream, one per encoded frame, or one per entry of a path with times.

    ``view`` names a camera of the rig; ``camera`` is a file of cameras, a Camera, a list of them with one per frame of
    the stream, or a CameraPath. ``output`` chooses the kind of file, see ``decogs.decoder.picture_output``. ``frames``:
    those of the stream, or the pictures of a path with times; consecutive ones, as a slice or a range; None for all.
    ``background``: display-referred RGB in 0..1, the stream's when None.
    ``undistorted``: without the rig camera's lens distortion. ``canonical``: in the scene's own colours and
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
            wanted = _wanted(growing.header, view, camera)
            return _decode_growing(growing, output, wanted, coming_frames(frames), show, on_frame, on_warning)
    with open_chosen(stream, None, strict=strict, max_memory=max_memory, on_warning=on_warning) as (opened, _):
        wanted = _wanted(opened.header, view, camera)
        chosen, shots = _chosen_shots(opened, wanted, frames)
        first = scaled_view(camera_of(opened.header, _first_view(wanted)), scale)
        with open_sink(output, view=first.name, frames=len(chosen), fps=_rate(opened.header, wanted)) as sink:
            for done, (shot, picture) in enumerate(_pictures(opened.header, shots, wanted, show), start=1):
                sink.write(shot.number, picture)
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


@dataclass(frozen=True)
class _Shot:
    """One picture to be taken: its number in the output, the frame it shows, and the view it shows it from."""

    number: int
    frame: DecodedFrame
    view: str | Camera


def _decode_growing(
    stream: GrowingStream,
    output: str | os.PathLike[str],
    wanted: str | CameraPath,
    chosen: slice,
    show: _Show,
    on_frame: OnFrame | None,
    on_warning: OnWarning | None,
) -> DecodeReport:
    if isinstance(wanted, CameraPath) and wanted.times is not None:
        raise UsageError(
            f"{wanted.source}: has times of its own, which need the whole stream; decode its file when done"
        )
    first, done = scaled_view(camera_of(stream.header, _first_view(wanted)), show.scale), 0
    with open_sink(output, view=first.name, frames=None, fps=_rate(stream.header, wanted)) as sink:
        shots = _shots_by_frame(islice(stream.frames(), chosen.start, chosen.stop), wanted)
        for shot, picture in _pictures(stream.header, shots, wanted, show):
            sink.write(shot.number, picture)
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


def _chosen_shots(stream: Stream, wanted: str | CameraPath, frames: Frames) -> tuple[range, Iterator[_Shot]]:
    """The numbers of the pictures asked for, and the pictures to be taken."""
    if isinstance(wanted, CameraPath) and wanted.times is not None:
        shown = shown_frames(wanted, stream.frame_count)
        chosen = chosen_pictures(wanted.source, len(shown), frames)
        coming = frames_in_any_order(stream, (shown[number] for number in chosen))
        return chosen, (
            _Shot(number, frame, wanted.cameras[number]) for number, frame in zip(chosen, coming, strict=True)
        )
    chosen = chosen_frames(stream, frames)
    return chosen, _shots_by_frame(stream.frames(chosen.start, chosen.stop), wanted)


def _shots_by_frame(frames: Iterator[DecodedFrame], wanted: str | CameraPath) -> Iterator[_Shot]:
    """One picture of every frame, which gives it its number."""
    for frame in frames:
        if isinstance(wanted, CameraPath) and len(wanted.cameras) > 1:
            yield _Shot(frame.index, frame, camera_of_frame(wanted.cameras, frame.index))
        else:
            yield _Shot(frame.index, frame, _first_view(wanted))


def _pictures(
    header: StreamHeader, shots: Iterator[_Shot], wanted: str | CameraPath, show: _Show
) -> Iterator[tuple[_Shot, Rendering]]:
    """Shot by shot what the camera sees; of a fixed camera's picture, only what changed is rendered again."""
    from .played_view import PlayedView

    how = {name: value for name, value in vars(show).items() if name != "canonical"}
    is_fixed = isinstance(wanted, str) or len(wanted.cameras) == 1
    fixed = PlayedView(header, _first_view(wanted), **vars(show)) if is_fixed else None
    for shot in shots:
        if fixed is not None:
            yield shot, fixed.show(shot.frame)
        else:
            yield shot, render_view(header, shot.frame.splats, shot.view, **how)


def _first_view(wanted: str | CameraPath) -> str | Camera:
    return wanted if isinstance(wanted, str) else wanted.cameras[0]


def _rate(header: StreamHeader, wanted: str | CameraPath) -> float | None:
    """Pictures per second: the path's own, or the stream's frames."""
    return header.fps if isinstance(wanted, str) or wanted.fps is None else wanted.fps


def _wanted(
    header: StreamHeader,
    view: str | None,
    camera: str | os.PathLike[str] | Camera | Sequence[Camera] | CameraPath | None,
) -> str | CameraPath:
    """The rig camera's name, or the free camera or camera path asked for."""
    if (view is None) == (camera is None):
        names = ", ".join(rig_camera.name for rig_camera in header.cameras[:40])
        raise UsageError(f"choose one view: a camera of the rig ({names}), or a free camera from a pose file")
    if view is not None:
        return view
    if isinstance(camera, CameraPath):
        return camera
    if isinstance(camera, Camera):
        return CameraPath((camera,))
    if isinstance(camera, (str, os.PathLike)):
        return read_free_cameras(camera)
    if not camera:
        raise UsageError("the camera path is empty; list one camera per frame")
    return CameraPath(tuple(camera))


def _check_colour(colour: Colour | None) -> None:
    if colour is not None and not (len(colour) == 3 and all(0 <= channel <= 1 for channel in colour)):
        raise UsageError(f"the background {colour} is no colour; give red, green and blue from 0 to 1, such as 1,1,1")
