"""Pictures with an ICC profile into sRGB, by LittleCMS through Pillow, which is loaded with the first profile."""

from __future__ import annotations

import io
import itertools
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from PIL.ImageCms import ImageCmsTransform

_KEPT = 8
"""Profiles whose conversion is kept: the cameras of a rig rarely have more."""

_BAND = 1 << 20
"""Numbers of a 16-bit picture that are converted at a time, which takes 30 bytes for each."""


@lru_cache(_KEPT)
def conversion(profile: bytes) -> ImageCmsTransform | None:
    """The conversion of RGB or grey pictures into sRGB; None for a profile that cannot be used.

    The rendering intent is perceptual, as in viewers; for profiles of matrix and curves all intents are one.
    """
    from PIL import ImageCms

    try:
        given = ImageCms.ImageCmsProfile(io.BytesIO(profile))
        mode = {"RGB": "RGB", "GRAY": "L"}.get(given.profile.xcolor_space.strip())
        if mode is None:
            return None
        # What LittleCMS makes faster of grey is up to 10 levels off in the shadows of linear light.
        flags = ImageCms.Flags.NOOPTIMIZE if mode == "L" else ImageCms.Flags.NONE
        return ImageCms.buildTransform(given, ImageCms.createProfile("sRGB"), mode, "RGB", flags=flags)
    except (ImageCms.PyCMSError, OSError, ValueError, TypeError):
        return None


def to_srgb(picture: NDArray[Any], profile: bytes) -> NDArray[Any]:
    """The 8 or 16 bit picture (H, W, 3), grey repeated, in sRGB of 8 bit; untouched if the profile is sRGB's, cannot be
    used, or is for grey and the picture is not."""
    transform = conversion(profile)
    if transform is None or _changes_nothing(profile):
        return picture
    if transform.input_mode == "L" and (picture != picture[..., :1]).any():
        return picture
    if picture.dtype == np.uint8:
        return _apply(transform, picture)
    bands = np.array_split(picture, -(-picture.size // _BAND))
    return np.concatenate([_apply_deep(transform, band) for band in bands])


@lru_cache(_KEPT)
def _changes_nothing(profile: bytes) -> bool:
    """Whether this is sRGB's own profile, in one of its many spellings: no colour moves by more than a level."""
    transform = conversion(profile)
    if transform is None:
        return True
    grey = transform.input_mode == "L"
    levels = np.arange(0, 256, 15, dtype=np.uint8)
    cube = np.array([(v, v, v) for v in levels] if grey else list(itertools.product(levels, repeat=3)), np.uint8)
    return bool(np.abs(_apply(transform, cube[None]).astype(int) - cube).max() <= 1)


def _apply(transform: ImageCmsTransform, picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    from PIL import Image

    coded = picture[..., 0] if transform.input_mode == "L" else picture
    return np.asarray(transform.apply(Image.fromarray(np.ascontiguousarray(coded))), np.uint8)


def _apply_deep(transform: ImageCmsTransform, picture: NDArray[np.uint16]) -> NDArray[np.uint8]:
    """Pillow converts 8 bit only: between the eight nearest colours of 8 bit, results are interpolated."""
    below = (picture // 257).astype(np.uint8)
    ends = below, np.minimum(below, 254) + np.uint8(1)
    share = (picture - below * np.uint16(257)).astype(np.float32) / 257
    weights = 1 - share, share
    total = np.zeros(picture.shape, np.float32)
    for corner in itertools.product((0, 1), repeat=3):
        near = np.stack([ends[end][..., channel] for channel, end in enumerate(corner)], axis=2)
        red, green, blue = (weights[end][..., channel] for channel, end in enumerate(corner))
        total += (red * green * blue)[..., None] * _apply(transform, near)
    return np.rint(total).astype(np.uint8)
