"""The numbers of the dense baseline, 3DGStream."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from .cache import CacheSettings
from .checked import Checked, Count, Opacity, Rate, Share, Size, Steps, Within
from .optimiser import LearningRates

_BASE_RATES = LearningRates(
    means=1.6e-4, log_scales=5e-3, quaternions=1e-3, opacity_logits=5e-2, sh_dc=2.5e-3, sh_rest=2.5e-3 / 20
)
"""3DGS's own (Kerbl 2023), ``means`` in units of the rig's extent."""


@dataclass(frozen=True)
class BaselineSettings(Checked):
    """The numbers of 3DGStream's recipe; the defaults are its released configuration."""

    cache: CacheSettings = field(default_factory=CacheSettings)
    cache_iterations: Steps = 150  # of stage 1, one view each; more: slower
    spawn_iterations: Steps = 100  # of stage 2, one view each; more: slower
    spawn_gradient: Rate = 1.5e-4  # mean view gradient from which a Gaussian spawns another; less: slower
    spawn_window: Count = 20  # last steps of stage 1 over which that is a mean
    spawn_spread: Annotated[float, Within(0, 1000)] = 2.0  # deviation from the parent's place, in the parent's sigmas
    spawn_opacity: Opacity = 0.1  # of a spawned Gaussian
    spawn_growth: Size = 1.25  # of its size, in units of the parent's
    prune_every: Count = 20  # steps of stage 2
    prune_opacity: Share = 0.01  # below it a spawned Gaussian goes
    prune_size: Annotated[float, Within(1e-9, 1e9)] = 0.1  # sigma above which it goes, in units of the rig's extent
    rates: LearningRates = field(default_factory=lambda: _BASE_RATES.scaled(15))  # of stage 2
    dissimilarity: Share = 0.2  # lambda of 3DGS's loss
