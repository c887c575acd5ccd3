"""One camera in the search for first points: its pinhole model, its picture and a normalised picture for matching."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.resizing import recorded_pixels
from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.colours.srgb import LUMA
from decogs.rig.numerics import floats

Array = NDArray[np.float32]
_WINDOW_SIGMA = 3.0
"""Standard deviation, in pixels, of the window in which brightness and contrast are normalised."""
_MIN_CONTRAST = 0.012
"""Contrast below which a window is noise rather than texture, picture units (3 of 255 steps)."""


@dataclass(frozen=True)
class SweepView:
    """One camera at the resolution of the sweep.

    ``picture`` (H, W, 3) RGB 0..1; ``normalised`` (H, W) luminance with local mean and contrast taken out, so that
    exposure and white balance of the cameras do not matter; ``centred`` (H, W) with the local mean alone taken out;
    ``contrast`` (H, W) its standard deviation around each pixel. ``recorded`` (H, W): where the picture was; None means
    everywhere.
    ``intrinsics`` and its inverse put the centre of the first pixel at (0, 0), as OpenCV's sampling does.
    """

    camera: Camera
    picture: Array
    normalised: Array
    centred: Array
    contrast: Array
    intrinsics: NDArray[np.float64]
    rotation: NDArray[np.float64]
    translation: NDArray[np.float64]
    centre: NDArray[np.float64]
    recorded: NDArray[np.bool_] | None = None

    @property
    def width(self) -> int:
        """Of the picture, in pixels."""
        return self.camera.width

    @property
    def height(self) -> int:
        """Of the picture, in pixels."""
        return self.camera.height

    @property
    def focal(self) -> float:
        """Focal length in pixels, the geometric mean of fx and fy."""
        return float(np.sqrt(self.camera.fx * self.camera.fy))

    @property
    def pixels(self) -> int:
        """That were recorded."""
        return self.width * self.height if self.recorded is None else int(np.count_nonzero(self.recorded))


def make_view(camera: Camera, picture: Array, scale: float, recorded: NDArray[np.bool_] | None = None) -> SweepView:
    """The view of ``camera`` at ``scale`` (at most 1) of its resolution.

    ``picture`` (H, W, 3) RGB 0..1; ``recorded`` (H, W): where it was, None means everywhere.
    """
    if scale < 1:
        camera = scale_camera(camera, scale)
        picture = floats(cv2.resize(picture, (camera.width, camera.height), interpolation=cv2.INTER_AREA))
        recorded = None if recorded is None else recorded_pixels(floats(recorded), camera)
    picture = np.ascontiguousarray(picture)
    luminance = floats(picture @ LUMA.astype(np.float32))
    mean = cv2.GaussianBlur(luminance, (0, 0), _WINDOW_SIGMA)
    centred = luminance - mean
    contrast = np.sqrt(cv2.GaussianBlur(centred * centred, (0, 0), _WINDOW_SIGMA) + np.float32(_MIN_CONTRAST**2))
    rotation, translation = camera.world_to_camera[:3, :3], camera.world_to_camera[:3, 3]
    return SweepView(
        camera=camera,
        picture=picture,
        normalised=centred / contrast,
        centred=centred,
        contrast=contrast,
        intrinsics=np.array(
            [[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1]],
            np.float64,
        ),
        rotation=rotation,
        translation=translation,
        centre=-rotation.T @ translation,
        recorded=recorded,
    )


def pixel_rays(view: SweepView, u: NDArray[np.floating], v: NDArray[np.floating]) -> NDArray[np.float64]:
    """World directions of pixels (u, v; first centre at 0), shape (..., 3), at unit depth along the optical axis."""
    k = view.intrinsics
    camera_rays = np.stack([(u - k[0, 2]) / k[0, 0], (v - k[1, 2]) / k[1, 1], np.ones_like(u)], axis=-1)
    return np.asarray(camera_rays @ view.rotation)


def project(
    view: SweepView, xyz: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Pixel columns, rows (first centre at 0; -1e6 behind the camera) and depths of world points (..., 3)."""
    p = xyz @ view.rotation.T + view.translation
    depth = p[..., 2]
    in_front = depth > 1e-9
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=in_front)
    u = np.where(in_front, view.intrinsics[0, 0] * p[..., 0] * inverse + view.intrinsics[0, 2], -1e6)
    v = np.where(in_front, view.intrinsics[1, 1] * p[..., 1] * inverse + view.intrinsics[1, 2], -1e6)
    return u, v, depth


def inside(view: SweepView, u: NDArray[np.floating], v: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Whether pixel positions (first centre at 0) fall inside what was recorded of the picture."""
    fall = np.asarray((u > -0.5) & (u < view.width - 0.5) & (v > -0.5) & (v < view.height - 0.5))
    return fall if view.recorded is None else fall & was_recorded(view.recorded, u, v, fall)


def was_recorded(
    recorded: NDArray[np.bool_], u: NDArray[np.floating], v: NDArray[np.floating], fall: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Whether the pixels (H, W) at positions were recorded, for those that ``fall`` into the picture."""
    column, row = (np.round(np.where(fall, position, 0)).astype(np.int64) for position in (u, v))
    return recorded[row, column]


def between(view: SweepView, other: SweepView) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """A (3, 3) and b (3,): pixel p = (u, v, 1) of ``view`` at inverse depth d falls on pixel A p + b d of ``other``.

    The third component over d is the depth there; first pixel centres at 0.
    """
    rotation = other.rotation @ view.rotation.T
    offset = other.intrinsics @ (other.translation - rotation @ view.translation)
    return np.asarray(other.intrinsics @ rotation @ np.linalg.inv(view.intrinsics)), np.asarray(offset)
