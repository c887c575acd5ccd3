"""The transformation cache of one stream: what is placed, what is trained, and what a frame leaves behind."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from decogs.formats.errors import TrainingError, UsageError
from decogs.formats.splats import FloatArray

from ...backends.cpu.native import adam_step
from .native import CacheKernel, Parameters
from .weights import CacheConfig, CacheWeights

_OUTPUTS = 7
"""Translation 3, rotation 4. 3DGStream's eighth output is unused and left out."""
_BETA1, _BETA2 = 0.9, 0.999
"""Adam's (3DGStream's released configuration)."""
_LANES = 16
"""The kernel rounds the sides of the network's matrices up to this (kernel/network.h)."""


class TransformationCache:
    """The transformation cache of one stream; see the package for what it computes.

    ``box_low``, ``box_high`` (3,) bound the part of the scene that may move, ``extent`` is the size of the rig,
    both in world units; ``seed`` draws the starting weights; ``threads`` only changes the speed, never the result.
    Raises UsageError for an empty box.
    """

    def __init__(
        self,
        box_low: ArrayLike,
        box_high: ArrayLike,
        config: CacheConfig,
        seed: int,
        *,
        extent: float = 1.0,
        threads: int = 1,
    ) -> None:
        low, high = (np.asarray(b, np.float64).reshape(3) for b in (box_low, box_high))
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low < high).all()):
            raise UsageError(f"the box of the moving scene is empty: {low.tolist()} to {high.tolist()}")
        if threads < 1:
            raise UsageError(f"threads is {threads}; it must be at least 1")
        self.config = config
        self._head: Parameters
        self._count = 0
        self._has_read = self._has_moved = self._has_gradients = False
        sizes = [config.levels * config.features, *[config.hidden_width] * config.hidden_layers, _OUTPUTS]
        self._shapes = [(out, given) for given, out in pairwise(sizes)]
        self._kernel = CacheKernel(config, low, high, extent, threads)
        self._store(_first_weights(config, self._shapes, seed))
        self._place(np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32))

    # -- the Gaussians to move ------------------------------------------------------------------------------------

    def place(self, means: FloatArray, quaternions: FloatArray, *, same_frame: bool = False) -> None:
        """Fix the M selected Gaussians to be moved: means (M, 3) in world units, quaternions (M, 4) wxyz, any norm.

        The grid will be read at these means until the next call; where the base values differ from the reading points
        (stage 2), give those to `rebase` afterwards. Gradients not yet stepped are dropped.

        A new frame starts with Adam at rest; with ``same_frame`` (densification in mid-frame) moments and step count
        stay, and entries read for the first time have zero moments, as they would have in an Adam over the whole table.
        Takes about 2 kB per Gaussian.
        Raises TrainingError for values that are not finite.
        """
        means, quaternions = _checked(means, quaternions)
        entries, rows, head, count = self._entries, self._rows, self._head, self._count
        self._settle()
        self._place(means, quaternions)
        if same_frame:
            self._head, self._count = head, count
            for old, new in ((rows.first, self._rows.first), (rows.second, self._rows.second)):
                table = np.zeros_like(self._grid)
                table[entries] = old
                new[:] = table[self._entries]

    def rebase(self, means: FloatArray, quaternions: FloatArray) -> None:
        """Give the placed Gaussians other base values (same M, same order); the grid is read where it was.

        For stage 2, where the Gaussians' own attributes are optimised together with the cache.
        """
        if len(means) != self._placed:
            raise ValueError(f"{len(means)} Gaussians cannot replace the {self._placed} that were placed")
        self._kernel.base(*_checked(means, quaternions))
        self._has_moved = False

    def move(self) -> tuple[FloatArray, FloatArray]:
        """The placed Gaussians where the cache moves them: means (M, 3), unit quaternions (M, 4), fresh arrays.

        Keeps what `backward` needs, until the next `step`. Source: DecoGS stage 1; 3DGStream, equation 5.
        """
        if not self._has_read:
            self._kernel.read(self._rows)
        self._has_read = self._has_moved = True
        return self._kernel.move(self._head)

    # -- training -------------------------------------------------------------------------------------------------

    def backward(self, v_means: FloatArray, v_quaternions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Take the weights' gradients for a loss with these gradients in the moved values, (M, 3) and (M, 4).

        Once per `move`. Returns the gradients in the base values given to `place` or `rebase`, (M, 3) and (M, 4), for
        stage 2; the grid's reading points count as constants.
        Raises TrainingError for NaN; infinite gradients are clipped to GRADIENT_LIMIT as all are.
        """
        if not self._has_moved:
            raise RuntimeError("backward() needs move() first, each time")
        if v_means.shape != (self._placed, 3) or v_quaternions.shape != (self._placed, 4):
            raise ValueError(f"gradients {v_means.shape}, {v_quaternions.shape} for {self._placed} Gaussians")
        if np.isnan(v_means).any() or np.isnan(v_quaternions).any():
            raise TrainingError("a gradient of the transformation cache is NaN; lower the learning rate")
        self._has_moved, self._has_gradients = False, True
        return self._kernel.backward(v_means, v_quaternions)

    def step(self) -> None:
        """One Adam step on the gradients of the last `backward`; nothing happens when they are spent."""
        self._has_moved = False
        if not self._has_gradients:
            return
        self._count += 1
        c = self.config
        adam = adam_step(self._count, _BETA1, _BETA2, c.epsilon)
        self._kernel.step(adam, c.learning_rate, self._rows, self._head)
        self._has_gradients = False

    def restart(self) -> None:
        """Back to the starting weights, Adam at rest; placed Gaussians stay placed."""
        grid, head = self._start
        self._grid[:] = grid
        self._head = Parameters(head.copy())
        self._rest()

    # -- the weights as data --------------------------------------------------------------------------------------

    def weights(self) -> CacheWeights:
        """A copy of the weights as they stand."""
        self._settle()
        return self._as_arrays(self._grid, self._head.value)

    def gradients(self) -> CacheWeights:
        """A copy of the gradients that the next `step` will take, zero for entries that no placed Gaussian reads."""
        grid, head = np.zeros_like(self._grid), np.zeros_like(self._head.value)
        if self._has_gradients:
            grid[self._entries], head = self._kernel.gradients(self._rows, self._head)
        return self._as_arrays(grid, head)

    def set_weights(self, weights: CacheWeights) -> None:
        """Replace the weights and what `restart` returns to, Adam at rest; raises ValueError for other shapes."""
        given = [a.shape for a in (weights.grid, *weights.matrices, *weights.biases)]
        own = self._as_arrays(self._grid, self._head.value)
        if given != [a.shape for a in (own.grid, *own.matrices, *own.biases)]:
            raise ValueError("these weights belong to a cache of another configuration")
        self._store(weights)
        self._rest()

    # -- inside ---------------------------------------------------------------------------------------------------

    def _place(self, means: FloatArray, quaternions: FloatArray) -> None:
        """A new frame: reads the grid as it stands at these means, Adam at rest."""
        self._placed = len(means)
        self._entries = self._kernel.place(means)
        self._kernel.base(means, quaternions)
        self._head = Parameters(self._head.value)
        self._rest()

    def _rest(self) -> None:
        """Takes the trained entries from the table; no moments, nothing gathered, nothing moved."""
        self._rows = Parameters(self._grid[self._entries])
        self._count = 0
        self._has_read = self._has_moved = self._has_gradients = False

    def _settle(self) -> None:
        """Write the trained entries back to the table."""
        self._grid[self._entries] = self._rows.value

    def _store(self, weights: CacheWeights) -> None:
        """Sets the weights, and what `restart` returns to."""
        self._grid = np.array(weights.grid, np.float32).reshape(-1, self.config.features)
        sizes = [_rounded_up(out) * (_rounded_up(given) + 1) for out, given in self._shapes]
        self._head = Parameters(np.zeros(sum(sizes), np.float32))
        given = (*weights.matrices, *weights.biases)
        matrices, biases = self._layers(self._head.value)
        for own, array in zip((*matrices, *biases), given, strict=True):
            own[...] = array
        self._start = self._grid.copy(), self._head.value.copy()

    def _layers(self, flat: FloatArray) -> tuple[list[FloatArray], list[FloatArray]]:
        """Views of the network's parameters: per layer the matrix (out, in) and the bias (out,)."""
        matrices, biases, at = [], [], 0
        for out, given in self._shapes:
            rows, columns = _rounded_up(out), _rounded_up(given)
            matrices.append(flat[at : at + rows * columns].reshape(rows, columns)[:out, :given])
            at += rows * columns
            biases.append(flat[at : at + out])
            at += rows
        return matrices, biases

    def _as_arrays(self, grid: FloatArray, head: FloatArray) -> CacheWeights:
        c = self.config
        matrices, biases = (tuple(a.copy() for a in arrays) for arrays in self._layers(head))
        return CacheWeights(grid.reshape(c.levels, c.table, c.features).copy(), matrices, biases)


def _rounded_up(count: int) -> int:
    return -(-count // _LANES) * _LANES


def _checked(means: FloatArray, quaternions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Base values as the kernel reads them."""
    if means.ndim != 2 or means.shape[1] != 3 or quaternions.shape != (len(means), 4):
        raise ValueError(f"means (M, 3) and quaternions (M, 4) wanted, not {means.shape} and {quaternions.shape}")
    if not (np.isfinite(means).all() and np.isfinite(quaternions).all()):
        raise TrainingError("a Gaussian in the transformation cache has a value that is not finite")
    return np.ascontiguousarray(means, np.float32), np.ascontiguousarray(quaternions, np.float32)


def _first_weights(config: CacheConfig, shapes: Sequence[tuple[int, int]], seed: int) -> CacheWeights:
    """Starting weights: a faint random grid, Xavier-uniform layers (as tiny-cuda-nn), the identity as last bias."""
    rng = np.random.default_rng(seed)
    spread = config.grid_spread
    grid = rng.uniform(-spread, spread, (config.levels, config.table, config.features)).astype(np.float32)
    matrices = []
    for out, given in shapes:
        bound = math.sqrt(6.0 / (out + given))
        matrices.append(rng.uniform(-bound, bound, (out, given)).astype(np.float32))
    if config.identity_start:
        matrices[-1] = np.zeros(shapes[-1], np.float32)
    biases = [np.zeros(out, np.float32) for out, _ in shapes]
    biases[-1][3] = 1.0
    return CacheWeights(grid, tuple(matrices), tuple(biases))
