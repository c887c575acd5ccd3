"""The numbers of the neural transformation cache."""

from __future__ import annotations

from dataclasses import dataclass

from decogs.formats.errors import UsageError


@dataclass(frozen=True)
class CacheSettings:
    """All numbers of the cache; the defaults are 3DGStream's released configuration.

    The grid has ``levels`` levels of ``features`` features; level k has round(base_resolution * level_scale**k)
    vertices along each side of the box, stored densely where they fit into 2**table_log2 entries, hashed where not.
    More levels, features, entries or hidden units are slower. Adam: ``learning_rate``, ``beta1``, ``beta2``,
    ``epsilon``. ``translation_scale`` is the world units that an output of 1 stands for. ``grid_spread``: table entries
    start uniform in +-spread (Instant-NGP). ``identity_start``: the last layer starts at zero, so that the untrained
    cache is the identity; False starts it at random. ``gradient_limit``: gradients handed in are
    clipped to this, far above any real one, so that no square overflows.
    """

    levels: int = 16
    features: int = 4
    table_log2: int = 15
    base_resolution: int = 16
    level_scale: float = 2.0
    hidden_layers: int = 2
    hidden_width: int = 64
    learning_rate: float = 2e-3
    beta1: float = 0.9
    beta2: float = 0.999
    epsilon: float = 1e-8
    translation_scale: float = 1.0
    grid_spread: float = 1e-4
    identity_start: bool = True
    gradient_limit: float = 1e6

    def __post_init__(self) -> None:
        bounds: dict[str, tuple[float, float]] = {
            "levels": (1, 32),
            "features": (1, 32),
            "table_log2": (6, 24),
            "base_resolution": (2, 1 << 20),
            "level_scale": (1.0, 16.0),
            "hidden_layers": (0, 16),
            "hidden_width": (1, 4096),
            "learning_rate": (0.0, 1.0),
            "beta1": (0.0, 0.999999),
            "beta2": (0.0, 0.999999),
            "epsilon": (1e-20, 1.0),
            "translation_scale": (1e-9, 1e9),
            "grid_spread": (0.0, 1.0),
            "gradient_limit": (1e-3, 1e12),
        }
        for name, (low, high) in bounds.items():
            value = getattr(self, name)
            if not low <= value <= high:  # NaN fails as well
                raise UsageError(f"transformation cache setting {name} is {value}; it must lie in {low:g} to {high:g}")
        if self.base_resolution * self.level_scale ** (self.levels - 1) > 2**30:
            raise UsageError("transformation cache: the finest level has over 2^30 vertices a side; use fewer levels")

    @property
    def table(self) -> int:
        """Entries per level."""
        return 1 << self.table_log2

    def resolutions(self) -> list[int]:
        """Vertices along each side of the box, per level."""
        return [round(self.base_resolution * self.level_scale**k) for k in range(self.levels)]
