"""How a later frame is masked, selected, trained and coded, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from .checked import (
    Checked,
    Count,
    Decay,
    Levels,
    Loss,
    Multiple,
    OneOf,
    Share,
    Steps,
    Within,
)
from .optimiser import LearningRates


@dataclass(frozen=True)
class MaskSettings(Checked):
    """Which pixels count as changed, and how far the region of interest reaches around them."""

    threshold: Levels = 25.0  # of a pixel's change (the paper's 25); less selects more: slower
    radius_fraction: Share = 0.0355  # of the dilation, of the picture's width (the paper's 48 px of 1352); more: slower
    speck_area: Steps = 0  # pixels of a connected change, below which it is dropped; 0, the paper's: slower
    since_trained: bool = False  # compare with the picture last trained, not with the frame before: slow changes add up
    noise_multiple: Multiple = 0.0  # least threshold, in deviations of a camera's noise; 0: off, slower
    light_threshold: Levels = 0.0  # of a window's mean, where light changes much; less selects more: slower; 0: off

    def radius(self, width: int) -> int:
        """The max-pool's radius in pixels for pictures of this width."""
        return round(self.radius_fraction * width)


@dataclass(frozen=True)
class SelectionSettings(Checked):
    """How changed pixels select Gaussians."""

    rule: str = "weight"  # a name in SELECTION_RULES
    min_views: Count = 2  # views that must show a change (the paper's kappa); more selects fewer: faster
    min_fraction: Share = 0.65  # of a Gaussian's rendering weight, inside the masks; more selects fewer: faster


@dataclass(frozen=True)
class FocusWeights(Checked):
    """The weights of ``(1 - lambda) (beta1 L1 + beta2 L1_focus) + lambda (1 - SSIM_focus)``; none is slower.

    The focus terms are means over the "region" of interest, whose pixels weigh more the fewer they are, or over the
    whole "picture", as the text has it. Source: DecoGS, focus-aware loss (docs/METHOD.md, "Focus-aware loss").
    """

    dissimilarity: Share = 0.2  # lambda
    whole: Multiple = 0.2  # beta1
    focus: Multiple = 0.8  # beta2
    over: Annotated[str, OneOf(("region", "picture"))] = "region"  # what they are means over


@dataclass(frozen=True)
class IterationSettings(Checked):
    """How many of its iterations a frame runs: a frame that misses twice as much runs twice as many."""

    usual_miss: Share = 0.0  # of the region, missed by over 25 levels in a usual frame; less: slower; 0: all run
    min_factor: Annotated[float, Within(0.01, 3)] = 1.0  # of the iterations, at least; less: faster, drifts


@dataclass(frozen=True)
class EmergenceSettings(Checked):
    """How much is spent on new objects, which get Gaussians where views miss a surface (`training/seeding.py`)."""

    max_seeds: Steps = 2000  # new Gaussians of a frame; more: slower, larger; 0: no search
    max_rays: Count = 2000  # rays of a frame's search; more: slower, more and smaller Gaussians


@dataclass(frozen=True)
class SignificanceSettings(Checked):
    """Which changes are significant enough to be coded, and how exactly; none is slower.

    Losses are of a picture's mean, in millionths (1: one pixel of a million from black to white).
    """

    threshold: Loss = 0.0  # by which a change that is coded moves the loss; more: smaller, less exact; 0 codes all
    rd_lambda: Loss = 0.0  # squared loss that a bit of a shape is worth; more: smaller, less exact; 0: nearest value
    colour_rd_lambda: Loss = 0.0  # the same of colours and opacities, whose errors add up where light changes


@dataclass(frozen=True)
class FrameSettings(Checked):
    """How a later frame is trained. The defaults are the paper's where it gives a number.

    Method "paper" reverts no change, seeds nothing, and always runs its iterations.
    """

    masks: MaskSettings = field(default_factory=MaskSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    joint_iterations: Steps = 100  # steps; more: slower, follows faster motion
    warm_start: Share = 0.0  # of the displacement that optical flow shows, to begin with; 0: none measured, faster
    grow_fraction: Share = 0.05  # of the selected Gaussians that a frame may add, at most; more: slower, larger
    prune_opacity: Share = 0.01  # below it a Gaussian is removed; 0: never, larger
    focus: FocusWeights = field(default_factory=FocusWeights)
    rates: LearningRates = field(  # of the steps; means in units of the rig's extent
        default_factory=lambda: LearningRates(1.28e-3, 2e-2, 8e-3, 0.1, 2e-2, 1e-3)
    )
    beta1: Decay = 0.9  # Adam's, of the gradient; no slower
    beta2: Decay = 0.999  # Adam's, of its square
    adaptive_iterations: IterationSettings = field(default_factory=IterationSettings)
    significance: SignificanceSettings = field(default_factory=SignificanceSettings)
    emergence: EmergenceSettings = field(default_factory=EmergenceSettings)
    ablated: Annotated[tuple[str, ...], OneOf(("focus", "gate"))] = ()  # parts of the method that are left out
