"""The cameras' videos as they come, without poses: which there are, and pictures of some instants of the take."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.colours.srgb import srgb_from_linear
from decogs.formats.errors import RigError
from decogs.formats.files.unicode_forms import composed
from decogs.formats.pictures.reading import Picture
from decogs.formats.rigs import FrameSource
from decogs.formats.rigs.sources import (
    holds_frames,
    largest_unknown,
    list_folder,
    open_source,
    pictures_in,
    refuse_unknown_kinds,
)

_THUMBNAIL = (64, 48)
_SAME_STEPS = 1.0
"""Mean difference of two thumbnails, in 8-bit steps: of one video coded twice it is a tenth, of neighbouring cameras of
`workbench` 8 and more."""
_SHOWS_NOTHING = 2.0
"""Standard deviation of a thumbnail of a closed lens, in 8-bit steps, at most."""

U8 = NDArray[np.uint8]

_SOUGHT_FROM = 30
"""Frames between two instants from which a video is sought for each instead of being decoded through: a second."""


@dataclass(frozen=True)
class Footage:
    """One camera: its name, the stem of its file, its frames, and when the first of the recording was taken.

    ``start``: in frames, of which only differences count; None: nobody says.
    """

    name: str
    source: FrameSource
    start: float | None = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.source.width, self.source.height


def open_footage(folder: Path) -> tuple[Footage, ...]:
    """The cameras in a folder, in natural order: its videos, else its folders of pictures, else its pictures.

    Raises RigError where there are none, two of one name, or one whose name no rig could state.
    """
    if not folder.is_dir():
        raise RigError(f"{folder}: there is no such folder; give the one that holds the cameras' videos")
    framed = [entry for entry in list_folder(folder) if holds_frames(entry)]
    entries = [entry for entry in framed if entry.is_file()] or framed or list(pictures_in(folder))
    if not entries:
        refuse_unknown_kinds(list_folder(folder))
        raise RigError(f"{folder}: no videos in here, nor pictures; put one video for each camera there")
    unsaid = [entry.name for entry in entries if not str(entry.resolve()).isprintable()]
    if unsaid:
        raise RigError(f"{folder}: {unsaid[0]!r}, or a folder it is in, has a name with control characters; rename it")
    names = [composed(entry.stem) for entry in entries]
    twice = [name for name, count in Counter(names).items() if count > 1]
    if twice:
        raise RigError(f"{folder}: two files are called {twice[0]}; give each camera a name of its own")
    return tuple(Footage(name, open_source(entry)) for name, entry in zip(names, entries, strict=True))


def unread_beside(folder: Path, footage: Sequence[Footage]) -> Path | None:
    """The largest file beside the cameras', or in a folder there, whose ending is not read."""
    read = {camera.source.path for camera in footage}
    return largest_unknown(entry for entry in list_folder(folder) if entry not in read)


def instants_of(footage: Sequence[Footage], count: int) -> range:
    """At most ``count`` frame numbers, evenly over what all cameras have of the take."""
    common = min(camera.source.frame_count for camera in footage)
    return range(0, common, -(-common // count))


def check_copies(footage: Sequence[Footage]) -> None:
    """Raises RigError where two cameras show the same picture in the middle of the take: one video, taken twice."""
    common = min(camera.source.frame_count for camera in footage)
    instant = range(common // 2, common // 2 + 1)
    small = [cv2.resize(next(pictures_at(one, instant)), _THUMBNAIL, interpolation=cv2.INTER_AREA) for one in footage]
    pictures = np.array(small, np.float64)
    for (a, one), (b, two) in combinations(enumerate(footage), 2):
        shows_something = min(pictures[a].std(), pictures[b].std()) > _SHOWS_NOTHING
        if shows_something and np.abs(pictures[a] - pictures[b]).mean() < _SAME_STEPS:
            raise RigError(
                f"{one.source.path}: {one.name} and {two.name} show the same pictures; is one video there twice?"
            )


def unequal_lengths(footage: Sequence[Footage]) -> Iterator[str]:
    """A warning where one camera has less than half the frames of another: no more is looked at of any."""
    lengths = {camera.name: camera.source.frame_count for camera in footage}
    shortest, longest = min(lengths, key=lengths.__getitem__), max(lengths, key=lengths.__getitem__)
    if 2 * lengths[shortest] < lengths[longest]:
        yield (
            f"{shortest} has {lengths[shortest]} frames, {longest} has {lengths[longest]}: "
            "only what all cameras have of the take is looked at"
        )


def pictures_at(camera: Footage, instants: range) -> Iterator[U8]:
    """The camera's pictures (H, W, 3) of these frames, sRGB."""
    if instants.step < _SOUGHT_FROM:
        pictures: Iterator[Picture] = camera.source.read(instants.start, instants[-1] + 1, instants.step)
    else:
        pictures = (next(camera.source.read(instant, instant + 1)) for instant in instants)
    for picture in pictures:
        if picture.dtype == np.float32:
            coded = srgb_from_linear(np.clip(picture.astype(np.float32), 0, 1))
            picture = np.round(255 * coded).astype(np.uint8)
        yield np.asarray(picture, np.uint8)
