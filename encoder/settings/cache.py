"""The numbers of the neural transformation cache."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from decogs.formats.errors import UsageError

from .checked import Checked, Decay, Share, Within


@dataclass(frozen=True)
class CacheSettings(Checked):
    """All numbers of the cache; the defaults are 3DGStream's released configuration.

    The grid has ``levels`` levels of ``features`` features; level k has round(base_resolution * level_scale**k)
    vertices along each side of the box, stored densely where they fit into 2**table_log2 entries, hashed where not.
    More levels, features, entries or hidden units are slower. Adam: ``learning_rate``, ``beta1``, ``beta2``,
    ``epsilon``. ``translation_scale`` is the world units that an output of 1 stands for. ``grid_spread``: table entries
    start uniform in +-spread (Instant-NGP). ``identity_start``: the last layer starts at zero, so that the untrained
    cache is the identity; False starts it at random. ``gradient_limit``: gradients handed in are
    clipped to this, far above any real one, so that no square overflows.
    """

    levels: Annotated[int, Within(1, 32)] = 16
    features: Annotated[int, Within(1, 32)] = 4
    table_log2: Annotated[int, Within(6, 24)] = 15
    base_resolution: Annotated[int, Within(2, 1 << 20)] = 16
    level_scale: Annotated[float, Within(1, 16)] = 2.0
    hidden_layers: Annotated[int, Within(0, 16)] = 2
    hidden_width: Annotated[int, Within(1, 4096)] = 64
    learning_rate: Share = 2e-3
    beta1: Decay = 0.9
    beta2: Decay = 0.999
    epsilon: Annotated[float, Within(1e-20, 1)] = 1e-8
    translation_scale: Annotated[float, Within(1e-9, 1e9)] = 1.0
    grid_spread: Share = 1e-4
    identity_start: bool = True
    gradient_limit: Annotated[float, Within(1e-3, 1e12)] = 1e6

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.base_resolution * self.level_scale ** (self.levels - 1) > 2**30:
            raise UsageError(
                "`levels`: the finest level has over 2^30 vertices a side; use fewer, or a smaller `level_scale` "
                "(CacheSettings)"
            )

    @property
    def table(self) -> int:
        """Entries per level."""
        return 1 << self.table_log2

    def resolutions(self) -> list[int]:
        """Vertices along each side of the box, per level."""
        return [round(self.base_resolution * self.level_scale**k) for k in range(self.levels)]
