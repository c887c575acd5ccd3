"""Which pixels of the held-out camera are static and which change, and the pictures it recorded.

A rig that ships true masks (``truth/static_CAM.png``, ``truth/changing_CAM.png``) is taken at its word. Any other is
judged by what the held-out camera recorded in the frames measured: mTV's authors set rectangles by hand for the scenes
of one data set and publish no rule for others. Rejected: the range of single pixels (over 20 frames sensor noise alone
spans 5 to 8 levels; the mean of 3x3 pixels spans 3 to 4).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.output.pictures import to_8bit
from decogs.encoder.change.masks import difference_mask, dilate
from decogs.encoder.settings.frame import MaskSettings
from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.errors import RigError
from decogs.formats.pictures.reading import read_picture
from decogs.formats.rigs import Rig, read_frames
from decogs.rig.pictures.ingest import display_referred

from ..timing import retimed
from .metrics import BytePicture, Mask

STATIC_RANGE = 6.0
"""A recorded pixel is static while its 3x3 mean stays within so many 8-bit levels, and so do its neighbours' ..."""
STATIC_MARGIN = 2
"""... up to so many pixels away."""
DYNAMIC_RANGE = 12.0
"""A recorded pixel is dynamic when its 3x3 mean spans more than so many 8-bit levels."""


@dataclass(frozen=True)
class Regions:
    """Pixels (H, W) that never change and pixels that clearly do; the rest counts as neither.

    ``about``: where they come from, for the report. ``undisturbed``: those static ones that lie outside every dilated
    difference mask of the paper in what the camera itself recorded: away from everything that moves.
    """

    static: Mask
    dynamic: Mask
    about: str
    undisturbed: Mask


def held_out_pictures(rig: Rig, camera: str, frames: Sequence[int], scale: float) -> Iterator[BytePicture]:
    """What ``camera`` recorded in ``frames`` (rig indices, any order), 8 bit, at ``scale``, its lens left as it is."""
    size, first = _size(rig, camera, scale), frames[0]
    for _, (picture,) in read_frames(retimed(rig, frames), first, first + len(frames), names=[camera]):
        yield _resized(to_8bit(display_referred(picture)), size)


def true_mattes(rig: Rig, camera: str, frames: Sequence[int], scale: float) -> Iterator[Mask | None]:
    """The subject's pixels (H, W) in ``camera``, frame by frame; None where the rig has no matte.

    ``truth/mattes/CAM/FFFF.png``: subject from half coverage on. Raises RigError for one of another size.
    """
    for frame in frames:
        path = rig.path / "truth" / "mattes" / camera / f"{frame:04d}.png"
        yield _truth(path, rig, camera, scale) if path.is_file() else None


def find_regions(rig: Rig, camera: str, frames: range, scale: float) -> Regions:
    """Static and dynamic pixels of ``camera``. Raises RigError when the rig's own masks do not fit."""
    folder = rig.path / "truth"
    masked = masked_pixels(held_out_pictures(rig, camera, frames, scale))
    static, changing = folder / f"static_{camera}.png", folder / f"changing_{camera}.png"
    if static.is_file() and changing.is_file():
        resting = _truth(static, rig, camera, scale)
        return Regions(
            resting,
            _truth(changing, rig, camera, scale),
            f"the rig's own true masks, {static.name} and {changing.name}",
            resting & ~masked,
        )
    return recorded_regions(held_out_pictures(rig, camera, frames, scale), masked)


def masked_pixels(pictures: Iterator[BytePicture]) -> Mask:
    """Pixels (H, W) inside any dilated difference mask of consecutive pictures, with the paper's threshold and radius.

    Source: DecoGS, difference mask (tau 25 levels, dilation .0355 of the width).
    """
    settings = MaskSettings()
    first = next(pictures)
    height, width, _ = first.shape
    before, masked = _planar(first), np.zeros((height, width), np.bool_)
    for picture in pictures:
        now = _planar(picture)
        masked |= difference_mask(now, before, settings.threshold)
        before = now
    # The union of dilated masks is the dilated union.
    return dilate(masked, settings.radius(width))


def recorded_regions(pictures: Iterator[BytePicture], masked: Mask) -> Regions:
    """Static and dynamic pixels determined from what was recorded, one picture per frame.

    ``masked``: what `masked_pixels` finds in the same ones.
    """
    lowest: NDArray[np.float32] | None = None
    highest: NDArray[np.float32] | None = None
    for picture in pictures:
        mean = np.asarray(cv2.blur(picture.astype(np.float32), (3, 3)), np.float32)
        lowest = mean if lowest is None else np.minimum(lowest, mean)
        highest = mean if highest is None else np.maximum(highest, mean)
    assert lowest is not None
    assert highest is not None
    span = (highest - lowest).max(axis=2)
    window = np.ones((2 * STATIC_MARGIN + 1, 2 * STATIC_MARGIN + 1), np.uint8)
    touched = cv2.dilate((span > STATIC_RANGE).astype(np.uint8), window) > 0
    about = (
        f"determined from the recorded frames: static where the 3x3 mean spans at most {STATIC_RANGE:g} levels within "
        f"{STATIC_MARGIN} pixels, dynamic where it spans more than {DYNAMIC_RANGE:g}"
    )
    return Regions(~touched, span > DYNAMIC_RANGE, about, ~touched & ~masked)


def static_column(regions: Regions, picture: BytePicture) -> int:
    """The image column to follow over time: one of the most static, and of those the one with most detail.

    Only the middle four fifths of the picture: at its sides fewer cameras see the scene.
    """
    share = regions.static.mean(axis=0)
    side = len(share) // 10
    share[:side] = share[len(share) - side :] = -1
    detail = np.abs(np.diff(picture.astype(np.float64).sum(axis=2), axis=0)).mean(axis=0)
    return int(np.argmax(np.where(share >= 0.95 * share.max(), detail, -1.0)))


def _truth(path: Path, rig: Rig, camera: str, scale: float) -> Mask:
    mask = to_8bit(display_referred(read_picture(path)))
    native = _camera(rig, camera)
    if mask.shape[:2] != (native.height, native.width):
        raise RigError(
            f"{path}: {mask.shape[1]} x {mask.shape[0]} pixels, but {camera} has {native.width} x {native.height}; "
            "give the masks the size of the pictures, or take the folder away"
        )
    return np.asarray(_resized(mask, _size(rig, camera, scale))[..., 0] > 127)


def _planar(picture: BytePicture) -> NDArray[np.float32]:
    return np.asarray(picture.transpose(2, 0, 1) / np.float32(255), np.float32)


def _camera(rig: Rig, name: str) -> Camera:
    return next(camera for camera in rig.cameras if camera.name == name)


def measured_size(rig: Rig, camera: str, scale: float) -> str:
    """The size of the camera's pictures at ``scale``, in words."""
    (width, height), own = _size(rig, camera, scale), _camera(rig, camera)
    return f"{width}x{height}" if scale == 1 else f"{width}x{height}, scale {scale:g} of {own.width}x{own.height}"


def _size(rig: Rig, camera: str, scale: float) -> tuple[int, int]:
    scaled = scale_camera(_camera(rig, camera), scale)
    return scaled.width, scaled.height


def _resized(picture: NDArray[np.uint8], size: tuple[int, int]) -> NDArray[np.uint8]:
    if picture.shape[1::-1] == size:
        return picture
    shrinks = size[0] < picture.shape[1]
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_CUBIC), np.uint8)
