"""Where the frames of one camera come from: a video, a folder of pictures, or a single picture."""

from __future__ import annotations

import re
from collections.abc import Generator, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ..errors import RigError
from ..files.unicode_forms import composed
from ..pictures.reading import PICTURE_KINDS, PICTURE_SUFFIXES, Picture, picture_facts, read_picture
from ..videos.chapters import continues_another, files_of_video, open_recording
from ..videos.reading import VIDEO_SUFFIXES, VideoSource

GENERIC_FOLDERS = frozenset({"images", "frames", "videos", "rgb", "input"})
"""Folder names that hold pictures but name no camera."""

_OF_SYSTEMS = frozenset({"@eadir", "#recycle", "$recycle.bin", "__macosx", "lost+found", "thumbs.db", "desktop.ini"})
"""What file servers, archives and systems put beside a user's files; names that begin with a dot are such, too."""

_TURNED = {
    5: lambda picture: picture.transpose(1, 0, 2),
    6: lambda picture: np.rot90(picture, -1),
    7: lambda picture: np.rot90(picture, 2).transpose(1, 0, 2),
    8: lambda picture: np.rot90(picture),
}
"""EXIF orientations that exchange width and height: the stored picture, turned as it is to be shown."""


class FrameSource(Protocol):
    """The frames of one camera, read lazily and strictly in sequence. Sizes in pixels; fps None if unknown."""

    @property
    def path(self) -> Path:
        """The video, or the folder of pictures."""
        ...

    @property
    def width(self) -> int:
        """Of every frame, in pixels."""
        ...

    @property
    def height(self) -> int:
        """Of every frame, in pixels."""
        ...

    @property
    def frame_count(self) -> int:
        """How many frames there are."""
        ...

    @property
    def fps(self) -> float | None:
        """Frames per second; None when it is unknown."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """What it says of itself that is no error, but shows in the colours; a line each, without the path."""
        ...

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """Every step-th frame from start (inclusive) to stop (exclusive). Raises RigError naming file and frame."""
        ...

    def readable_after(self, index: int) -> int:
        """The first frame after ``index`` from which reading can go on where that one cannot be had."""
        ...


@dataclass(frozen=True)
class PictureSource:
    """The frames of one camera as picture files, one per frame, in order; ``path`` is the folder or the one file.

    ``orientation`` is what the first one's EXIF data say; pixels are turned by it only if ``is_turned``.
    """

    path: Path
    files: tuple[Path, ...]
    width: int
    height: int
    orientation: int = 1
    warnings: tuple[str, ...] = ()
    is_turned: bool = False

    @property
    def frame_count(self) -> int:
        """Number of pictures."""
        return len(self.files)

    @property
    def fps(self) -> float | None:
        """None: files state no rate."""
        return None

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """The pictures of these frames. Raises RigError for one that is damaged or of another size."""
        for file in self.files[start:stop:step]:
            picture = self.read_file(file)
            if self.is_turned:
                picture = np.ascontiguousarray(_TURNED[self.orientation](picture))
            if picture.shape != (self.height, self.width, 3):
                raise RigError(
                    f"{file}: {picture.shape[1]} x {picture.shape[0]} pixels, but this camera's first frame has "
                    f"{self.width} x {self.height}; bring all its frames to one size"
                )
            yield picture

    def readable_after(self, index: int) -> int:
        """The next one: each picture has a file of its own."""
        return index + 1

    def read_file(self, file: Path) -> Picture:
        """The picture in one file, as stored."""
        return read_picture(file)

    def turned(self) -> PictureSource | None:
        """The same frames as their EXIF orientation shows them, where that exchanges width and height."""
        if self.orientation not in _TURNED:
            return None
        return replace(self, width=self.height, height=self.width, is_turned=True)

    def frame_numbers(self) -> list[tuple[int, ...]] | None:
        """What counts the frames in the file names, for each; shows a frame that is missing in between.

        Of the numbers in a name (frame, camera, take, time stamp) that is the one which differs from file to file and
        counts in the smallest steps; of several alike the last; where each repeats, those that change, together. None
        if names have no numbers, or not the same number of them.
        """
        names = [re.findall(r"[0-9]+", file.stem) for file in self.files]
        if len({len(numbers) for numbers in names}) != 1:
            return None
        columns = [tuple(map(int, column)) for column in zip(*names, strict=True)]
        counting = [column for column in columns if len(set(column)) == len(column)]
        if counting:
            return list(zip(min(reversed(counting), key=lambda column: max(column) - min(column)), strict=True))
        return list(zip(*(column for column in columns if len(set(column)) > 1), strict=True)) or None


@dataclass(frozen=True)
class SourceOfAnother:
    """What a source has of the ``source`` whose frames it gives: where it is, its size, its warnings."""

    source: FrameSource

    @property
    def path(self) -> Path:
        """Of the whole source."""
        return self.source.path

    @property
    def width(self) -> int:
        """Of every frame, in pixels."""
        return self.source.width

    @property
    def height(self) -> int:
        """Of every frame, in pixels."""
        return self.source.height

    @property
    def warnings(self) -> tuple[str, ...]:
        """Those of the whole source."""
        return self.source.warnings

    def readable_after(self, index: int) -> int:
        """The next one, which is read anew."""
        return index + 1


@dataclass(frozen=True)
class CutSource(SourceOfAnother):
    """``frame_count`` frames of another source, from its frame ``first`` on, every ``step``-th."""

    first: int
    step: int
    frame_count: int

    @property
    def fps(self) -> float | None:
        """Frames per second of what is left; None when it is unknown."""
        return None if self.source.fps is None else self.source.fps / self.step

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """As of any source; errors name the frames of the whole source."""
        last = self.first + (stop - 1) * self.step
        yield from self.source.read(self.first + start * self.step, last + 1, step * self.step)

    def readable_after(self, index: int) -> int:
        """As of the whole source."""
        whole = self.source.readable_after(self.first + index * self.step)
        return -((self.first - whole) // self.step)


class ListedPictures(PictureSource):
    """Pictures whose instants their times or folders tell, whatever numbers are in their names."""

    def frame_numbers(self) -> None:
        """None: nothing to compare."""
        return None


def open_listed(path: Path, files: Iterable[Path]) -> ListedPictures:
    """Picture files in the order of their frames, which their names do not tell. Raises RigError."""
    return ListedPictures(**vars(open_pictures(path, files)))


def natural_key(name: str) -> tuple[list[str | int], str]:
    """Sorts cam_2 before cam_10."""
    # Numbers stand at the odd places of the split, so that like is compared with like.
    parts: list[str | int] = [int(part) if i % 2 else part for i, part in enumerate(re.split(r"([0-9]+)", name))]
    return parts, name


def open_source(path: Path) -> FrameSource:
    """The frames at ``path``: a video, a picture, or a folder of pictures (directly or in ``images/``).

    Raises RigError if there is nothing readable.
    """
    if path.is_dir():
        folder = path if pictures_in(path) else path / "images"
        return open_pictures(path, pictures_in(folder))
    suffix = path.suffix.lower()
    if suffix in PICTURE_SUFFIXES:
        return open_pictures(path, (path,))
    try:
        return open_recording(path)
    except RigError:
        if suffix not in VIDEO_SUFFIXES:
            refuse_unknown_kinds([path])
        raise


def open_pictures(path: Path, files: Iterable[Path]) -> PictureSource:
    """Picture files in the order of their frames. Raises RigError if there are none, or of several kinds."""
    files = tuple(files)
    if not files:
        refuse_unknown_kinds([path])
        videos = [entry.name for entry in list_folder(path) if entry.suffix.lower() in VIDEO_SUFFIXES]
        if videos:
            raise RigError(f"{path}: holds {videos[0]}, but no pictures; name the video itself, not its folder")
        raise RigError(f"{path}: no {PICTURE_KINDS} pictures in here; put the camera's frames there")
    kinds = sorted({file.suffix.lower() for file in files})
    if len(kinds) > 1:
        raise RigError(f"{path}: holds pictures of several kinds ({', '.join(kinds)}); keep one kind per camera")
    facts = picture_facts(files[0])
    return PictureSource(path, files, facts.width, facts.height, facts.orientation, facts.warnings)


def list_folder(folder: Path) -> list[Path]:
    """The folder's entries in natural order, without hidden ones and those of file servers and systems.

    Empty if there is no such folder. Raises RigError if it is not readable.
    """
    if not folder.is_dir():
        return []
    try:
        entries = [entry for entry in folder.iterdir() if not _is_hidden(entry.name)]
    except OSError as error:
        raise RigError(f"{folder}: cannot be listed ({error.strerror}); fix its rights") from None
    return sorted(entries, key=lambda entry: natural_key(entry.name))


def _is_hidden(name: str) -> bool:
    return name.startswith(".") or name.lower() in _OF_SYSTEMS


def holds_frames(entry: Path) -> bool:
    """Whether this is a video, the first of its chapters, or a folder with pictures in it."""
    if entry.is_dir():
        return bool(pictures_in(entry) or pictures_in(entry / "images"))
    return entry.suffix.lower() in VIDEO_SUFFIXES and not continues_another(entry)


def files_of_source(source: FrameSource) -> tuple[Path, ...]:
    """The files that are read of a camera's frames: pictures, chapters, or one video."""
    if isinstance(source, PictureSource):
        return source.files
    if isinstance(source, SourceOfAnother):
        return files_of_source(source.source)
    return files_of_video(source) if isinstance(source, VideoSource) else (source.path,)


def refuse_unknown_kinds(entries: Iterable[Path]) -> None:
    """For entries that should hold a camera's frames, and do not: raises RigError if that is for their files' endings.

    Names the largest of them.
    """
    file = largest_unknown(entries)
    if file is not None:
        raise RigError(
            f"{file}: files ending in {file.suffix} are not read as frames; convert them to {PICTURE_KINDS} pictures, "
            "or to a video such as .mp4"
        )


def largest_unknown(entries: Iterable[Path]) -> Path | None:
    """The largest of these files, and of those in these folders, of an unknown ending; others are notes beside it."""
    inside = (file for entry in entries for file in [entry, *list_folder(entry), *list_folder(entry / "images")])
    suffixes = PICTURE_SUFFIXES | VIDEO_SUFFIXES
    unknown = [file for file in inside if file.suffix and file.suffix.lower() not in suffixes and file.is_file()]
    return max(unknown, key=lambda file: file.stat().st_size, default=None)


def other_endings(path: Path) -> str:
    """For a file that is missing: what lies there under its name with another ending, in words, if anything."""
    like = [entry.name for entry in list_folder(path.parent) if composed(entry.stem) == composed(path.stem)]
    return f", but {', '.join(like)} is there" if like else ""


def pictures_in(folder: Path) -> tuple[Path, ...]:
    """The folder's pictures, in natural order."""
    return tuple(entry for entry in list_folder(folder) if entry.suffix.lower() in PICTURE_SUFFIXES)
