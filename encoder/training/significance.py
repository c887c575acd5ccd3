"""Significance of changes: hardly visible ones are reverted while training can still compensate for them.

Chosen: a dead zone inside the training loop, in millionths of a picture's loss. A change of one stored number moves the
loss by its size times the gradient (root mean square over steps and views, from Adam's moments). Late in stage 2,
numbers whose change moves the mean loss of a picture by less than the threshold return to the decoder's values and
stay there; the remaining steps train the others around them. The remaining changes are rounded by
rate-distortion optimisation (`rate_distortion.py`).

Measured on workbench (DESIGN.md): 12 kB a frame instead of 100 unrounded, for .2 dB where things move. Rejected: a
dead zone in lattice steps (at the same dynamic PSNR twice the bytes: it spares the sharp and the faint alike); a raised
epsilon in Adam, the prototype's lever (75th percentile: 19 % fewer bytes for .6 dB); predicted motion (5 % of the
positions' bytes: the rest of motion after training is noise, which neighbours do not predict); a threshold in pixels
(at half the size of the pictures the same scene lost 2 dB where things move: PSNR is a mean over the picture, so the
significance of a change is relative to it).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from decogs.codec.scene.lattice import KEPT_SCALE
from decogs.formats.splats import FloatArray, Splats

from ..backends import ATTRIBUTES, Optimiser
from .losses import PhotometricLoss

_GEOMETRY = ("means", "log_scales", "quaternions")


def picture_weight(losses: Sequence[PhotometricLoss]) -> float:
    """Scale from millionths of a whole picture's mean loss to these losses, which are means mostly over a focus."""
    return 1e-6 * float(np.mean([loss.emphasis for loss in losses]))


def revert_insignificant(
    optimiser: Optimiser,
    before: Splats,
    old: NDArray[np.bool_],
    threshold: float,
    geometry_factor: FloatArray | None = None,
) -> None:
    """Reverts the changes since ``before`` below the significance threshold, and freezes these values.

    ``before`` (M) has the optimiser's rows. Rows that are not ``old`` (M,) are new and keep their values. ``threshold``
    is in units of the loss; ``geometry_factor`` (M,): its factor for positions, sizes and rotations of each row.
    """
    optimiser.put(quaternions=_kept_scale(optimiser.splats.quaternions, before.quaternions))
    frozen = {}
    for name in ATTRIBUTES:
        values, was = getattr(optimiser.splats, name), getattr(before, name)
        limit = np.full((len(values),) + (1,) * (values.ndim - 1), threshold, np.float32)
        if name in _GEOMETRY and geometry_factor is not None:
            limit *= geometry_factor[:, None]
        idle = optimiser.gradient_size(name) * np.abs(values - was) < limit
        idle[~old] = False
        optimiser.put(**{name: np.where(idle, was, values)})
        frozen[name] = idle
    optimiser.freeze(frozen)


def _kept_scale(quaternions: FloatArray, before: FloatArray) -> FloatArray:
    """The quaternions, scaled so that the formerly largest component keeps its value; the rotations stay."""
    quaternions = quaternions.copy()
    row, largest = np.arange(len(before)), np.abs(before).argmax(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = before[row, largest] / quaternions[row, largest]
    low, high = KEPT_SCALE
    usable = (scale > 1 / high) & (scale < 1 / low)
    quaternions[usable] *= scale[usable, None]
    quaternions[row[usable], largest[usable]] = before[row[usable], largest[usable]]
    return quaternions
