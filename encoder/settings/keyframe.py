"""How the keyframe is trained, as plain data."""

from __future__ import annotations

from dataclasses import dataclass, field

from .optimiser import LearningRates


@dataclass(frozen=True)
class KeyframeSettings:
    """How the keyframe is trained.

    ``iterations``: more is slower and, up to the stop, better. ``cap``: most Gaussians; more is slower and larger.
    ``sh_degree``: higher is slower and larger, better where views disagree. ``start_size``: first sigma in units of
    the point spacing. ``grow_from``/``grow_to``: shares of the schedule in which densification runs every
    ``grow_every`` steps, where the mean view gradient reaches ``grow_gradient``; lower grows more and is slower, up to
    the cap. ``validation_share``: share of the tiles kept for the stop (0: no stop); the stop comes after ``patience``
    checks without a new best, more is slower. At the end, rotations and colours, then sizes are put on the lattice, and
    in ``settle_iterations`` more steps the rest makes up for it; more is slower. ``bit_worth``: what a bit of a
    rotation or of a view-dependent colour must do to be written, as the square of the change of a picture's loss summed
    over its pixels (1: one pixel from black to white); higher is smaller and less exact, 0 rounds to the nearest.
    ``optimiser``, ``densification``: names in OPTIMISERS and DENSIFICATIONS.
    """

    iterations: int = 1000
    cap: int = 52_000
    sh_degree: int = 0
    dissimilarity: float = 0.2
    start_opacity: float = 0.2
    start_size: float = 0.5
    grow_from: float = 0.15
    grow_to: float = 0.6
    grow_every: int = 100
    grow_gradient: float = 2e-4
    prune_opacity: float = 0.005
    validation_share: float = 0.02
    validation_every: int = 100
    patience: int = 4
    rates: LearningRates = field(default_factory=lambda: LearningRates(4e-4, 1e-2, 3e-3, 0.05, 1e-2, 5e-4))
    means_decay: float = 0.05
    late_decay: float = 0.2
    settle_iterations: int = 300
    bit_worth: float = 2e-5
    optimiser: str = "adam"
    densification: str = "clone-split"
