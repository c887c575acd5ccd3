"""Compensation of camera drift along a stream: each frame's corrections, and whether they help."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.corrections import CorrectedCameras, Corrections
from decogs.formats.splats import FloatArray, Splats

from ...backends import IncrementalViews, TrainingKernel
from ...settings.compensation import CorrectionSettings
from ...stopwatch import Stopwatch
from ..ingest import Ingest, RigFrame
from . import Corrector, corrector_of
from .colour import without_odds
from .matching import colours_at

_STAGE = "corrections"


class Compensation:
    """Compensates the named cameras' drift in every frame's pictures; without such cameras it does nothing."""

    def __init__(self, ingest: Ingest, kernel: TrainingKernel, settings: CorrectionSettings) -> None:
        self._ingest, self._kernel = ingest, kernel
        self._matches_colours = settings.match_colours
        self.colours: Corrections = {}
        """How each camera's colours differ from the scene's in every frame; the header has it."""
        self._corrector: Corrector | None = corrector_of(ingest.views, settings)

    @property
    def corrector(self) -> Corrector | None:
        """Estimates and compensates drift; None where no camera is named."""
        return self._corrector

    @property
    def cameras(self) -> CorrectedCameras:
        """The corrected cameras, as the stream's header lists them."""
        return CorrectedCameras() if self._corrector is None else self._corrector.cameras

    def match_colours(self, frame: RigFrame, xyz: FloatArray, seen: NDArray[np.bool_]) -> RigFrame:
        """The first frame, its cameras' colours matched, if that is enabled, at points (P, 3) that the views show where
        ``seen`` (V, P)."""
        if self._matches_colours:
            self.colours = colours_at(self._ingest.views, frame.training, xyz, seen)
        return self.matched(frame)

    def matched(self, frame: RigFrame) -> RigFrame:
        """The frame without the constant differences between its cameras' colours; the same object if there are
        none."""
        if not self.colours:
            return frame
        views = zip(self._ingest.views, frame.training, strict=True)
        pictures = [
            without_odds(picture, self.colours[view.camera.name].odds) if view.camera.name in self.colours else picture
            for view, picture in views
        ]
        return replace(frame, training=pictures)

    def see(self, scene: Splats) -> None:
        """Takes the keyframe's scene, on which cameras are compared from then on."""
        if self._corrector is not None:
            views = self._ingest.views
            self._corrector.see(lambda number: self._kernel.forward(scene, views[number].pinhole, depth=True))

    def begin(self, corrections: Corrections) -> None:
        """Takes the first frame's corrections, which stay where later ones are dropped."""
        if self._corrector is not None:
            self._corrector.begin(corrections)

    def apart(self) -> Compensation:
        """The same, to go on with apart from this one after a `restart`."""
        other = copy(self)
        other._corrector = copy(self._corrector)
        return other

    def restart(self) -> None:
        """Forgets what frames after the first have shown: which corrections help."""
        if self._corrector is not None:
            self._corrector.restart()

    def find(
        self, frame: RigFrame, scene: Splats, views: IncrementalViews, watch: Stopwatch
    ) -> tuple[RigFrame, Corrections]:
        """The compensated frame, and its corrections against the ``scene`` before it.

        ``views`` show that scene; where there are none, it is rendered.
        """
        corrector = self._corrector
        if corrector is None:
            return frame, {}

        def show(number: int) -> FloatArray:
            if views.views:
                return views.views[number].rgb
            return self._kernel.forward(scene, self._ingest.views[number].pinhole).rgb

        with watch.stage(_STAGE):
            corrections = corrector.find(frame.training, show)
            return self.undo(frame, corrections), corrections

    def undo(self, frame: RigFrame, corrections: Corrections) -> RigFrame:
        """The compensated frame, by ``corrections`` that are known."""
        if self._corrector is None:
            return frame
        return replace(frame, training=self._corrector.undo(frame.training, corrections))

    def judge(
        self,
        recorded: Sequence[FloatArray],
        corrections: Corrections,
        changed: Sequence[NDArray[np.bool_]],
        views: IncrementalViews,
        watch: Stopwatch,
    ) -> list[str]:
        """Corrections dropped after this frame, such as "cam04: colours" (`Corrector.judge`).

        ``recorded``: the frame's pictures (3, H, W); ``changed``: where each changed, (H, W), no view: judge nothing.
        """
        if self._corrector is None or not changed:
            return []
        with watch.stage(_STAGE):
            return self._corrector.judge(recorded, corrections, lambda number: views.views[number].rgb, changed)
