"""Selection of the Gaussians that a frame may change: a protocol, two rules, and those of installed packages.

Equations: docs/METHOD.md, "Selection".

Both rules look at the rendering weight of each Gaussian in each view, the sum over pixels of alpha times
transmittance, in all and inside the mask. A view weighs only the tiles that changed or that the mask meets.

* ``paper``: the projected centre lies in the dilated mask in at least ``min_views`` views in which it is visible.
* ``weight``: in the views where it is visible, more than ``min_fraction`` of its weight falls inside the masks. It
  excludes the background behind moving objects (encoder/DESIGN.md: 20 % selected instead of 77 %
  on `panoptic_basketball`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..backends import FixedView
from ..registry import Registry, described, guarded
from ..settings.frame import SelectionSettings

VISIBLE_WEIGHT = 0.02
"""Pixels of rendering weight from which a view sees a Gaussian: the paper's rule would take what is hidden."""


@dataclass(frozen=True)
class ViewEvidence:
    """Every Gaussian's contribution to one view, in all and inside the dilated mask.

    ``weight``, ``masked_weight`` (N,): the rendering weight in pixels, in all and inside the mask. ``centre_inside``:
    computes on demand whether the projected centre lies inside (N,), False for undrawn Gaussians.
    """

    weight: NDArray[np.float32]
    masked_weight: NDArray[np.float32]
    centre_inside: Callable[[], NDArray[np.bool_]]


class SelectionRule(Protocol):
    """Chooses S_t, (N,) bool, from every view's evidence; called once or twice a frame, from one thread.

    The choice must depend on the evidence alone: resumed and repeated encodes are identical to the bit.
    """

    def __call__(self, views: Sequence[ViewEvidence], settings: SelectionSettings, /) -> NDArray[np.bool_]: ...


def by_centres(views: Sequence[ViewEvidence], settings: SelectionSettings, /) -> NDArray[np.bool_]:
    """The paper's rule: the centre is in the mask in enough of the views in which the Gaussian is visible."""
    return _in_enough_views(views, [view.centre_inside() for view in views], settings)


def by_weight(views: Sequence[ViewEvidence], settings: SelectionSettings, /) -> NDArray[np.bool_]:
    """Part of the weight is in the mask in enough views, and enough of it over all views that see the Gaussian."""
    chosen = _in_enough_views(views, [view.masked_weight > 0 for view in views], settings)
    visible = [view.weight >= VISIBLE_WEIGHT for view in views]
    masked = sum(np.where(seen, view.masked_weight, 0) for seen, view in zip(visible, views, strict=True))
    total = sum(np.where(seen, view.weight, 0) for seen, view in zip(visible, views, strict=True))
    return np.asarray(chosen & (masked > settings.min_fraction * total))


def _wrong_choice(chosen: object, views: Sequence[ViewEvidence], settings: SelectionSettings) -> str:
    shape = views[0].weight.shape
    if isinstance(chosen, np.ndarray) and chosen.shape == shape and chosen.dtype == np.bool_:
        return ""
    return f"{described(chosen)}, not one bool for each Gaussian: bool {shape}"


SELECTION_RULES: Registry[SelectionRule] = Registry(
    "selection rule",
    "decogs.selection_rules",
    {"paper": by_centres, "weight": by_weight},
    guarded(_wrong_choice),
)


def view_evidence(view: FixedView, mask: NDArray[np.bool_]) -> ViewEvidence:
    """Weighs every Gaussian of the static scene against the view's dilated mask (H, W)."""
    weight, masked_weight = view.redraw(mask)
    return ViewEvidence(weight, masked_weight, lambda: _centres_inside(view.centres(), mask))


def select(views: Sequence[ViewEvidence], settings: SelectionSettings) -> NDArray[np.bool_]:
    """S_t as a mask over the Gaussians, (N,). Raises UsageError when the settings' rule is not installed."""
    return SELECTION_RULES.get(settings.rule)(views, settings)


def _in_enough_views(
    views: Sequence[ViewEvidence], inside: Sequence[NDArray[np.bool_]], settings: SelectionSettings
) -> NDArray[np.bool_]:
    votes = sum(
        ((view.weight >= VISIBLE_WEIGHT) & met).astype(np.int32) for view, met in zip(views, inside, strict=True)
    )
    return np.asarray(votes >= min(settings.min_views, len(views)))


def _centres_inside(centres: NDArray[np.float32], mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    height, width = mask.shape
    with np.errstate(invalid="ignore"):
        inside = (centres[:, 0] >= 0) & (centres[:, 0] < width) & (centres[:, 1] >= 0) & (centres[:, 1] < height)
    centre_inside = np.zeros(len(centres), bool)
    pixels = centres[inside].astype(np.int64)
    centre_inside[inside] = mask[pixels[:, 1], pixels[:, 0]]
    return centre_inside
