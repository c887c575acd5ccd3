"""Where the frames of one camera come from: a video, a folder of pictures, or a single picture."""

from __future__ import annotations

import re
from collections.abc import Generator, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ..errors import RigError
from ..pictures import PICTURE_SUFFIXES, Picture, picture_size, read_picture
from ..videos import VIDEO_SUFFIXES, open_video

GENERIC_FOLDERS = frozenset({"images", "frames", "videos", "rgb", "input"})
"""Folder names that hold pictures but name no camera."""


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

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """Every step-th frame from start (inclusive) to stop (exclusive). Raises RigError naming file and frame."""
        ...


@dataclass(frozen=True)
class PictureSource:
    """The frames of one camera as picture files, one per frame, in order; ``path`` is the folder or the one file."""

    path: Path
    files: tuple[Path, ...]
    width: int
    height: int

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
            picture = read_picture(file)
            if picture.shape != (self.height, self.width, 3):
                raise RigError(
                    f"{file}: {picture.shape[1]} x {picture.shape[0]} pixels, but this camera's first frame has "
                    f"{self.width} x {self.height}; bring all its frames to one size"
                )
            yield picture

    def frame_numbers(self) -> list[int] | None:
        """The last number in each file name, or None if a name has none; shows a frame that is missing in between."""
        found = [re.findall(r"[0-9]+", file.stem) for file in self.files]
        return [int(numbers[-1]) for numbers in found] if all(found) else None


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
        folder = path if _pictures_in(path) else path / "images"
        return open_pictures(path, _pictures_in(folder))
    if path.suffix.lower() in PICTURE_SUFFIXES:
        return open_pictures(path, (path,))
    return open_video(path)


def open_pictures(path: Path, files: Iterable[Path]) -> PictureSource:
    """Picture files in the order of their frames. Raises RigError if there are none, or of several kinds."""
    files = tuple(files)
    if not files:
        raise RigError(f"{path}: no PNG, JPEG or EXR pictures in here; put the camera's frames there")
    kinds = sorted({file.suffix.lower() for file in files})
    if len(kinds) > 1:
        raise RigError(f"{path}: holds pictures of several kinds ({', '.join(kinds)}); keep one kind per camera")
    width, height = picture_size(files[0])
    return PictureSource(path, files, width, height)


def list_folder(folder: Path) -> list[Path]:
    """The folder's entries in natural order, empty if there is no such folder. Raises RigError if not readable."""
    if not folder.is_dir():
        return []
    try:
        return sorted(folder.iterdir(), key=lambda entry: natural_key(entry.name))
    except OSError as error:
        raise RigError(f"{folder}: cannot be listed ({error.strerror}); fix its rights") from None


def holds_frames(entry: Path) -> bool:
    """Whether this is a video or a folder with pictures in it."""
    if entry.is_dir():
        return bool(_pictures_in(entry) or _pictures_in(entry / "images"))
    return entry.suffix.lower() in VIDEO_SUFFIXES


def _pictures_in(folder: Path) -> tuple[Path, ...]:
    return tuple(entry for entry in list_folder(folder) if entry.suffix.lower() in PICTURE_SUFFIXES)
