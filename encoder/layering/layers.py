"""A take in two layers: a base that stands alone, and all of it (SPEC.md, "Layers").

A take is trained in rounds of some 60 frames. Who is in the base stays there, and so do the offsets of
its values from those of the whole scene, unless it moves: then values drift apart from what they were trained with.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.layer_list import Layer
from decogs.codec.packets.keyframes import new_state
from decogs.codec.scene.lattice import dequantise, quantise
from decogs.codec.scene.state import (
    ARRAYS,
    Attributes,
    IntArray,
    Rows,
    State,
    changed_between,
    empty_attributes,
    same_scene,
    take_rows,
)
from decogs.decoder.editing.take import Frame, Take
from decogs.formats.cameras import Camera, as_pinhole, rig_extent, scale_camera
from decogs.formats.errors import UsageError

from ..backends import training_kernel
from .distil import Moment, Schedule, distil, likeness
from .utility import utility

_ROUND_FRAMES = 60
"""In which the base drifts by a dB or two from what it was trained for, on moving scenes."""
_MOMENTS = 6
"""Frames of a round that are trained on."""
_MOST_CAMERAS = 16
_PICTURE_PIXELS = 100_000
"""About which pictures are drawn for training: what a base of fewer Gaussians can show needs no more."""
_STEPS = 800
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
class _Round:
    """``ids``: those of the base in its ``frames``, rising; ``offsets``: what is added to their integers in the whole
    scene; ``likeness``: of the base to that, dB of some frames; ``moved``: ids of all that changed."""

    frames: range
    ids: Rows
    offsets: Attributes
    likeness: list[float]
    moved: Rows


@dataclass(frozen=True, eq=False)
class _Sample:
    """What a round is trained on: Gaussians ``ids``, each with its ``values`` in the first moment in which it is there;
    ``moved``: ids of all that changed."""

    frames: range
    ids: Rows
    values: Attributes
    moments: list[Moment]
    moved: Rows


def layered(take: Take, share: float) -> Take:
    """The take with a base of about this ``share`` of its Gaussians. Raises UsageError for frames without any.

    All frames are read once for that; training takes some seconds for each round.
    """
    maker = _RoundMaker(take, share)
    rounds: list[_Round] = []
    for frames in _rounds(take):
        rounds.append(maker.made(frames, rounds[-1] if rounds else None))

    def read(start: int, stop: int) -> Iterator[Frame]:
        coming = iter(rounds)
        now = next(coming)
        for number, frame in enumerate(take.read(start, stop), start=start):
            while number not in now.frames:
                now = next(coming)
            yield replace(frame, base=_base(frame.state, now), coded=None)

    likest = [dB for each in rounds for dB in each.likeness]
    psnr = float(np.mean(likest))
    header = replace(take.header, layers=(Layer(0, 0.0, psnr), Layer(0, 0.0)))
    note = f"layer: a base of {share:.0%} of the Gaussians, {psnr:.1f} dB of the whole (worst frame {min(likest):.1f})"
    return replace(take, header=header, read=read).with_note(note)


def _rounds(take: Take) -> list[range]:
    """The frames of each round: about as many in each, but that one begins with a segment if one begins thereabouts."""
    parts = max(1, round(take.frame_count / _ROUND_FRAMES))
    even = [take.frame_count * part // parts for part in range(1, parts)]
    nearest = [min(take.starts, key=lambda start: abs(start - border)) for border in even]
    borders = [
        start if abs(start - border) <= _ROUND_FRAMES // 4 else border
        for start, border in zip(nearest, even, strict=True)
    ]
    return [range(a, b) for a, b in pairwise([0, *borders, take.frame_count])]


class _RoundMaker:
    """Makes one round of a take after the other."""

    def __init__(self, take: Take, share: float) -> None:
        self._take, self._share, self._lattice = take, share, take.header.lattice
        self._kernel = training_kernel("cpu", background=take.header.background)
        self._cameras = _training_cameras(take.header.cameras)
        self._random = np.random.default_rng(_SEED)
        self._schedule = Schedule(_STEPS, rig_extent(take.header.cameras) or 1.0)

    def made(self, frames: range, before: _Round | None) -> _Round:
        """The base in these ``frames``; offsets of ``before`` stay where nothing moved, if that is as good."""
        sample = self._sample(frames, before)
        nobody = np.zeros(len(sample.ids), bool)
        if before is None:
            return self._trained(sample, _zeros(len(sample.ids), sample.values.coefficients), nobody)
        offsets = _offsets_of(before, sample.ids)
        moved = np.union1d(sample.moved, before.moved)
        still = np.isin(sample.ids, np.setdiff1d(before.ids, moved, assume_unique=True), assume_unique=True)
        grown = self._trained(sample, offsets, still)
        if np.mean(grown.likeness) >= np.mean(before.likeness) - _MAX_DRIFT_DB:
            return grown
        return self._trained(sample, offsets, nobody)

    def _trained(self, sample: _Sample, offsets: Attributes, kept: NDArray[np.bool_]) -> _Round:
        """A round that begins with ``offsets``, of which those of ``kept`` Gaussians stay."""
        ids, values, moments = sample.ids, sample.values, sample.moments
        if not kept.all():
            start = dequantise(_plus(values, offsets), self._lattice)
            trained = distil(self._kernel, moments, self._cameras, start, kept, self._schedule, self._random)
            changed = _coarse(_minus(quantise(trained, self._lattice, near=values), values))
            offsets = Attributes(*(_put(getattr(changed, n), kept, getattr(offsets, n)[kept]) for n in ARRAYS))
        base = dequantise(_plus(values, offsets), self._lattice)
        likest = likeness(self._kernel, base, moments, self._cameras)
        return _Round(sample.frames, ids, offsets, likest, sample.moved)

    def _sample(self, frames: range, before: _Round | None) -> _Sample:
        """What the base of these ``frames`` is trained on."""
        states, changed = self._scenes(frames)
        ids = self._chosen(states, changed, np.zeros(0, np.int64) if before is None else before.ids)
        if not len(ids):
            where = f"frames {frames.start} to {frames.stop - 1}"
            raise UsageError(f"layer: no Gaussian is there in {where}; `trim` them away")
        values = _over_time(states, ids)
        moments = [self._moment(state, ids, own) for state, own in zip(states, values, strict=True)]
        moved = np.unique(np.concatenate([*changed, np.zeros(0, np.int64)]))
        return _Sample(frames, ids, values[0], moments, moved)

    def _scenes(self, frames: range) -> tuple[list[State], list[Rows]]:
        """Some of the frames' scenes, the first among them, and the ids of what changes from frame to frame."""
        wanted = {round(at) for at in np.linspace(frames.start, frames.stop - 1, min(_MOMENTS, len(frames)))}
        states, changed, before = list[State](), list[Rows](), None
        for number, frame in enumerate(self._take.read(frames.start, frames.stop), frames.start):
            if before is not None and not same_scene(before, frame.state):
                changed.append(before.ids[changed_between(before, frame.state)])
            before = frame.state
            if number in wanted:
                states.append(frame.state)
        return states, changed

    def _chosen(self, states: list[State], changed: list[Rows], members: Rows) -> Rows:
        """The ids of the base: ``members`` of before that are still there, and of the others those that are worth most.

        ``changed``: ids of those that change, frame by frame; what changes takes bytes.
        """
        everyone = np.unique(np.concatenate([state.ids for state in states]))
        worth, frames_there, cost = (np.zeros(len(everyone)) for _ in range(3))
        for state in states:
            rows = np.searchsorted(everyone, state.ids)
            worth[rows] += utility(self._kernel, dequantise(state, self._lattice), self._cameras, self._random)
            frames_there[rows] += 1
        for ids in changed:
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


def _training_cameras(cameras: Sequence[Camera]) -> list[Camera]:
    """Pinholes of some of the cameras, spread over them, at the size of training."""
    count = min(len(cameras), _MOST_CAMERAS)
    some = [cameras[k * len(cameras) // count] for k in range(count)]
    scales = [min(1.0, (_PICTURE_PIXELS / (camera.width * camera.height)) ** 0.5) for camera in some]
    return [scale_camera(as_pinhole(camera), scale) for camera, scale in zip(some, scales, strict=True)]


def _offsets_of(before: _Round, ids: Rows) -> Attributes:
    """The offsets of a round for these ids; none for those that it has not."""
    known = np.isin(ids, before.ids, assume_unique=True)
    theirs = take_rows(before.offsets, np.searchsorted(before.ids, ids[known]))
    nothing = _zeros(len(ids), before.offsets.coefficients)
    return Attributes(*(_put(getattr(nothing, name), known, getattr(theirs, name)) for name in ARRAYS))


def _over_time(states: list[State], ids: Rows) -> list[Attributes]:
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


def _base(state: State, now: _Round) -> State:
    """The base of a frame: its Gaussians of the round, with the round's offsets."""
    here = np.isin(state.ids, now.ids, assume_unique=True)
    ids = state.ids[here]
    offsets = take_rows(now.offsets, np.searchsorted(now.ids, ids))
    return new_state(
        _plus(take_rows(state, np.flatnonzero(here)), offsets), state.frame, ids=ids, next_id=state.next_id
    )


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
