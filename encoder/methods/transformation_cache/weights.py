"""The transformation cache's numbers, and its weights as plain arrays."""

from __future__ import annotations

from dataclasses import dataclass

from decogs.formats.splats import FloatArray


@dataclass(frozen=True)
class CacheWeights:
    """The cache's parameters as plain arrays, float32; also the shape its gradients come in.

    grid (levels, table, features); per layer a matrix (out, in) and a bias (out,), hidden layers first. The last
    layer's bias holds the identity rotation.
    """

    grid: FloatArray
    matrices: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]
