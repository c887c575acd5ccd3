"""Which Gaussians a frame may change: one protocol, two rules, visibility part of either.

Equations: docs/METHOD.md, "Selection".

Both rules look at the rendering weight of each Gaussian in each view, the sum over pixels of alpha times
transmittance, in all and inside the mask. A view weighs only the tiles that changed or that the mask meets.

* ``paper``: the projected centre lies in the dilated mask in at least ``least_views`` views in which it is visible.
* ``weight``: in the views where it is visible, more than ``least_share`` of its weight falls inside the masks. It
  leaves out the background that merely stands behind moving things (encoder/DESIGN.md: 20 % selected instead of 77 %
  on `panoptic_basketball`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from .rasterise import FixedView

SelectionRule = Literal["paper", "weight"]


@dataclass(frozen=True)
class SelectionSettings:
    """``least_views`` is the paper's kappa; higher selects fewer and is faster, and so does ``least_share``, 0 to 1.

    A Gaussian is visible in a view when its weight there is at least ``visible_weight`` pixels. ``mend_share``: what
    ``least_share`` is where nothing changes any more and the masks only mend (`masks.MaskSettings.mend_frames`): what
    enough views have seen all along needs none.
    """

    rule: SelectionRule = "weight"
    least_views: int = 2
    least_share: float = 0.65
    visible_weight: float = 0.02
    mend_share: float = 0.8


@dataclass(frozen=True)
class ViewEvidence:
    """What one view says of every Gaussian: weight in all and in its mask; centre inside it, if the rule asks."""

    weight: NDArray[np.float32]
    masked_weight: NDArray[np.float32]
    centre_inside: NDArray[np.bool_] | None = None


def view_evidence(view: FixedView, mask: NDArray[np.bool_], rule: SelectionRule) -> ViewEvidence:
    """Weighs every Gaussian of the scene at rest against the view's dilated mask (H, W)."""
    weight, masked_weight = view.refresh(mask)
    return ViewEvidence(weight, masked_weight, _centres_inside(view.centres(), mask) if rule == "paper" else None)


def select(evidence: Sequence[ViewEvidence], settings: SelectionSettings) -> NDArray[np.bool_]:
    """S_t as a mask over the Gaussians, (N,)."""
    visible = [e.weight >= settings.visible_weight for e in evidence]
    inside = [e.masked_weight > 0 if e.centre_inside is None else e.centre_inside for e in evidence]
    votes = sum((seen & met).astype(np.int32) for seen, met in zip(visible, inside, strict=True))
    chosen = np.asarray(votes >= min(settings.least_views, len(evidence)))
    if settings.rule == "weight":
        masked = sum(np.where(seen, e.masked_weight, 0) for seen, e in zip(visible, evidence, strict=True))
        total = sum(np.where(seen, e.weight, 0) for seen, e in zip(visible, evidence, strict=True))
        chosen &= masked > settings.least_share * total
    return chosen


def _centres_inside(centres: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    height, width = mask.shape
    with np.errstate(invalid="ignore"):
        inside = (centres[:, 0] >= 0) & (centres[:, 0] < width) & (centres[:, 1] >= 0) & (centres[:, 1] < height)
    found = np.zeros(len(centres), bool)
    pixels = centres[inside].astype(np.int64)
    found[inside] = mask[pixels[:, 1], pixels[:, 0]]
    return found
