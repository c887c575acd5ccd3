"""What methods that train S_t share: one later frame's views, pictures and losses, and a step's gradients."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import in_picture, project
from decogs.formats.splats import FloatArray, Splats
from decogs.rig.parallel import side_by_side
from decogs.rig.pictures.ingest import View

from ..backends import Drawable, Gradients, ViewGradients
from ..change.masks import FrameMask, usable_views
from ..settings.frame import FocusWeights, FrameSettings
from .losses import PhotometricLoss, StepLosses, focus_loss
from .method import FrameInput, TrainedFrame, TrainingContext
from .schedule import TargetWatch
from .significance import picture_weight
from .view_order import view_order
from .working_set import WorkingSet

_DIVERGED_ERROR_RATIO = 1.5
"""Training that raises the squared error in focus by this factor (1.8 dB) has diverged; normally the error falls."""

LossOfView = Callable[[FloatArray, NDArray[np.bool_], FloatArray | None, FocusWeights], PhotometricLoss]
"""A view's loss, from its picture, region of interest and recorded pixels."""


class Step(NamedTuple):
    """A step of training: the stage, its number within it from 0, and the view that it draws."""

    stage: str
    number: int
    view: int


@dataclass(frozen=True)
class FrameTraining:
    """One frame's training. ``losses``: one a view. ``used``: the views whose pictures show their frame.

    ``seen``: its steps' losses, unread. ``random`` is the only source of chance, and the same for a frame whatever was
    trained before.
    """

    context: TrainingContext
    frame: FrameInput
    losses: Sequence[PhotometricLoss]
    used: Sequence[int]
    random: np.random.Generator
    seen: StepLosses = field(default_factory=StepLosses)

    @property
    def settings(self) -> FrameSettings:
        """The frame's."""
        return self.frame.settings

    @property
    def picture_weight(self) -> float:
        """From millionths of a picture's mean loss to these losses."""
        return picture_weight([self.losses[index] for index in self.used])

    def steps(self, stage: str) -> Iterator[Step]:
        """Endless steps of a stage; each round draws every used view once, in a new order."""
        order = view_order(len(self.used), self.random)
        return (Step(stage, number, self.used[slot]) for number, slot in enumerate(order))

    def gradients(self, step: Step, work: WorkingSet, drawn: Drawable) -> Gradients:
        """Gradients of the values ``drawn`` (M), from the pixels that they cover."""
        view = self.context.static_views[step.view]
        view.draw(drawn, work.rows)
        loss = self.losses[step.view]
        value = (loss.with_clipped(view.rgb) if self.frame.clipped else loss).evaluate_drawn(view)
        self.seen.add(value, self.context.views[step.view].camera)
        if self.frame.stopping.on_loss is not None:
            self.frame.stopping.on_loss(step.stage, step.number, value.total)
        return view.backward()

    def gather(self, gathered: ViewGradients, gradients: Gradients, view: int) -> None:
        """Adds a view's gradients, rescaled to those of the plain loss, the scale of the paper's tau_d."""
        gathered.add(gradients, self.context.views[view].pinhole, self.losses[view].emphasis)

    def draw(self, views: Sequence[int], work: WorkingSet, drawn: Drawable) -> None:
        """Draws these views with the values ``drawn``."""
        for index in views:
            self.context.static_views[index].draw(drawn, work.rows)

    def errors(self, views: Sequence[int]) -> list[FloatArray]:
        """Errors of views as last drawn, in their regions of interest, (3, pixels) each, colours 0 to 1."""

        def missing(index: int) -> FloatArray:
            focus = np.flatnonzero(self.focus(index))
            drawn = np.clip(_pixels(self.context.static_views[index].rgb, focus), 0, 1)
            return drawn - _pixels(self.frame.pictures[index], focus)

        with side_by_side(self.context.threads) as each:
            return list(each(missing, views))

    def squared_error(self, views: Sequence[int]) -> float:
        """Sum of the squared `errors`; where whole pictures are compared in no time, weighed as their losses are."""
        if self.context.kernel.leaves_processor_idle:
            drawn, pictures = self.context.static_views, self.frame.pictures
            return sum(drawn[i].squared_error(pictures[i], self.losses[i].focus) for i in views)
        return sum(float(np.square(errors).sum(dtype=np.float64)) for errors in self.errors(views))

    def outcome(self, work: WorkingSet, drawn: Drawable, before: float, views: Sequence[int]) -> TrainedFrame:
        """The trained frame; no change if these views' squared error, ``before`` at the start, has grown by half.

        Raises TrainingError for a loss that is not finite.
        """
        self.seen.check()
        self.draw(views, work, drawn)
        if self.squared_error(views) > _DIVERGED_ERROR_RATIO * before:
            return work.rejected_frame()
        return work.result(drawn if isinstance(drawn, Splats) else drawn.splats, self.picture_weight)

    def focus(self, index: int) -> NDArray[np.bool_]:
        """The recorded part of a view's region of interest, (H, W)."""
        mask, valid = self.frame.masks[index].dilated, self.context.views[index].valid
        return mask if valid is None else mask & (valid > 0)

    def target_watch(self) -> TargetWatch | None:
        """What notices that the target quality is reached; None without a target."""
        if self.frame.stopping.target_psnr is None:
            return None
        regions = [self.focus(index) for index in range(len(self.losses))]
        return TargetWatch(self.frame.stopping.target_psnr, self.frame.pictures, regions)

    def is_free(self, means: FloatArray) -> NDArray[np.bool_]:
        """Points (P, 3) in the frame's empty space; none where it is not known."""
        return np.zeros(len(means), bool) if self.frame.stage is None else self.frame.stage.free(means)

    def in_any_focus(self, means: FloatArray) -> NDArray[np.bool_]:
        """Points (P, 3) that project into the region of interest of at least one view."""
        inside = np.zeros(len(means), bool)
        for view, mask in zip(self.context.views, self.frame.masks, strict=True):
            u, v, depth = project(view.pinhole, means)
            rows = np.flatnonzero(in_picture(view.pinhole, u, v, depth))
            inside[rows] |= mask.dilated[v[rows].astype(np.int64), u[rows].astype(np.int64)]
        return inside


def frame_training(context: TrainingContext, frame: FrameInput, loss: LossOfView = focus_loss) -> FrameTraining:
    """The training of a frame with one ``loss`` for every view."""

    def of_view(picture: FloatArray, mask: FrameMask, view: View) -> PhotometricLoss:
        made = loss(picture, mask.dilated, view.valid, frame.settings.focus)
        context.kernel.bring(made.target, made.l1_weight, made.focus)
        return made

    with side_by_side(context.threads) as each:
        losses = list(each(of_view, frame.pictures, frame.masks, context.views))
    random = np.random.default_rng((context.seed, frame.index))
    return FrameTraining(context, frame, losses, usable_views(frame.masks), random)


def _pixels(picture: FloatArray, places: NDArray[np.int64]) -> FloatArray:
    """Colours (3, P) at flat pixels of a picture (3, H, W)."""
    return np.take(picture.reshape(3, -1), places, axis=1)
