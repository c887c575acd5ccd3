"""Decodes a range of frames to pictures of a view."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Literal, Union, get_args

from decogs.codec.header.header import StreamHeader
from decogs.formats.cameras import Camera
from decogs.formats.colours.srgb import Colour
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.files.outputs import Output, check_outputs, files_read
from decogs.formats.frames.ranges import Frames
from decogs.formats.geometry.length_units import metres_of
from decogs.formats.splats import FloatArray
from decogs.formats.system.callbacks import OnProgress, OnWarning

from .cameras.files import camera_file, read_camera_file
from .cameras.moves import Move, camera_move
from .cameras.path import DEFAULT_FPS, CameraPath, ToFilm, shown_frames
from .frame_choice import chosen_frames, chosen_pictures, coming_frames, damage_to, frames_in_any_order, open_chosen
from .limits import DEFAULT_MAX_MEMORY
from .output.pictures import PictureSink, holds_sound, open_sink
from .output.video import VideoSettings
from .reading.following import DEFAULT_IDLE, GrowingStream, follow_stream
from .reading.refining import BASE
from .reading.stream import Stream
from .rendering.compositing import Ids, static_ids
from .rendering.layouts import Layout
from .rendering.shots import Shot, Show, asked_for, picture_camera, pictures, shots_by_frame, with_layers
from .sound.samples import mixed_sound

if TYPE_CHECKING:
    from .subject.subject import AnyStream

Cameras = Union[str, "os.PathLike[str]", Camera, Sequence[Camera], CameraPath]
"""A file of cameras, one camera for every frame, one per frame, or a path."""
Unseen = Literal["drawn", "transparent"]
"""What becomes of places that no camera saw."""


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
    output: str | os.PathLike[str] | BinaryIO,
    *,
    view: str | None = None,
    camera: Cameras | None = None,
    move: Move | None = None,
    frames: Frames = None,
    scale: float = 1.0,
    background: Colour | None = None,
    subject: str | os.PathLike[str] | None = None,
    undistorted: bool = False,
    drift_free: bool = False,
    unseen: Unseen = "drawn",
    threads: int = 0,
    strict: bool = False,
    max_memory: int = DEFAULT_MAX_MEMORY,
    layer: str | int | None = None,
    follow: bool = False,
    idle: float = DEFAULT_IDLE,
    layout: Layout | None = None,
    video: VideoSettings = VideoSettings(),  # noqa: B008 (frozen)
    on_frame: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> DecodeReport:
    """Writes the pictures of one view of a stream, one per encoded frame, or one per entry of a path with times.

    ``view`` names a camera of the rig; ``camera`` is a file of cameras, a Camera, a list of them with one per frame of
    the stream, or a CameraPath; ``move`` is one made from the rig, "orbit" or "spiral". ``output`` chooses the kind of
    file, see ``decogs.decoder.output.pictures``. ``frames``: those of the stream, or the pictures of a path with times;
    consecutive ones, as a slice or a range; None for all. ``background``: display-referred RGB in 0..1, the stream's
    when None; of a subject, an output that can hold it then gets the alpha and no background.
    ``subject``: a folder of mattes; only Gaussians in their hull are shown (``decogs.decoder.subject.subject``).
    ``undistorted``: without the rig camera's lens distortion. ``drift_free``: in the scene's own colours and
    through the calibrated pose, where the stream signals exposure, white balance or shake of the camera; otherwise what
    it recorded. ``unseen``: "transparent" leaves out what no camera that was trained on has seen: by alpha, where the
    output can hold it and no ``background`` is given. ``strict``, ``max_memory`` (bytes) and ``layer`` are those of
    ``open_stream``: without ``strict``, damaged frames show the last good one. ``layout``: a picture of several
    renderings (``rendering.layouts``).
    ``video`` says how a video is encoded, and what is heard instead of the stream's own sound. An ``output`` that is an
    open file takes uncompressed video. ``on_frame(done, all)`` reports progress, ``all`` 0 while nobody knows, and
    ``on_warning(text)`` damage and a video that is not as good as it could be.

    ``follow``: each picture as soon as its packet is complete in the file that an encoder is writing as ``stream``
    (``reading.following``), until the stream ends or nothing came for ``idle`` seconds; files of single pictures
    then appear one by one. A ``stream`` that is an open file, such as a pipe, is read in that way, too.

    Raises UsageError, StreamError or OSError; nothing is then left under the output's name, but for pictures that
    appeared one by one.
    """
    _check_colour(background)
    named = camera_file(camera)[0] if isinstance(camera, (str, os.PathLike)) else None
    read = files_read(stream=stream, camera=named, audio=video.audio)
    check_outputs([Output("output", Path(output) if isinstance(output, (str, os.PathLike)) else output)], read)
    show = Show(
        scale, background, undistorted, threads, drift_free, max_memory, layout, shows_unseen=unseen != "transparent"
    )
    if unseen not in get_args(Unseen):
        raise UsageError(f"`unseen` {unseen}: is one of {', '.join(get_args(Unseen))}")
    if layout is not None:
        layout.check()
        if not show.shows_unseen:
            raise UsageError("`unseen`: stereo and 360 degree pictures show all; leave one of both out")
    if follow or not isinstance(stream, (str, os.PathLike)):
        if subject is not None:
            raise UsageError("`subject` needs the whole stream; decode its file when it is complete")
        if layer not in (None, BASE):
            raise UsageError(f"`layer` {layer}: layers come behind their frames; decode the file when it is complete")
        on_damage = damage_to(on_warning)
        with follow_stream(stream, idle=idle, strict=strict, on_damage=on_damage, max_memory=max_memory) as growing:
            if growing.header.layers and layer is None and on_warning is not None:
                on_warning(f"{growing.name}: the base alone is shown; its layers come behind their frames")
            wanted = _wanted(growing.header, view, camera, move, None, max_memory)
            return _decode_growing(
                growing,
                output,
                wanted,
                coming_frames(frames),
                show=show,
                video=video,
                read=read,
                on_frame=on_frame,
                on_warning=on_warning,
            )
    chosen_stream = open_chosen(stream, None, strict=strict, max_memory=max_memory, on_warning=on_warning, layer=layer)
    with chosen_stream as (opened, every):
        wanted = _wanted(opened.header, view, camera, move, opened.frame_count, max_memory)
        shown: AnyStream = opened
        if subject is not None:
            from .subject.subject import SubjectOfStream

            shown = SubjectOfStream(opened, Path(subject), every, on_warning)
            read += shown.files_read()
        chosen, shots = _chosen_shots(shown, wanted, frames)
        first = picture_camera(shown.header, wanted, show)
        fps = _rate(shown.header, wanted)
        cut_out = _is_cut_out(shown.header, show)
        with open_sink(
            output,
            view=first.name,
            frames=len(chosen),
            fps=fps,
            video=video,
            cut_out=cut_out,
            sound=_sound(opened, video, wanted, chosen, on_warning) if holds_sound(output) else None,
        ) as sink:
            _check_files(sink, chosen, read)
            static = _static(shown, on_warning) if sink.has_layers else None
            taken = _taken(shown.header, shots(sink.has_layers), wanted, show, sink, static)
            for done, _ in enumerate(taken, start=1):
                if on_frame is not None:
                    on_frame(done, len(chosen))
    return DecodeReport(_path(output), first.name, len(chosen), first.width, first.height)


def _decode_growing(
    stream: GrowingStream,
    output: str | os.PathLike[str] | BinaryIO,
    wanted: str | CameraPath,
    chosen: slice,
    *,
    show: Show,
    video: VideoSettings,
    read: list[tuple[Path, str]],
    on_frame: OnProgress | None,
    on_warning: OnWarning | None,
) -> DecodeReport:
    if isinstance(wanted, CameraPath) and wanted.times is not None:
        raise UsageError(
            f"{wanted.source}: has times of its own, which need the whole stream; decode its file when done"
        )
    first, done = picture_camera(stream.header, wanted, show), 0
    fps = _rate(stream.header, wanted)
    cut_out = _is_cut_out(stream.header, show)
    sound = _sound(stream, video, wanted, chosen, on_warning) if holds_sound(output) else None
    with open_sink(output, view=first.name, frames=None, fps=fps, video=video, cut_out=cut_out, sound=sound) as sink:
        shots = shots_by_frame(islice(stream.frames(), chosen.start, chosen.stop), wanted)
        coming = _unread(shots, sink, read)
        for _ in _taken(stream.header, coming, wanted, show, sink, None):
            done += 1
            if on_frame is not None:
                on_frame(done, 0)
        if not done:
            where = "its first keyframe" if not stream.frame_count else f"frame {stream.frame_count}"
            cut = f"; the stream stops {stream.unfinished_bytes} bytes into {where}" if stream.unfinished_bytes else ""
            raise UsageError(f"{stream.name}: nothing to decode, no such frame came{cut}")
    if on_warning is not None and not stream.ended and (chosen.stop is None or chosen.start + done < chosen.stop):
        on_warning(f"{stream.name}: nothing more came, and no end packet; {done} pictures were written")
    return DecodeReport(_path(output), first.name, done, first.width, first.height)


def _sound(
    stream: Stream | GrowingStream,
    video: VideoSettings,
    wanted: str | CameraPath,
    chosen: range | slice,
    on_warning: OnWarning | None,
) -> Iterator[FloatArray] | None:
    """What is heard with the pictures: a file, or the stream's own sound where pictures play at its rate."""
    header = stream.header
    if video.audio is not None:
        from decogs.formats.sound.tracks import read_samples

        return read_samples(video.audio, 2, begin=chosen.start / (_rate(header, wanted) or DEFAULT_FPS))
    if video.silent or not header.sound or header.fps is None:
        return None
    if isinstance(stream, GrowingStream):
        return stream.heard(chosen.start) if _rate(header, wanted) == header.fps else None
    shown = _shown_on(stream, wanted, range(chosen.start, chosen.stop))
    if shown is None:
        if on_warning is not None:
            on_warning(
                f"{stream.path}: its sound is left out, since pictures do not show its frames one after the other"
            )
        return None
    return mixed_sound(stream, shown)


def _shown_on(stream: Stream, wanted: str | CameraPath, chosen: range) -> range | None:
    """The frames that the chosen pictures show, where they do at the stream's rate and one after the other."""
    if isinstance(wanted, str):
        return chosen
    if _rate(stream.header, wanted) != stream.header.fps:
        return None
    if wanted.times is None:
        return chosen
    shown = shown_frames(wanted, stream.frame_count)[chosen.start : chosen.stop]
    frames = range(shown[0], shown[0] + len(shown))
    return frames if shown == list(frames) else None


def _chosen_shots(
    stream: AnyStream, wanted: str | CameraPath, frames: Frames
) -> tuple[range, Callable[[bool], Iterator[Shot]]]:
    """The numbers of the pictures asked for, and those to be taken: with a neighbour on each side, or without."""
    if isinstance(wanted, CameraPath) and wanted.times is not None:
        path, shown = wanted, shown_frames(wanted, stream.frame_count)
        chosen = chosen_pictures(path.source, len(shown), frames)

        def by_entry(neighbours: bool) -> Iterator[Shot]:
            numbers = _widened(chosen, len(shown)) if neighbours else chosen
            coming = frames_in_any_order(stream, (shown[number] for number in numbers))
            return (Shot(number, frame, path.cameras[number]) for number, frame in zip(numbers, coming, strict=True))

        return chosen, lambda neighbours: asked_for(by_entry(neighbours), chosen)
    chosen = chosen_frames(stream, frames)

    def by_frame(neighbours: bool) -> Iterator[Shot]:
        numbers = _widened(chosen, min(stream.frame_count, _cameras_for(wanted))) if neighbours else chosen
        return shots_by_frame(stream.frames(numbers.start, numbers.stop), wanted)

    return chosen, lambda neighbours: asked_for(by_frame(neighbours), chosen)


def _static(stream: AnyStream, on_warning: OnWarning | None) -> Ids | None:
    """Ids of what never changes; None, with a warning, where damage that is an error hides it."""
    try:
        return static_ids(stream.frames())
    except StreamError as error:
        if on_warning is not None:
            on_warning(f"dynamic.A is left out, which needs every frame: {error}")
        return None


def _widened(chosen: range, count: int) -> range:
    return range(max(0, chosen.start - 1), max(chosen.stop, min(count, chosen.stop + 1)))


def _cameras_for(wanted: str | CameraPath) -> int:
    """How many frames have a camera."""
    if isinstance(wanted, str) or len(wanted.cameras) == 1:
        return sys.maxsize
    return len(wanted.cameras)


def _taken(
    header: StreamHeader,
    shots: Iterator[Shot],
    wanted: str | CameraPath,
    show: Show,
    sink: PictureSink,
    static: Ids | None,
) -> Iterator[Shot]:
    """Writes the picture of every shot asked for, with its layers where the output holds some."""
    if sink.has_layers and show.layout is not None:
        raise UsageError("a stereo or 360 degree picture is no EXR; write PNG or a video")
    if sink.has_layers and header.subject and not sink.has_alpha:
        raise UsageError("an EXR of a subject has no background; leave out `background`, or write PNG")
    if sink.has_alpha:
        show = show.as_cut_out(header)
    if sink.has_layers:
        for shot, picture, layers in with_layers(header, shots, wanted, show, static):
            sink.write(shot.number, picture, layers)
            yield shot
    else:
        for shot, picture in pictures(header, shots, wanted, show):
            sink.write(shot.number, picture)
            yield shot


def _is_cut_out(header: StreamHeader, show: Show) -> bool:
    """Whether the pictures have nothing behind them: those of a subject, or without what nobody saw."""
    return (header.subject or not show.shows_unseen) and show.background is None


def _check_files(sink: PictureSink, numbers: Iterable[int], read: list[tuple[Path, str]]) -> None:
    """Raises UsageError where the picture of one of these numbers would be written over what is read."""
    if sink.file_of is not None:
        check_outputs([Output("output", sink.file_of(number)) for number in numbers], read)


def _unread(shots: Iterator[Shot], sink: PictureSink, read: list[tuple[Path, str]]) -> Iterator[Shot]:
    """The shots as they come, each checked by `_check_files`."""
    for shot in shots:
        _check_files(sink, [shot.number], read)
        yield shot


def _path(output: str | os.PathLike[str] | BinaryIO) -> Path:
    return Path(output) if isinstance(output, (str, os.PathLike)) else Path("-")


def _rate(header: StreamHeader, wanted: str | CameraPath) -> float | None:
    """Pictures per second: the path's own, or the stream's frames."""
    return header.fps if isinstance(wanted, str) or wanted.fps is None else wanted.fps


def _wanted(
    header: StreamHeader,
    view: str | None,
    camera: Cameras | None,
    move: Move | None,
    frame_count: int | None,
    max_memory: int,
) -> str | CameraPath:
    """The rig camera's name, or the free camera or camera path asked for."""
    if [view, camera, move].count(None) != 2:
        names = ", ".join(rig_camera.name for rig_camera in header.cameras[:40])
        raise UsageError(f"choose one view: a camera of the rig ({names}), or a free camera from a pose file")
    film = ToFilm(header.cameras, header.fps, frame_count, metres_of(header.units) or 1.0)
    if view is not None:
        return view
    if move is not None:
        return camera_move(move, film)
    if isinstance(camera, CameraPath):
        return camera
    if isinstance(camera, Camera):
        return CameraPath((camera,))
    if isinstance(camera, (str, os.PathLike)):
        return read_camera_file(camera, film, max_memory)
    if not camera:
        raise UsageError("the camera path is empty; list one camera per frame")
    return CameraPath(tuple(camera))


def _check_colour(colour: Colour | None) -> None:
    if colour is not None and not (len(colour) == 3 and all(0 <= channel <= 1 for channel in colour)):
        raise UsageError(f"the background {colour} is no colour; give red, green and blue from 0 to 1, such as 1,1,1")
