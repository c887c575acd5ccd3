"""The protocol of a frame method, which trains later frames (docs/extending.md; `methods` has them by name).

A method makes one trainer per stream; the loop calls it once for each later frame that changed. All methods share the
keyframe, the views, the rasteriser and the lattice.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray, Splats
from decogs.rig.pictures.ingest import View, scene_extent
from decogs.rig.stage.stage import Stage

from ..backends import FixedView, TrainingKernel
from ..change.masks import FrameMask
from ..settings.encode import EncodeSettings
from ..settings.frame import FrameSettings
from .schedule import UNKNOWN_PACE, WHOLE, Pace, StoppingRule

GROW_GRADIENT = 1e-4
"""Mean view gradient from which a Gaussian is cloned or split (the paper's tau_d)."""

MAX_GROWTH = 1.25
"""Bound of the scene's size in later frames, as a multiple of the keyframe's. Without it long streams keep
growing: the tests' scene from 2 500 Gaussians to 18 000 in a thousand frames, which costs 2 dB."""


@dataclass(frozen=True)
class TrainingContext:
    """Constants of a stream's training.

    ``views``: the training views. ``static_views``: their renderings of the scene, updated by the loop; empty for a
    dense method. ``population``: Gaussians of the keyframe. ``max_gaussians``: bound of later frames;
    ``grow_gradient``: mean view gradient from which there are any. ``extent``: size of the rig, world units; position
    rates scale with it. ``box``: corners (3,) around the scene, the domain of a transformation cache. ``threads``: at
    least 1; results do not depend on it.
    """

    kernel: TrainingKernel
    views: Sequence[View]
    static_views: Sequence[FixedView]
    settings: EncodeSettings
    population: int
    max_gaussians: int
    extent: float
    box: tuple[NDArray[np.float64], NDArray[np.float64]]
    seed: int
    threads: int = 1
    grow_gradient: float = GROW_GRADIENT


@dataclass(frozen=True)
class FrameInput:
    """Input of the training of one later frame.

    ``index``: within the stream; with the seed it determines all randomness, so that a frame can be trained alone.
    ``scene``: the N reconstructed Gaussians of the frame before. ``selected`` (N,): S_t. ``light_only`` (N,): those
    of them that light alone changes, or None where all are trained alike. ``pictures``: one (3, H, W) for each
    view, colours 0 to 1. ``masks``: one for each view, none for a dense method. ``settings``: of this frame.
    ``stopping``: the end of training. ``stage``: the frame's, where its empty space is known. ``lost``: views, by
    number, that have no picture of this frame; what is in its place must not teach. Masks say so as well.
    ``relit``: light has changed more than steps follow. ``clipped``: it has in this or an earlier frame, so that
    what is recorded as white may be brighter. ``pace``: of the frames before, under a deadline.
    """

    index: int
    scene: Splats
    selected: NDArray[np.bool_]
    light_only: NDArray[np.bool_] | None
    pictures: Sequence[FloatArray]
    masks: Sequence[FrameMask]
    settings: FrameSettings
    stopping: StoppingRule = WHOLE
    stage: Stage | None = None
    lost: Collection[int] = ()
    relit: bool = False
    clipped: bool = False
    pace: Pace = UNKNOWN_PACE


@dataclass(frozen=True)
class TrainedFrame:
    """Changes of one frame: new values (M rows) for the rows ``kept``, rows ``removed``, Gaussians ``added``.

    Rows are of the frame's scene, ascending. ``rejected``: training made the pictures worse and changes nothing.
    ``truncated``: a deadline left too few steps. ``sensitivity``: change of a picture's mean loss, in
    millionths, per unit of each of ``values``; None: they are coded as exactly as the lattice can. ``pace``: after a
    frame with a deadline; None: that before it.
    """

    kept: NDArray[np.int64]
    values: Splats
    removed: NDArray[np.int64]
    added: Splats
    rejected: bool = False
    truncated: bool = False
    sensitivity: Splats | None = None
    pace: Pace | None = None


class FrameTrainer(Protocol):
    """Trains the later frames of one stream, one after the other, from one thread.

    Encodes are resumed and repeated to the bit: the result follows from the frame's input and the context alone.
    """

    def train(self, frame: FrameInput, /) -> TrainedFrame:
        """Trains one frame.

        The static views show ``frame.scene``, and its selected Gaussians are detached in them. Views that are lost,
        by the frame or by their masks, have no part in it.
        """
        ...


@dataclass(frozen=True)
class FrameMethod:
    """One way to train later frames.

    ``trainer``: makes a stream's trainer, and one for each closed segment. ``dense``: it trains every Gaussian on every
    pixel by a schedule of its own, so masks, selection, effects, budgets and significance have no part in it.
    """

    trainer: Callable[[TrainingContext], FrameTrainer]
    dense: bool = False


def training_context(
    kernel: TrainingKernel,
    views: Sequence[View],
    static_views: Sequence[FixedView],
    settings: EncodeSettings,
    keyframe: Splats,
    *,
    seed: int,
    threads: int,
) -> TrainingContext:
    """The context of a stream that begins with ``keyframe``. The box holds 98 % of its Gaussians and a tenth more."""
    low, high = np.percentile(keyframe.means.astype(np.float64), [1, 99], axis=0)
    extent = scene_extent(views) or 1.0
    margin = 0.1 * (high - low) + 1e-6 * extent
    return TrainingContext(
        kernel,
        views,
        static_views,
        settings,
        population=len(keyframe),
        max_gaussians=round(MAX_GROWTH * len(keyframe)),
        extent=extent,
        box=(low - margin, high + margin),
        seed=seed,
        threads=max(1, threads),
    )
