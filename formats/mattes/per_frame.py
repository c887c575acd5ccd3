"""Mattes of each camera and frame, as the "pictures" of a rig: so they are read in step, side by side and checked.

``masks/cam00/0000.png``: `numbering` says which frame a picture file is of. ``masks/cam00.mp4``: as long as the rig.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Generator, Iterator, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera
from ..errors import RigError
from ..pictures.reading import PICTURE_SUFFIXES, Picture, read_alpha, read_picture
from ..rigs import Rig
from ..rigs.rig import more
from ..rigs.sources import CutSource, FrameSource, PictureSource, list_folder, pictures_in, refuse_unknown_kinds
from ..videos.reading import VIDEO_SUFFIXES, VideoSource, open_video
from .camera_paths import paths_of_cameras
from .numbering import mattes_of_recording, mattes_of_stream

Alpha = NDArray[np.float32]

_INNER = ("pha", "alpha", "masks", "mask", "", "images")
"""Folders, or videos, in which a camera's folder keeps its mattes: ``pha`` is BackgroundMattingV2's, which may have its
foreground and composite beside it."""
_COLOUR_LEVELS, _COLOUR_SHARE = 24, 1e-3
"""A matte has colour if so many of its pixels have channels so many levels apart: video codecs shift grey by a few."""
_OPAQUE = 0.998
"""Half a level of 255 from 1."""


def matte_rig(folder: Path, rig: Rig, names: Collection[str], frames: range) -> Rig:
    """The cameras of ``rig`` that have mattes in ``folder``, with these as their frames: grey pictures.

    ``names``: cameras that must have some. Its warnings say which frames mattes are taken for, where other numbers than
    the pictures' tell. Raises RigError, naming the camera or frame that is missing.
    """
    folders = _folders_of(folder, rig.cameras, names)
    cameras = [camera for camera in rig.cameras if camera.name in folders]
    mattes = [(camera, _opened(folders[camera.name], camera, rig, frames)) for camera in cameras]
    return replace(_with(rig, mattes), warnings=tuple(_renumbered(rig, mattes, frames.start)))


def stream_matte_rig(folder: Path, cameras: Sequence[Camera], first: int, count: int, frames: range) -> Rig:
    """The mattes in ``folder`` of a stream's ``cameras`` and ``count`` frames, those of ``frames`` sure to be there.

    The rig is not known, only that the stream begins at its frame ``first``. Mattes are as many as the stream's frames,
    or count from 0 at the rig's first one. Raises RigError, naming the camera or frame that is missing.
    """
    folders = _folders_of(folder, cameras, [camera.name for camera in cameras])
    sources = tuple(_opened_for_stream(folders[camera.name], camera, first, count, frames) for camera in cameras)
    return Rig(folder, "mattes", tuple(cameras), sources, None, count)


def matte_origin(rig: Rig, name: str, frame: int) -> str:
    """Where the matte of a camera and frame of such a rig comes from, for a message."""
    source = next(source for camera, source in zip(rig.cameras, rig.sources, strict=True) if camera.name == name)
    return str(source.files[frame]) if isinstance(source, PictureSource) else f"{source.path}, frame {frame}"


def alpha_of(matte: Picture) -> Alpha:
    """The matte (H, W) 0..1 of a grey picture."""
    plane = matte[..., 0]
    return np.asarray(plane / np.float32(255) if plane.dtype == np.uint8 else np.clip(plane, 0, 1), np.float32)


def own_alpha_rig(rig: Rig, names: Collection[str], frames: range) -> Rig | None:
    """The cameras of ``rig`` whose pictures have alpha, with this as their frames: grey pictures.

    None where alpha is 1 throughout the ``frames``. Of the first and the last frame every camera is looked at, of those
    between one camera in turn, until one is transparent somewhere: opaque pictures with alpha cost a decoded picture a
    frame. Raises RigError where a first frame is opaque that others are not like, and where one of the cameras
    ``names`` has no alpha.
    """
    sources = {
        camera.name: source
        for camera, source in zip(rig.cameras, rig.sources, strict=True)
        if isinstance(source, PictureSource)
    }
    first, last = frames[0], frames[-1]
    opening = {name: read_alpha(source.files[first]) for name, source in sources.items()}
    ending = {name: _alpha_if_read(source.files[last]) for name, source in sources.items()}
    having = [name for name in sources if opening[name] is not None or ending[name] is not None]
    asked = [name for name in having if name in names]
    if not asked:
        return None
    if not any(_is_clear(opening[name]) for name in asked):
        in_turn = ((frame, _alpha_if_read(sources[asked[frame % len(asked)]].files[frame])) for frame in frames[1:-1])
        at_end = ((last, ending[name]) for name in asked)
        later = next((frame for frame, alpha in chain(at_end, in_turn) if _is_clear(alpha)), None)
        if later is None:
            return None
        raise RigError(
            f"{rig.path}: the pictures are opaque in frame {first} and cut-outs in frame {later}; begin where all are "
            "cut out (`frames`), or do without their alpha (`own_masks`)"
        )
    for name in names:
        if name not in having:
            raise RigError(
                f"{rig.path}: the pictures of camera {name} have no alpha, those of {having[0]} have; give all of them "
                "alpha, or do without (`own_masks`)"
            )
    pairs = zip(rig.cameras, rig.sources, strict=True)
    return _with(rig, [(camera, _OwnAlpha(**vars(source))) for camera, source in pairs if camera.name in having])


def _alpha_if_read(file: Path) -> Alpha | None:
    try:
        return read_alpha(file)
    except RigError:
        return None  # of that frame its camera is lost


def _is_clear(alpha: Alpha | None) -> bool:
    return alpha is not None and float(alpha.min()) < _OPAQUE


def _with(rig: Rig, mattes: Sequence[tuple[Camera, FrameSource]]) -> Rig:
    cameras, sources = zip(*mattes, strict=True)
    return replace(rig, cameras=cameras, sources=sources, warnings=())


class _Mattes(PictureSource):
    """Files of mattes: their alpha where they have one, else what they show."""

    def read_file(self, file: Path) -> Picture:
        """The matte, grey, three times (H, W, 3); 8 bit or float."""
        if file == Path():
            raise RigError(f"{self.path}: no matte of this frame; give one for every frame, such as 0000.png")
        alpha = read_alpha(file)
        matte = read_picture(file) if alpha is None or alpha.min() >= _OPAQUE else _grey(alpha)
        height, width = matte.shape[:2]
        if (width, height) != (self.width, self.height):
            raise RigError(
                f"{file}: {width} x {height} pixels, but the camera's pictures have {self.width} x {self.height}; "
                "write mattes at the size of the pictures"
            )
        return _without_colour(file, matte)


class _OwnAlpha(PictureSource):
    """The alpha of picture files."""

    def read_file(self, file: Path) -> Picture:
        """The alpha, three times (H, W, 3)."""
        alpha = read_alpha(file)
        if alpha is None:
            raise RigError(f"{file}: has no alpha, which this camera's first picture has; write all pictures alike")
        return _grey(alpha)


class _MatteVideo(VideoSource):
    """A video of mattes."""

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """The mattes (H, W, 3) of these frames."""
        for picture in super().read(start, stop, step):
            yield _without_colour(self.path, picture)


def _grey(alpha: Alpha) -> Alpha:
    return np.repeat(alpha[..., None], 3, axis=2)


def _without_colour(path: Path, matte: Picture) -> Picture:
    """The matte, which must be grey: segmentation tools also write pictures with a colour for each object."""
    apart = np.ptp(matte, axis=2) > _COLOUR_LEVELS / (255 if matte.dtype != np.uint8 else 1)
    if apart.mean() > _COLOUR_SHARE:
        raise RigError(f"{path}: is a picture in colour, no matte; write white where the subject is, black elsewhere")
    return matte


def _folders_of(folder: Path, cameras: Sequence[Camera], names: Collection[str]) -> dict[str, Path]:
    """Where each camera's mattes are; those of ``names`` must be there."""
    folders = paths_of_cameras(folder, [camera.name for camera in cameras], names)
    for name in names:
        if name not in folders:
            raise RigError(f"{folder}: no mattes of camera {name}; put them into {name}/ or {name}.mp4")
    return folders


def _opened(matte_path: Path, camera: Camera, rig: Rig, frames: range) -> FrameSource:
    """The mattes of a camera, one for each of the rig's frames, those of ``frames`` sure to be there."""
    files = _mattes_at(matte_path)
    recording, clock = rig.recording(camera.name), rig.timeline.clock(camera.name)
    if isinstance(files, Path):
        video = open_video(files)
        mattes = _MatteVideo(**vars(video))
        if video.frame_count == rig.frame_count:
            return mattes
        if video.frame_count == recording.frame_count:
            return CutSource(mattes, clock.first, clock.step, rig.frame_count)
        raise RigError(
            f"{files}: {video.frame_count} frames, but the rig has {rig.frame_count}; cut both to the same frames"
        )
    numbered = mattes_of_recording(matte_path, files, recording, clock, rig.frame_count, frames)
    return _Mattes(matte_path, numbered, camera.width, camera.height)


def _renumbered(rig: Rig, sources: Sequence[tuple[Camera, FrameSource]], frame: int) -> Iterator[str]:
    """Where the matte of a camera's picture has another number than the picture: what was matched to what."""
    apart = []
    for camera, mattes in sources:
        own = rig.sources[rig.cameras.index(camera)]
        if isinstance(mattes, PictureSource) and isinstance(own, PictureSource):
            matte, picture = mattes.files[frame], own.files[frame]
            if _last_number(matte) != _last_number(picture):
                apart.append((matte, picture))
    if apart:
        matte, picture = apart[0]
        yield f"{matte}{more(apart)}: taken for the matte of {picture.name}, frame {frame}"


def _last_number(file: Path) -> int | None:
    digits = re.findall(r"[0-9]+", file.stem)
    return int(digits[-1]) if digits else None


def _opened_for_stream(matte_path: Path, camera: Camera, first: int, count: int, frames: range) -> FrameSource:
    """The mattes of a camera, one for each of the stream's ``count`` frames, those of ``frames`` sure to be there."""
    files = _mattes_at(matte_path)
    if isinstance(files, Path):
        video = open_video(files)
        if video.frame_count != count and (first or video.frame_count < count):
            raise RigError(f"{files}: {video.frame_count} frames, but the stream has {count}; cut it to these")
        return _MatteVideo(**vars(video))
    return _Mattes(matte_path, mattes_of_stream(matte_path, files, first, count, frames), camera.width, camera.height)


def _mattes_at(matte_path: Path) -> Path | tuple[Path, ...]:
    """The pictures of a camera's mattes, or the video that has them. Raises RigError where there are neither."""
    if not matte_path.is_dir():
        return (matte_path,) if matte_path.suffix.lower() in PICTURE_SUFFIXES else matte_path
    videos = [entry for entry in list_folder(matte_path) if entry.suffix.lower() in VIDEO_SUFFIXES and entry.is_file()]
    for name in _INNER:
        if pictures := pictures_in(matte_path / name):
            return pictures
        for video in videos:
            if video.stem.lower() == name:
                return video
    if len(videos) == 1:
        return videos[0]
    refuse_unknown_kinds([matte_path, *(matte_path / name for name in _INNER)])
    content = (
        f"videos, of which none is called pha.mp4 ({', '.join(v.name for v in videos)})" if videos else "no mattes"
    )
    raise RigError(f"{matte_path}: {content}; give a matte for every frame, such as 0000.png")
