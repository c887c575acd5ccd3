"""What a change is worth: those that hardly show are taken back while the rest can still make up for them.

Chosen: a dead zone inside the training loop, in units of the picture and not of the value. How much a change of one
stored number moves the loss is its size times the gradient that it has seen (root mean square over steps and views,
which Adam keeps anyway). When stage 2 is well under way, numbers whose change moves the summed loss of a picture by
less than ``worth`` go back to what the decoder has and stay there; the remaining steps train the others around them.
What is left is written in coarser steps than the lattice's, so that few and small integers remain.

Measured on workbench (DESIGN.md): 12 kB a frame instead of 100 unrounded, for .2 dB where things move. Rejected: a
dead zone in lattice steps (at the same dynamic PSNR twice the bytes: it spares the sharp and the faint alike); a raised
epsilon in Adam, the prototype's lever (75th percentile: 19 % fewer bytes for .6 dB); predicted motion (5 % of the
positions' bytes: what is left of motion after training is noise, which no neighbour tells).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from decogs.codec.lattice import KEPT_SCALE
from decogs.codec.state import IntArray
from decogs.formats.splats import FloatArray, Splats

from .losses import PhotometricLoss
from .optimiser import ATTRIBUTES, Optimiser

_ROUNDS = 4
"""Of choosing under the table that the choices before make; more change next to nothing."""
_COMMONEST = 256
"""Candidates of a channel: every number that rotations and colours on a lattice have, a bound for any others."""


def picture_weight(losses: Sequence[PhotometricLoss]) -> float:
    """What a loss summed over pixels is in units of these losses, which are means, most of them over a focus."""
    return float(np.mean([loss.emphasis / loss.target[0].size for loss in losses]))


def revert_insignificant(optimiser: Optimiser, before: Splats, old: NDArray[np.bool_], worth: float) -> None:
    """Changes since ``before`` that are worth too little go back, and their numbers are held from now on.

    ``before`` (M) has the optimiser's rows; those that are not ``old`` (M,) are new and keep what they have. ``worth``
    is in units of the loss.
    """
    _keep_scale(optimiser.splats.quaternions, before.quaternions)
    held = {}
    for name in ATTRIBUTES:
        values, was = getattr(optimiser.splats, name), getattr(before, name)
        idle = optimiser.gradient_size(name) * np.abs(values - was) < np.float32(worth)
        idle[~old] = False
        np.copyto(values, was, where=idle)
        held[name] = idle
    optimiser.hold(held)


def cheapest(values: FloatArray, change: FloatArray, bit: float) -> IntArray:
    """Integers near ``values`` (N, C), in lattice steps, that take fewer bits for as long as it hardly shows.

    ``change`` (N, C): by how much a step moves the loss. Every number becomes the one, of its own nearest and its
    channel's commonest, whose squared change of the loss plus ``bit`` times its bits is least; bits are those of an
    entropy coder with a table per channel. With a ``bit`` of 0, the nearest. Source: entropy-constrained scalar
    quantisation (Chou, Lookabaugh and Gray 1989), each number with a weight of its own.
    """
    chosen = np.rint(values).astype(np.int32)
    if not (bit and len(values)):
        return chosen
    for channel, column in enumerate(values.T):
        for _ in range(_ROUNDS):
            chosen[:, channel] = _cheaper(column, chosen[:, channel], change[:, channel], bit)
    return chosen


def _cheaper(values: FloatArray, chosen: IntArray, change: FloatArray, bit: float) -> IntArray:
    """One channel's (N,) choice under the table that the former choice makes."""
    table, places, counts = np.unique(chosen, return_inverse=True, return_counts=True)
    bits = np.log2(len(chosen) / counts)
    best = np.asarray(chosen)
    least = (change * (chosen - values)) ** 2 + bit * bits[places]
    for place in np.argsort(-counts, kind="stable")[:_COMMONEST]:
        cost = (change * (table[place] - values)) ** 2 + bit * bits[place]
        best = np.where(cost < least, table[place], best)
        least = np.minimum(cost, least)
    return best


def _keep_scale(quaternions: FloatArray, before: FloatArray) -> None:
    """Scales quaternions so that what was their largest component is as it was; the rotations stay."""
    row, largest = np.arange(len(before)), np.abs(before).argmax(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = before[row, largest] / quaternions[row, largest]
    low, high = KEPT_SCALE
    usable = (scale > 1 / high) & (scale < 1 / low)
    quaternions[usable] *= scale[usable, None]
    quaternions[row[usable], largest[usable]] = before[row[usable], largest[usable]]
