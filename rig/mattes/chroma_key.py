"""A subject before a screen of one colour, told by the angle of colours in the CbCr plane.

The screen is found in every picture anew, so that uneven light, shadows on it and a camera's own colours are followed:
first whatever is near the key's angle and saturated, then what agrees with the screen around it. Screen-coloured cloth
inside the subject is told from a gap through which the screen shows by its own pattern and brightness, as far as it has
any. Figures: DESIGN.md.

Sources: Jack, "Video Demystified" (key angle and its strength); Smith and Blinn 1996.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.colours.srgb import LUMA
from decogs.formats.errors import UsageError
from decogs.formats.splats import FloatArray

from .cutting import BoolArray, Subject, cut_out
from .filling import shrunk_and_filled

_COLOURS = {"green": (0, 255, 0), "blue": (0, 0, 255)}
_Y = LUMA.astype(np.float32)
_CBCR = np.array([[-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]], np.float32)
"""ITU-T T.871, without offsets."""

_MAX_KEY_ANGLE, _MIN_SATURATION = 30.0, 0.2
"""Of a screen: degrees from the key that is named, chroma relative to luma."""
_MIN_SCREEN_SHARE = 0.02
"""Of a picture, from which it shows a screen."""
_NEAR_ANGLE, _NEAR_SATURATION = 15.0, 0.6
"""Of what may be screen: degrees from the screen's own angle, saturation relative to the screen's."""
_SCREEN_ANGLE, _SCREEN_SATURATION, _SCREEN_LIGHT = 3.0, 0.08, (0.25, 1.2)
"""Of what is screen, relative to the screen around it: degrees, saturation, bounds of luma: shadows."""
_GAP_ANGLE, _GAP_SATURATION, _GAP_LIGHT, _GAP_PATTERN = 2.0, 0.05, 1.1, 0.1
"""The same of the median of a region amid the subject, and the deviation of its luma's logarithm."""
_MAX_GAP_SHARE, _MIN_REGION_SHARE = 0.02, 2e-4
"""Of the picture, of a gap and of a region of the screen."""
_SMOOTHING_PIXELS = 0.8
_FAINT_SPILL, _CLOTH = 0.3, 0.6
"""Key strength relative to the screen's, up to which it is spill and goes; from which it is cloth and stays."""
_ROUNDS = 2
"""What is screen is told against the screen found before."""
_PLATE_WIDTH, _SAMPLED = 160, 2
"""Of the screen as it goes on behind the subject, in pixels; and every so manieth pixel tells its own axis."""
_DARK = 1e-3
"""Least luma, linear, whose colour is told."""


@dataclass(frozen=True)
class Keyed:
    """The subject before a screen, and the share of its pixels that have the screen's colour."""

    subject: Subject
    screen_coloured_share: float


def key_axis(text: str) -> FloatArray:
    """The direction (2,) of a screen's colour in the CbCr plane, of a name or of "R,G,B" with 8 bits each."""
    try:
        rgb = _COLOURS[text] if text in _COLOURS else tuple(int(part) for part in text.split(","))
    except (AttributeError, ValueError):
        rgb = ()
    if len(rgb) != 3 or not all(0 <= value <= 255 for value in rgb):
        raise UsageError(f"`key` {text}: give green, blue, or the screen's colour as R,G,B with 0 to 255 each")
    if max(rgb) - min(rgb) < 0.2 * max(rgb) or not any(rgb):
        raise UsageError(f"`key` {text}: a grey screen has no colour to key by; use `background_plate`")
    return _unit(_CBCR @ (np.array(rgb, np.float32) / 255) ** np.float32(2.2))


def keyed(picture: FloatArray, axis: FloatArray) -> Keyed | None:
    """The subject in a picture (H, W, 3), linear, spill taken off; None where no screen of the ``axis`` is."""
    smooth = np.asarray(cv2.GaussianBlur(picture, (0, 0), _SMOOTHING_PIXELS), np.float32)
    own = _own_axis(smooth, axis)
    if own is None:
        return None
    tones = _tones(smooth, own)
    screen, screen_coloured = _near(tones), np.zeros(tones.luma.shape, np.bool_)
    for _ in range(_ROUNDS):
        screen, screen_coloured = _screen(_against(tones, _spread(picture, screen), own))
        if not screen.any():
            return None
    plate = _resized(_spread(picture, screen), screen.shape)
    subject = cut_out(picture, plate, screen)
    covered = max(float(subject.alpha.sum()), 1.0)
    colours = _without_spill(subject.colours, plate, own)
    return Keyed(Subject(subject.alpha, colours), float(np.count_nonzero(screen_coloured)) / covered)


def _unit(vector: FloatArray) -> FloatArray:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-12), np.float32)


@dataclass(frozen=True)
class _Tones:
    """Degrees from an axis, saturation and luma of pixels (H, W)."""

    angle: FloatArray
    saturation: FloatArray
    luma: FloatArray


def _tones(picture: FloatArray, axis: FloatArray) -> _Tones:
    chroma, luma = picture @ _CBCR.T, np.maximum(picture @ _Y, np.float32(_DARK))
    along, across = chroma @ axis, chroma @ np.array([-axis[1], axis[0]], np.float32)
    return _Tones(np.degrees(np.arctan2(across, along)), np.hypot(along, across) / luma, luma)


def _own_axis(picture: FloatArray, axis: FloatArray) -> FloatArray | None:
    """The mean direction of the screen's colours near the key's; None where there is hardly any."""
    picture = picture[::_SAMPLED, ::_SAMPLED]
    tones = _tones(picture, axis)
    near = (np.abs(tones.angle) < _MAX_KEY_ANGLE) & (tones.saturation > _MIN_SATURATION) & (tones.luma > 4 * _DARK)
    if near.mean() < _MIN_SCREEN_SHARE:
        return None
    return _unit((picture[near] @ _CBCR.T).sum(axis=0))


def _near(tones: _Tones) -> BoolArray:
    near = np.abs(tones.angle) < _NEAR_ANGLE
    near &= tones.saturation > _NEAR_SATURATION * np.median(tones.saturation[near])
    labels, stats = _regions(near)
    return np.asarray(_large(stats, near.size)[labels])


def _regions(mask: BoolArray) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=4)
    return np.asarray(labels, np.int32), np.asarray(stats, np.int32)


def _large(stats: NDArray[np.int32], pixels: int) -> BoolArray:
    large = stats[:, cv2.CC_STAT_AREA] >= _MIN_REGION_SHARE * pixels
    large[0] = False
    return np.asarray(large)


def _against(tones: _Tones, plate: FloatArray, axis: FloatArray) -> _Tones:
    """Degrees from the plate, which may be smaller; saturation and luma relative to the plate's."""
    behind = _tones(plate, axis)
    angle, saturation, luma = _resized(
        np.stack([behind.angle, np.maximum(behind.saturation, np.float32(1e-6)), behind.luma], axis=2), tones.luma.shape
    ).transpose(2, 0, 1)
    return _Tones(tones.angle - angle, tones.saturation / saturation, tones.luma / luma)


def _resized(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    return np.asarray(cv2.resize(values, shape[::-1], interpolation=cv2.INTER_LINEAR), np.float32)


def _screen(tones: _Tones) -> tuple[BoolArray, BoolArray]:
    """Where the screen shows, and where the subject has its colour; both (H, W)."""
    alike = (np.abs(tones.angle) < _SCREEN_ANGLE) & (np.abs(tones.saturation - 1) < _SCREEN_SATURATION)
    alike &= (tones.luma > _SCREEN_LIGHT[0]) & (tones.luma < _SCREEN_LIGHT[1])
    labels, stats = _regions(alike)
    shown, (height, width) = _large(stats, alike.size), alike.shape
    screen_coloured = np.zeros_like(shown)
    for label in np.flatnonzero(shown):
        x, y, w, h, area = stats[label]
        amid = x > 0 and y > 0 and x + w < width and y + h < height and area < _MAX_GAP_SHARE * alike.size
        if amid and not _is_gap(tones, labels, int(label), (slice(y, y + h), slice(x, x + w))):
            shown[label], screen_coloured[label] = False, True
    return np.asarray(shown[labels]), np.asarray(screen_coloured[labels])


def _is_gap(tones: _Tones, labels: NDArray[np.int32], label: int, box: tuple[slice, slice]) -> bool:
    """Whether a region shows the screen: evenly, in its colour, no brighter. Mixed pixels at its rim do not count."""
    region = cv2.erode((labels[box] == label).astype(np.uint8), np.ones((3, 3), np.uint8), borderValue=0) > 0
    if np.count_nonzero(region) < 4:
        return False
    angle, saturation, luma = (values[box][region] for values in (tones.angle, tones.saturation, tones.luma))
    return bool(
        abs(np.median(angle)) < _GAP_ANGLE
        and abs(np.median(saturation) - 1) < _GAP_SATURATION
        and np.median(luma) < _GAP_LIGHT
        and np.std(np.log(luma)) < _GAP_PATTERN
    )


def _spread(picture: FloatArray, screen: BoolArray) -> FloatArray:
    """The screen's colours, shrunk, going on behind the subject."""
    weights = cv2.erode(screen.astype(np.uint8), np.ones((3, 3), np.uint8)).astype(np.float32)
    height, width = screen.shape
    return shrunk_and_filled(picture, weights, (_PLATE_WIDTH, max(1, round(height * _PLATE_WIDTH / width))))


def _strength(picture: FloatArray, axis: FloatArray) -> FloatArray:
    """Chroma along the key's axis, beyond a wedge of 120 degrees, relative to luma. Source: Jack."""
    chroma, luma = picture @ _CBCR.T, np.maximum(picture @ _Y, np.float32(_DARK))
    along, across = chroma @ axis, chroma @ np.array([-axis[1], axis[0]], np.float32)
    return np.asarray(np.maximum(along - np.abs(across) / np.float32(3**0.5), 0) / luma, np.float32)


def _without_spill(colours: FloatArray, plate: FloatArray, axis: FloatArray) -> FloatArray:
    """The colours without the light that the screen throws: chroma along the key's axis goes, luma stays."""
    strength = _strength(colours, axis)
    relative = strength / np.maximum(_strength(plate, axis), np.float32(1e-6))
    kept = np.clip((relative - _FAINT_SPILL) / (_CLOTH - _FAINT_SPILL), 0, 1)
    excess = (1 - kept) * strength * np.maximum(colours @ _Y, np.float32(_DARK))
    # The colour whose chroma is the axis and whose luma is 0.
    of_axis = np.linalg.solve(np.stack([_Y, *_CBCR]).astype(np.float64), [0.0, *axis]).astype(np.float32)
    return np.asarray(np.maximum(colours - excess[..., None] * of_axis, 0), np.float32)
