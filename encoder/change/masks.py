"""Difference mask of a view and the region of interest, its dilation.

Source: DecoGS, difference mask (method step 1): D = max over RGB of |I_t - I_{t-1}| on the 8-bit scale, M = D > tau,
and the focus region is the max-pool of M with radius r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
class PixelChange:
    """Where one view's picture changed, ``raw`` (H, W), and its ``noise`` floor in 8-bit levels.

    ``lost``: reason why the picture does not show its frame (`input.dropouts`); "" otherwise.
    """

    raw: BoolArray
    noise: float
    lost: str = ""


@dataclass(frozen=True)
class FrameMask:
    """One view's masks, bool (H, W): ``raw`` is where the picture changed, ``dilated`` the region of interest.

    The region of interest covers the changed pixels, faint light, and their surroundings.

    ``faint_reach``: the share of the area away from other changes that the faintest light reaches. ``lost``: reason why
    the picture does not show its frame (`input.dropouts`), with empty masks; "" otherwise.
    """

    raw: BoolArray
    dilated: BoolArray
    faint_reach: float = 0.0
    lost: str = ""


def showing(masks: Sequence[PixelChange | FrameMask]) -> list[int]:
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


@dataclass(frozen=True)
class MaskMemory:
    """What the masks of one frame hand to the next; one entry for each view.

    ``references``: pictures (3, H, W) that the next ones are compared with. ``before``: the frame before. ``blank``:
    whether the first picture shows nothing. ``usual_miss``: 8-bit levels that a trained picture misses by, where a time
    budget may leave frames unfinished; None elsewhere. ``only_light``: light alone changed the frame before.
    """

    references: Sequence[FloatArray]
    before: Sequence[FloatArray]
    blank: Sequence[bool]
    usual_miss: Sequence[float] | None = None
    only_light: bool = False

    @classmethod
    def begin(cls, pictures: Sequence[FloatArray], shown: Sequence[FloatArray] | None = None) -> MaskMemory:
        """That of a scene's first frame: its ``pictures``, and renderings of it if frames may be left unfinished."""
        return cls(
            references=tuple(pictures),
            before=tuple(pictures),
            blank=[bool(blankness(picture)) for picture in pictures],
            usual_miss=None if shown is None else [_usual_miss(*pair) for pair in zip(pictures, shown, strict=True)],
        )

    def pixel_changes(
        self, pictures: Sequence[FloatArray], settings: MaskSettings, threads: int = 1
    ) -> list[PixelChange]:
        """Where every view's picture changed.

        Raises ValueError when they are not the same views. Source: DecoGS, difference mask.
        """

        def change(now: FloatArray, reference: FloatArray) -> PixelChange:
            noise = _noise_floor(now, reference, settings)
            raw = difference_mask(now, reference, max(settings.threshold, noise))
            return PixelChange(without_specks(raw, settings.speck_area), noise)

        views = list(zip(pictures, self.references, strict=True))
        with side_by_side(threads) as each:
            changes = list(each(lambda view: change(*view), views))
        reasons = self._lost_pictures(pictures, changes)
        return [replace(change, lost=why) for change, why in zip(changes, reasons, strict=True)]

    def masks(
        self, pictures: Sequence[FloatArray], changes: Sequence[PixelChange], settings: MaskSettings, threads: int = 1
    ) -> list[FrameMask]:
        """The region of interest of every view around its ``changes``."""

        def mask(now: FloatArray, reference: FloatArray, change: PixelChange) -> FrameMask:
            around = _grown(change.raw, settings)
            threshold, reach = self._light(now, reference, around, change.noise / _LIGHT_WINDOW, settings)
            if threshold:
                faint = faint_light_mask(now, reference, threshold)
                around = _grown(change.raw | without_specks(faint, settings.speck_area), settings)
            if change.lost:
                nowhere = np.zeros_like(change.raw)
                return FrameMask(nowhere, nowhere, reach, change.lost)
            return FrameMask(change.raw, around, reach)

        views = list(zip(pictures, self.references, changes, strict=True))
        with side_by_side(threads) as each:
            return list(each(lambda view: mask(*view), views))

    def trained(
        self,
        pictures: Sequence[FloatArray],
        masks: Sequence[FrameMask],
        *,
        moved: bool,
        shown: Sequence[FloatArray] | None = None,
        threads: int = 1,
    ) -> MaskMemory:
        """After the regions of interest were trained; ``moved``: including positions.

        ``shown``: the scene's renderings. Pixels whose error exceeds the usual one of the first frame count as
        unfinished and keep their reference.
        """

        def reference(index: int) -> FloatArray:
            now, mask, before = pictures[index], masks[index], self.references[index]
            if mask.lost:
                return before
            done = mask.dilated
            if shown is not None and self.usual_miss is not None:
                done = done & ~difference_mask(shown[index], now, self.usual_miss[index])
            return np.where(done, now, before)

        with side_by_side(threads) as each:
            references = list(each(reference, range(len(masks))))
        only_light = not moved and float(np.median([mask.faint_reach for mask in masks])) > _GLIMMER
        return replace(self, references=references, only_light=only_light)

    def advance(
        self,
        pictures: Sequence[FloatArray],
        masks: Sequence[FrameMask],
        settings: MaskSettings,
        *,
        held: bool = False,
    ) -> MaskMemory:
        """For the next frame; ``held``: this frame's changes still wait for training."""
        references = self.references
        if not (held or settings.since_trained):
            reasons = [mask.lost for mask in masks] or [""] * len(pictures)
            views = zip(pictures, references, reasons, strict=True)
            references = [was if why else now for now, was, why in views]
        return replace(self, references=references, before=tuple(pictures))

    def changed_fraction(self, pictures: Sequence[FloatArray], settings: MaskSettings) -> float:
        """Share of pixels, median over the views, that differ from the reference."""
        pairs = zip(pictures, self.references, strict=True)
        return float(np.median([difference_mask(*pair, settings.threshold).mean() for pair in pairs]))

    def _lost_pictures(self, pictures: Sequence[FloatArray], changes: Sequence[PixelChange]) -> list[str]:
        """Reason why each view's picture does not show its frame, or ""."""
        lost = ["" if never else blankness(now) for now, never in zip(pictures, self.blank, strict=True)]
        again = [repeats(now, before) for now, before in zip(pictures, self.before, strict=True)]
        flags = zip(changes, lost, again, strict=True)
        changed = sum(bool(change.raw.any()) for change, why, repeat in flags if not (why or repeat))
        if 2 * changed <= lost.count(""):
            return lost
        return [why or (FROZEN if repeat else "") for why, repeat in zip(lost, again, strict=True)]

    def _light(
        self, now: FloatArray, reference: FloatArray, around: BoolArray, noise: float, settings: MaskSettings
    ) -> tuple[float, float]:
        """Levels from which faint light counts, at least its ``noise``, 0 for nowhere; and the reach of the faintest.

        The reach is a share of the area not ``around`` other changes.
        """
        if not settings.light_threshold:
            return 0.0, 0.0
        least = max(_FAINTEST * settings.light_threshold, noise)
        usual = max(settings.light_threshold, noise)
        spread, faintly = _light_reach(now, reference, around, (usual, least))
        if self.only_light or faintly > _EVERYWHERE:
            return least, faintly
        return (usual if spread > _SPREADS else 0.0), faintly


def full_masks(changes: Sequence[PixelChange]) -> list[FrameMask]:
    """Masks of all pixels, of every view that shows its frame."""
    return [FrameMask(full := np.full_like(change.raw, not change.lost), full, lost=change.lost) for change in changes]


def _noise_floor(now: FloatArray, reference: FloatArray, settings: MaskSettings) -> float:
    """Levels below which a difference may be noise; 0 where most of the picture clearly changed."""
    if not settings.noise_multiple:
        return 0.0
    noise = settings.noise_multiple * frame_noise(now, reference, settings.threshold / settings.noise_multiple)
    changed = noise > settings.threshold and difference_mask(now, reference, CLEARLY).mean() > MOST
    return 0.0 if changed else noise


def _grown(mask: BoolArray, settings: MaskSettings) -> BoolArray:
    return dilate(mask, settings.radius(mask.shape[1]))


def _usual_miss(picture: FloatArray, shown: FloatArray) -> float:
    """Error, in 8-bit levels, that a tenth of the pixels of a fully trained picture (3, H, W) exceed."""
    miss = np.abs(np.clip(shown, 0, 1) - picture).max(axis=0)
    return 255 * float(np.quantile(miss, _USUALLY))
