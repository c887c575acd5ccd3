"""The transformation cache's numbers, and its weights as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

from decogs.formats.splats import FloatArray


@dataclass(frozen=True)
class CacheConfig:
    """All numbers of the cache; the defaults are 3DGStream's released configuration, but for the unit of length.

    Level k has round(base_resolution * level_scale**k) vertices along each side of the box, stored densely where they
    fit into the table, hashed where not.
    """

    levels: int = 16  # of the grid
    features: int = 4  # of a vertex
    table_log2: int = 15  # of the entries of a level
    base_resolution: int = 16  # vertices along a side of the coarsest level
    level_scale: float = 2.0  # from one level to the next
    hidden_layers: int = 2
    hidden_width: int = 64  # units of a layer
    learning_rate: float = 2e-3  # Adam's
    epsilon: float = 1e-8  # Adam's
    translation_scale: float = 0.5  # extents of the rig that an output of 1 stands for: a metre in usual rigs
    grid_spread: float = 1e-4  # entries start uniform in +- that (Instant-NGP)
    identity_start: bool = True  # the last layer starts at zero; else at random

    @property
    def table(self) -> int:
        """Entries per level."""
        return 1 << self.table_log2

    def resolutions(self) -> list[int]:
        """Vertices along each side of the box, per level."""
        return [round(self.base_resolution * self.level_scale**k) for k in range(self.levels)]


RELEASED_CACHE = CacheConfig()


@dataclass(frozen=True)
class CacheWeights:
    """The cache's parameters as plain arrays, float32; also the shape its gradients come in.

    grid (levels, table, features); per layer a matrix (out, in) and a bias (out,), hidden layers first. The last
    layer's bias holds the identity rotation.
    """

    grid: FloatArray
    matrices: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
