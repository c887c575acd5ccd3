"""Rounds of a take: who is in the base, and by which offsets its values differ from those in the whole scene.

Who is in the base stays there, and so do the offsets, unless a Gaussian moves: then values drift apart from what they
were trained with.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.keyframes import new_state
from decogs.codec.scene.lattice import Lattice, dequantise, quantise
from decogs.codec.scene.state import (
    ARRAYS,
    Attributes,
    IntArray,
    Rows,
    State,
    empty_attributes,
    take_rows,
)
from decogs.formats.cameras import Camera, as_pinhole, rig_extent, scale_camera

from ..backends import training_kernel
from .distil import Moment, Schedule, distil, likeness
from .utility import utility

_MOST_CAMERAS = 16
_PICTURE_PIXELS = 100_000
"""About which pictures are drawn for training: what a base of fewer Gaussians can show needs no more."""
_STEPS = 800
_GROWTH = 0.35
"""Of logarithmic sizes of those that are new in the base: few Gaussians have to cover what many did."""
_CHANGE_COST = 0.6
"""Of a Gaussian in a frame in which it changes, in bytes of one that is new: 3.7 to 6.3."""
_BYTES_PER_SHARE = 1.3
"""So much of all bytes may the base take for its share of the Gaussians: those that change most are useful most."""
_THRIFTS = (0.0, 0.15, 0.3, 0.45, 0.6, 0.8, 1.0)
"""How much what one takes counts against what it is worth; as little as keeps within that."""
_MAX_DRIFT_DB = 1.5
"""By which a base may be less like the whole in a round than in the one before, if the offsets of what stands still are
kept: new ones are coded twice."""
_COARSENESS = {"means": 4, "log_scales": 1, "quaternions": 1, "opacity_logits": 2, "sh": 2}
"""Steps of the lattice to which offsets are rounded: the base need not have the precision of the whole."""
_SEED = 0


@dataclass(frozen=True, eq=False)
class Footage:
    """What is known of a round: some of its ``scenes``, of which there is one at least, and the ids of what changes,
    frame by frame (``changed``)."""

    scenes: Sequence[State]
    changed: Sequence[Rows]

    @property
    def moved(self) -> Rows:
        """The ids of all that changed, rising."""
        return np.unique(np.concatenate([*self.changed, np.zeros(0, np.int64)]))


@dataclass(frozen=True, eq=False)
class Round:
    """``ids``: those of the base, rising; ``offsets``: what is added to their integers in the whole scene;
    ``likeness``: of the base to that, dB of each scene that was trained on."""

    ids: Rows
    offsets: Attributes
    likeness: list[float]

    def base(self, scene: State) -> State:
        """The base of a scene: those of its Gaussians that are in the base, with their offsets."""
        here = np.isin(scene.ids, self.ids, assume_unique=True)
        ids = scene.ids[here]
        offsets = take_rows(self.offsets, np.searchsorted(self.ids, ids))
        values = _plus(take_rows(scene, np.flatnonzero(here)), offsets)
        return new_state(values, scene.frame, ids=ids, next_id=scene.next_id)

    def updated(self, scene: State, ids: Rows, offsets: Attributes) -> Round:
        """Those that are in the ``scene``, with these ``offsets`` of these ``ids``, which may be new in the base."""
        stay = np.isin(self.ids, np.setdiff1d(scene.ids, ids, assume_unique=True), assume_unique=True)
        every = np.concatenate([self.ids[stay], ids])
        both = (np.concatenate([getattr(self.offsets, name)[stay], getattr(offsets, name)]) for name in ARRAYS)
        order = np.argsort(every)
        return replace(self, ids=every[order], offsets=take_rows(Attributes(*both), order))


@dataclass(frozen=True, eq=False)
class _Sample:
    """What a round is trained on: Gaussians ``ids``, each with its ``values`` in the first moment in which it is
    there."""

    ids: Rows
    values: Attributes
    moments: list[Moment]


class RoundMaker:
    """Makes one round of a stream with this ``header`` after the other, with a base of about this ``share``."""

    def __init__(self, header: StreamHeader, share: float, threads: int = 0) -> None:
        self._share, self._lattice = share, header.lattice
        self._kernel = training_kernel("cpu", threads, header.background)
        self._cameras = _training_cameras(header.cameras)
        self._random = np.random.default_rng(_SEED)
        self._schedule = Schedule(_STEPS, rig_extent(header.cameras) or 1.0)

    def made(self, footage: Footage, before: Round | None, moved: Rows) -> Round:
        """The base of a round; offsets of ``before`` stay where nothing ``moved``, if that is as good."""
        sample = self._sample(footage, before)
        start = grown(len(sample.ids), sample.values.coefficients, _GROWTH, self._lattice)
        nobody = np.zeros(len(sample.ids), bool)
        if before is None:
            return self._trained(sample, start, nobody)
        start = _with_offsets(start, sample.ids, before)
        still = np.isin(sample.ids, np.setdiff1d(before.ids, moved, assume_unique=True), assume_unique=True)
        trained = self._trained(sample, start, still)
        if np.mean(trained.likeness) >= np.mean(before.likeness) - _MAX_DRIFT_DB:
            return trained
        return self._trained(sample, start, nobody)

    def _trained(self, sample: _Sample, offsets: Attributes, kept: NDArray[np.bool_]) -> Round:
        """A round that begins with ``offsets``, of which those of ``kept`` Gaussians stay."""
        ids, values, moments = sample.ids, sample.values, sample.moments
        if not kept.all():
            start = dequantise(_plus(values, offsets), self._lattice)
            trained = distil(self._kernel, moments, self._cameras, start, kept, self._schedule, self._random)
            changed = _coarse(_minus(quantise(trained, self._lattice, near=values), values))
            offsets = Attributes(*(_put(getattr(changed, n), kept, getattr(offsets, n)[kept]) for n in ARRAYS))
        base = dequantise(_plus(values, offsets), self._lattice)
        likest = likeness(self._kernel, base, moments, self._cameras)
        return Round(ids, offsets, likest)

    def _sample(self, footage: Footage, before: Round | None) -> _Sample:
        """What the base of the round is trained on."""
        ids = self._chosen(footage, np.zeros(0, np.int64) if before is None else before.ids)
        values = _over_time(footage.scenes, ids)
        moments = [self._moment(scene, ids, own) for scene, own in zip(footage.scenes, values, strict=True)]
        return _Sample(ids, values[0], moments)

    def _chosen(self, footage: Footage, members: Rows) -> Rows:
        """The ids of the base: ``members`` of before that are still there, and of the others those that are worth most.

        What changes takes bytes.
        """
        everyone = np.unique(np.concatenate([scene.ids for scene in footage.scenes]))
        worth, frames_there, cost = (np.zeros(len(everyone)) for _ in range(3))
        for scene in footage.scenes:
            rows = np.searchsorted(everyone, scene.ids)
            worth[rows] += utility(self._kernel, dequantise(scene, self._lattice), self._cameras, self._random)
            frames_there[rows] += 1
        for ids in footage.changed:
            cost[np.searchsorted(everyone, np.intersect1d(ids, everyone, assume_unique=True))] += _CHANGE_COST
        cost += 1
        stays = np.isin(everyone, members, assume_unique=True)
        most = max(round(self._share * len(everyone)), int(stays.sum()), min(1, len(everyone)))
        for thrift in _THRIFTS:
            # Those of before come first, the others as they are worth.
            best = np.lexsort((-worth / frames_there / cost**thrift, ~stays))[:most]
            if cost[best].sum() <= _BYTES_PER_SHARE * self._share * cost.sum():
                break
        return everyone[np.sort(best)]

    def _moment(self, state: State, ids: Rows, values: Attributes) -> Moment:
        scene = dequantise(state, self._lattice)
        pictures = [np.clip(self._kernel.forward(scene, camera).rgb, 0, 1).copy() for camera in self._cameras]
        return Moment(dequantise(values, self._lattice), np.isin(ids, state.ids, assume_unique=True), pictures)


def grown(count: int, coefficients: int, growth: float, lattice: Lattice) -> Attributes:
    """Offsets of Gaussians that are new in the base: none but larger logarithmic sizes."""
    nothing = _zeros(count, coefficients)
    return replace(nothing, log_scales=nothing.log_scales + np.int32(round(growth / lattice.log_scales)))


def _training_cameras(cameras: Sequence[Camera]) -> list[Camera]:
    """Pinholes of some of the cameras, spread over them, at the size of training."""
    count = min(len(cameras), _MOST_CAMERAS)
    some = [cameras[k * len(cameras) // count] for k in range(count)]
    scales = [min(1.0, (_PICTURE_PIXELS / (camera.width * camera.height)) ** 0.5) for camera in some]
    return [scale_camera(as_pinhole(camera), scale) for camera, scale in zip(some, scales, strict=True)]


def _with_offsets(offsets: Attributes, ids: Rows, before: Round) -> Attributes:
    """The ``offsets`` of these Gaussians, but those of the round ``before`` where it has them."""
    known = np.isin(ids, before.ids, assume_unique=True)
    theirs = take_rows(before.offsets, np.searchsorted(before.ids, ids[known]))
    return Attributes(*(_put(getattr(offsets, name), known, getattr(theirs, name)) for name in ARRAYS))


def _over_time(states: Sequence[State], ids: Rows) -> list[Attributes]:
    """The integers of these Gaussians in each state; where one is not there, those of the nearest state before or
    after in which it is."""
    count, coefficients = len(ids), states[0].coefficients
    known = np.zeros(count, bool)
    now = _zeros(count, coefficients)
    filled: list[Attributes] = []
    for state in [*states[::-1], *states]:  # backwards, so that the first state has all
        here = np.isin(ids, state.ids, assume_unique=True)
        rows = take_rows(state, np.searchsorted(state.ids, ids[here]))
        now = Attributes(*(_put(getattr(now, name), here, getattr(rows, name)) for name in ARRAYS))
        known |= here
        filled.append(now)
    return filled[len(states) :]


def _plus(one: Attributes, other: Attributes) -> Attributes:
    return Attributes(*(getattr(one, name) + getattr(other, name) for name in ARRAYS))


def _minus(one: Attributes, other: Attributes) -> Attributes:
    return Attributes(*(getattr(one, name) - getattr(other, name) for name in ARRAYS))


def _coarse(offsets: Attributes) -> Attributes:
    """The nearest multiples of `_COARSENESS` lattice steps."""
    steps = {name: np.int32(_COARSENESS[name]) for name in ARRAYS}
    rounded = {name: np.rint(getattr(offsets, name) / steps[name]).astype(np.int32) * steps[name] for name in ARRAYS}
    return Attributes(**rounded)


def _zeros(count: int, coefficients: int) -> Attributes:
    nothing = empty_attributes(coefficients)
    return Attributes(*(np.zeros((count, *getattr(nothing, name).shape[1:]), np.int32) for name in ARRAYS))


def _put(values: IntArray, here: NDArray[np.bool_], some: IntArray) -> IntArray:
    """A copy with ``some`` in the rows that are ``here``."""
    changed: IntArray = values.copy()
    changed[here] = some
    return changed
