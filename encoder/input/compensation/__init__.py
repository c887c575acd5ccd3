"""Compensation of camera drift in the pictures, right after ingest, so that the scene is free of it.

Masks, selection and training see compensated pictures: the scene's own colours, from the calibrated poses. A frame's
packet codes its corrections, and a decoder applies them to show a camera's view as recorded. Nothing here runs, and
nothing is allocated, unless a camera is named.

A change that all cameras share is the scene's light and stays in their pictures (`rig/check/light.py` has the rule). A
later frame's shifts are those that differ from camera to camera at the same points of the scene. The cameras that are
not named define neutral. Where all are named, their median does, as far as it exceeds the median that so many cameras
have by chance, each drifting by itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import (
    ALWAYS_LIT,
    ANGLE_STEP,
    COLOUR_STEP,
    PHASE_TURNS,
    CorrectedCameras,
    Correction,
    Corrections,
    phase_steps,
    whole_steps,
)
from decogs.formats.errors import UsageError
from decogs.formats.splats import FloatArray
from decogs.rig.pictures.ingest import View

from ...settings.effects import CorrectionSettings
from .agreement import DrawView, SharedSurface, agreeing_shifts, shared_changes, shared_surface
from .benefit import Benefit, on_grid
from .colour import LogitShift, logit_shift, remove_gain
from .lamps import LampView
from .shake import angles_of, estimate_turn, undo_turn

__all__ = ["CorrectionMemory", "CorrectionSettings", "Corrector", "corrector_of"]

F64 = NDArray[np.float64]

RenderView = Callable[[int], FloatArray]
"""Renders the scene through the training view of that number, (3, H, W)."""

_KINDS = {"colours": ("exposure", "red", "blue"), "shake": ("yaw", "pitch", "roll")}
"""Parts of a correction that are judged separately, and their numbers."""

_CHANCE_DEVIATIONS = 2.6
"""Deviations of the median of many cameras that drift each by itself within which it is chance, at 99 %."""
_FEW_CAMERAS_FACTOR = 3.5
"""What that grows by over one less than the cameras' number: within a tenth of Student's t from 4 cameras on."""

_ALTERNATIONS = 2
"""Pose and colours are estimated in turn, each with the other compensated."""


def corrector_of(views: Sequence[View], settings: CorrectionSettings) -> Corrector | None:
    """The corrector of the cameras that are named; None when there are none.

    Raises UsageError for a name that is no training view's.
    """
    if not (settings.exposure or settings.white_balance or settings.shake or settings.lamps):
        return None
    return Corrector(views, settings)


@dataclass(frozen=True)
class CorrectionMemory:
    """What one frame's corrections hand to the next.

    ``surface``: where cameras are compared. ``first``: the corrections of the rig's frame ``begun``, the first, which
    stay where later ones are dropped; ``latest``: those of its frame ``index``. ``benefits``: of the corrections so
    far, by camera and kind; those ``dropped`` made pictures worse.
    """

    surface: SharedSurface
    first: Corrections = field(default_factory=dict)
    begun: int = 0
    latest: Corrections = field(default_factory=dict)
    index: int = 0
    benefits: Mapping[tuple[str, str], Benefit] = field(default_factory=dict)
    dropped: frozenset[tuple[str, str]] = frozenset()

    def begin(self, first: Corrections, index: int) -> CorrectionMemory:
        """With the corrections of the first frame, the rig's ``index``."""
        return CorrectionMemory(self.surface, first, index, first, index)

    def restart(self) -> CorrectionMemory:
        """Without the evidence of frames after the first."""
        return self.begin(self.first, self.begun)


class Corrector:
    """Estimates and compensates the drift of the named cameras. ``cameras``: the stream header's entry."""

    def __init__(self, views: Sequence[View], settings: CorrectionSettings) -> None:
        self._views = {view.camera.name: (number, view) for number, view in enumerate(views)}
        lists = (settings.exposure, settings.white_balance, settings.shake, tuple(settings.lamps))
        self.cameras = CorrectedCameras(*(self._check_names(names) for names in lists))
        self._named = [name for name in self._views if self.cameras.of(name)]
        self._has_colours = bool(self.cameras.exposure_drift or self.cameras.white_balance_drift)
        self._phases = settings.lamp_phases
        self._lamps = {name: LampView(settings.lamps[name], self._views[name][1]) for name in self.cameras.lamp_flicker}

    def begin(self, draw: DrawView) -> CorrectionMemory:
        """The memory of a scene's first frame; ``draw``: of the keyframe."""
        views = [view for _, view in self._views.values()]
        if self._has_colours:
            return CorrectionMemory(shared_surface(views, draw))
        nowhere = np.zeros((len(views), 0), np.int64)
        return CorrectionMemory(SharedSurface(nowhere, nowhere, nowhere > 0))

    def find(self, memory: CorrectionMemory, recorded: Sequence[FloatArray], render: RenderView) -> Corrections:
        """Corrections of a frame's ``recorded`` pictures (3, H, W) against the scene as ``render`` draws it."""
        straight, rotations = list(recorded), dict.fromkeys(self._named, np.eye(3))
        lamps: Corrections = {
            name: lamp.find(*self._beside(name, straight, render)) for name, lamp in self._lamps.items()
        }
        straight = self.undo(straight, lamps)
        for name in self.cameras.camera_shake:
            number, view = self._views[name]
            rotations[name] = self._measure(name, straight, render).rotation
            straight[number] = undo_turn(straight[number], view.pinhole, rotations[name])
        shifts = self._own_shifts(memory.surface, straight, render) if self._has_colours else {}
        corrections = {
            name: _with_lamp(
                self._correction(name, _Drift(shifts.get(name, _NO_SHIFT), rotations[name])), lamps.get(name)
            )
            for name in self._named
        }
        for name, kind in memory.dropped:
            corrections[name] = _as_at_first(memory, name, kind, corrections[name])
        return corrections

    def foretold(self, frame: int, rate: float | None, memory: CorrectionMemory | None) -> Corrections:
        """What lamps do in the rig's ``frame``, from the latest that is known, by ``memory`` or by the analysis.

        ``rate``: frames in a second.
        """
        latest, index = ({}, 0) if memory is None else (memory.latest, memory.index)
        foretold = {}
        for name, lamp in self._lamps.items():
            known = latest.get(name, Correction(lamp_amplitude=ALWAYS_LIT))
            before = known.lamp_phase * PHASE_TURNS if name in latest else self._phases.get(name, 0.0)
            later = 0.0 if rate is None else lamp.wave.hertz * (frame - index) / rate
            foretold[name] = replace(known, lamp_phase=phase_steps(before + later))
        return foretold

    def judge(
        self,
        memory: CorrectionMemory,
        recorded: Sequence[FloatArray],
        corrections: Corrections,
        render: RenderView,
        changed: Sequence[NDArray[np.bool_]],
    ) -> CorrectionMemory:
        """The memory after a frame, without the corrections that made its pictures worse.

        ``render``: the scene as trained. ``changed``: where every view's picture changed, (H, W). A scene that has not
        followed its light yet misses every camera by it; what the other cameras miss in common is therefore no camera's
        loss.
        """
        benefits, left_behind = dict(memory.benefits), dict[str, F64]()
        for name, correction in corrections.items():
            number, _ = self._views[name]
            for kind in _KINDS:
                left_out = _as_at_first(memory, name, kind, correction)
                if (name, kind) in memory.dropped or left_out == correction:
                    continue
                corrected, left = (
                    on_grid(self._compensate(name, recorded[number], each)) for each in (correction, left_out)
                )
                rendered = on_grid(render(number))
                if self._has_colours:
                    left_behind = left_behind or self._left_behind(recorded, corrections, render)
                    rendered = remove_gain(rendered, _gain_of(-_of_the_others(left_behind, name)))
                benefit = benefits.get((name, kind), Benefit())
                benefits[name, kind] = benefit.update(corrected, left, rendered, on_grid(changed[number]))
        dropped = {key for key, benefit in benefits.items() if not benefit.pays}
        return replace(memory, benefits=benefits, dropped=memory.dropped | dropped)

    def _left_behind(
        self, recorded: Sequence[FloatArray], corrections: Corrections, render: RenderView
    ) -> dict[str, F64]:
        """Logit shift (3,) from the scene to every camera's corrected picture."""
        return {
            name: logit_shift(
                self._compensate(name, recorded[number], corrections.get(name, Correction())),
                render(number),
                view.valid,
            ).shift
            for name, (number, view) in self._views.items()
        }

    def find_jointly(self, recorded: Sequence[FloatArray], draw: DrawView) -> Corrections:
        """Corrections while the scene is being trained and has absorbed some of the drift.

        What is neutral is determined by the cameras that are not named, by their median; where none is left, it is
        the mean of all.
        """
        straight, rotations = list(recorded), dict.fromkeys(self._named, np.eye(3))
        for name in self.cameras.camera_shake:
            number, view = self._views[name]
            rotations[name] = self._measure(name, recorded, lambda number: draw(number).rgb).rotation
            straight[number] = undo_turn(recorded[number], view.pinhole, rotations[name])
        if not self._has_colours:
            return {name: self._correction(name, _Drift(_NO_SHIFT, rotations[name])) for name in self._named}
        views = [view for _, view in self._views.values()]
        colours = dict(zip(self._views, agreeing_shifts(views, straight, draw), strict=True))
        offset = self._neutral({name: colour.shift for name, colour in colours.items()}, _mean)
        return {
            name: self._correction(name, _Drift(colours[name].without(offset), rotations[name])) for name in self._named
        }

    def undo(self, recorded: Sequence[FloatArray], corrections: Corrections) -> list[FloatArray]:
        """The compensated pictures; those of other cameras are the very objects."""
        compensated = list(recorded)
        for name, correction in corrections.items():
            number, _ = self._views[name]
            compensated[number] = self._compensate(name, compensated[number], correction)
        return compensated

    def _compensate(self, name: str, picture: FloatArray, correction: Correction) -> FloatArray:
        if correction.lamp_amplitude:
            picture = self._lamps[name].undo(picture, correction)
        if correction.has_gain:
            picture = remove_gain(picture, correction.odds_gain)
        if correction.is_turned:
            picture = undo_turn(picture, self._views[name][1].pinhole, correction.rotation)
        return picture

    def _beside(self, name: str, pictures: Sequence[FloatArray], render: RenderView) -> tuple[FloatArray, FloatArray]:
        """A camera's picture, and the scene through its view."""
        number, _ = self._views[name]
        return pictures[number], render(number)

    def _check_names(self, names: Sequence[str]) -> tuple[str, ...]:
        for name in names:
            if name not in self._views:
                raise UsageError(f"camera {name} cannot be compensated: it is not a training camera")
        return tuple(name for name in self._views if name in names)

    def _measure(self, name: str, recorded: Sequence[FloatArray], render: RenderView) -> _Drift:
        number, view = self._views[name]
        picture, rendered = recorded[number], render(number)
        colour = logit_shift(picture, rendered, view.valid) if self._has_colours else _NO_SHIFT
        if name not in self.cameras.camera_shake:
            return _Drift(colour, np.eye(3))
        rotation = np.eye(3)
        for _ in range(_ALTERNATIONS if self._has_colours else 1):
            rotation = estimate_turn(remove_gain(picture, _gain_of(colour.shift)), rendered, view.pinhole, view.valid)
            if self._has_colours:
                colour = logit_shift(undo_turn(picture, view.pinhole, rotation), rendered, view.valid)
        return _Drift(colour, rotation)

    def _own_shifts(
        self, surface: SharedSurface, pictures: Sequence[FloatArray], render: RenderView
    ) -> dict[str, LogitShift]:
        """Shifts of the pictures' colours against the scene's, without the scene's change of light, by camera."""
        rendered = [render(number) for number in range(len(pictures))]
        changes = shared_changes(surface, pictures, rendered)
        names, total = list(self._views), changes.shifts + changes.common
        own = {
            name: shift for name, shift, reference in zip(names, total, changes.has_overlap, strict=True) if reference
        }
        alone = {} if len(own) == len(names) else self._shifts_of_pictures(pictures, rendered)
        reference = own or alone
        light = self._neutral(reference, _light_of)
        rest = self._neutral(alone, _light_of) if alone else light
        return {
            name: LogitShift(own[name] - light if name in own else alone[name] - rest, np.ones(3)) for name in names
        }

    def _shifts_of_pictures(self, pictures: Sequence[FloatArray], rendered: Sequence[FloatArray]) -> dict[str, F64]:
        """Shifts of whole pictures against the rendered ones, for cameras that share too little with others."""
        return {
            name: logit_shift(pictures[number], rendered[number], view.valid).shift
            for name, (number, view) in self._views.items()
        }

    def _neutral(self, shifts: dict[str, F64], of_all: Callable[[F64], F64]) -> F64:
        """The neutral shift (3,). ``of_all``: of the shifts (cameras, 3) where every camera is named."""
        exposure = _of_others(shifts, self.cameras.exposure_drift, of_all)
        balance = _of_others(shifts, self.cameras.white_balance_drift, of_all)
        return np.asarray(exposure[1] + balance - balance[1])

    def _correction(self, name: str, drift: _Drift) -> Correction:
        """The numbers of the effects for which the camera is named."""
        shift, precision = drift.colour
        drifts, unbalanced = name in self.cameras.exposure_drift, name in self.cameras.white_balance_drift
        red, green, blue = shift.tolist()
        if not unbalanced:
            green = float((precision * shift).sum() / max(float(precision.sum()), 1e-12))
        yaw, pitch, roll = angles_of(drift.rotation)
        return Correction(
            whole_steps(green, COLOUR_STEP) if drifts else 0,
            whole_steps(red - green, COLOUR_STEP) if unbalanced else 0,
            whole_steps(blue - green, COLOUR_STEP) if unbalanced else 0,
            whole_steps(yaw, ANGLE_STEP),
            whole_steps(pitch, ANGLE_STEP),
            whole_steps(roll, ANGLE_STEP),
        )


class _Drift(NamedTuple):
    """A camera's measured drift: the logit shift of its colours, and its rotation (3, 3)."""

    colour: LogitShift
    rotation: F64


_NO_SHIFT = LogitShift(np.zeros(3), np.zeros(3))


def _with_lamp(correction: Correction, lamp: Correction | None) -> Correction:
    if lamp is None:
        return correction
    return replace(correction, lamp_phase=lamp.lamp_phase, lamp_amplitude=lamp.lamp_amplitude)


def _as_at_first(memory: CorrectionMemory, name: str, kind: str, correction: Correction) -> Correction:
    """The correction with the first frame's numbers of that kind."""
    first = memory.first.get(name, Correction())
    return replace(correction, **{number: getattr(first, number) for number in _KINDS[kind]})


def _of_others(shifts: dict[str, F64], named: Sequence[str], of_all: Callable[[F64], F64]) -> F64:
    """Median shift (3,) of the cameras that are not named, or ``of_all`` when every one is."""
    others = [shift for name, shift in shifts.items() if name not in named]
    return np.asarray(np.median(others, axis=0) if others else of_all(np.array(list(shifts.values()))))


def _mean(shifts: F64) -> F64:
    return np.asarray(shifts.mean(axis=0))


def _light_of(shifts: F64) -> F64:
    """The light's part (3,) of shifts (cameras, 3): their median, shrunk by what may be chance."""
    if len(shifts) < 2:
        return np.zeros(3)
    # Exposure and white balance drift each by itself.
    kinds = np.stack([shifts[:, 0] - shifts[:, 1], shifts[:, 1], shifts[:, 2] - shifts[:, 1]], axis=1)
    median = np.median(kinds, axis=0)
    # The median of n normal values has 1.2533 / sqrt n of their deviation.
    chance = (
        _CHANCE_DEVIATIONS
        * (1 + _FEW_CAMERAS_FACTOR / (len(shifts) - 1))
        * 1.2533
        * kinds.std(axis=0, ddof=1)
        / np.sqrt(len(shifts))
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        left = np.where(median == 0, 0, 1 - np.square(chance / median))
    red, green, blue = median * np.maximum(left, 0)
    return np.array([red + green, green, blue + green])


def _of_the_others(shifts: Mapping[str, F64], name: str) -> F64:
    """The median shift (3,) of the cameras but ``name``; 0 where there is only one, which is no majority."""
    others = [shift for other, shift in shifts.items() if other != name]
    return np.median(others, axis=0) if len(others) > 1 else np.zeros(3)


def _gain_of(shift: F64) -> tuple[float, float, float]:
    red, green, blue = np.exp(shift).tolist()
    return red, green, blue
