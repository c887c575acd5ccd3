"""The numbers of the dense baseline, 3DGStream."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

from .cache import CacheSettings
from .checked import Checked, Count, Rate, Share, Steps, Within


@dataclass(frozen=True)
class BaselineSettings(Checked):
    """The numbers of 3DGStream's recipe; the defaults are its released configuration."""

    cache: CacheSettings = field(default_factory=CacheSettings)
    cache_iterations: Steps = 150  # of stage 1, one view each; more: slower
    spawn_iterations: Steps = 100  # of stage 2, one view each; more: slower
    spawn_gradient: Rate = 1.5e-4  # mean view gradient from which a Gaussian spawns another; less: slower
    prune_every: Count = 20  # steps of stage 2
    prune_opacity: Share = 0.01  # below it a spawned Gaussian goes
    prune_size: Annotated[float, Within(1e-9, 1e9)] = 0.1  # sigma above which it goes, in units of the rig's extent
