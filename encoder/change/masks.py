"""Difference mask of a view and the region of interest, its dilation.

Source: DecoGS, difference mask (method step 1): D = max over RGB of |I_t - I_{t-1}| on the 8-bit scale, M = D > tau,
and the focus region is the max-pool of M with radius r.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

from ..input.dropouts import FROZEN, blankness, repeats
from ..parallel import side_by_side
from ..settings.frame import MaskSettings
from .noise import frame_noise

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int32]

_LEVEL_SLACK = 1e-3
"""Pictures that came from 8-bit files differ by whole levels, up to float32 rounding of about 3e-5 of a level; this
slack keeps a difference of exactly tau on the unchanged side, as in integer arithmetic."""

_USUALLY = 0.9
"""Quantile of the first frame's errors that counts as the usual one: edges and glare exceed it."""
CLEARLY = 25.0
"""Levels (the paper's threshold); noise of deviation 14 makes half of a picture's pixels differ by so much."""
MOST = 0.5
"""Share of clearly changed pixels beyond which a change is not noise."""

_SPREADS = 0.3
"""Least share that faint light must reach of the area away from other changes, itself at least this share of the
picture. The shading of a moving object stays near it."""
_EVERYWHERE, _FAINTEST = 0.75, 0.5
"""Share of that area beyond which light changes everywhere, and the threshold there and where light alone changes, in
units of the usual one: noise never reaches most of a picture at once, and what it changes everywhere shows most."""
_GLIMMER = 0.03
"""Least share, median over the views, that faint light must reach in a frame that light alone changes, for the next to
look for light as faint. Video coding leaves changes at .016, a candle's light is at .038 and more."""
_LIGHT_WINDOW = 7
"""Side, in pixels, of the window that averages faint light: noise shrinks by this factor, light does not."""


@dataclass(frozen=True)
class FrameMask:
    """One view's masks, bool (H, W): ``raw`` is where the picture changed, ``dilated`` the region of interest.

    The region of interest covers the changed pixels, faint light, their surroundings, and ``refined``, pixels that
    changed some frames ago (None: no pixels).

    ``lost``: reason why the picture does not show its frame (`input.dropouts`), with empty masks; "" otherwise.
    """

    raw: BoolArray
    dilated: BoolArray
    refined: BoolArray | None = None
    lost: str = ""

    @property
    def refines(self) -> bool:
        """Whether the region of interest has pixels that are only being refined."""
        return self.refined is not None and bool(self.refined.any())

    @property
    def changing(self) -> BoolArray:
        """The region of interest without pixels that are only being refined."""
        return self.dilated if self.refined is None else self.dilated & ~self.refined


def showing(masks: Sequence[FrameMask]) -> list[int]:
    """The views whose pictures show their frame."""
    return [index for index, mask in enumerate(masks) if not mask.lost]


def difference_mask(current: FloatArray, previous: FloatArray, threshold: float) -> BoolArray:
    """Pixels at which some colour channel changed by more than ``threshold`` 8-bit levels; bool (H, W).

    Pictures are planar float32 (3, H, W), 0..1 for black to white (scene-linear pictures may exceed 1).
    Raises ValueError when the pictures' shapes differ. Source: DecoGS, difference mask.
    """
    if current.shape != previous.shape or current.ndim != 3 or current.shape[0] != 3:
        raise ValueError(f"pictures must be two (3, H, W) arrays, not {current.shape} and {previous.shape}")
    limit = np.float32((threshold + _LEVEL_SLACK) / 255.0)
    largest = cv2.absdiff(current[0], previous[0])
    for now, before in zip(current[1:], previous[1:], strict=True):
        cv2.max(largest, cv2.absdiff(now, before), dst=largest)
    mask: BoolArray = largest > limit
    return mask


def faint_light_mask(current: FloatArray, previous: FloatArray, threshold: float) -> BoolArray:
    """Pixels around which some colour channel changed by more than ``threshold`` 8-bit levels in the mean; bool (H, W).

    Pictures are planar float32 (3, H, W), 0..1 for black to white.
    """
    window = (_LIGHT_WINDOW, _LIGHT_WINDOW)
    means = (cv2.blur(cv2.subtract(now, before), window) for now, before in zip(current, previous, strict=True))
    largest = np.abs(next(means))
    for mean in means:
        cv2.max(largest, np.abs(mean), dst=largest)
    mask: BoolArray = largest > np.float32(threshold / 255.0)
    return mask


def dilate(mask: BoolArray, radius: int) -> BoolArray:
    """Max-pool of a mask with a square window of ``radius`` pixels each way; radius 0 gives the mask itself."""
    if radius < 0:
        raise ValueError(f"radius {radius} is negative")
    if radius == 0 or not mask.any():
        return np.array(mask)
    # A window wider than twice the picture covers nothing more, and costs time.
    across, down = (2 * min(radius, n) + 1 for n in (mask.shape[1], mask.shape[0]))
    window = cv2.getStructuringElement(cv2.MORPH_RECT, (across, down))
    grown: BoolArray = cv2.dilate(mask.view(np.uint8), window).view(np.bool_)
    return grown


def without_specks(mask: BoolArray, area: int) -> BoolArray:
    """The mask without its connected parts (8 neighbours) of fewer than ``area`` pixels."""
    if area <= 1 or not mask.any():
        return np.array(mask)
    # The fastest of OpenCV's ways; all find the same parts.
    way = 8, cv2.CV_32S, cv2.CCL_BBDT
    _, labels, stats, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask.view(np.uint8), *way)
    kept, at = np.zeros_like(mask), np.flatnonzero(mask)
    kept.flat[at] = (stats[:, cv2.CC_STAT_AREA] >= area)[labels.ravel()[at]]
    return kept


def _without_lines(mask: BoolArray) -> BoolArray:
    """The mask opened by 2 x 2 pixels: renderings miss edges one pixel wide everywhere."""
    square = np.ones((2, 2), np.uint8)
    cores = cv2.erode(mask.view(np.uint8), square, anchor=(0, 0))
    opened: BoolArray = cv2.dilate(cores, square, anchor=(1, 1)).view(np.bool_)
    return opened


def _light_reach(
    now: FloatArray, reference: FloatArray, around: BoolArray, thresholds: tuple[float, ...]
) -> list[float]:
    """Share of the area not ``around`` other changes that faint light, too slow to count as one, changed.

    One for each of ``thresholds``, levels.
    """
    height, width = (max(1, size // _LIGHT_WINDOW) for size in around.shape)
    shrink = partial(cv2.resize, dsize=(width, height), interpolation=cv2.INTER_AREA)
    away = shrink((~around).astype(np.float32)) > 0.99
    changes = np.abs([shrink(cv2.subtract(*planes)) for planes in zip(now, reference, strict=True)]).max(axis=0)
    area = max(away.sum(), _SPREADS * away.size)
    return [float((changes[away] > threshold / 255).sum() / area) for threshold in thresholds]


class MaskMemory:
    """The masks of a stream's frames, with the state between frames.

    ``pictures``: the first frame's, one planar float32 (3, H, W) per view; views may differ in size. ``shown``: their
    renderings, if a lack of time may leave frames unfinished (`trained`).
    """

    def __init__(
        self,
        pictures: Sequence[FloatArray],
        settings: MaskSettings,
        shown: Sequence[FloatArray] | None = None,
        *,
        threads: int = 1,
    ) -> None:
        self._settings, self._threads = settings, threads
        self._usual = None if shown is None else [_usual_miss(*pair) for pair in zip(pictures, shown, strict=True)]
        self._references = self._before = list(pictures)
        self._blank = [bool(blankness(picture)) for picture in pictures]
        self._lost = [""] * len(pictures)
        self._changed = [np.zeros(picture.shape[1:], bool) for picture in pictures]
        self._frame, self._only_light = 0, False
        self._faint_reach = [0.0] * len(pictures)
        self._refine_until = [np.zeros(picture.shape[1:], np.int32) for picture in pictures]

    @property
    def references(self) -> Sequence[FloatArray]:
        """Reference of every view's next picture."""
        return self._references

    def masks(self, current: Sequence[FloatArray], shown: Sequence[FloatArray]) -> list[FrameMask]:
        """The masks of every view's ``current`` picture, in the views' order; ``shown``: the scene before this frame.

        Raises ValueError when they are not the same views. Source: DecoGS, difference mask.
        """
        every = range(len(self._references))
        views = list(zip(every, current, self._references, shown, self._changed, self._refine_until, strict=True))
        with side_by_side(self._threads) as each:
            masks = list(each(lambda view: self._mask(*view), views))
        self._lost = self._lost_pictures(current, masks)
        return [_left_out(mask, why) if why else mask for mask, why in zip(masks, self._lost, strict=True)]

    def whole(self, current: Sequence[FloatArray], shown: Sequence[FloatArray]) -> list[FrameMask]:
        """Full masks of every view that shows its frame, if most pixels clearly changed and the scene misses them.

        An empty list for other frames. Call ``masks`` with the same pictures first.
        """
        used = [index for index, why in enumerate(self._lost) if not why]
        pairs = [(current[i], self._references[i], shown[i]) for i in used]
        missed = [
            (difference_mask(now, was, CLEARLY) & difference_mask(now, seen, CLEARLY)).mean()
            for now, was, seen in pairs
        ]
        if not used or float(np.median(missed)) <= MOST:
            return []
        everywhere = [np.ones(now.shape[1:], bool) for now in current]
        masks = [FrameMask(each, each) for each in everywhere]
        return [_left_out(mask, why) if why else mask for mask, why in zip(masks, self._lost, strict=True)]

    def changed_fraction(self, current: Sequence[FloatArray]) -> float:
        """Share of pixels, median over the views, that differ from the reference."""
        threshold, pairs = self._settings.threshold, zip(current, self._references, strict=True)
        return float(np.median([difference_mask(now, reference, threshold).mean() for now, reference in pairs]))

    def copy(self) -> MaskMemory:
        """An independent copy of the state."""
        copied = copy(self)
        copied._references, copied._faint_reach = list(self._references), list(self._faint_reach)
        copied._changed = [changed.copy() for changed in self._changed]
        copied._refine_until = [until.copy() for until in self._refine_until]
        return copied

    def _lost_pictures(self, current: Sequence[FloatArray], masks: Sequence[FrameMask]) -> list[str]:
        """Reason why each view's picture does not show its frame, or ""."""
        lost = ["" if never else blankness(now) for now, never in zip(current, self._blank, strict=True)]
        again = [repeats(now, before) for now, before in zip(current, self._before, strict=True)]
        flags = zip(masks, lost, again, strict=True)
        changed = sum(bool(mask.raw.any()) for mask, why, repeat in flags if not (why or repeat))
        if 2 * changed <= lost.count(""):
            return lost
        return [why or (FROZEN if repeat else "") for why, repeat in zip(lost, again, strict=True)]

    def _mask(
        self,
        index: int,
        now: FloatArray,
        reference: FloatArray,
        shown: FloatArray,
        changed: BoolArray,
        refine_until: IntArray,
    ) -> FrameMask:
        settings = self._settings
        noise = self._noise(now, reference)
        raw = without_specks(difference_mask(now, reference, max(settings.threshold, noise)), settings.speck_area)
        if settings.residual and changed.any():
            raw |= _without_lines(difference_mask(now, shown, settings.residual) & changed)
        around, refining = self._grown(raw), refine_until > self._frame
        threshold, self._faint_reach[index] = self._light(now, reference, around, noise / _LIGHT_WINDOW)
        if threshold:
            faint = faint_light_mask(now, reference, threshold)
            around = self._grown(raw | without_specks(faint, settings.speck_area))
        return FrameMask(raw, around | refining, refining & ~around)

    def _light(self, now: FloatArray, reference: FloatArray, around: BoolArray, noise: float) -> tuple[float, float]:
        """Levels from which faint light counts, at least its ``noise``, 0 for nowhere; and the reach of the faintest.

        The reach is a share of the area not ``around`` other changes.
        """
        if not self._settings.light_threshold:
            return 0.0, 0.0
        least = max(_FAINTEST * self._settings.light_threshold, noise)
        usual = max(self._settings.light_threshold, noise)
        spread, faintly = _light_reach(now, reference, around, (usual, least))
        if self._only_light or faintly > _EVERYWHERE:
            return least, faintly
        return (usual if spread > _SPREADS else 0.0), faintly

    def _noise(self, now: FloatArray, reference: FloatArray) -> float:
        """Levels below which a difference may be noise; 0 where most of the picture clearly changed."""
        settings = self._settings
        if not settings.noise_multiple:
            return 0.0
        noise = settings.noise_multiple * frame_noise(now, reference, settings.threshold / settings.noise_multiple)
        changed = noise > settings.threshold and difference_mask(now, reference, CLEARLY).mean() > MOST
        return 0.0 if changed else noise

    def _grown(self, mask: BoolArray) -> BoolArray:
        return dilate(mask, self._settings.radius(mask.shape[1]))

    def trained(
        self,
        current: Sequence[FloatArray],
        masks: Sequence[FrameMask],
        *,
        moved: bool,
        shown: Sequence[FloatArray] | None = None,
    ) -> None:
        """Records that the regions of interest were trained on ``current``; ``moved``: including positions.

        ``shown``: the scene's renderings. Pixels whose error exceeds the usual one of the first frame count as
        unfinished and keep their reference.
        """
        self._only_light = not moved and float(np.median(self._faint_reach)) > _GLIMMER

        def note(index: int) -> None:
            now, mask = current[index], masks[index]
            if moved and self._settings.refine_frames:
                self._refine(index, now)
            done = mask.dilated
            if shown is not None and self._usual is not None:
                done = done & ~difference_mask(shown[index], now, self._usual[index])
            self._references[index] = np.where(done, now, self._references[index])
            self._changed[index] |= mask.dilated

        with side_by_side(self._threads) as each:
            list(each(note, showing(masks)))

    def _refine(self, index: int, now: FloatArray) -> None:
        """Keeps clearly changed pixels of a view in its region of interest for some frames."""
        settings = self._settings
        clearly = difference_mask(now, self._references[index], settings.refine_threshold)
        clearly = self._grown(without_specks(clearly, settings.speck_area))
        self._refine_until[index][clearly] = self._frame + 1 + settings.refine_frames

    def passed(self, current: Sequence[FloatArray], *, held: bool = False) -> None:
        """Goes on to the next frame; ``held``: this frame's changes still wait for training."""
        self._before = list(current)
        self._frame += 1
        if not (held or self._settings.since_trained):
            pairs = zip(current, self._references, self._lost, strict=True)
            self._references = [was if why else now for now, was, why in pairs]


def _usual_miss(picture: FloatArray, shown: FloatArray) -> float:
    """Error, in 8-bit levels, that a tenth of the pixels of a fully trained picture (3, H, W) exceed."""
    miss = np.abs(np.clip(shown, 0, 1) - picture).max(axis=0)
    return 255 * float(np.quantile(miss, _USUALLY))


def _left_out(mask: FrameMask, why: str) -> FrameMask:
    nowhere = np.zeros_like(mask.raw)
    return FrameMask(nowhere, nowhere, lost=why)
