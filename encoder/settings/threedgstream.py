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
    """The numbers of 3DGStream's recipe; the defaults are its released configuration.

    ``cache_iterations``, ``spawn_iterations``: steps of stage 1 and stage 2, one view each; more is slower.
    ``spawn_gradient``: mean view gradient, over the last ``spawn_window`` steps of stage 1, from which a Gaussian
    spawns another; lower spawns more, and is slower. ``spawn_spread``: standard deviation of its place about the
    parent's, in the parent's own sigmas; ``spawn_opacity``: its opacity, 0 to 1; ``spawn_growth``: its size in units of
    the parent's. Every ``prune_every`` steps of stage 2, spawned Gaussians of less than ``prune_opacity`` or with a
    sigma above ``prune_size`` (in units of the rig's extent) go. ``rates``: stage 2, ``means`` in units of the rig's
    extent. ``dissimilarity``: lambda of 3DGS's loss.
    """

    cache: CacheSettings = field(default_factory=CacheSettings)
    cache_iterations: Steps = 150
    spawn_iterations: Steps = 100
    spawn_gradient: Rate = 1.5e-4
    spawn_window: Count = 20
    spawn_spread: Annotated[float, Within(0, 1000)] = 2.0
    spawn_opacity: Opacity = 0.1
    spawn_growth: Size = 1.25
    prune_every: Count = 20
    prune_opacity: Share = 0.01
    prune_size: Annotated[float, Within(1e-9, 1e9)] = 0.1
    rates: LearningRates = field(default_factory=lambda: _BASE_RATES.scaled(15))
    dissimilarity: Share = 0.2
