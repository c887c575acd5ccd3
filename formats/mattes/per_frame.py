"""Mattes of each camera and frame, as the "pictures" of a rig: so they are read in step, side by side and checked.

``masks/cam00/0000.png``: picture files carry the numbers that the rig's own pictures have, or count from 0 at the first
frame; as many as frames are taken in order, whatever their numbers. ``masks/cam00.mp4``: as long as the rig.
"""

from __future__ import annotations

from collections.abc import Collection, Generator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera
from ..errors import RigError
from ..pictures import PICTURE_SUFFIXES, Picture, read_alpha, read_picture
from ..rigs import Rig
from ..rigs.sources import CutSource, FrameSource, PictureSource, list_folder, pictures_in, refuse_unknown_kinds
from ..videos import VIDEO_SUFFIXES, VideoSource, open_video
from .places import places_of_cameras

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

    ``names``: cameras that must have some. Raises RigError, naming the camera or frame that is missing.
    """
    places = _places(folder, rig.cameras, names)
    found = [
        (camera, _opened(places[camera.name], camera, source, rig.frame_count, frames))
        for camera, source in zip(rig.cameras, rig.sources, strict=True)
        if camera.name in places
    ]
    return _with(rig, found)


def stream_matte_rig(folder: Path, cameras: Sequence[Camera], first: int, count: int, frames: range) -> Rig:
    """The mattes in ``folder`` of a stream's ``cameras`` and ``count`` frames, those of ``frames`` sure to be there.

    The rig is not known, only that the stream begins at its frame ``first``. Mattes are as many as the stream's frames,
    or count from 0 at the rig's first one. Raises RigError, naming the camera or frame that is missing.
    """
    places = _places(folder, cameras, [camera.name for camera in cameras])
    sources = tuple(_opened_for_stream(places[camera.name], camera, first, count, frames) for camera in cameras)
    return Rig(folder, "mattes", tuple(cameras), sources, None, count)


def matte_place(rig: Rig, name: str, frame: int) -> str:
    """Where the matte of a camera and frame of such a rig comes from, for a message."""
    source = next(source for camera, source in zip(rig.cameras, rig.sources, strict=True) if camera.name == name)
    return str(source.files[frame]) if isinstance(source, PictureSource) else f"{source.path}, frame {frame}"


def alpha_of(matte: Picture) -> Alpha:
    """The matte (H, W) 0..1 of a grey picture."""
    plane = matte[..., 0]
    return np.asarray(plane / np.float32(255) if plane.dtype == np.uint8 else np.clip(plane, 0, 1), np.float32)


def own_alpha_rig(rig: Rig, names: Collection[str], frame: int) -> Rig | None:
    """The cameras of ``rig`` whose pictures have alpha, with this as their frames: grey pictures.

    None where alpha is 1 throughout the ``frame``. Raises RigError where one of the cameras ``names`` has none.
    """
    found, is_clear = list[tuple[Camera, FrameSource]](), False
    for camera, source in zip(rig.cameras, rig.sources, strict=True):
        alpha = read_alpha(source.files[frame]) if isinstance(source, PictureSource) else None
        if alpha is not None:
            found.append((camera, _OwnAlpha(**vars(source))))
            is_clear |= camera.name in names and float(alpha.min()) < _OPAQUE
    if not is_clear:
        return None
    having = [camera.name for camera, _ in found]
    for name in names:
        if name not in having:
            raise RigError(
                f"{rig.path}: the pictures of camera {name} have no alpha, those of {having[0]} have; give all of them "
                "alpha, or do without (`own_masks`)"
            )
    return _with(rig, found)


def _with(rig: Rig, found: Sequence[tuple[Camera, FrameSource]]) -> Rig:
    cameras, sources = zip(*found, strict=True)
    return replace(rig, cameras=cameras, sources=sources)


class _Mattes(PictureSource):
    """Files of mattes: their alpha where they have one, else what they show."""

    def read_file(self, file: Path) -> Picture:
        """The matte, grey, three times (H, W, 3); 8 bit or float."""
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


def _places(folder: Path, cameras: Sequence[Camera], names: Collection[str]) -> dict[str, Path]:
    """Where each camera's mattes are; those of ``names`` must be there."""
    places = places_of_cameras(folder, [camera.name for camera in cameras], names)
    for name in names:
        if name not in places:
            raise RigError(f"{folder}: no mattes of camera {name}; put them into {name}/ or {name}.mp4")
    return places


def _opened(place: Path, camera: Camera, source: FrameSource, count: int, frames: range) -> FrameSource:
    """The mattes of a camera, one for each of the rig's ``count`` frames, those of ``frames`` sure to be there."""
    found = _mattes_at(place)
    if isinstance(found, Path):
        video = open_video(found)
        mattes = _MatteVideo(**vars(video))
        if isinstance(source, CutSource) and video.frame_count == source.source.frame_count:
            return replace(source, source=mattes)
        if video.frame_count != count:
            raise RigError(f"{found}: {video.frame_count} frames, but the rig has {count}; cut both to the same frames")
        return mattes
    return _checked(place, camera, _by_frame(found, source, count), frames)


def _opened_for_stream(place: Path, camera: Camera, first: int, count: int, frames: range) -> FrameSource:
    """The mattes of a camera, one for each of the stream's ``count`` frames, those of ``frames`` sure to be there."""
    files = _mattes_at(place)
    if isinstance(files, Path):
        video = open_video(files)
        if video.frame_count != count and (first or video.frame_count < count):
            raise RigError(f"{files}: {video.frame_count} frames, but the stream has {count}; cut it to these")
        return _MatteVideo(**vars(video))
    if len(files) != count:
        named = dict(zip(PictureSource(Path(), files, 0, 0).frame_numbers() or (), files, strict=False))
        if first and files and (0,) not in named:
            raise RigError(
                f"{place}: {len(files)} mattes, but the stream has {count} frames, from the rig's frame {first} on; "
                "give as many, or count them from 0 at the rig's first frame"
            )
        files = tuple(named.get((first + index,), Path()) for index in range(count))
    return _checked(place, camera, files, frames)


def _checked(place: Path, camera: Camera, files: tuple[Path, ...], frames: range) -> _Mattes:
    for frame in frames:
        if not files[frame].is_file():
            raise RigError(f"{place}: no matte of frame {frame}; give one for every frame, such as 0000.png")
    return _Mattes(place, files, camera.width, camera.height)


def _mattes_at(place: Path) -> Path | tuple[Path, ...]:
    """The pictures of a camera's mattes, or the video that has them. Raises RigError where there are neither."""
    if not place.is_dir():
        return (place,) if place.suffix.lower() in PICTURE_SUFFIXES else place
    videos = [entry for entry in list_folder(place) if entry.suffix.lower() in VIDEO_SUFFIXES and entry.is_file()]
    for name in _INNER:
        if pictures := pictures_in(place / name):
            return pictures
        for video in videos:
            if video.stem.lower() == name:
                return video
    if len(videos) == 1:
        return videos[0]
    refuse_unknown_kinds([place, *(place / name for name in _INNER)])
    there = f"videos, of which none is called pha.mp4 ({', '.join(v.name for v in videos)})" if videos else "no mattes"
    raise RigError(f"{place}: {there}; give a matte for every frame, such as 0000.png")


def _by_frame(files: tuple[Path, ...], source: FrameSource, count: int) -> tuple[Path, ...]:
    """The files in the order of the rig's frames; a path that is no file where there is none."""
    if isinstance(source, CutSource) and len(files) == source.source.frame_count:
        return files[source.first :: source.step][:count]
    numbers = PictureSource(Path(), files, 0, 0).frame_numbers()
    of_rig = source.frame_numbers() if isinstance(source, PictureSource) else None
    if len(files) == count and (numbers is None or of_rig is None or set(numbers) != set(of_rig)):
        return files
    if of_rig is None or numbers is None or not set(numbers) & set(of_rig):
        of_rig = [(index,) for index in range(count)]
    named = dict(zip(numbers or (), files, strict=False))
    return tuple(named.get(number, Path()) for number in of_rig)
