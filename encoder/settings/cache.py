"""The numbers of the neural transformation cache."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from decogs.formats.errors import UsageError

from .checked import Checked, Share, Within


@dataclass(frozen=True)
class CacheSettings(Checked):
    """All numbers of the cache; the defaults are 3DGStream's released configuration.

    Level k has round(base_resolution * level_scale**k) vertices along each side of the box, stored densely where they
    fit into the table, hashed where not.
    """

    levels: Annotated[int, Within(1, 32)] = 16  # of the grid; more: slower
    features: Annotated[int, Within(1, 32)] = 4  # of a vertex; more: slower
    table_log2: Annotated[int, Within(6, 24)] = 15  # of the entries of a level; more: slower
    base_resolution: Annotated[int, Within(2, 1 << 20)] = 16  # vertices along a side of the coarsest level
    level_scale: Annotated[float, Within(1, 16)] = 2.0  # from one level to the next
    hidden_layers: Annotated[int, Within(0, 16)] = 2  # more: slower
    hidden_width: Annotated[int, Within(1, 4096)] = 64  # units of a layer; more: slower
    learning_rate: Share = 2e-3  # Adam's
    epsilon: Annotated[float, Within(1e-20, 1)] = 1e-8  # Adam's
    translation_scale: Annotated[float, Within(1e-9, 1e9)] = 1.0  # world units that an output of 1 stands for
    grid_spread: Share = 1e-4  # entries start uniform in +- that (Instant-NGP)
    identity_start: bool = True  # the last layer starts at zero; else at random

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
