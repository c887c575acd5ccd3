"""The Gaussians under training in a later frame: S_t and those that the frame adds."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray, Splats, empty_splats, join_splats, sigmoid, take_splats

from ..backends import ATTRIBUTES, TrainingKernel
from .method import FrameInput, TrainedFrame


class WorkingSet:
    """S_t and the Gaussians that a frame adds; everything else in the scene stays as it is.

    ``rows`` (M,), ascending, are their rows in the scene; new Gaussians get rows behind its last. The optimiser has
    moments for these rows alone, and none at the beginning of a frame (docs/METHOD.md, "Optimiser-state reset").
    """

    def __init__(self, frame: FrameInput, kernel: TrainingKernel) -> None:
        self.rows = self._detached = np.flatnonzero(frame.selected)
        self._scene, self._next_row = frame.scene, len(frame.scene)
        settings = frame.settings
        self._prune_opacity = settings.prune_opacity
        values = take_splats(frame.scene, self.rows)
        self.optimiser = kernel.optimiser(values, beta1=settings.beta1, beta2=settings.beta2)

    @property
    def values(self) -> Splats:
        """Their own values, as trained so far."""
        return self.optimiser.splats

    @property
    def old(self) -> NDArray[np.bool_]:
        """Which of ``rows`` the scene had before the frame, (M,)."""
        return self.rows < len(self._scene)

    @property
    def population(self) -> int:
        """Current number of Gaussians in the scene."""
        return len(self._scene) - len(self._detached) + len(self.rows)

    def may_grow(self) -> NDArray[np.bool_]:
        """Which of ``rows`` densification may clone, split and prune, (M,): all."""
        return np.ones(len(self.rows), bool)

    def append(self, added: Splats) -> None:
        """Appends Gaussians; every per-Gaussian buffer grows (docs/METHOD.md, "Selective densification")."""
        self.optimiser.append(added)
        self.rows = np.concatenate([self.rows, np.arange(self._next_row, self._next_row + len(added))])
        self._next_row += len(added)

    def remove(self, positions: NDArray[np.int64]) -> None:
        """Removes the Gaussians at ``positions`` of ``rows`` from training and scene."""
        stays = np.ones(len(self.rows), bool)
        stays[positions] = False
        self.rows = self.rows[stays]
        self.optimiser.keep(stays)

    def before(self) -> Splats:
        """Values of ``rows`` before the frame; new Gaussians have their current ones."""
        return join_splats(take_splats(self._scene, self.rows[self.old]), take_splats(self.values, ~self.old))

    def is_lasting(self) -> NDArray[np.bool_]:
        """Which of ``rows`` outlive the frame: all except transparent new ones."""
        return self.old | (sigmoid(self.values.opacity_logits) >= self._prune_opacity)

    def result(self, drawn: Splats, picture_weight: float) -> TrainedFrame:
        """The frame as ``drawn`` (M); ``picture_weight``: from millionths of a picture's mean loss to this frame's."""
        return TrainedFrame(
            self.rows[self.old],
            take_splats(drawn, self.old),
            np.setdiff1d(self._detached, self.rows),
            take_splats(drawn, ~self.old & self.is_lasting()),
            sensitivity=Splats(*(self._sensitivity(name, picture_weight) for name in ATTRIBUTES)),
        )

    def rejected_frame(self) -> TrainedFrame:
        """The frame without any change to the scene."""
        nothing = empty_splats(self._scene.sh_degree)
        values = take_splats(self._scene, self._detached)
        return TrainedFrame(self._detached, values, np.zeros(0, np.int64), nothing, rejected=True)

    def _sensitivity(self, name: str, picture_weight: float) -> FloatArray:
        return np.asarray(self.optimiser.gradient_size(name)[self.old] / np.float32(picture_weight))
