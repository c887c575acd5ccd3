"""PSNR of a scene against the training or held-out pictures, over recorded pixels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decogs.formats.splats import FloatArray, Splats
from decogs.rig.parallel import side_by_side
from decogs.rig.pictures.ingest import View

from . import TrainingKernel


def psnr_of(mean_square: float) -> float:
    """Peak signal-to-noise ratio in dB of pictures in 0..1."""
    return float(-10 * np.log10(max(mean_square, 1e-12)))


def square_error(rendered: FloatArray, picture: FloatArray) -> float:
    """Mean square error of ``rendered``, clipped to 0..1."""
    return float(((np.clip(rendered, 0, 1) - picture) ** 2).mean(dtype=np.float64))


def mean_psnr(kernel: TrainingKernel, splats: Splats, views: Sequence[View], pictures: Sequence[FloatArray]) -> float:
    """Mean PSNR of ``splats`` through the views against ``pictures`` (3, H, W); NaN without views."""
    return mean_picture_psnr(views, [kernel.forward(splats, view.pinhole).rgb for view in views], pictures)


def mean_picture_psnr(
    views: Sequence[View], rendered: Sequence[FloatArray], pictures: Sequence[FloatArray], *, threads: int = 1
) -> float:
    """Mean over the views of their PSNR, over recorded pixels, ``rendered`` clipped to 0..1; NaN without views."""
    with side_by_side(threads) as each:
        values = list(each(_picture_psnr, views, rendered, pictures))
    return float(np.mean(values)) if values else float("nan")


def _picture_psnr(view: View, rendered: FloatArray, picture: FloatArray) -> float:
    square = (np.clip(rendered, 0, 1) - picture) ** 2
    if view.valid is not None:
        square = square * view.valid
    return psnr_of(float(square.sum(dtype=np.float64)) / (3 * float(_size(view))))


def _size(view: View) -> float:
    if view.valid is None:
        return view.pinhole.width * view.pinhole.height
    return max(1.0, float(view.valid.sum()))
