"""A frame's compensated pictures: without its cameras' constant differences, and the drift of named ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import Correction, Corrections, with_colours
from decogs.formats.splats import FloatArray
from decogs.rig.check.lamps import standing_hertz
from decogs.rig.pictures.ingest import RigFrame, View

from ...settings.effects import CorrectionSettings
from ...stopwatch import Stopwatch
from . import CorrectionMemory, Corrector, RenderView
from .colour import remove_colours
from .falloff import falloff_corrections, falloff_of
from .lamps import LampView
from .matching import find_colours
from .point_fit import PointFit, SharedPoints, shared_points
from .standing_bands import band_corrections, find_bands


def find_camera_colours(
    frame: RigFrame,
    rate: float | None,
    views: Sequence[View],
    settings: CorrectionSettings,
    xyz: FloatArray,
    seen: NDArray[np.bool_],
) -> Corrections:
    """How cameras differ in every frame: their fall-offs and standing bands, and, without these, their gains.

    ``rate``: frames in a second. ``xyz`` (P, 3): points of the surface, which the views see where ``seen`` (V, P).
    """
    hertz = standing_hertz(rate) if settings.standing_bands and not settings.lamps else ()
    shades: Corrections = {}
    if settings.falloff or hertz:
        points = shared_points(views, frame.training, xyz, seen)
        shades = _shades(views, points, hertz, darkens=settings.falloff)
    if not settings.match_colours:
        return shades
    gains = find_colours(views, match_colours(frame, views, shades).training, xyz, seen)
    return _together(gains, shades)


def _shades(views: Sequence[View], points: SharedPoints, hertz: Sequence[float], *, darkens: bool) -> Corrections:
    """Fall-offs, if lenses may have some, and bands of lamps whose ``hertz`` let them stand."""
    fit = PointFit(points)
    fit.fit()
    bands: Corrections = {}
    if hertz:
        fit, sure = find_bands(points, fit)
        bands = band_corrections(views, fit, sure, hertz[0])
    return _together(falloff_corrections(views, falloff_of(fit, points)) if darkens else {}, bands)


def _together(some: Corrections, others: Corrections) -> Corrections:
    none = Correction()
    return {name: with_colours(some.get(name, none), others.get(name, none)) for name in {**some, **others}}


def match_colours(frame: RigFrame, views: Sequence[View], colours: Corrections) -> RigFrame:
    """The frame without the constant differences between its cameras' ``colours``."""
    if not colours:
        return frame
    none = Correction()
    return replace(
        frame,
        training=[
            _in_own_colours(picture, colours.get(view.camera.name, none), view)
            for view, picture in zip(views, frame.training, strict=True)
        ],
    )


def _in_own_colours(picture: FloatArray, colours: Correction, view: View) -> FloatArray:
    """A view's picture in the scene's own colours; the very object where its camera has none of its own."""
    if colours.has_wave and colours.lamp is not None:
        picture = LampView(colours.lamp, view).undo(picture, colours)
    plain = replace(colours, lamp=None)
    return remove_colours(picture, plain, view.pinhole) if plain.is_coloured else picture


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
