"""The gated Neural Transformation Cache (NTC): a hash grid and a small MLP that move the selected Gaussians.

A normalised centre x in the box goes through a multi-resolution hash grid and an MLP to a translation (world units) and
a rotation (quaternion wxyz): mu' = mu + dmu, q' = normalise(q) (x) normalise(dq). Only the M Gaussians that were placed
are moved; a Gaussian outside the box keeps its centre and gets no gradient.
Sources: DecoGS (gating, use), 3DGStream (configuration), Instant-NGP, Mueller 2022 (hash grid).

Three facts make this fast on a CPU, none of them an approximation:

- Within a frame the grid is read at fixed points (the centres as placed), so the indices and the trilinear weights are
  computed once. Reading all features is then one sparse matrix times the table, the table's gradient the transposed
  matrix times the features' gradient; both run as ``embedding_bag``.
- Adam leaves an entry with zero gradient and zero moments where it is. Moments start at zero with each frame, so the
  entries that no placed centre reads never change: only those read are trained, and written back to the table at the
  end ("settling").
- The MLP runs over chunks of a fixed number of Gaussians, which stay in the processor's cache.

All of it is float32: the cosine of the quaternion loss is known to overflow in fp16. Results do not depend on torch's
thread setting nor on ``threads``: torch runs on one thread in here (``torch.set_num_threads(1)``, restored on return),
work is cut by level and by chunk, whatever the number of threads, and partial sums are added in a fixed order.
The forward and backward passes are written out (torch as an array library): no autograd graph, no ``torch.optim``, of
which the first step alone costs seconds of imports.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import pairwise
from typing import TypeVar

import numpy as np
import torch
import torch.nn.functional as functional
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from decogs.formats.errors import TrainingError, UsageError
from decogs.formats.splats import FloatArray

_PRIMES = (1, 2654435761, 805459861)
"""Instant-NGP, equation 4."""
_CORNERS = np.array([[k & 1, k >> 1 & 1, k >> 2] for k in range(8)], np.int64)
_CHUNK = 2048
"""Gaussians per pass of the MLP. Part of the results' definition (order of summation), so not a setting."""
_ADAM_CHUNK = 1 << 16
_OUTPUTS = 7
"""Translation 3, rotation 4. 3DGStream's eighth output is unused and left out."""
_TINY = 1e-30

_Task = TypeVar("_Task")
_Result = TypeVar("_Result")


@dataclass(frozen=True)
class CacheSettings:
    """All numbers of the cache; the defaults are 3DGStream's released configuration.

    The grid has ``levels`` levels of ``features`` features; level k has round(base_resolution * level_scale**k)
    vertices along each side of the box, stored densely where they fit into 2**table_log2 entries, hashed where not.
    More levels, features, entries or hidden units are slower. Adam: ``learning_rate``, ``beta1``, ``beta2``,
    ``epsilon``. ``translation_scale`` is the world units that an output of 1 stands for. ``grid_spread``: table entries
    start uniform in +-spread (Instant-NGP). ``identity_start``: the last layer starts at zero, so that the untrained
    cache is the identity; False starts it at random, to be warmed up. ``gradient_limit``: gradients handed in are
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


@dataclass(frozen=True)
class CacheWeights:
    """The cache's parameters as plain arrays, float32; also the shape its gradients come in.

    grid (levels, table, features); per layer a matrix (out, in) and a bias (out,), hidden layers first. The last
    layer's bias holds the identity rotation.
    """

    grid: FloatArray
    matrices: tuple[FloatArray, ...]
    biases: tuple[FloatArray, ...]


@dataclass(frozen=True)
class ParameterCount:
    """How many parameters there are, their size in bytes as float32, and how many the placed Gaussians can train."""

    count: int
    size: int
    trained: int


def level_indices(settings: CacheSettings, points: NDArray[np.float64], level: int) -> NDArray[np.int64]:
    """Table entries (P, 8) of the corners of the cells around ``points`` (P, 3) in 0..1, at one level.

    Corner k is offset by bits 0, 1, 2 of k along x, y, z. Dense levels count x fastest; the others use Instant-NGP's
    spatial hash, (x * 1 XOR y * 2654435761 XOR z * 805459861) mod table in 32-bit arithmetic.
    """
    resolution = settings.resolutions()[level]
    vertices = _cells(points, resolution)[:, None, :] + _CORNERS
    if resolution**3 <= settings.table:
        return vertices @ np.array([1, resolution, resolution**2], np.int64)
    hashed = (vertices.astype(np.uint32) * np.array(_PRIMES, np.uint32)).astype(np.int64)
    return (hashed[..., 0] ^ hashed[..., 1] ^ hashed[..., 2]) & (settings.table - 1)


def level_weights(settings: CacheSettings, points: NDArray[np.float64], level: int) -> NDArray[np.float64]:
    """Trilinear weights (P, 8) of the corners of `level_indices`; each row sums to 1."""
    resolution = settings.resolutions()[level]
    fraction = (points * (resolution - 1) - _cells(points, resolution))[:, None, :]
    weights: NDArray[np.float64] = np.where(_CORNERS == 1, fraction, 1.0 - fraction).prod(axis=2)
    return weights


def _cells(points: NDArray[np.float64], resolution: int) -> NDArray[np.int64]:
    """Lower corner of the cell around each point; the box's upper faces belong to the last cell."""
    return np.minimum((points * (resolution - 1)).astype(np.int64), resolution - 2)


class _Trained:
    """A tensor under Adam (Kingma 2015): value, gradient and both moments."""

    def __init__(self, value: Tensor) -> None:
        self.value = value
        self.gradient = torch.zeros_like(value)
        self.first = torch.zeros_like(value)
        self.second = torch.zeros_like(value)

    def reset(self) -> None:
        for tensor in (self.gradient, self.first, self.second):
            tensor.zero_()

    def step(self, settings: CacheSettings, rate: float, count: int) -> None:
        """One Adam step in place, ``count`` from 1; then the gradient is zero again."""
        correction1, correction2 = 1.0 - settings.beta1**count, 1.0 - settings.beta2**count
        flat = (torch.split(t.view(-1), _ADAM_CHUNK) for t in (self.value, self.gradient, self.first, self.second))
        for value, gradient, first, second in zip(*flat, strict=True):
            first.lerp_(gradient, 1.0 - settings.beta1)
            second.mul_(settings.beta2).addcmul_(gradient, gradient, value=1.0 - settings.beta2)
            divisor = second.sqrt().div_(math.sqrt(correction2)).add_(settings.epsilon)
            value.addcdiv_(first, divisor, value=-rate / correction1)
            gradient.zero_()


@dataclass(frozen=True)
class _Reading:
    """The sparse matrix between the trained entries and the features of the n centres inside the box.

    Forward, row (centre, level) sums 8 entries: ``entry`` and ``weight``, (n * levels * 8,). Transposed, per level, an
    entry sums the features it fed: ``feature`` and ``feature_weight`` sorted by entry, ``starts`` of each entry's run.
    """

    inside: NDArray[np.int64]
    rows: Tensor
    entry: Tensor
    weight: Tensor
    transposed: tuple[tuple[Tensor, Tensor, Tensor, slice], ...]


@dataclass(frozen=True)
class _Pass:
    """What the forward pass of one chunk keeps for the backward pass."""

    rows: slice
    activations: list[Tensor]
    base: Tensor
    turn: Tensor
    turn_norm: Tensor


class TransformationCache:
    """The transformation cache of one stream; see the module for what it computes.

    ``box_low``, ``box_high`` (3,) bound the part of the scene that may move, in world units; ``seed`` draws the
    starting weights; ``threads`` only changes the speed, never the result. Raises UsageError for an empty box.
    """

    def __init__(
        self, box_low: ArrayLike, box_high: ArrayLike, settings: CacheSettings, seed: int, *, threads: int = 1
    ) -> None:
        self._low, self._high = (np.asarray(b, np.float64).reshape(3) for b in (box_low, box_high))
        if not (np.isfinite(self._low).all() and np.isfinite(self._high).all() and (self._low < self._high).all()):
            raise UsageError(f"the box of the moving scene is empty: {self._low.tolist()} to {self._high.tolist()}")
        if threads < 1:
            raise UsageError(f"threads is {threads}; it must be at least 1")
        self.settings = settings
        self._pool = (
            ThreadPoolExecutor(threads, initializer=torch.set_num_threads, initargs=(1,)) if threads > 1 else None
        )
        sizes = [settings.levels * settings.features, *[settings.hidden_width] * settings.hidden_layers, _OUTPUTS]
        self._shapes = [(out, given) for given, out in pairwise(sizes)]
        self._passes: list[_Pass] | None = None
        self._count, self._pending = 0, False
        with _one_thread():
            self._grid = torch.empty(settings.levels * settings.table, settings.features)
            self._head = _Trained(torch.empty(sum(out * (given + 1) for out, given in self._shapes)))
            self._matrices, self._biases = self._layers(self._head.value)
            self._set(_first_weights(settings, self._shapes, seed))
            self._start = (self._grid.clone(), self._head.value.clone())
            self._forget_placement()

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
        with _one_thread():
            first, second, count = self._head.first.clone(), self._head.second.clone(), self._count
            kept = self._table_moments() if same_frame else None
            self._settle()
            self._forget_placement()
            self._set_base(means, quaternions)
            points = (self._means.astype(np.float64) - self._low) / (self._high - self._low)
            inside = np.flatnonzero(((points >= 0.0) & (points <= 1.0)).all(axis=1))
            self._reading = _read_grid(self.settings, points[inside], inside)
            self._rows = _Trained(self._grid[self._reading.rows])
            self._feature_gradients = torch.empty(len(inside) * self.settings.levels, self.settings.features)
            if kept is not None:
                self._rows.first, self._rows.second = (m[self._reading.rows] for m in kept)
                self._head.first, self._head.second, self._count = first, second, count

    def rebase(self, means: FloatArray, quaternions: FloatArray) -> None:
        """Give the placed Gaussians other base values (same M, same order); the grid is read where it was.

        For stage 2, where the Gaussians' own attributes are optimised together with the cache.
        """
        if len(means) != len(self._means):
            raise ValueError(f"{len(means)} Gaussians cannot replace the {len(self._means)} that were placed")
        self._set_base(means, quaternions)
        self._passes = None

    def moved(self) -> tuple[FloatArray, FloatArray]:
        """The placed Gaussians where the cache moves them: means (M, 3), unit quaternions (M, 4), fresh arrays.

        Keeps what `backward` needs, until the next `step`. Source: DecoGS stage 1; 3DGStream, equation 5.
        """
        means, quaternions = self._means.copy(), self._quaternions.copy()
        with _one_thread():
            passes = self._run(self._forward, self._chunks())
            base = torch.from_numpy(means[self._reading.inside])
            for chunk in passes:
                out = chunk.activations[-1]
                base[chunk.rows] += out[:, :3] * self.settings.translation_scale
                quaternions[self._reading.inside[chunk.rows]] = _multiply(chunk.base, chunk.turn).numpy()
            means[self._reading.inside] = base.numpy()
        self._passes = passes
        return means, quaternions

    # -- training -------------------------------------------------------------------------------------------------

    def backward(self, v_means: FloatArray, v_quaternions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Add the weights' gradients for a loss with these gradients in the moved values, (M, 3) and (M, 4).

        May be called several times after one `moved` (one per view). Returns the gradients in the base values given to
        `place` or `rebase`, (M, 3) and (M, 4), for stage 2; the grid's reading points count as constants.
        Raises TrainingError for NaN; infinite gradients are clipped to ``gradient_limit`` as all are.
        """
        if self._passes is None:
            raise RuntimeError("backward() needs moved() first, since the last step(), place(), rebase() or restart()")
        if v_means.shape != self._means.shape or v_quaternions.shape != self._quaternions.shape:
            raise ValueError(f"gradients {v_means.shape}, {v_quaternions.shape} for {len(self._means)} Gaussians")
        if np.isnan(v_means).any() or np.isnan(v_quaternions).any():
            raise TrainingError(
                "a gradient handed to the transformation cache is not a number; lower the learning rate"
            )
        limit = self.settings.gradient_limit
        v_means, v_quaternions = (np.clip(v, -limit, limit).astype(np.float32) for v in (v_means, v_quaternions))
        v_unit = v_quaternions.copy()
        inside = self._reading.inside
        with _one_thread():
            v_moved = torch.from_numpy(np.concatenate([v_means[inside], v_quaternions[inside]], axis=1))
            through: list[Tensor] = []
            jobs = []
            for chunk in self._passes:
                v_out, v_base = self._through_transform(chunk, v_moved[chunk.rows])
                through.append(v_base)
                jobs.append((chunk, v_out))
            self._accumulate(jobs)
            if through:
                v_unit[inside] = torch.cat(through).numpy()
        return v_means, self._through_base_norm(v_unit)

    def step(self) -> None:
        """One Adam step on the gradients gathered since the last one; nothing happens when there are none."""
        self._adam(self.settings.learning_rate)

    def restart(self) -> None:
        """Back to the starting (identity or warmed-up) weights, Adam at rest; placed Gaussians stay placed."""
        with _one_thread():
            grid, head = self._start
            self._grid.copy_(grid)
            self._head.value.copy_(head)
            self._head.reset()
            self._rows = _Trained(self._grid[self._reading.rows])
            self._count, self._pending, self._passes = 0, False, None

    def warm_up(
        self,
        means: FloatArray,
        *,
        iterations: int = 500,
        learning_rate: float = 1e-4,
        points: int = 8192,
        noise: float = 0.01,
        seed: int = 0,
    ) -> float:
        """Train towards the identity on the initial frame's centres; `restart` then returns to these weights.

        Loss (3DGStream): L1 of the translation + (1 - cos^2) of the rotation to the identity, over at most ``points``
        of {centres, centres + noise * U[0, 1), uniform in the box}, a third each. Adam at 3DGStream's warm-up rate,
        500 iterations as in DecoGS. Returns the last loss. Not needed, and without effect, with ``identity_start``:
        the loss is then at its minimum. Forgets placed Gaussians.
        """
        rng = np.random.default_rng(seed)
        third = max(1, points // 3)
        chosen = means[rng.permutation(len(means))[:third]].astype(np.float64)
        spread = chosen + noise * rng.random(chosen.shape)
        anywhere = self._low + (self._high - self._low) * rng.random((third, 3))
        samples = np.concatenate([chosen, spread, anywhere]).astype(np.float32)
        self.place(samples, np.tile(np.array([1, 0, 0, 0], np.float32), (len(samples), 1)))
        loss = 0.0
        for _ in range(iterations):
            with _one_thread():
                passes = self._run(self._forward, self._chunks())
                losses = [_identity_loss(chunk.activations[-1], len(self._reading.inside)) for chunk in passes]
                loss = math.fsum(value for value, _ in losses)
                self._accumulate([(chunk, v) for chunk, (_, v) in zip(passes, losses, strict=True)])
            self._adam(learning_rate)
        with _one_thread():
            self._settle()
            self._forget_placement()
            self._start = (self._grid.clone(), self._head.value.clone())
        return loss

    # -- the weights as data --------------------------------------------------------------------------------------

    def weights(self) -> CacheWeights:
        """A copy of the weights as they stand."""
        self._settle()
        return self._as_arrays(self._grid, self._head.value)

    def gradients(self) -> CacheWeights:
        """A copy of the gradients gathered since the last `step`, zero for entries that no placed Gaussian reads."""
        grid = torch.zeros_like(self._grid)
        grid[self._reading.rows] = self._rows.gradient
        return self._as_arrays(grid, self._head.gradient)

    def set_weights(self, weights: CacheWeights) -> None:
        """Replace the weights and what `restart` returns to, Adam at rest; raises ValueError for other shapes."""
        given = [a.shape for a in (weights.grid, *weights.matrices, *weights.biases)]
        own = self._as_arrays(self._grid, self._head.value)
        if given != [a.shape for a in (own.grid, *own.matrices, *own.biases)]:
            raise ValueError("these weights belong to a cache of other settings")
        self._set(weights)
        self._start = (self._grid.clone(), self._head.value.clone())
        self.restart()

    def parameters(self) -> ParameterCount:
        """Number and size of the parameters, and how many of them the placed Gaussians train."""
        head = self._head.value.numel()
        dense = sum(min(r**3, self.settings.table) for r in self.settings.resolutions())
        count = dense * self.settings.features + head
        return ParameterCount(count, 4 * count, self._rows.value.numel() + head)

    def digest(self) -> str:
        """SHA-256 of all weights, in hexadecimal: equal for equal states."""
        weights = self.weights()
        state = hashlib.sha256()
        for array in (weights.grid, *weights.matrices, *weights.biases):
            state.update(array.astype("<f4").tobytes())
        return state.hexdigest()

    # -- inside ---------------------------------------------------------------------------------------------------

    def _run(self, work: Callable[[_Task], _Result], tasks: Sequence[_Task]) -> list[_Result]:
        """Results in the order of the tasks, whatever the number of threads."""
        if self._pool is None or len(tasks) < 2:
            return [work(task) for task in tasks]
        return list(self._pool.map(work, tasks))

    def _chunks(self) -> list[slice]:
        n = len(self._reading.inside)
        return [slice(k, min(k + _CHUNK, n)) for k in range(0, n, _CHUNK)]

    def _forward(self, rows: slice) -> _Pass:
        """Grid and MLP for one chunk of the Gaussians inside the box."""
        per_centre = 8 * self.settings.levels
        pairs = slice(rows.start * per_centre, rows.stop * per_centre)
        starts = torch.arange(0, pairs.stop - pairs.start, 8, dtype=torch.int32)
        entry, weight = self._reading.entry[pairs], self._reading.weight[pairs]
        features = _sparse_product(entry, starts, self._rows.value, weight)
        activations = [features.view(rows.stop - rows.start, -1)]
        for layer, (matrix, bias) in enumerate(zip(self._matrices, self._biases, strict=True)):
            x = torch.addmm(bias, activations[-1], matrix.t())
            activations.append(x.relu_() if layer < len(self._matrices) - 1 else x)
        turn, norm = _normalise(activations[-1][:, 3:])
        base = torch.from_numpy(self._quaternions[self._reading.inside[rows]])
        return _Pass(rows, activations, base, turn, norm)

    def _through_transform(self, chunk: _Pass, v_moved: Tensor) -> tuple[Tensor, Tensor]:
        """Gradients in the MLP's outputs (n, 7) and in the unit base quaternions (n, 4).

        The transpose of a product by a quaternion is the product by its conjugate.
        """
        v_quaternions = v_moved[:, 3:]
        v_turn = _multiply(_conjugate(chunk.base), v_quaternions)
        v_turn = (v_turn - chunk.turn * (chunk.turn * v_turn).sum(1, keepdim=True)) / chunk.turn_norm
        v_turn = torch.where(chunk.turn_norm > _TINY, v_turn, torch.zeros_like(v_turn))
        v_out = torch.cat([v_moved[:, :3] * self.settings.translation_scale, v_turn], 1)
        return v_out, _multiply(v_quaternions, _conjugate(chunk.turn))

    def _accumulate(self, jobs: Sequence[tuple[_Pass, Tensor]]) -> None:
        """Add the gradients of MLP and grid, from the gradients in the MLP's outputs per chunk."""
        if not jobs:
            return
        for gradient in self._run(self._backward_mlp, jobs):
            self._head.gradient += gradient
        self._run(self._backward_level, range(self.settings.levels))
        self._pending = True

    def _backward_mlp(self, job: tuple[_Pass, Tensor]) -> Tensor:
        """One chunk's gradient of the MLP's weights; the features' gradient goes to its rows of the shared buffer."""
        chunk, v = job
        gradient = torch.empty_like(self._head.value)
        matrices, biases = self._layers(gradient)
        levels = self.settings.levels
        features = self._feature_gradients[chunk.rows.start * levels : chunk.rows.stop * levels]
        for layer in reversed(range(len(matrices))):
            given = chunk.activations[layer]
            torch.mm(v.t(), given, out=matrices[layer])
            torch.sum(v, 0, out=biases[layer])
            if layer == 0:
                torch.mm(v, self._matrices[0], out=features.view(given.shape))
            else:
                v = (v @ self._matrices[layer]).mul_(given.sign())  # ReLU's outputs are 0 or positive
        return gradient

    def _backward_level(self, level: int) -> None:
        """One level's share of the grid's gradient: the transposed sparse product."""
        feature, starts, weight, rows = self._reading.transposed[level]
        self._rows.gradient[rows] += _sparse_product(feature, starts, self._feature_gradients, weight)

    def _adam(self, rate: float) -> None:
        self._passes = None
        if not self._pending:
            return
        self._count += 1
        with _one_thread():
            for trained in (self._rows, self._head):
                trained.step(self.settings, rate, self._count)
        self._pending = False

    def _set_base(self, means: FloatArray, quaternions: FloatArray) -> None:
        if means.ndim != 2 or means.shape[1] != 3 or quaternions.shape != (len(means), 4):
            raise ValueError(f"means (M, 3) and quaternions (M, 4) wanted, not {means.shape} and {quaternions.shape}")
        if not (np.isfinite(means).all() and np.isfinite(quaternions).all()):
            raise TrainingError("a Gaussian handed to the transformation cache has a value that is not finite")
        self._means = np.array(means, np.float32, order="C")
        # In float64, so that the float32 result is the nearest one and a large stored norm cannot overflow.
        wide = quaternions.astype(np.float64)
        self._norms = np.sqrt((wide * wide).sum(axis=1, keepdims=True))
        turned = self._norms > 1e-18  # a zero quaternion stands for no rotation, as in the rasteriser
        unit = np.where(turned, wide / np.where(turned, self._norms, 1.0), [1.0, 0.0, 0.0, 0.0])
        self._quaternions = np.ascontiguousarray(unit.astype(np.float32))

    def _through_base_norm(self, v_unit: FloatArray) -> FloatArray:
        """Gradient in the base quaternions from that in their unit versions; zero for a zero quaternion."""
        along = (self._quaternions * v_unit).sum(axis=1, keepdims=True)
        turned = self._norms > 1e-18
        v = np.where(turned, (v_unit - self._quaternions * along) / np.where(turned, self._norms, 1.0), 0.0)
        limit = self.settings.gradient_limit  # a tiny norm makes a huge gradient
        clipped: FloatArray = np.clip(v, -limit, limit).astype(np.float32)
        return clipped

    def _forget_placement(self) -> None:
        self._means, self._quaternions = np.zeros((0, 3), np.float32), np.zeros((0, 4), np.float32)
        self._norms = np.zeros((0, 1))
        self._reading = _read_grid(self.settings, np.zeros((0, 3)), np.zeros(0, np.int64))
        self._rows = _Trained(self._grid[:0].clone())
        self._feature_gradients = torch.empty(0, self.settings.features)
        self._head.reset()
        self._count, self._pending = 0, False
        self._passes = None

    def _settle(self) -> None:
        """Write the trained entries back to the table."""
        self._grid[self._reading.rows] = self._rows.value

    def _table_moments(self) -> list[Tensor]:
        """Both moments of the grid as an Adam over the whole table would hold them."""
        moments = []
        for own in (self._rows.first, self._rows.second):
            table = torch.zeros_like(self._grid)
            table[self._reading.rows] = own
            moments.append(table)
        return moments

    def _layers(self, flat: Tensor) -> tuple[list[Tensor], list[Tensor]]:
        """Views of a flat MLP tensor: per layer the matrix (out, in) and the bias (out,)."""
        matrices, biases, at = [], [], 0
        for out, given in self._shapes:
            matrices.append(flat[at : at + out * given].view(out, given))
            biases.append(flat[at + out * given : at + out * (given + 1)])
            at += out * (given + 1)
        return matrices, biases

    def _set(self, weights: CacheWeights) -> None:
        self._grid.copy_(torch.tensor(weights.grid).view(self._grid.shape))
        given = (*weights.matrices, *weights.biases)
        for own, array in zip((*self._matrices, *self._biases), given, strict=True):
            own.copy_(torch.tensor(array))

    def _as_arrays(self, grid: Tensor, head: Tensor) -> CacheWeights:
        s = self.settings
        matrices, biases = (tuple(t.numpy().copy() for t in tensors) for tensors in self._layers(head))
        return CacheWeights(grid.view(s.levels, s.table, s.features).numpy().copy(), matrices, biases)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Torch on one thread: the order of its sums, hence their rounding, depends on the number."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _first_weights(settings: CacheSettings, shapes: Sequence[tuple[int, int]], seed: int) -> CacheWeights:
    """Starting weights: a faint random grid, Xavier-uniform layers (as tiny-cuda-nn), the identity as last bias.

    Drawn by numpy, whose streams are the same in every version of torch.
    """
    rng = np.random.default_rng(seed)
    spread = settings.grid_spread
    grid = rng.uniform(-spread, spread, (settings.levels, settings.table, settings.features)).astype(np.float32)
    matrices = []
    for out, given in shapes:
        bound = math.sqrt(6.0 / (out + given))
        matrices.append(rng.uniform(-bound, bound, (out, given)).astype(np.float32))
    if settings.identity_start:
        matrices[-1] = np.zeros(shapes[-1], np.float32)
    biases = [np.zeros(out, np.float32) for out, _ in shapes]
    biases[-1][3] = 1.0
    return CacheWeights(grid, tuple(matrices), tuple(biases))


def _read_grid(settings: CacheSettings, points: NDArray[np.float64], inside: NDArray[np.int64]) -> _Reading:
    """The sparse matrix for centres ``points`` (n, 3) in 0..1, and its transpose sorted by entry."""
    levels, table = settings.levels, settings.table
    entry = np.empty((len(points), levels, 8), np.int32)
    weight = np.empty((len(points), levels, 8), np.float32)
    sortable = np.uint16 if settings.table_log2 <= 16 else np.uint32  # 16-bit keys are radix-sorted
    rows, transposed, first_row = [], [], 0
    for level in range(levels):
        indices = level_indices(settings, points, level)
        weights = level_weights(settings, points, level).astype(np.float32)
        counts = np.bincount(indices.reshape(-1), minlength=table)
        present = np.flatnonzero(counts)
        new_row = np.zeros(table, np.int32)
        new_row[present] = np.arange(first_row, first_row + len(present), dtype=np.int32)
        entry[:, level], weight[:, level] = new_row[indices], weights
        order = np.argsort(indices.reshape(-1).astype(sortable), kind="stable")
        ends = np.cumsum(counts[present])
        transposed.append(
            (
                torch.tensor((order // 8 * levels + level).astype(np.int32)),
                torch.tensor((ends - counts[present]).astype(np.int32)),
                torch.tensor(weights.reshape(-1)[order]),
                slice(first_row, first_row + len(present)),
            )
        )
        rows.append(present + level * table)
        first_row += len(present)
    read = torch.tensor(np.concatenate(rows), dtype=torch.int64)
    return _Reading(inside, read, torch.tensor(entry.reshape(-1)), torch.tensor(weight.reshape(-1)), tuple(transposed))


def _sparse_product(columns: Tensor, starts: Tensor, dense: Tensor, values: Tensor) -> Tensor:
    """A sparse matrix (its rows' columns and values, and where each row starts) times ``dense``, summed in order."""
    return functional.embedding_bag(columns, dense, starts, mode="sum", per_sample_weights=values)


def _multiply(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product of quaternions (n, 4) wxyz."""
    aw, ax, ay, az = a.unbind(1)
    bw, bx, by, bz = b.unbind(1)
    return torch.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        1,
    )


def _conjugate(quaternions: Tensor) -> Tensor:
    return quaternions * torch.tensor([1.0, -1.0, -1.0, -1.0])


def _normalise(quaternions: Tensor) -> tuple[Tensor, Tensor]:
    """Unit quaternions (n, 4) and the norms (n, 1); (nearly) zero ones become the identity. No overflow, no NaN."""
    size = quaternions.abs().amax(1, keepdim=True).clamp_min(_TINY)
    scaled = quaternions / size
    norm = scaled.norm(dim=1, keepdim=True)
    identity = torch.tensor([1.0, 0.0, 0.0, 0.0])
    usable = norm * size > _TINY
    return torch.where(usable, scaled / norm.clamp_min(_TINY), identity), norm * size


def _identity_loss(out: Tensor, total: int) -> tuple[float, Tensor]:
    """3DGStream's warm-up loss of a chunk's outputs (n, 7) among ``total``, and its gradient in them."""
    shift, (turn, norm) = out[:, :3], _normalise(out[:, 3:])
    w = turn[:, :1]
    value = float(shift.abs().sum()) / (3 * total) + float((1.0 - w * w).sum()) / total
    v_turn = 2.0 * w * (w * turn - torch.tensor([1.0, 0.0, 0.0, 0.0])) / norm.clamp_min(_TINY)
    return value, torch.cat([shift.sign() / (3 * total), v_turn / total], 1)
