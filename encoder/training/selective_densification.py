"""Densification and pruning inside the regions of interest of a later frame.

Source: DecoGS (docs/METHOD.md, "Selective densification"). Beyond the paper: ``grow_fraction`` bounds a frame's
additions, ``max_gaussians`` the scene's.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import Splats, sigmoid

from ..backends import ViewGradients
from .densification import clone_and_split
from .frame_training import FrameTraining
from .working_set import WorkingSet

_LARGE_SIGMA_EXTENTS = 0.01
"""Sigma, in units of the rig's extent, from which a Gaussian is split and not cloned (3DGS's)."""


def densify(training: FrameTraining, work: WorkingSet, drawn: Splats, gathered: ViewGradients) -> bool:
    """Adds Gaussians where ``gathered`` gradients are large, and removes transparent ones; whether it did either.

    ``drawn`` (M): the values as drawn, where the working set's own are moved by a cache.
    """
    training.seen.check()
    settings = training.settings
    selected = work.may_grow()
    values = work.values
    faint = selected & ((sigmoid(values.opacity_logits) < settings.prune_opacity) | training.is_free(values.means))
    room = training.context.max_gaussians - work.population + int(faint.sum())
    # Rounded up: a small scene that may never grow loses quality over hundreds of frames.
    room = min(math.ceil(settings.grow_fraction * selected.sum()), room)
    grows = room > 0 and _grow(training, work, drawn, gathered, selected & ~faint, room)
    work.remove(np.flatnonzero(faint))
    return grows or bool(faint.any())


def _grow(
    training: FrameTraining,
    work: WorkingSet,
    drawn: Splats,
    gathered: ViewGradients,
    eligible: NDArray[np.bool_],
    room: int,
) -> bool:
    """Adds at most ``room`` Gaussians; a child outside every region of interest starts at its parent's position."""
    own = work.values
    growth = clone_and_split(
        own,
        gathered.mean(),
        eligible,
        threshold=training.context.grow_gradient,
        room=room,
        large=_LARGE_SIGMA_EXTENTS * training.context.extent,
        random=training.random,
    )
    parents = growth.parents
    if not len(parents):
        return False
    shift = drawn.means[parents] - own.means[parents]
    stray = ~training.in_any_focus(growth.children.means + shift)
    growth.children.means[stray] = own.means[parents[stray]]
    work.optimiser.put(parents, means=growth.parent_means, log_scales=growth.parent_log_scales)
    work.append(growth.children)
    return True
