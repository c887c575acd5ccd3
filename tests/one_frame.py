"""Trains one later frame outside of a stream."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from decogs.codec.scene.state import MAX_GAUSSIANS
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.encoder.change.masks import FrameMask
from decogs.encoder.methods.decogs import DecogsTrainer
from decogs.encoder.methods.paper import PaperTrainer
from decogs.encoder.settings.encode import EncodeSettings
from decogs.encoder.settings.frame import FrameSettings
from decogs.encoder.training.method import FrameInput, FrameTrainer, TrainedFrame, TrainingContext
from decogs.formats.cameras import Camera
from decogs.formats.rigs import open_rig
from decogs.formats.splats import Splats
from decogs.rig.pictures.ingest import Ingest

BOX = (np.array([-3.0, -3.0, -1.0]), np.array([3.0, 3.0, 1.0]))


def training_context(kernel: Any, views: Sequence[Any], static_views: Sequence[Any], **other: Any) -> TrainingContext:
    given: dict[str, Any] = {
        "settings": EncodeSettings(),
        "population": 0,
        "max_gaussians": MAX_GAUSSIANS,
        "extent": 1.2,
        "seed": 0,
    }
    return TrainingContext(kernel, views, static_views, **(given | other))


Trainer = DecogsTrainer | PaperTrainer
NewTrainer = Callable[[TrainingContext], Trainer]


def sparse_trainer(
    kernel: Any,
    views: Sequence[Any],
    static_views: Sequence[Any],
    settings: FrameSettings,
    new: NewTrainer = DecogsTrainer,
    **other: Any,
) -> Trainer:
    """A trainer whose frames have these ``settings`` unless they say otherwise (`train`)."""
    whole = replace(EncodeSettings(), frame=settings)
    return new(training_context(kernel, views, static_views, settings=whole, **other))


def train(
    trainer: FrameTrainer,
    scene: Any,
    selected: Any,
    pictures: Any,
    masks: Any,
    *,
    frame: int,
    settings: FrameSettings | None = None,
    light_only: Any = None,
    **effort: Any,
) -> TrainedFrame:
    context: TrainingContext | None = getattr(trainer, "context", None)  # which the baseline has not
    if settings is None:
        settings = FrameSettings() if context is None else context.settings.frame
    for view in () if context is None else context.static_views:
        view.detach(np.flatnonzero(selected))
    return trainer.train(FrameInput(frame, scene, selected, light_only, pictures, masks, settings, **effort))


@dataclass(frozen=True)
class Case:
    """The rig's true scene of frame 0, of which the square is selected, and the pictures of frame 1."""

    ingest: Ingest
    scene: Splats
    selected: np.ndarray
    pictures: list[np.ndarray]
    unit: float = 1.0

    def in_units(self, unit: float) -> Case:
        """The same in a world whose numbers are ``unit`` times as large."""
        scene = replace(
            self.scene,
            means=self.scene.means * np.float32(unit),
            log_scales=self.scene.log_scales + np.float32(np.log(unit)),
        )
        views = [replace(view, pinhole=_in_units(view.pinhole, unit)) for view in self.ingest.views]
        ingest: Any = SimpleNamespace(views=views)
        return replace(self, ingest=ingest, scene=scene, unit=unit)

    def masks(self, *, everywhere: bool) -> list[FrameMask]:
        mask = np.full(self.pictures[0].shape[1:], everywhere)
        return [FrameMask(mask, mask) for _ in self.pictures]

    def static_views(self, kernel: CpuKernel) -> list[CpuFixedView]:
        """The views as they show the scene."""
        views = [CpuFixedView(kernel, view.pinhole) for view in self.ingest.views]
        for view in views:
            view.set_scene(self.scene)
            view.redraw()
        return views

    def trainer(
        self, settings: FrameSettings, new: NewTrainer = DecogsTrainer, *, threads: int = 2, seed: int = 0
    ) -> Trainer:
        kernel = CpuKernel(threads)
        views, watch = self.ingest.views, self.static_views(kernel)
        box, extent = (self.unit * BOX[0], self.unit * BOX[1]), 1.2 * self.unit
        return sparse_trainer(kernel, views, watch, settings, new, box=box, extent=extent, seed=seed, threads=threads)

    def train(
        self,
        settings: FrameSettings,
        new: NewTrainer = DecogsTrainer,
        *,
        everywhere: bool = True,
        threads: int = 2,
        **other: Any,
    ) -> TrainedFrame:
        trainer = self.trainer(settings, new, threads=threads, seed=other.pop("seed", 0))
        given: dict[str, Any] = {
            "scene": self.scene,
            "selected": self.selected,
            "pictures": self.pictures,
            "masks": self.masks(everywhere=everywhere),
            "frame": 1,
        }
        return train(trainer, **(given | other))


def _in_units(camera: Camera, unit: float) -> Camera:
    pose = camera.world_to_camera.copy()
    pose[:3, 3] *= unit
    return replace(camera, world_to_camera=pose)


def moved_square(moving_rig: Path, tiny_rig: Any) -> Case:
    """The tiny rig's square (the last 25 Gaussians), which moves in frame 1."""
    scene = tiny_rig.scene_at(0)
    ingest = Ingest(open_rig(moving_rig))
    return Case(ingest, scene, np.arange(len(scene)) >= len(scene) - 25, next(ingest.frames(1, 2)).training)


def bits(splats: Splats) -> bytes:
    return b"".join(array.tobytes() for array in vars(splats).values())
