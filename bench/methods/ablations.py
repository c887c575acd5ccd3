"""What a method does without its selection, its focus loss or its gate: the rows of the component table.

decogs offers them to itself as packages do (docs/extending.md): `--ablate select` is the selection rule "all", and
`--ablate focus,gate` the method "decogs-ablated", or "paper-ablated" with `--method paper`.

Without the gate, gradients reach every Gaussian and Adam's moments last from frame to frame, so that static ones move
by stale momentum and by noise. Densification still follows S_t. All three leave a recipe close to plain fine-tuning of
each frame, not the baseline. Source: the paper's component table.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decogs.encoder.backends import Optimiser, TrainingKernel
from decogs.encoder.change.selection import ViewEvidence
from decogs.encoder.methods.decogs import DecogsTrainer
from decogs.encoder.methods.paper import PaperTrainer
from decogs.encoder.settings.frame import FocusWeights, SelectionSettings
from decogs.encoder.training.losses import PhotometricLoss, focus_loss, whole_picture_loss
from decogs.encoder.training.method import FrameInput, FrameMethod, TrainedFrame, TrainingContext
from decogs.encoder.training.working_set import WorkingSet
from decogs.formats.splats import FloatArray


def select_all(views: Sequence[ViewEvidence], settings: SelectionSettings, /) -> NDArray[np.bool_]:
    """The selection rule of `--ablate select`: every Gaussian."""
    return np.ones(len(views[0].weight), bool)


def plain_loss(
    picture: FloatArray, region: NDArray[np.bool_], valid: FloatArray | None, weights: FocusWeights
) -> PhotometricLoss:
    """3DGS's loss over the whole picture, whatever the region of interest."""
    return whole_picture_loss(picture, valid, weights.dissimilarity)


class AblatedTrainer:
    """A method's trainer without the parts that ``frame.ablated`` names, of "focus" and "gate"."""

    def __init__(self, context: TrainingContext, method: type[DecogsTrainer] | type[PaperTrainer]) -> None:
        self.context, ablated = context, context.settings.frame.ablated
        self._inner = method(context, loss=plain_loss if "focus" in ablated else focus_loss)
        self._has_gate = "gate" not in ablated
        self._momentum: Optimiser | None = None

    def train(self, frame: FrameInput, /) -> TrainedFrame:
        """Trains one frame."""
        if self._has_gate:
            return self._inner.train(frame)
        others = np.flatnonzero(~frame.selected)
        for view in self.context.static_views:
            view.detach(others)
        work = _UngatedSet(frame, self.context.kernel, self._momentum)
        trained = self._inner.train_set(frame, work)
        if not trained.rejected:
            lasting, self._momentum = work.is_lasting(), work.optimiser
            work.optimiser.keep(lasting)
        return trained


class _UngatedSet(WorkingSet):
    """Every Gaussian of the scene under training, with the ``momentum`` of the frame before; S_t alone may grow."""

    def __init__(self, frame: FrameInput, kernel: TrainingKernel, momentum: Optimiser | None) -> None:
        everything = np.arange(len(frame.scene))
        super().__init__(replace(frame, selected=np.ones(len(everything), bool)), kernel)
        self._selected = frame.selected
        if momentum is not None:
            self.optimiser.copy_momentum(momentum, everything, everything)

    def may_grow(self) -> NDArray[np.bool_]:
        grows = ~self.old
        grows[self.old] = self._selected[self.rows[self.old]]
        return grows


DECOGS = FrameMethod(lambda context: AblatedTrainer(context, DecogsTrainer))
PAPER = FrameMethod(lambda context: AblatedTrainer(context, PaperTrainer))
