"""Recordings that a camera splits into chapters of some gigabytes: several files, one video.

GoPro names chapter CC of recording NNNN GXCCNNNN, GHCCNNNN or GLCCNNNN; up to the Hero 5 the first is GOPRNNNN, the
second GP01NNNN. Source: GoPro's support pages on file naming.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Generator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import RigError
from ..pictures.reading import Picture
from .reading import VideoSource, open_video

_NAME = re.compile(r"(G[HXL])[0-9]{2}([0-9]{4})", re.ASCII)
_OLD_NAME = re.compile(r"(?:GOPR|GP[0-9]{2})([0-9]{4})", re.ASCII)
_NEAR_RATE = 0.01
"""Relative difference of the rates of two chapters: a short last one states another average."""


@dataclass(frozen=True)
class ChapteredVideo(VideoSource):
    """A recording of several ``chapters``: their frames, one chapter after the other; ``path`` is the first one's."""

    chapters: tuple[VideoSource, ...] = ()

    def read(self, start: int, stop: int, step: int = 1) -> Generator[Picture, None, None]:
        """As of any video; errors name the chapter and its own frame."""
        begin, following = 0, start
        for chapter in self.chapters:
            end = begin + chapter.frame_count
            if following < min(end, stop):
                yield from chapter.read(following - begin, min(end, stop) - begin, step)
                following += -(-(min(end, stop) - following) // step) * step
            begin = end

    def readable_after(self, index: int) -> int:
        """As of any video: damage ends with its chapter at the latest."""
        chapters, frame = chapters_from(self, index)
        return index - frame + min(chapters[0].readable_after(frame), chapters[0].frame_count)

    def whole(self) -> VideoSource:
        """As of any video, of all chapters."""
        return replace(self, **_size(self.chapters[0].whole()), chapters=tuple(each.whole() for each in self.chapters))


def _size(video: VideoSource) -> dict[str, Any]:
    return {name: getattr(video, name) for name in ("width", "height", "edges")}


def open_recording(path: Path) -> VideoSource:
    """A video with the chapters that go on with it, which lie beside it. Raises RigError as `open_video`.

    A chapter that is not the first is opened alone. Chapters of other sizes or rates are refused, as is one that is
    missing between two others.
    """
    first = open_video(path)
    files = _following(path)
    if not files:
        return first
    chapters = (first, *map(open_video, files))
    for file, chapter in zip(files, chapters[1:], strict=True):
        _check_goes_on(path, first, file, chapter)
    count = sum(chapter.frame_count for chapter in chapters)
    warning = f"goes on in {len(files)} more chapter{'s' if len(files) > 1 else ''}, read as one recording"
    warnings = (warning, *first.warnings)
    return ChapteredVideo(
        path,
        **_size(first),
        frame_count=count,
        fps=first.fps,
        readout=first.readout,
        warnings=warnings,
        chapters=chapters,
    )


def continues_another(path: Path) -> bool:
    """Whether a file is a chapter, but the first, of a recording whose first one lies beside it."""
    names = _chapter_names(path)
    return path.stem.upper() in names[1:] and _beside(path, names[0]) is not None


def chapters_from(video: VideoSource, frame: int) -> tuple[list[VideoSource], int]:
    """The files of a recording from the one with its ``frame`` on, and the number that the frame has in that one."""
    chapters = list(video.chapters) if isinstance(video, ChapteredVideo) else [video]
    while len(chapters) > 1 and frame >= chapters[0].frame_count:
        frame -= chapters.pop(0).frame_count
    return chapters, frame


def files_of_video(video: VideoSource) -> tuple[Path, ...]:
    """The files that are read of a video."""
    return tuple(each.path for each in video.chapters) if isinstance(video, ChapteredVideo) else (video.path,)


def _following(path: Path) -> list[Path]:
    """The files of the chapters after the first one, ``path``."""
    real = Path(os.path.realpath(path))  # a link's own name says nothing
    names = _chapter_names(real)
    if real.stem.upper() not in names[:1]:
        return []
    files = [_beside(real, name) for name in names[1:]]
    last = max((number for number, file in enumerate(files) if file is not None), default=0)
    for name, file in zip(names[1:], files[:last], strict=False):
        if file is None:
            raise RigError(f"{path}: its chapter {name} is missing, but {files[last]} is there; put it back")
    return [file for file in files if file is not None]


def _chapter_names(path: Path) -> list[str]:
    """The names, without their ending, that the chapters of a file's recording have, in order; none if it has none."""
    stem = path.stem.upper()
    if match := _NAME.fullmatch(stem):
        return [f"{match[1]}{chapter:02d}{match[2]}" for chapter in range(1, 100)]
    if match := _OLD_NAME.fullmatch(stem):
        return [f"GOPR{match[1]}", *(f"GP{chapter:02d}{match[1]}" for chapter in range(1, 100))]
    return []


def _beside(path: Path, stem: str) -> Path | None:
    """The file of this name and the same ending in the same folder, whatever the case of its letters."""
    exact = path.with_name(f"{stem}{path.suffix}")
    if exact.is_file():
        return exact
    low = path.with_name(f"{stem.lower()}{path.suffix}")
    return low if low.is_file() else None


def _check_goes_on(path: Path, first: VideoSource, file: Path, chapter: VideoSource) -> None:
    if (first.width, first.height) != (chapter.width, chapter.height):
        what = f"{chapter.width} x {chapter.height} pixels, not {first.width} x {first.height}"
    elif first.fps and chapter.fps and not math.isclose(first.fps, chapter.fps, rel_tol=_NEAR_RATE):
        what = f"{chapter.fps:.3f} frames per second, not {first.fps:.3f}"
    else:
        return
    raise RigError(f"{file}: has {what} as {path.name}, whose next chapter it is by its name; move it away if not")
