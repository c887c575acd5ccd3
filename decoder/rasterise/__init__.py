"""Renders a scene of Gaussians through a pinhole camera: a fast native kernel and a readable float64 twin.

EWA splatting with the opacity-compensated low-pass filter of Mip-Splatting, so that a picture at another scale
keeps its brightness; one C++ source compiled per instruction set; tiles of 16x16 pixels composited in 4x4 blocks.

A backend is a function with the signature of ``native.render_planes``.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from decogs.formats.cameras import Camera, is_distorted
from decogs.formats.errors import UsageError
from decogs.formats.splats import FloatArray, Splats

from .faces import faces_of
from .native import MAX_PAIRS, render_planes


@dataclass(frozen=True)
class Rendering:
    """What a camera sees: image (H, W, 3) display-referred, alpha (H, W) 0..1, depth (H, W) in world units.

    Depth is the mean along the view axis of what the pixel shows, weighted as its colour is; 0 where alpha is 0.
    """

    image: FloatArray
    alpha: FloatArray
    depth: FloatArray


def render(
    splats: Splats,
    camera: Camera,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    threads: int = 0,
    max_pairs: int = MAX_PAIRS,
) -> Rendering:
    """The picture of ``splats`` through ``camera``, whose lens distortion must have been taken out (``as_pinhole``).

    ``threads`` 0 means all processors; the result does not depend on it. Raises UsageError for a camera with a lens,
    for Gaussians that are not finite, which would be left out, and above ``max_pairs`` of a 16x16 tile and a Gaussian,
    which is what bounds the memory taken; MemoryError when there is none. Very wide pictures are drawn in parts
    (``faces``). Source: Kerbl 2023, equation 3.
    """
    for field in fields(splats):
        finite = np.isfinite(getattr(splats, field.name))
        if not finite.all():
            bad = len(splats) - int(finite.reshape(len(splats), -1).all(axis=1).sum())
            raise UsageError(f"{field.name} of {bad} of {len(splats)} Gaussians are not finite; take those out first")
    if is_distorted(camera):
        raise UsageError(
            f"camera {camera.name}: render through its pinhole and re-apply the lens distortion afterwards"
        )
    faces = faces_of(camera)
    if not faces:
        return _drawn(splats, camera, background, threads, max_pairs)
    size = camera.height, camera.width
    whole = Rendering(*(np.zeros((*size, *more), np.float32) for more in ((3,), (), ())))
    for face in faces:
        face.put_all(_drawn(splats, face.camera, background, threads, max_pairs), whole)
    return whole


def _drawn(
    splats: Splats, camera: Camera, background: tuple[float, float, float], threads: int, max_pairs: int
) -> Rendering:
    rgb, alpha, depth_sum = render_planes(splats, camera, background, threads, max_pairs)
    depth = np.divide(depth_sum, alpha, out=np.zeros_like(depth_sum), where=alpha > 0)
    return Rendering(np.ascontiguousarray(rgb.transpose(1, 2, 0)), alpha, depth)
