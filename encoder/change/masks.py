"""Difference mask of a view and the region of interest, its dilation.

Source: DecoGS, difference mask (method step 1): D = max over RGB of |I_t - I_{t-1}| on the 8-bit scale, M = D > tau,
and the focus region is the max-pool of M with radius r.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray
from decogs.rig.parallel import side_by_side
from decogs.rig.pictures.dropouts import FROZEN, blankness, repeats
from decogs.rig.pictures.noise import frame_noise

from ..settings.frame import MaskSettings

BoolArray = NDArray[np.bool_]

_ROUNDING_LEVELS = 1e-3
"""Added to tau, so that a difference of exactly tau is no change: pictures from 8-bit files differ by whole levels, up
to float32 rounding of some 3e-5 levels."""
_TRAINED_ERROR_QUANTILE = 0.8
"""Of the mean errors in a fully trained picture, which edges and glare exceed. With .9 a room loses .2 dB."""
_ERROR_WINDOW_PIXELS = 3
"""Side of the window whose mean error counts: fine texture that Gaussians leave out has none, what they smear has."""
CLEAR_CHANGE_LEVELS = 25.0
"""The paper's tau; noise of a deviation of 14 levels changes half of the pixels by so much."""
MAX_NOISE_FRACTION = 0.5
"""Fraction of clearly changed pixels beyond which a change is not noise."""

_MIN_LIGHT_FRACTION = 0.3
"""Least fraction of the area outside other changes in which faint light counts, and least size of that area, as a
fraction of the picture. The shading of a moving object stays below it."""
_GLOBAL_LIGHT_FRACTION = 0.75
"""Fraction of that area from which light changes the whole picture, which noise never does: a lower threshold holds."""
_LOW_THRESHOLD_FACTOR = 0.5
"""Of the usual threshold of faint light, where light changes the whole picture or was alone in changing the last."""
_MIN_LIGHT_ONLY_FRACTION = 0.03
"""Least fraction, median over the views, that faint light reaches in a frame that light alone changes. Below it is what
video coding leaves, .016; a candle's light reaches .038 and more."""
_LIGHT_WINDOW_PIXELS = 7
"""Side of the window that averages faint light: it divides the deviation of noise by 7, and leaves light."""


@dataclass(frozen=True)
class PixelChange:
    """Where one view's picture changed, ``raw`` (H, W), and its ``noise`` floor in 8-bit levels.

    ``lost``: reason why the picture does not show its frame (`rig.pictures.dropouts`); "" otherwise.
    """

    raw: BoolArray
    noise: float
    lost: str = ""


@dataclass(frozen=True)
class FrameMask:
    """One view's masks, bool (H, W): ``raw`` is where the picture changed, ``dilated`` the region of interest.

    The region of interest is the dilation of the changed pixels and of faint light. ``faint_light``: fraction of the
    area outside other changes that light of the low threshold reaches. ``lost``: reason why the picture does not show
    its frame (`rig.pictures.dropouts`), with empty masks; "" otherwise.
    """

    raw: BoolArray
    dilated: BoolArray
    faint_light: float = 0.0
    lost: str = ""


def share(mask: BoolArray, recorded: BoolArray | None = None) -> float:
    """Of ``recorded`` pixels, None meaning all, that are marked, 0 to 1; a mean takes twenty times as long."""
    if recorded is None:
        return np.count_nonzero(mask) / mask.size
    return np.count_nonzero(mask & recorded) / (int(np.count_nonzero(recorded)) or 1)


def usable_views(masks: Sequence[PixelChange | FrameMask]) -> list[int]:
    """The views whose pictures show their frame."""
    return [index for index, mask in enumerate(masks) if not mask.lost]


def difference_mask(current: FloatArray, previous: FloatArray, threshold: float) -> BoolArray:
    """Pixels at which some colour channel changed by more than ``threshold`` 8-bit levels; bool (H, W).

    Pictures are planar float32 (3, H, W), 0..1 for black to white (scene-linear pictures may exceed 1).
    Raises ValueError when the pictures' shapes differ. Source: DecoGS, difference mask.
    """
    if current.shape != previous.shape or current.ndim != 3 or current.shape[0] != 3:
        raise ValueError(f"pictures must be two (3, H, W) arrays, not {current.shape} and {previous.shape}")
    limit = np.float32((threshold + _ROUNDING_LEVELS) / 255.0)
    largest = cv2.absdiff(current[0], previous[0])
    for now, before in zip(current[1:], previous[1:], strict=True):
        cv2.max(largest, cv2.absdiff(now, before), dst=largest)
    mask: BoolArray = largest > limit
    return mask


def faint_light_mask(current: FloatArray, previous: FloatArray, threshold: float) -> BoolArray:
    """Pixels around which some colour channel changed by more than ``threshold`` 8-bit levels in the mean; bool (H, W).

    Pictures are planar float32 (3, H, W), 0..1 for black to white.
    """
    mask: BoolArray = _mean_difference(current, previous, _LIGHT_WINDOW_PIXELS) > np.float32(threshold / 255.0)
    return mask


def _mean_difference(current: FloatArray, previous: FloatArray, window: int) -> FloatArray:
    """Of the channel with most, the difference in the mean over a ``window`` around each pixel; (H, W)."""
    differences = (cv2.subtract(now, before) for now, before in zip(current, previous, strict=True))
    means = (np.abs(cv2.blur(difference, (window, window))) for difference in differences)
    largest: FloatArray = next(means)
    for mean in means:
        cv2.max(largest, mean, dst=largest)
    return largest


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


def remove_specks(mask: BoolArray, area: int) -> BoolArray:
    """The mask without its connected components (8 neighbours) of fewer than ``area`` pixels."""
    if area <= 1 or not mask.any():
        return np.array(mask)
    # The fastest of OpenCV's algorithms; all find the same components.
    algorithm = 8, cv2.CV_32S, cv2.CCL_BBDT
    _, labels, stats, _ = cv2.connectedComponentsWithStatsWithAlgorithm(mask.view(np.uint8), *algorithm)
    kept, at = np.zeros_like(mask), np.flatnonzero(mask)
    kept.flat[at] = (stats[:, cv2.CC_STAT_AREA] >= area)[labels.ravel()[at]]
    return kept


def _light_fractions(
    now: FloatArray,
    reference: FloatArray,
    region: BoolArray,
    thresholds: tuple[float, ...],
    recorded: BoolArray | None,
) -> list[float]:
    """Fraction of the recorded area outside the ``region`` of other changes that light changed by each threshold,
    levels."""
    height, width = (max(1, size // _LIGHT_WINDOW_PIXELS) for size in region.shape)
    shrink = partial(cv2.resize, dsize=(width, height), interpolation=cv2.INTER_AREA)
    outside = shrink(_recorded(~region, recorded).astype(np.float32)) > 0.99
    changes = np.abs([shrink(cv2.subtract(*planes)) for planes in zip(now, reference, strict=True)]).max(axis=0)
    picture = outside.size if recorded is None else outside.size * recorded.mean()
    area = max(outside.sum(), _MIN_LIGHT_FRACTION * picture)
    return [float((changes[outside] > threshold / 255).sum() / area) for threshold in thresholds]


@dataclass(frozen=True)
class MaskMemory:
    """What the masks of one frame hand to the next; one entry for each view.

    ``recorded`` (H, W): where the pictures were, None meaning everywhere; nothing else is marked or counted.
    ``references``: pictures (3, H, W) that the next ones are compared with. ``previous``: those of the frame
    before. ``blank``: whether the first picture shows nothing. ``regions`` (H, W): all regions of interest since then.
    ``trained_errors``: of a trained picture, 0 to 1; None where none is known. ``light_only``: light alone changed the
    frame before. ``relit``: in some frame light changed more than steps follow. ``subject``: the pictures are of a
    subject alone, which has left where all are of one colour: that is no dropout.
    """

    recorded: Sequence[BoolArray | None]
    references: Sequence[FloatArray]
    previous: Sequence[FloatArray]
    blank: Sequence[bool]
    regions: Sequence[BoolArray]
    trained_errors: Sequence[float] | None = None
    light_only: bool = False
    relit: bool = False
    subject: bool = False

    @classmethod
    def begin(
        cls,
        pictures: Sequence[FloatArray],
        rendered: Sequence[FloatArray] | None = None,
        *,
        recorded: Sequence[BoolArray | None] = (),
        subject: bool = False,
        threads: int = 1,
    ) -> MaskMemory:
        """After a scene's first frame; ``rendered``: its renderings, None for a method that needs no masks."""
        recorded, errors = recorded or [None] * len(pictures), None
        if rendered is not None:
            with side_by_side(threads) as each:
                errors = list(each(_trained_error, pictures, rendered, recorded))
        return cls(
            recorded=recorded,
            references=tuple(pictures),
            previous=tuple(pictures),
            blank=[bool(blankness(picture)) for picture in pictures],
            regions=[np.zeros(picture.shape[1:], bool) for picture in pictures],
            trained_errors=errors,
            subject=subject,
        )

    def pixel_changes(
        self,
        pictures: Sequence[FloatArray],
        settings: MaskSettings,
        threads: int = 1,
        *,
        lost: Mapping[int, str] | None = None,
    ) -> list[PixelChange]:
        """Where every view's picture changed; ``lost``: why views, by number, have none of this frame.

        Raises ValueError when they are not the same views. Source: DecoGS, difference mask.
        """

        def change(now: FloatArray, reference: FloatArray, recorded: BoolArray | None) -> PixelChange:
            noise = _noise_floor(now, reference, settings, recorded)
            raw = _recorded(difference_mask(now, reference, max(settings.threshold, noise)), recorded)
            return PixelChange(remove_specks(raw, settings.speck_area), noise)

        views = list(zip(pictures, self.references, self.recorded, strict=True))
        with side_by_side(threads) as each:
            changes = list(each(lambda view: change(*view), views))
        reasons = dict(enumerate(self._dropouts(pictures, changes))) | dict(lost or {})
        return [replace(change, lost=reasons[view]) for view, change in enumerate(changes)]

    def masks(
        self, pictures: Sequence[FloatArray], changes: Sequence[PixelChange], settings: MaskSettings, threads: int = 1
    ) -> list[FrameMask]:
        """The region of interest of every view around its ``changes``."""

        def mask(now: FloatArray, reference: FloatArray, change: PixelChange, recorded: BoolArray | None) -> FrameMask:
            region = _recorded(_dilated(change.raw, settings), recorded)
            threshold, faint_light = self._light_threshold(now, reference, region, change.noise, settings, recorded)
            if change.lost:
                nowhere = np.zeros_like(change.raw)
                return FrameMask(nowhere, nowhere, faint_light, change.lost)
            if threshold:
                light = _recorded(faint_light_mask(now, reference, threshold), recorded)
                light = remove_specks(light, settings.speck_area)
                region = _recorded(_dilated(change.raw | light, settings), recorded)
            return FrameMask(change.raw, region, faint_light)

        views = list(zip(pictures, self.references, changes, self.recorded, strict=True))
        with side_by_side(threads) as each:
            return list(each(lambda view: mask(*view), views))

    def trained(
        self,
        pictures: Sequence[FloatArray],
        masks: Sequence[FrameMask],
        *,
        moved: bool,
        rendered: Sequence[FloatArray] | None = None,
        relit: bool = False,
        threads: int = 1,
    ) -> MaskMemory:
        """After the regions of interest were trained; ``moved``: including positions.

        ``rendered``: the scene's renderings, where pixels that they miss are to be selected again, though they may
        change no more: so far as some region of interest ever held them, and by more than a trained picture's error.
        ``relit``: light changed more than steps follow; what is missed then keeps its reference, and goes on training.
        """
        regions = [old | mask.dilated for old, mask in zip(self.regions, masks, strict=True)]

        def reference(index: int) -> FloatArray:
            now, mask, old = pictures[index], masks[index], self.references[index]
            if mask.lost:
                return old
            reference = np.where(mask.dilated, now, old)
            if rendered is None or self.trained_errors is None:
                return reference
            shown = np.clip(rendered[index], 0, 1)
            missed = _mean_difference(shown, now, _ERROR_WINDOW_PIXELS) > self.trained_errors[index]
            return np.where(missed & regions[index], old if relit else shown, reference)

        with side_by_side(threads) as each:
            references = list(each(reference, range(len(masks))))
        faint_light = float(np.median([mask.faint_light for mask in masks]))
        light_only = not moved and faint_light > _MIN_LIGHT_ONLY_FRACTION
        return replace(self, references=references, regions=regions, light_only=light_only, relit=self.relit or relit)

    def advance(
        self,
        pictures: Sequence[FloatArray],
        masks: Sequence[FrameMask],
        settings: MaskSettings,
        *,
        deferred: bool = False,
    ) -> MaskMemory:
        """For the next frame; ``deferred``: this frame's changes still wait for training."""
        references = self.references
        if not (deferred or settings.since_trained):
            lost = [bool(mask.lost) for mask in masks] or [False] * len(pictures)
            views = zip(pictures, references, lost, strict=True)
            references = [old if is_lost else now for now, old, is_lost in views]
        return replace(self, references=references, previous=tuple(pictures))

    def _dropouts(self, pictures: Sequence[FloatArray], changes: Sequence[PixelChange]) -> list[str]:
        """Reason why each view's picture does not show its frame, or ""."""
        blank = ["" if was_blank else blankness(now) for now, was_blank in zip(pictures, self.blank, strict=True)]
        repeated = [repeats(*pair) for pair in zip(pictures, self.previous, strict=True)]
        if self.subject and all(blank):
            blank = [""] * len(blank)
        flags = zip(changes, blank, repeated, strict=True)
        changed = sum(bool(change.raw.any()) for change, reason, repeat in flags if not (reason or repeat))
        if 2 * changed <= blank.count(""):
            return blank
        return [reason or (FROZEN if repeat else "") for reason, repeat in zip(blank, repeated, strict=True)]

    def _light_threshold(
        self,
        now: FloatArray,
        reference: FloatArray,
        region: BoolArray,
        noise: float,
        settings: MaskSettings,
        recorded: BoolArray | None,
    ) -> tuple[float, float]:
        """Levels from which faint light counts, 0 for nowhere; and `FrameMask.faint_light`.

        ``region``: that of other changes. ``noise``: of a pixel, in levels.
        """
        if not settings.light_threshold:
            return 0.0, 0.0
        noise /= _LIGHT_WINDOW_PIXELS
        usual, low = (max(factor * settings.light_threshold, noise) for factor in (1.0, _LOW_THRESHOLD_FACTOR))
        light, faint_light = _light_fractions(now, reference, region, (usual, low), recorded)
        if self.light_only or faint_light > _GLOBAL_LIGHT_FRACTION:
            return low, faint_light
        return (usual if light > _MIN_LIGHT_FRACTION else 0.0), faint_light

    def full_masks(self, changes: Sequence[PixelChange]) -> list[FrameMask]:
        """Masks of all recorded pixels, of every view that shows its frame; none where no changes were looked for."""
        views = zip(changes, self.recorded, strict=bool(changes))
        masks = [_recorded(np.full_like(change.raw, not change.lost), recorded) for change, recorded in views]
        return [FrameMask(mask, mask, lost=change.lost) for change, mask in zip(changes, masks, strict=True)]

    def shares(self, masks: Sequence[BoolArray]) -> list[float]:
        """Of each view's recorded pixels that its mask (H, W) marks, 0 to 1; none where no masks were made."""
        return [share(*each) for each in zip(masks, self.recorded, strict=bool(masks))]

    def changed_fraction(
        self, pictures: Sequence[FloatArray], before: Sequence[FloatArray], settings: MaskSettings
    ) -> float:
        """Fraction of recorded pixels, median over the views, that differ from those ``before``."""
        pairs = zip(pictures, before, strict=True)
        return float(np.median(self.shares([difference_mask(*pair, settings.threshold) for pair in pairs])))


def _recorded(mask: BoolArray, recorded: BoolArray | None) -> BoolArray:
    """The mask in what was recorded."""
    return mask if recorded is None else mask & recorded


def _noise_floor(now: FloatArray, reference: FloatArray, settings: MaskSettings, recorded: BoolArray | None) -> float:
    """Levels below which a difference may be noise; 0 where most of the picture clearly changed."""
    if not settings.noise_multiple:
        return 0.0
    negligible = settings.threshold / settings.noise_multiple
    noise = settings.noise_multiple * frame_noise(now, reference, negligible, recorded=recorded)
    if noise <= settings.threshold:
        return noise
    clearly = share(difference_mask(now, reference, CLEAR_CHANGE_LEVELS), recorded)
    return 0.0 if clearly > MAX_NOISE_FRACTION else noise


def _dilated(mask: BoolArray, settings: MaskSettings) -> BoolArray:
    return dilate(mask, settings.radius(mask.shape[1]))


def _trained_error(picture: FloatArray, rendered: FloatArray, recorded: BoolArray | None) -> float:
    """Mean error around a pixel that a fifth of the recorded ones of a fully trained picture (3, H, W) exceed, 0 to 1.

    Of pixels without any error, such as those around a subject, there may be any number.
    """
    error = _mean_difference(np.clip(rendered, 0, 1), picture, _ERROR_WINDOW_PIXELS)
    error = error[error > 0] if recorded is None else error[recorded & (error > 0)]
    return float(np.quantile(error, _TRAINED_ERROR_QUANTILE)) if error.size else 0.0
