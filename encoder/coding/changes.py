"""A frame's changes as lattice points, by rate-distortion optimised quantisation."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.deltas import Delta, difference
from decogs.codec.scene.lattice import Lattice, in_steps, nearest_points, quantise
from decogs.codec.scene.state import ARRAYS, Attributes, State, take_rows
from decogs.formats.splats import Splats

from ..settings.frame import SignificanceSettings
from ..training.method import TrainedFrame
from ..training.rate_distortion import cheapest_changes

_COLOURS = ("opacity_logits", "sh")


def delta_of(state: State, lattice: Lattice, trained: TrainedFrame, settings: SignificanceSettings) -> Delta:
    """What a frame's training changes of the ``state`` before it, on the lattice."""
    before = take_rows(state, trained.kept)
    current = quantise_changes(trained.values, before, lattice, trained.sensitivity, settings)
    added = quantise(trained.added, lattice)
    return difference(state, trained.kept, current, removed=trained.removed, added=added)


def quantise_changes(
    values: Splats, before: Attributes, lattice: Lattice, sensitivity: Splats | None, settings: SignificanceSettings
) -> Attributes:
    """Lattice points near ``values`` (N rows), by rate-distortion optimisation of their changes since ``before``.

    ``sensitivity``: change of a picture's mean loss, in millionths, per unit of each value; None: the nearest points.
    Raises TrainingError for values that are not finite or beyond 32 bits.
    """
    points = in_steps(values, lattice, near=before)
    if sensitivity is not None and len(before):
        sizes = _step_sizes(lattice, before.coefficients)
        for name in ARRAYS:
            was, flat = getattr(before, name), (len(before), -1)
            loss = (getattr(sensitivity, name) * sizes[name]).reshape(flat)
            bit = settings.colour_rd_lambda if name in _COLOURS else settings.rd_lambda
            changes = cheapest_changes((points[name] - was).reshape(flat), loss, bit)
            chosen = was + changes.reshape(was.shape)
            # A change that is common elsewhere may leave 32 bits here.
            points[name] = np.where(np.abs(chosen) <= np.iinfo(np.int32).max, chosen, points[name])
    return nearest_points(points)


def _step_sizes(lattice: Lattice, coefficients: int) -> dict[str, NDArray[np.float64]]:
    """Size of a lattice step of each array's numbers, which it broadcasts to."""
    sh = np.full((coefficients, 1), lattice.sh_rest)
    sh[0] = lattice.sh_dc
    sizes = (lattice.means, lattice.log_scales, lattice.quaternions, lattice.opacity_logits, sh)
    return dict(zip(ARRAYS, map(np.asarray, sizes), strict=True))
