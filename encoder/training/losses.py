"""The losses of the keyframe and of later frames, as weights for the kernel's fused L1 + SSIM.

Lambda is 0.2 as in 3DGS. The paper does not publish beta1 and beta2. They only weigh pixels outside the focus against
pixels inside, since Adam ignores the loss's scale. The choice is 0.2 and 0.8: the whole picture alone, 1 and 0, gains
.17 dB for 54 % more bytes, the focus alone loses .04 dB (report/choices.md).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.errors import TrainingError
from decogs.formats.splats import FloatArray

from ..backends import FixedView, LossValue, TrainingKernel
from ..settings.frame import FocusWeights

_WHITE = np.float32(250 / 255)
"""From here on a pixel may be clipped: a camera's noise is some levels, and takes them off white as well."""


@dataclass(frozen=True)
class PhotometricLoss:
    """A loss against one target picture, ready for the kernel; weight maps are (H, W) float32, None meaning 1.

    ``emphasis``: weight of a pixel in focus over its weight in the mean of the whole picture.
    """

    target: FloatArray
    l1_scale: float
    ssim_scale: float
    l1_weight: FloatArray | None = None
    focus: FloatArray | None = None
    emphasis: float = 1.0

    def with_clipped(self, rendered: FloatArray) -> PhotometricLoss:
        """Without what pixels recorded as white would take off colours (3, H, W) ``rendered`` beyond white."""
        beyond = (self.target >= _WHITE) & (rendered > self.target)
        return replace(self, target=np.where(beyond, rendered, self.target))

    def evaluate(self, kernel: TrainingKernel) -> LossValue:
        """Loss of the last picture of ``kernel``; the kernel keeps its gradient."""
        return kernel.picture_loss(
            self.target,
            l1_scale=self.l1_scale,
            ssim_scale=self.ssim_scale,
            l1_weight=self.l1_weight,
            focus=self.focus,
        )

    def evaluate_drawn(self, view: FixedView) -> LossValue:
        """Loss of the last picture of ``view`` in the tiles that can change; the view keeps its gradient."""
        return view.loss(
            self.target,
            l1_scale=self.l1_scale,
            ssim_scale=self.ssim_scale,
            l1_weight=self.l1_weight,
            focus=self.focus,
        )


class StepLosses:
    """Losses of a frame's steps. To read one waits for the device, so they are checked together, now and then."""

    def __init__(self) -> None:
        self._unchecked: list[tuple[LossValue, Camera]] = []

    def add(self, value: LossValue, camera: Camera) -> None:
        """Takes the loss of a step, which drew ``camera``."""
        self._unchecked.append((value, camera))

    def check(self) -> None:
        """Raises TrainingError for a loss since the last check that is not finite."""
        unchecked, self._unchecked = self._unchecked, []
        for value, camera in unchecked:
            require_finite(value, camera)


def require_finite(value: LossValue, camera: Camera) -> None:
    """Raises TrainingError for a later frame's loss that is not finite."""
    if not math.isfinite(value.total):
        raise TrainingError(f"the loss of camera {camera.name} is {value.total}; lower the learning rates")


def whole_picture_loss(target: FloatArray, counted: FloatArray | None, dissimilarity: float) -> PhotometricLoss:
    """3DGS's loss over the pixels that count (Kerbl 2023, equation 7): (1 - lambda) L1 + lambda (1 - SSIM)."""
    size = max(1.0, 3.0 * (target[0].size if counted is None else float(counted.sum())))
    return PhotometricLoss(target, (1 - dissimilarity) / size, dissimilarity / size, counted, counted)


def focus_loss(
    target: FloatArray, mask: NDArray[np.bool_], valid: FloatArray | None, weights: FocusWeights
) -> PhotometricLoss:
    """The focus-aware loss of a later frame; ``mask`` (H, W) is the dilated difference mask of the view.

    SSIM compares the masked pictures; ``weights.over`` says what the terms of the focus are means over (docs/METHOD.md,
    "Focus-aware loss": how the paper's formula is read). Without a focus, L1 alone remains.
    """
    focus = np.where(mask, np.float32(1) if valid is None else valid, np.float32(0))
    whole_size = max(1.0, 3.0 * (mask.size if valid is None else float(valid.sum())))
    focus_size = 3.0 * float(focus.sum())
    if weights.over == "picture" and focus_size > 0:
        focus_size = whole_size
    whole_weight = np.float32(weights.whole / whole_size)
    in_focus = whole_weight + np.float32(weights.focus / focus_size) if focus_size > 0 else whole_weight
    weight = np.where(mask, in_focus, whole_weight)
    if valid is not None:
        weight *= valid
    ssim_scale = weights.dissimilarity / focus_size if focus_size > 0 else 0.0
    emphasis = weights.whole + weights.focus * whole_size / focus_size if focus_size > 0 else 1.0
    return PhotometricLoss(target, 1 - weights.dissimilarity, ssim_scale, weight, focus, emphasis)
