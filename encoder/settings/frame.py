"""How a later frame is masked, selected, trained and coded, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from decogs.formats.errors import UsageError

from .cache import CacheSettings
from .checked import (
    Checked,
    Count,
    Decay,
    Levels,
    Loss,
    OneOf,
    Opacity,
    Rate,
    Share,
    Steps,
    Stretch,
    Within,
)
from .optimiser import LearningRates


@dataclass(frozen=True)
class MaskSettings(Checked):
    """Which pixels count as changed, and how far the region of interest reaches around them.

    ``threshold``: change of a pixel in 8-bit levels (paper: 25). Lower selects more and is slower.
    ``radius_fraction``: radius of the dilation in units of the picture's width (paper: 48 px of 1352). More is slower.
    ``speck_area``: connected changes (8 neighbours) of fewer pixels are dropped before the dilation; 0, the paper's,
    drops none. A few pixels help with noisy sensors.
    ``since_trained``: a pixel is compared with the picture on which it was last trained, not with the frame before.
    Slow changes then add up until they pass the threshold.
    ``noise_multiple``: a camera's threshold is at least so many standard deviations of its own noise from frame to
    frame, unless most of the picture changed; 0 turns it off.
    ``residual``: a pixel that changed earlier stays changed while the rendering misses it by more than so many levels.
    Later frames then correct the errors of one. Lower selects more; 0 turns it off.
    ``refine_frames``: disocclusion refinement. Pixels that changed by more than ``refine_threshold`` levels as
    something moved stay in the region of interest for so many more frames. More is slower.
    ``light_threshold``: levels by which the mean over a small window must change to count as well, where light changes
    much of the picture; half of it where light changes nearly all of it, and after a frame in which light alone
    changed. Lower selects more; 0 turns it off.
    """

    threshold: Levels = 25.0
    radius_fraction: Share = 0.0355
    speck_area: Steps = 0
    since_trained: bool = False
    noise_multiple: Annotated[float, Within(0, 1000)] = 0.0
    residual: Levels = 0.0
    refine_frames: Steps = 0
    refine_threshold: Levels = 25.0
    light_threshold: Levels = 0.0

    def radius(self, width: int) -> int:
        """The max-pool's radius in pixels for pictures of this width."""
        return round(self.radius_fraction * width)


@dataclass(frozen=True)
class SelectionSettings(Checked):
    """How changed pixels select Gaussians. ``rule``: a name in SELECTION_RULES.

    ``min_views``: the paper's kappa, the views that must show a change. Higher selects fewer and is faster.
    ``min_fraction``: share of a Gaussian's rendering weight that must lie inside the masks, 0 to 1. Higher selects
    fewer and is faster.
    ``visible_weight``: rendering weight, in pixels, from which a view sees a Gaussian.
    ``refine_fraction``: the ``min_fraction`` of pixels that are only refined (`MaskSettings.refine_frames`). Gaussians
    that other views kept seeing need no refinement.
    """

    rule: str = "weight"
    min_views: Count = 2
    min_fraction: Share = 0.65
    visible_weight: Annotated[float, Within(0, 1e6)] = 0.02
    refine_fraction: Share = 0.8


@dataclass(frozen=True)
class FocusWeights(Checked):
    """The weights of ``(1 - lambda) (beta1 L1 + beta2 L1_focus) + lambda (1 - SSIM_focus)``.

    ``over``: what the two terms of the focus are means over. "picture": the text's, whose norms are over whole pictures
    that are 0 outside the region of interest. "region": the region of interest, whose pixels weigh more the fewer they
    are. Source: DecoGS, focus-aware loss (docs/METHOD.md, "Focus-aware loss").
    """

    dissimilarity: Share = 0.2
    whole: Annotated[float, Within(0, 1000)] = 0.2
    focus: Annotated[float, Within(0, 1000)] = 0.8
    over: Annotated[str, OneOf(("region", "picture"))] = "region"


@dataclass(frozen=True)
class IterationSettings(Checked):
    """How many of its iterations a frame runs.

    ``usual_miss``: share of the region of interest that the scene misses by more than 25 levels in a usual frame. A
    frame that misses twice as much runs twice as many iterations. Lower is slower; 0: every frame runs all.
    ``min_factor``, ``max_factor``: bounds of that factor. Higher is slower. With ``min_factor`` below 1, moving things
    lose quality over hundreds of frames.
    """

    usual_miss: Share = 0.0
    min_factor: Annotated[float, Within(0.01, 100)] = 1.0
    max_factor: Annotated[float, Within(0.01, 100)] = 3.0

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.min_factor > self.max_factor:
            raise UsageError(
                f"`min_factor` {self.min_factor:g}: it is above `max_factor` {self.max_factor:g}; give at most that "
                "(IterationSettings)"
            )


@dataclass(frozen=True)
class EmergenceSettings(Checked):
    """How new objects are found and seeded; ``max_seeds`` 0 turns it off.

    ``residual``: 8-bit levels by which a rendering must miss the picture. Lower finds fainter objects, and more wrong
    ones. ``min_fraction``: share of all views' pixels that must be missed before a search begins.
    ``max_seeds``: seeds of one frame. ``max_rays``: rays of one frame; more is slower and makes more and smaller
    Gaussians.
    ``depths``: steps along a ray. ``min_views``: views that must miss the same point. ``missing_fraction``: share of
    the views that see the point and need not miss it. ``spread``: 8-bit levels by which colours of one point may
    differ. ``in_front``: share of the rendered depth by which a seed must lie before it. ``opacity``: of a seed.
    """

    residual: Levels = 25.0
    min_fraction: Share = 2e-4
    max_seeds: Steps = 2000
    max_rays: Count = 2000
    depths: Annotated[int, Within(2, 4096)] = 64
    min_views: Count = 4
    missing_fraction: Share = 0.25
    spread: Levels = 14.0
    in_front: Share = 0.02
    opacity: Opacity = 0.3


@dataclass(frozen=True)
class SignificanceSettings(Checked):
    """Which changes are significant enough to be coded, and how exactly.

    ``threshold``: a change is coded if it moves the mean loss of a picture by at least so many millionths (1: one pixel
    of a million from black to white). Higher is smaller and less exact; 0 codes every change.
    ``decide_at``: share of stage 2 after which insignificant changes are reverted, once.
    ``lit_factor``: factor of the threshold for positions, sizes and rotations of Gaussians that only light changes,
    where a frame's effects are detected. Higher leaves them colour and opacity alone, which is smaller.
    ``rd_lambda``: the rate-distortion trade-off of the changes that are coded, of positions, sizes and rotations:
    squared change of a picture's loss, in millionths, that a bit is worth. Higher is smaller and less exact; 0 codes
    the nearest lattice point. ``colour_rd_lambda``: the same of colours and opacities, whose errors add up where light
    changes an area.
    """

    threshold: Loss = 0.0
    decide_at: Share = 0.6
    lit_factor: Annotated[float, Within(0, 1e6)] = 1.0
    rd_lambda: Loss = 0.0
    colour_rd_lambda: Loss = 0.0


@dataclass(frozen=True)
class FrameSettings(Checked):
    """How a later frame is trained. The defaults are the paper's where it gives a number.

    ``joint_iterations``: steps. More is slower and follows faster motion. ``cache_iterations``, ``cache``: steps of
    method "paper" before them, and its neural transformation cache; None: `CacheSettings`.
    ``warm_start``: share of the last displacement to begin with, 0 to 1: the median over the ``warm_neighbours``
    nearest selected Gaussians.
    ``grow_gradient``: the paper's tau_d. Lower adds more. ``grow_fraction``: most additions of one frame, as a share
    of the selected Gaussians, rounded up. More is slower and larger. ``prune_opacity``: Gaussians below it are removed.
    ``rates``: of stage 2, ``means`` in units of the rig's extent. Over its second half they fall to ``late_decay`` of
    that. ``beta1``, ``beta2``: Adam's decay rates in stage 2.
    ``max_stretch``: largest ratio of a Gaussian's largest to its middle size that stage 2 may bring about; 0: any.
    ``adaptive_iterations``: how the iterations follow from what a frame misses.
    ``significance``: which changes are coded. ``emergence``: how new objects are seeded. Method "paper" reverts no
    change, seeds nothing, and always runs its iterations.
    ``ablated``: parts of the method that are left out (`switches.without`).
    ``densification``: a name in DENSIFICATIONS.
    """

    masks: MaskSettings = field(default_factory=MaskSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    cache: CacheSettings | None = field(default_factory=CacheSettings)
    cache_iterations: Steps = 150
    joint_iterations: Steps = 100
    warm_start: Share = 0.0
    warm_neighbours: Count = 8
    grow_gradient: Rate = 1e-4
    grow_fraction: Share = 0.05
    prune_opacity: Share = 0.01
    focus: FocusWeights = field(default_factory=FocusWeights)
    rates: LearningRates = field(default_factory=lambda: LearningRates(1.28e-3, 2e-2, 8e-3, 0.1, 2e-2, 1e-3))
    late_decay: Share = 0.2
    beta1: Decay = 0.9
    beta2: Decay = 0.999
    max_stretch: Stretch = 0.0
    adaptive_iterations: IterationSettings = field(default_factory=IterationSettings)
    significance: SignificanceSettings = field(default_factory=SignificanceSettings)
    emergence: EmergenceSettings = field(default_factory=EmergenceSettings)
    ablated: Annotated[tuple[str, ...], OneOf(("focus", "gate"))] = ()
    densification: str = "clone-split"
