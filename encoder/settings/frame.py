"""How a later frame is masked, selected, trained and coded, as plain data."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields

from decogs.formats.errors import UsageError

from .cache import CacheSettings
from .optimiser import LearningRates


@dataclass(frozen=True)
class MaskSettings:
    """How much a pixel must change, and how far around it the region of interest reaches.

    ``threshold`` in 8-bit levels (paper: 25), lower selects more and is slower; ``radius_share`` is the max-pool's
    radius as a share of the picture's width (paper: 48 px at 1352), more is slower; ``speck_area`` drops connected
    (8-neighbour) changes of fewer pixels than this before growing. The paper has no such step, so 0 (off) is the
    default; a few pixels help with noisy sensors. ``since_trained``: compare with the picture on which a pixel was last
    in a region of interest, not with the frame before: changes too slow for the threshold then add up until they are
    seen. ``noise_multiple``: a camera's threshold is at least that many standard deviations of its own frame-to-frame
    noise, unless most of the picture changed; 0 leaves it as it is. ``residual``: where a picture has changed before,
    pixels count as changed as long as the rendering misses them by more than so many 8-bit levels, so that what one
    frame got wrong the next ones mend; 0 turns it off, lower selects more. ``mend_frames``: what changed by more than
    ``mend_threshold`` levels as something moved stays in the region of interest for so many more frames, since what was
    covered is only seen from then on; more is slower. ``light_threshold``: after a frame in which only light changed,
    and where light changes much of the picture, levels by which the mean over a small window must change to count as
    well; 0 turns it off, lower selects more.
    """

    threshold: float = 25.0
    radius_share: float = 0.0355
    speck_area: int = 0
    since_trained: bool = False
    noise_multiple: float = 0.0
    residual: float = 0.0
    mend_frames: int = 0
    mend_threshold: float = 25.0
    light_threshold: float = 0.0

    def __post_init__(self) -> None:
        for each in fields(self):
            name, value = each.name, getattr(self, each.name)
            if not (math.isfinite(value) and value >= 0):
                raise UsageError(f"mask setting {name} is {value}; it must be a finite number of at least 0")

    def radius(self, width: int) -> int:
        """The max-pool's radius in pixels for pictures of this width."""
        return round(self.radius_share * width)


@dataclass(frozen=True)
class SelectionSettings:
    """``rule``: a name in SELECTION_RULES.

    ``least_views`` is the paper's kappa; higher selects fewer and is faster, and so does ``least_share``, 0 to 1.
    A Gaussian is visible in a view when its weight there is at least ``visible_weight`` pixels. ``mend_share``: what
    ``least_share`` is where nothing changes any more and the masks only mend (`masks.MaskSettings.mend_frames`): what
    enough views have seen all along needs none.
    """

    rule: str = "weight"
    least_views: int = 2
    least_share: float = 0.65
    visible_weight: float = 0.02
    mend_share: float = 0.8


@dataclass(frozen=True)
class FocusWeights:
    """The weights of ``(1 - lambda) (beta1 L1 + beta2 L1_focus) + lambda (1 - SSIM_focus)``.

    Source: DecoGS, focus-aware loss (docs/METHOD.md, "Focus-aware loss").
    """

    dissimilarity: float = 0.2
    whole: float = 0.2
    focus: float = 0.8


@dataclass(frozen=True)
class PaceSettings:
    """How many of its iterations a frame runs, by how much the scene that it begins with misses its pictures.

    ``usual_miss``: share of the region of interest, 0 to 1, that is clearly missed in a frame that runs them all; where
    twice as much is missed, it runs twice as many. Lower is slower; 0: every frame runs them all. ``least``, ``most``:
    bounds of that factor; higher is slower. With ``least`` below 1 what moves loses quality over hundreds of frames.
    """

    usual_miss: float = 0.0
    least: float = 1.0
    most: float = 3.0


@dataclass(frozen=True)
class EmergenceSettings:
    """How new objects are sought; ``most`` 0 turns it off.

    ``residual``: 8-bit levels by which a rendering must miss the picture; lower finds fainter objects and more wrong
    ones. ``least_share``: share of all views' pixels that must be missed before anything is done. ``most``: most seeds
    of one frame. ``most_rays``: more is slower and finds finer detail. ``depths``: steps along a ray. ``least_views``:
    views that must miss the same point; ``missing_share``: share of the views that see it and may not. ``spread``:
    8-bit levels by which colours of the same point may differ. ``in_front``: share of the rendered depth a seed
    must lie before it. ``opacity``: a seed's, 0 to 1.
    """

    residual: float = 25.0
    least_share: float = 2e-4
    most: int = 2000
    most_rays: int = 2000
    depths: int = 64
    least_views: int = 4
    missing_share: float = 0.25
    spread: float = 14.0
    in_front: float = 0.02
    opacity: float = 0.3


@dataclass(frozen=True)
class Coarseness:
    """In how many lattice steps at a time changes are written; higher is smaller and less exact."""

    means: int = 1
    log_scales: int = 1
    quaternions: int = 1
    opacity_logits: int = 1
    sh_dc: int = 1
    sh_rest: int = 1


@dataclass(frozen=True)
class EconomySettings:
    """How much a change must do for the pictures to be sent.

    ``worth``: by how much it must move the loss of a picture, summed over its pixels (1: one pixel from black to
    white); 0 sends everything, higher is smaller and less exact. ``hold_at``: the share of stage 2 after which changes
    are judged, once. ``coarseness``: of the changes that are sent.
    """

    worth: float = 0.0
    hold_at: float = 0.6
    coarseness: Coarseness = field(default_factory=Coarseness)


@dataclass(frozen=True)
class FrameSettings:
    """How a later frame is trained; the defaults are the paper's where it gives a number.

    ``cache_iterations`` and ``joint_iterations``: stage 1 and stage 2; more is slower and follows faster motion.
    ``carry_cache``: keep the cache's weights from frame to frame instead of restarting it. ``warm_start``: share of
    the last displacement to begin with, 0 to 1, the median over the ``warm_neighbours`` nearest selected Gaussians.
    ``grow_gradient``: the paper's tau_d; lower adds more Gaussians. ``grow_share``: most Gaussians a frame may add, as
    a share of the selected; more is slower and larger. ``rates``: stage 2, ``means`` in units of the rig's extent; over
    its second half they fall to ``late_decay`` of that. ``economy``: what changes must be worth, without a cache.
    ``beta1``, ``beta2``: stage 2's Adam. ``pace``: how a frame's iterations follow from what it misses. ``flat``:
    stage 2 ends, not before its half, once a round through all views lowers their loss by less than this share; higher
    is faster. ``ablated``: parts of the method left out (`switches.without`).
    ``optimiser``, ``densification``: names in OPTIMISERS and DENSIFICATIONS.
    """

    masks: MaskSettings = field(default_factory=MaskSettings)
    selection: SelectionSettings = field(default_factory=SelectionSettings)
    cache: CacheSettings | None = field(default_factory=CacheSettings)
    carry_cache: bool = False
    cache_iterations: int = 150
    joint_iterations: int = 100
    warm_start: float = 0.0
    warm_neighbours: int = 24
    grow_gradient: float = 1e-4
    grow_share: float = 0.05
    prune_opacity: float = 0.01
    focus: FocusWeights = field(default_factory=FocusWeights)
    rates: LearningRates = field(default_factory=lambda: LearningRates(1.28e-3, 2e-2, 8e-3, 0.1, 2e-2, 1e-3))
    late_decay: float = 0.2
    beta1: float = 0.9
    beta2: float = 0.999
    pace: PaceSettings = field(default_factory=PaceSettings)
    flat: float = 0.0
    economy: EconomySettings = field(default_factory=EconomySettings)
    emergence: EmergenceSettings = field(default_factory=EmergenceSettings)
    ablated: tuple[str, ...] = ()
    optimiser: str = "adam"
    densification: str = "clone-split"
