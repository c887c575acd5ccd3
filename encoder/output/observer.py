"""Observers of an encode's progress."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .reports import FrameReport


class EncodeObserver:
    """Observes an encode: a subclass overrides the events that it needs. Here they do nothing."""

    def look_step(self, step: int, steps: int) -> None:
        """A step of the rig's analysis is done: ``step`` of ``steps``."""

    def looked(self, detected: Mapping[str, Sequence[str]]) -> None:
        """The rig was analysed: ``detected`` has each detected effect with the names of its cameras."""

    def started(self, facts: Mapping[str, Any]) -> None:
        """The first frame is begun: the rig's facts and the settings, as plain JSON values.

        ``facts["frames"]`` are the rig's first frame and the one after the last.
        """

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        """A step of a keyframe's training is done: ``step`` of ``steps``, and the loss before it.

        Of the first frame, or of a later one that shows another scene.
        """

    def frame(self, report: FrameReport) -> None:
        """A frame is written."""

    def finished(self, facts: Mapping[str, Any]) -> None:
        """The stream is whole: its path, its bytes, and whether it was interrupted, as plain JSON values."""


class Observers(EncodeObserver):
    """Several observers as one, called in their order."""

    def __init__(self, observers: Sequence[EncodeObserver]) -> None:
        self._observers = tuple(observers)

    def look_step(self, step: int, steps: int) -> None:
        for observer in self._observers:
            observer.look_step(step, steps)

    def looked(self, detected: Mapping[str, Sequence[str]]) -> None:
        for observer in self._observers:
            observer.looked(detected)

    def started(self, facts: Mapping[str, Any]) -> None:
        for observer in self._observers:
            observer.started(facts)

    def keyframe_step(self, step: int, steps: int, loss: float) -> None:
        for observer in self._observers:
            observer.keyframe_step(step, steps, loss)

    def frame(self, report: FrameReport) -> None:
        for observer in self._observers:
            observer.frame(report)

    def finished(self, facts: Mapping[str, Any]) -> None:
        for observer in self._observers:
            observer.finished(facts)
