"""Trains one later frame outside of a stream."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from decogs.codec.state import MAX_GAUSSIANS
from decogs.encoder.methods.decogs import DeltaTrainer
from decogs.encoder.settings.encode import EncodeSettings
from decogs.encoder.settings.frame import FrameSettings
from decogs.encoder.training.method import FrameInput, FrameTrainer, TrainedFrame, TrainingContext


def training_context(kernel: Any, views: Sequence[Any], static_views: Sequence[Any], **other: Any) -> TrainingContext:
    given: dict[str, Any] = {
        "settings": EncodeSettings(),
        "population": 0,
        "max_gaussians": MAX_GAUSSIANS,
        "extent": 1.2,
        "seed": 0,
    }
    return TrainingContext(kernel, views, static_views, **(given | other))


def delta_trainer(
    kernel: Any, views: Sequence[Any], static_views: Sequence[Any], settings: FrameSettings, **other: Any
) -> DeltaTrainer:
    """A trainer whose frames have these ``settings`` unless they say otherwise (`train`)."""
    whole = replace(EncodeSettings(), frame=settings)
    return DeltaTrainer(training_context(kernel, views, static_views, settings=whole, **other))


def train(
    trainer: FrameTrainer,
    scene: Any,
    selected: Any,
    pictures: Any,
    masks: Any,
    motion: Any,
    *,
    frame: int,
    settings: FrameSettings | None = None,
    lit: Any = None,
    **effort: Any,
) -> TrainedFrame:
    if settings is None:
        settings = trainer.context.settings.frame if isinstance(trainer, DeltaTrainer) else FrameSettings()
    for view in trainer.context.static_views if isinstance(trainer, DeltaTrainer) else ():
        view.detach(np.flatnonzero(selected))
    return trainer.train(FrameInput(frame, scene, selected, lit, pictures, masks, motion, settings, **effort))
