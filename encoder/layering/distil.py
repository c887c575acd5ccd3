"""Values with which some Gaussians of a scene alone look as much like all of it as they can, over several frames.

The values differ from those in the whole scene by an offset that is the same in every frame. It is trained on the
decoded scene: no recording is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.splats import FloatArray, Splats

from ..backends import ATTRIBUTES, TrainingKernel
from ..backends.psnr import psnr_of, square_error
from ..settings.optimiser import LearningRates
from ..training.losses import whole_picture_loss
from ..training.view_order import view_order

_DISSIMILARITY = 0.2
"""Of 3DGS's loss."""
_RATES = LearningRates(means=1.6e-3, log_scales=3e-2, quaternions=0.0, opacity_logits=0.1, sh_dc=2e-2, sh_rest=1e-3)
"""Means in units of the rig's extent. Quaternions stay: for .6 dB of the base they would take a quarter more bytes of
what refines it."""
_LAST_RATE = 0.1
"""Share of the rates that is left in the last step."""
_HIDDEN_LOGIT = -20.0
"""Opacity of a Gaussian in frames in which it is not there."""


@dataclass(frozen=True, eq=False)
class Moment:
    """A frame that is trained on: ``splats`` the N chosen Gaussians as the whole scene has them, whatever the values of
    those that are not ``there`` (N,); ``pictures`` (3, H, W) of the whole scene, of each camera."""

    splats: Splats
    there: NDArray[np.bool_]
    pictures: Sequence[FloatArray]


@dataclass(frozen=True)
class Schedule:
    """``steps``, and the rig's ``extent`` in world units, in which positions move."""

    steps: int
    extent: float


def distil(
    kernel: TrainingKernel,
    moments: Sequence[Moment],
    cameras: Sequence[Camera],
    start: Splats,
    kept: NDArray[np.bool_],
    schedule: Schedule,
    random: np.random.Generator,
) -> Splats:
    """The values of the chosen Gaussians in the first moment; in others they differ as they do in the whole scene.

    Training begins with ``start``, whose ``kept`` (N,) Gaussians stay as they are.
    """
    reference = moments[0].splats
    optimiser = kernel.optimiser(start)
    if kept.any():
        optimiser.freeze({name: _of_rows(getattr(start, name), kept) for name in ATTRIBUTES})
    order = view_order(len(moments) * len(cameras), random)
    rates = replace(_RATES, means=_RATES.means * schedule.extent)
    for step, number in zip(range(schedule.steps), order, strict=False):
        moment, camera = moments[number // len(cameras)], cameras[number % len(cameras)]
        drawn = in_moment(optimiser.splats, reference, moment)
        kernel.forward(drawn, camera)
        whole_picture_loss(moment.pictures[number % len(cameras)], None, _DISSIMILARITY).evaluate(kernel)
        optimiser.step(kernel.backward(drawn), rates.scaled(_LAST_RATE ** (step / schedule.steps)))
    return optimiser.splats


def _of_rows(values: FloatArray, rows: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """A mask of all values of these rows."""
    return np.asarray(np.broadcast_to(rows.reshape(-1, *[1] * (values.ndim - 1)), values.shape).copy())


def likeness(kernel: TrainingKernel, base: Splats, moments: Sequence[Moment], cameras: Sequence[Camera]) -> list[float]:
    """PSNR in dB of the chosen Gaussians with the values ``base`` against all of them, of each moment."""

    def error(moment: Moment) -> float:
        drawn = in_moment(base, moments[0].splats, moment)
        pictures = zip(cameras, moment.pictures, strict=True)
        return float(
            np.mean([square_error(kernel.forward(drawn, camera).rgb, picture) for camera, picture in pictures])
        )

    return [psnr_of(error(moment)) for moment in moments]


def in_moment(values: Splats, reference: Splats, moment: Moment) -> Splats:
    """The ``values``, which belong to the ``reference``, as far from it as the moment's Gaussians are."""
    now = moment.splats
    moved = Splats(
        values.means + (now.means - reference.means),
        values.log_scales + (now.log_scales - reference.log_scales),
        values.quaternions + (now.quaternions - reference.quaternions),
        values.opacity_logits + (now.opacity_logits - reference.opacity_logits),
        values.sh + (now.sh - reference.sh),
    )
    if moment.there.all():
        return moved
    return replace(moved, opacity_logits=np.where(moment.there, moved.opacity_logits, np.float32(_HIDDEN_LOGIT)))
