"""How the keyframe is trained, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from decogs.codec.state import DEFAULT_MAX_GAUSSIANS
from decogs.formats.errors import UsageError

from .checked import Checked, Count, Loss, Opacity, Rate, Share, Size, Steps, Stretch, Within
from .optimiser import LearningRates


@dataclass(frozen=True)
class KeyframeSettings(Checked):
    """How the keyframe is trained.

    ``iterations``: steps, of which large pictures take fewer. More is slower and, up to early stopping, better.
    ``cap``: Gaussians at most. More is slower and larger. ``sh_degree``: higher is slower and larger, better where
    views disagree.
    ``dissimilarity``: lambda of 3DGS's loss where many views see a surface; ``few_views_dissimilarity``: where few do
    (`training/few_views.py`). Higher keeps fine structure, lower errs less in other views.
    ``start_opacity``: of the first Gaussians. ``start_size``: their sigma in units of the point spacing.
    ``guess_opacity``, ``guess_size``: the same of points that no view confirms, which stand for what is not known:
    large and faint ones spread over it, small and opaque ones leave holes that needles fill.
    ``grow_from``, ``grow_to``: shares of the schedule between which Gaussians are added, every ``grow_every`` steps,
    where the mean view gradient reaches ``grow_gradient``. Lower adds more, up to the cap, and is slower.
    ``prune_opacity``: Gaussians below it are removed.
    ``max_stretch``: largest ratio of a Gaussian's largest to its middle size; 0: any. Lower makes fewer needles, which
    look wrong from elsewhere, and more Gaussians along edges.
    ``validation_fraction``: share of the 16x16 tiles that are kept out of the loss for early stopping; 0 turns it off.
    They are checked every ``validation_every`` steps; training stops after ``patience`` checks without a new best.
    ``rates``: step sizes, ``means`` in units of the rig's extent. Those of positions fall to ``means_decay`` over the
    schedule, the others to ``late_decay`` over its second half.
    ``settle_iterations``: steps in which rotations and colours, then sizes, then positions are fixed on the lattice
    while the rest adapts. More is slower.
    ``surroundings``: how far Gaussians go on beside the pictures, where no view looks, in units of their width; 0: not
    at all. They are at most ``surroundings_fraction`` of the cap. More is larger.
    ``rd_lambda``: the rate-distortion trade-off of rotations and view-dependent colours: squared change of a picture's
    mean loss, in millionths, per bit. Higher is smaller and less exact; 0 rounds to the nearest.
    ``densification``: a name in DENSIFICATIONS.
    """

    iterations: Count = 1000
    cap: Annotated[int, Within(1, DEFAULT_MAX_GAUSSIANS)] = 52_000
    sh_degree: Annotated[int, Within(0, 3)] = 0
    dissimilarity: Share = 0.2
    few_views_dissimilarity: Share = 0.2
    start_opacity: Opacity = 0.2
    start_size: Size = 0.5
    guess_opacity: Opacity = 0.1
    guess_size: Size = 1.0
    grow_from: Share = 0.15
    grow_to: Share = 0.6
    grow_every: Count = 100
    grow_gradient: Rate = 2e-4
    prune_opacity: Share = 0.005
    max_stretch: Stretch = 10.0
    validation_fraction: Annotated[float, Within(0, 0.9)] = 0.02
    validation_every: Count = 100
    patience: Count = 4
    rates: LearningRates = field(default_factory=lambda: LearningRates(4e-4, 1e-2, 3e-3, 0.05, 1e-2, 5e-4))
    means_decay: Share = 0.05
    late_decay: Share = 0.2
    settle_iterations: Steps = 300
    surroundings: Annotated[float, Within(0, 100)] = 0.0
    surroundings_fraction: Annotated[float, Within(0, 0.9)] = 0.025
    rd_lambda: Loss = 2.3e-3
    densification: str = "clone-split"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.grow_from > self.grow_to:
            raise UsageError(
                f"`grow_from` {self.grow_from:g}: it is after `grow_to` {self.grow_to:g}; give at most that "
                "(KeyframeSettings)"
            )

    @property
    def seen_cap(self) -> int:
        """Gaussians at most that views see; the rest of the cap is for those beside the pictures."""
        return self.cap - (round(self.surroundings_fraction * self.cap) if self.surroundings else 0)
