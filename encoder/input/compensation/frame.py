"""A frame's compensated pictures: without its cameras' constant colour differences, and the drift of named ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from decogs.codec.packets.corrections import Corrections
from decogs.rig.pictures.ingest import RigFrame, View

from ...stopwatch import Stopwatch
from . import CorrectionMemory, Corrector, RenderView
from .colour import remove_gain


def match_colours(frame: RigFrame, views: Sequence[View], colours: Corrections) -> RigFrame:
    """The frame without the constant differences between its cameras' ``colours``."""
    if not colours:
        return frame
    pictures = [
        remove_gain(picture, colours[view.camera.name].odds_gain) if view.camera.name in colours else picture
        for view, picture in zip(views, frame.training, strict=True)
    ]
    return replace(frame, training=pictures)


def find_corrections(
    frame: RigFrame, corrector: Corrector | None, memory: CorrectionMemory | None, render: RenderView, watch: Stopwatch
) -> Corrections:
    """A matched frame's corrections against the scene before it, drawn by ``render``."""
    if corrector is None or memory is None:
        return {}
    with watch.stage("corrections"):
        return corrector.find(memory, frame.training, render)


def compensate(frame: RigFrame, corrector: Corrector | None, corrections: Corrections) -> RigFrame:
    """A matched frame with its ``corrections`` undone."""
    return frame if corrector is None else replace(frame, training=corrector.undo(frame.training, corrections))


def newly_dropped(before: CorrectionMemory | None, after: CorrectionMemory | None) -> list[str]:
    """The corrections dropped from one frame to the next, such as "cam04: colours"."""
    if before is None or after is None:
        return []
    return [f"{name}: {kind}" for name, kind in sorted(after.dropped - before.dropped)]
