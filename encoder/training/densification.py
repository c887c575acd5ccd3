"""Densification and pruning: in the whole keyframe, and only inside the focus of a later frame.

Source: Kerbl 2023, section 5.2 (clone small Gaussians and split large ones where the projected centre's gradient is
high); DecoGS for later frames (docs/METHOD.md, "Selective densification"). Rejected for the keyframe: growth without a
limit (on `workbench` 80 000 Gaussians fit the training views 1.2 dB better than 52 000 and the held-out one no better).
Opacity resets: not tried.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from decogs.codec.scene.lattice import LOG_SCALE_BOUND
from decogs.formats.geometry.rotations import rotation_matrices
from decogs.formats.splats import Splats, take_splats

_SPLIT_SHRINK = np.float32(np.log(1.6))


@dataclass(frozen=True)
class Growth:
    """Proposal of a densification: ``children`` to append, one per row of ``parents``, and the parents' new values."""

    parents: NDArray[np.int64]
    children: Splats
    parent_means: NDArray[np.float32]
    parent_log_scales: NDArray[np.float32]


def grow(splats: Splats, parents: NDArray[np.int64], large: float, random: np.random.Generator) -> Growth:
    """One child per parent: a copy of a small Gaussian, the second half of one whose largest sigma exceeds ``large``.

    Both halves of a split lie at opposite points drawn from the Gaussian itself and are 1.6 times smaller (Kerbl 2023).
    """
    taken = take_splats(splats, parents)
    scales = np.exp(np.clip(taken.log_scales.astype(np.float64), -LOG_SCALE_BOUND, LOG_SCALE_BOUND))
    rotations = rotation_matrices(taken.quaternions.astype(np.float64))
    offsets = np.einsum("nij,nj->ni", rotations, random.normal(size=scales.shape) * scales)
    split = (scales.max(axis=1, initial=0) > large)[:, None]
    offsets = np.where(split, offsets, 0).astype(np.float32)
    log_scales = np.where(split, taken.log_scales - _SPLIT_SHRINK, taken.log_scales)
    children = Splats(
        np.ascontiguousarray(taken.means + offsets),
        np.ascontiguousarray(log_scales),
        taken.quaternions,
        taken.opacity_logits,
        taken.sh,
    )
    return Growth(parents, children, taken.means - offsets, log_scales)


def strongest(
    gradients: NDArray[np.float64], eligible: NDArray[np.bool_], threshold: float, room: int
) -> NDArray[np.int64]:
    """Rows whose mean gradient reaches ``threshold``, the strongest ``room`` of them, in ascending order."""
    candidates = np.flatnonzero((gradients >= threshold) & eligible)
    best = candidates[np.argsort(-gradients[candidates], kind="stable")[: max(0, room)]]
    return np.sort(best)


def clone_and_split(
    splats: Splats,
    gradients: NDArray[np.float64],
    eligible: NDArray[np.bool_],
    *,
    threshold: float,
    room: int,
    large: float,
    random: np.random.Generator,
) -> Growth:
    """3DGS's: the strongest gradients from the threshold on; small Gaussians are cloned, large ones split.

    ``gradients`` (N,): mean view gradients, in 3DGS's normalised units. Of the ``eligible`` (N,) at most ``room`` get a
    child. ``large``: sigma, in world units, above which a Gaussian counts as large. ``random``: the only source of
    chance, so that encodes repeat to the bit.
    """
    return grow(splats, strongest(gradients, eligible, threshold, room), large, random)


def are_splats(value: object, like: Splats, count: int | None = None) -> bool:
    """Whether these are finite Gaussians of the same SH degree, and so many of them if ``count`` says."""
    if not isinstance(value, Splats):
        return False
    rows = len(value) if count is None else count
    pairs = [(getattr(value, each.name), getattr(like, each.name)) for each in fields(Splats)]
    shaped = all(
        isinstance(mine, np.ndarray) and mine.dtype.kind == "f" and mine.shape == (rows, *other.shape[1:])
        for mine, other in pairs
    )
    return shaped and all(np.isfinite(mine).all() for mine, _ in pairs)
