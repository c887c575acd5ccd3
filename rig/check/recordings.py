"""What a camera's pictures tell of the camera by themselves: pictures that show nothing, repeats, noise, sharpness.

Video coding leaves no two pictures alike bit for bit, not even copies. A copy has no noise of its own: what differs
from the picture before it is a small part of what differs in the other cameras' pictures of that moment.

A blur takes the finest details first. So their energy is compared with that of details twice as large, and that with
details four times as large: neither depends on contrast, and both of a scene that several cameras see are alike.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.colours.srgb import LUMA
from decogs.formats.pictures.reading import Picture

from ..pictures.dropouts import blankness
from ..pictures.ingest import display_referred

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
BoolArray = NDArray[np.bool_]

BANDS = 3
"""Bands of detail, each of twice the size of the one before."""
_SIGMAS = (1.0, 2.0, 4.0)
"""Blurs, in pixels, between which a band lies; the first band begins at the pixel."""
_MAX_CHANGE_SHARE = 0.25
"""Largest change of a repeat, in shares of the other cameras' median ..."""
_MAX_OWN_SHARE, _OWN_QUANTILE = 0.4, 0.9
"""... and of the camera's own usual change: copies coded as video have up to .24 of either, a real camera's quietest
picture .46 of its own."""
_MAX_FROZEN_SHARE = 0.15
"""Largest median change of a camera that repeats one picture all along, in shares of the others'."""
_MIN_OTHERS_LEVELS = 0.25
"""Least median change of the others, in levels, against which a repeat shows."""
_HANGS = 5
"""Recorded pictures in a row that tell a camera that hangs, or is dead, from one that dropped frames."""
_HANGS_AT_THE_END = 2
"""Pictures of a row that goes on to the last one: nothing shows that the camera came back."""


@dataclass(frozen=True)
class Recordings:
    """Pictures, (cameras, F), that show nothing of their moment: ``blank``, and ``repeats`` of the one before.

    ``step``: recorded frames from one picture to the next, all of which a repeat has missed. ``at_rest``: frames (F,)
    in which no camera could show a change, so that they end no row of repeats. ``unread``: those that cannot be read,
    in whose place there is the one before.
    """

    blank: BoolArray
    repeats: BoolArray
    step: int
    at_rest: BoolArray
    unread: BoolArray

    def dead(self, camera: int) -> BoolArray:
        """Which pictures (F,) of a camera show nothing, in a long row."""
        return _long_rows(self.blank[camera])

    def hung(self, camera: int) -> BoolArray:
        """Which pictures (F,) are repeats, in a long row, or one from which the camera never comes back."""
        return _long_rows(self.repeats[camera], self.at_rest, self.step, _HANGS_AT_THE_END)

    def dropped(self, camera: int) -> BoolArray:
        """Which pictures (F,) are missing singly."""
        lost, rows = self.blank[camera] | self.repeats[camera], self.dead(camera) | self.hung(camera)
        return np.asarray(lost & ~rows)

    def without_lost(self, noise: F64) -> F64:
        """The ``noise`` (cameras, F) between pictures and those before them, NaN where one of the two is lost."""
        lost = self.blank | self.repeats | self.unread
        return np.asarray(np.where(lost | np.roll(self.blank, 1, axis=1), np.nan, noise))


def find_lost(pictures: Sequence[U8], step: int = 1, unread: BoolArray | None = None) -> Recordings:
    """The lost ones among the cameras' ``pictures``, (F, H, W, 3) each, of every ``step``-th frame.

    ``unread`` (cameras, F) are neither blank nor repeats.

    What most cameras show in a frame is no loss: a room without light is black.
    """
    blank = np.array([[bool(blankness(_planar(picture))) for picture in own] for own in pictures])
    blank &= 2 * blank.sum(axis=0) <= len(pictures)
    changes = np.array([_changes(own) for own in pictures])
    changes[:, 1:][blank[:, 1:] | blank[:, :-1]] = np.nan
    repeats = np.zeros(changes.shape, bool)
    at_rest = np.nan_to_num(_median(changes)) < _MIN_OTHERS_LEVELS
    for camera in range(len(pictures)) if len(pictures) > 2 else ():
        others = np.nan_to_num(_median(np.delete(changes, camera, axis=0)))
        shows = np.isfinite(changes[camera]) & (others >= _MIN_OTHERS_LEVELS)
        if shows.any():
            own = changes[camera][shows]
            stands = np.median(own) < _MAX_FROZEN_SHARE * np.median(others[shows])
            usual = np.inf if stands else float(np.quantile(own, _OWN_QUANTILE))
            repeats[camera] = shows & (changes[camera] < np.minimum(_MAX_CHANGE_SHARE * others, _MAX_OWN_SHARE * usual))
    unread = np.zeros_like(blank) if unread is None else unread
    return Recordings(blank & ~unread, repeats & ~unread, step, at_rest, unread)


def detail(picture: Picture) -> F64:
    """Mean squares (BANDS,) of a picture's details (H, W, 3) by size, in levels: finest first."""
    levels = np.asarray(picture if picture.dtype == np.uint8 else display_referred(picture) * 255, np.float32)
    grey = np.asarray(cv2.transform(levels, LUMA[None].astype(np.float32)), np.float32)
    return np.array([float(np.square(band).mean()) for band in _bands(grey)])


def sharpness(details: F64, noise: F64) -> F64:
    """Each camera's ratios (cameras, BANDS - 1) of details to those twice as large, over the cameras' medians.

    ``details`` (cameras, BANDS); ``noise`` (cameras,): deviation in levels, whose share is taken off. NaN of a camera
    that shows nothing.
    """
    of_noise = (LUMA**2).sum() * noise[:, None] ** 2 * _NOISE_SHARES
    clean = np.maximum(details - of_noise, 1e-3 * details)
    ratios = np.where(clean[:, 1:] > 0, clean[:, :-1] / np.maximum(clean[:, 1:], 1e-9), np.nan)
    return np.asarray(ratios / _median(ratios))


def _bands(grey: NDArray[np.float32]) -> list[NDArray[np.float32]]:
    blurred = [grey, *(cv2.GaussianBlur(grey, (0, 0), sigma) for sigma in _SIGMAS)]
    return [np.asarray(fine - coarse, np.float32) for fine, coarse in pairwise(blurred)]


def _shares_of_noise() -> F64:
    """What of the variance of white noise each band has: that of a single pixel's picture."""
    pixel = np.zeros((65, 65), np.float32)
    pixel[32, 32] = 1
    return np.array([float(np.square(band).sum()) for band in _bands(pixel)])


_NOISE_SHARES = _shares_of_noise()


def _planar(picture: U8) -> NDArray[np.float32]:
    return display_referred(picture[::4, ::4].transpose(2, 0, 1))


def _changes(pictures: U8) -> F64:
    """Mean change (F,) of a camera's pictures from one to the next, in levels; NaN of the first."""
    changes = np.full(len(pictures), np.nan)
    green = np.ascontiguousarray(pictures[:, ::2, ::2, 1])
    for frame in range(1, len(green)):
        changes[frame] = cv2.absdiff(green[frame], green[frame - 1]).mean()
    return changes


def _long_rows(lost: BoolArray, bridges: BoolArray | None = None, step: int = 1, at_the_end: int = _HANGS) -> BoolArray:
    """Those of lost pictures (F,) that lie in rows of _HANGS frames, of all that can be lost, or of ``at_the_end``.

    ``bridges``: those that end no row, and count for none.
    """
    kept = np.zeros(len(lost), bool)
    goes_on = lost if bridges is None else lost | bridges
    edges = np.flatnonzero(np.diff(np.concatenate([[False], goes_on, [False]])))
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        count, enough = int(lost[begin:end].sum()), at_the_end if end == len(lost) else _HANGS
        if count * step >= _HANGS or count >= min(enough, max(1, len(lost) - 1)):
            kept[begin:end] = lost[begin:end]
    return kept


def _median(values: F64) -> F64:
    """Over the cameras (cameras, ...), without what is not known; NaN where nothing is."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # Nothing is known of a frame.
        return np.asarray(np.nanmedian(values, axis=0))
