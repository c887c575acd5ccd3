"""Changes in coarser steps than the lattice's, so that few and small integers remain to be coded."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decogs.codec.state import Attributes, IntArray

from ..settings.frame import RequantisationSteps


def requantised(before: Attributes, after: Attributes, requantisation: RequantisationSteps) -> Attributes:
    """``after`` with its differences from ``before`` rounded to whole multiples, halves to the even one.

    Where that would leave 32 bits, the difference stays as it is.
    """
    sh_steps = np.full((after.coefficients, 1), requantisation.sh_rest)
    sh_steps[0] = requantisation.sh_dc
    return Attributes(
        _coarse(before.means, after.means, requantisation.means),
        _coarse(before.log_scales, after.log_scales, requantisation.log_scales),
        _coarse(before.quaternions, after.quaternions, requantisation.quaternions),
        _coarse(before.opacity_logits, after.opacity_logits, requantisation.opacity_logits),
        _coarse(before.sh, after.sh, sh_steps),
    )


def _coarse(before: IntArray, after: IntArray, step: int | NDArray[np.int64]) -> IntArray:
    change = after.astype(np.int64) - before
    # Halves towards none would make every change smaller on average, where a multiple is 2: .08 dB on candle.
    whole = np.rint(change / step).astype(np.int64)
    coarse = before + whole * step
    return np.where(np.abs(coarse) <= np.iinfo(np.int32).max, coarse, after).astype(np.int32)
