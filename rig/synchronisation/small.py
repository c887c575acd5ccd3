"""Recordings as motion is looked for in them: grey, small, some frames of each."""

from __future__ import annotations

import math
from collections.abc import Iterator

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.pictures.reading import Picture
from decogs.formats.rigs import FrameSource, read_repeating

from ..pictures.ingest import display_referred

U8 = NDArray[np.uint8]

_MAX_PIXELS = 352 * 264
MAX_FRAMES = 300
"""Of each recording in which motion is looked for: ten seconds, which bounds memory and time."""


def small_camera(camera: Camera) -> Camera:
    """The camera at the size of its small pictures."""
    return scale_camera(camera, min(1.0, math.sqrt(_MAX_PIXELS / (camera.width * camera.height))))


def small_clip(source: FrameSource, frames: range, camera: Camera) -> Iterator[U8]:
    """Pictures of a recording, grey and at a small camera's size; one that cannot be read is as the one before."""
    for picture in read_repeating(source, frames):
        yield small_grey(picture, camera)


def small_grey(picture: Picture, camera: Camera) -> U8:
    """The picture (H, W), grey, at the camera's size."""
    levels = picture if picture.dtype == np.uint8 else np.rint(display_referred(picture) * 255).astype(np.uint8)
    grey = cv2.cvtColor(levels, cv2.COLOR_RGB2GRAY)
    if grey.shape != (camera.height, camera.width):
        grey = cv2.resize(grey, (camera.width, camera.height), interpolation=cv2.INTER_AREA)
    return np.asarray(grey, np.uint8)
