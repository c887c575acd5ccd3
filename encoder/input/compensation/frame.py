"""A frame's compensated pictures: without its cameras' constant differences, and the drift of named ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import Correction, Corrections, with_colours
from decogs.formats.splats import FloatArray
from decogs.rig.pictures.ingest import RigFrame, View

from ...settings.effects import CorrectionSettings
from ...stopwatch import Stopwatch
from . import CorrectionMemory, Corrector, RenderView
from .colour import remove_colours
from .falloff import falloff_corrections, find_falloff
from .matching import find_colours


def find_camera_colours(
    frame: RigFrame, views: Sequence[View], settings: CorrectionSettings, xyz: FloatArray, seen: NDArray[np.bool_]
) -> Corrections:
    """How cameras differ in every frame: their fall-offs, and, without these, their gains.

    ``xyz`` (P, 3): points of the surface, which the views see where ``seen`` (V, P).
    """
    falloffs: Corrections = {}
    if settings.falloff:
        falloffs = falloff_corrections(views, find_falloff(views, frame.training, xyz, seen))
    if not settings.match_colours:
        return falloffs
    gains = find_colours(views, match_colours(frame, views, falloffs).training, xyz, seen)
    none = Correction()
    return {name: with_colours(gains.get(name, none), falloffs.get(name, none)) for name in {**gains, **falloffs}}


def match_colours(frame: RigFrame, views: Sequence[View], colours: Corrections) -> RigFrame:
    """The frame without the constant differences between its cameras' ``colours``."""
    if not colours:
        return frame
    pictures = [
        remove_colours(picture, own, view.pinhole)
        if (own := colours.get(view.camera.name, Correction())).is_coloured
        else picture
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


def without_lamps(
    frame: RigFrame, rate: float | None, corrector: Corrector | None, memory: CorrectionMemory | None
) -> RigFrame:
    """A frame of which no scene is known, in the mean light of lamps that flicker, as far as that can be foretold.

    ``rate``: frames in a second.
    """
    lamps = {} if corrector is None else corrector.foretold(frame.index, rate, memory)
    return compensate(frame, corrector, lamps) if lamps else frame


def compensate(frame: RigFrame, corrector: Corrector | None, corrections: Corrections) -> RigFrame:
    """A matched frame with its ``corrections`` undone."""
    return frame if corrector is None else replace(frame, training=corrector.undo(frame.training, corrections))


def newly_dropped(before: CorrectionMemory | None, after: CorrectionMemory | None) -> list[str]:
    """The corrections dropped from one frame to the next, such as "cam04: colours"."""
    if before is None or after is None:
        return []
    return [f"{name}: {kind}" for name, kind in sorted(after.dropped - before.dropped)]
