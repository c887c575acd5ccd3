"""Cameras' own faults taken out of their pictures, right after ingest, so that the scene is kept without them.

What masks, selection and training see is canonical: the scene's own colours, from the calibrated poses. A frame's
packet says what was taken out of it, and a decoder puts it back to show what a camera recorded. Nothing here runs, and
nothing is allocated, unless a camera is named.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from decogs.codec.corrections import ANGLE_STEP, COLOUR_STEP, LARGEST, CorrectedCameras, Correction, Corrections
from decogs.formats.errors import UsageError
from decogs.formats.splats import FloatArray

from ..ingest import View
from .agreement import Look, agreeing_shifts
from .colour import OddsShift, odds_shift, without_odds
from .settings import CorrectionSettings
from .shake import angles_of, turn_of, unturned

__all__ = ["CorrectionSettings", "Corrector", "corrector_of"]

F64 = NDArray[np.float64]

Show = Callable[[int], FloatArray]
"""The scene through the training view of that number, (3, H, W)."""

_ALTERNATIONS = 2
"""Pose and colours are found in turn, each with the other taken out."""


def corrector_of(views: Sequence[View], settings: CorrectionSettings) -> Corrector | None:
    """The corrector of the cameras that are named; None when there are none.

    Raises UsageError for a name that is no training view's.
    """
    if not (settings.exposure or settings.white_balance or settings.shake):
        return None
    return Corrector(views, settings)


class Corrector:
    """Finds and undoes the faults of the named cameras. ``cameras`` is what the stream's header says of it."""

    def __init__(self, views: Sequence[View], settings: CorrectionSettings) -> None:
        self._views = {view.camera.name: (number, view) for number, view in enumerate(views)}
        lists = (settings.exposure, settings.white_balance, settings.shake)
        self.cameras = CorrectedCameras(*(self._known(names) for names in lists))
        self._named = [name for name in self._views if self.cameras.of(name)]
        self._has_colours = bool(self.cameras.exposure_drift or self.cameras.white_balance_drift)

    def find(self, recorded: Sequence[FloatArray], show: Show) -> Corrections:
        """The faults of a frame's ``recorded`` pictures (3, H, W) against the scene as ``show`` gives it."""
        measured = {name: self._measured(name, recorded, show) for name in self._named}
        return {name: self._correction(name, fault) for name, fault in measured.items()}

    def find_jointly(self, recorded: Sequence[FloatArray], look: Look) -> Corrections:
        """The same while the scene is in the making, and has taken some of the faults for its own.

        What is neutral is told by the cameras that are not named; where none is left, it is the mean of all.
        """
        straight, rotations = list(recorded), dict.fromkeys(self._named, np.eye(3))
        for name in self.cameras.camera_shake:
            number, view = self._views[name]
            rotations[name] = self._measured(name, recorded, lambda number: look(number).rgb).rotation
            straight[number] = unturned(recorded[number], view.pinhole, rotations[name])
        if not self._has_colours:
            return {name: self._correction(name, _Fault(_NO_SHIFT, rotations[name])) for name in self._named}
        views = [view for _, view in self._views.values()]
        colours = dict(zip(self._views, agreeing_shifts(views, straight, look), strict=True))
        offset = self._neutral({name: colour.shift for name, colour in colours.items()})
        return {
            name: self._correction(name, _Fault(colours[name].without(offset), rotations[name])) for name in self._named
        }

    def undo(self, recorded: Sequence[FloatArray], corrections: Corrections) -> list[FloatArray]:
        """The pictures without the faults; those of other cameras are the very objects."""
        canonical = list(recorded)
        for name, correction in corrections.items():
            number, view = self._views[name]
            if correction.is_coloured:
                canonical[number] = without_odds(canonical[number], correction.odds)
            if correction.is_turned:
                canonical[number] = unturned(canonical[number], view.pinhole, correction.rotation)
        return canonical

    def _known(self, names: Sequence[str]) -> tuple[str, ...]:
        for name in names:
            if name not in self._views:
                raise UsageError(f"camera {name} cannot be corrected: it is none of those trained on")
        return tuple(name for name in self._views if name in names)

    def _measured(self, name: str, recorded: Sequence[FloatArray], show: Show) -> _Fault:
        number, view = self._views[name]
        picture, shown = recorded[number], show(number)
        colour = odds_shift(picture, shown, view.valid) if self._has_colours else _NO_SHIFT
        if name not in self.cameras.camera_shake:
            return _Fault(colour, np.eye(3))
        rotation = np.eye(3)
        for _ in range(_ALTERNATIONS if self._has_colours else 1):
            red, green, blue = np.exp(colour.shift).tolist()
            rotation = turn_of(without_odds(picture, (red, green, blue)), shown, view.pinhole, view.valid)
            if self._has_colours:
                colour = odds_shift(unturned(picture, view.pinhole, rotation), shown, view.valid)
        return _Fault(colour, rotation)

    def _neutral(self, shifts: dict[str, F64]) -> F64:
        """The shift (3,) that is none."""
        exposure = _mean_of_others(shifts, self.cameras.exposure_drift)
        balance = _mean_of_others(shifts, self.cameras.white_balance_drift)
        return np.asarray(exposure[1] + balance - balance[1])

    def _correction(self, name: str, fault: _Fault) -> Correction:
        """The numbers of the effects for which the camera is named."""
        shift, precision = fault.colour
        drifts, unbalanced = name in self.cameras.exposure_drift, name in self.cameras.white_balance_drift
        red, green, blue = shift.tolist()
        if not unbalanced:
            green = float((precision * shift).sum() / max(float(precision.sum()), 1e-12))
        yaw, pitch, roll = angles_of(fault.rotation)
        return Correction(
            _steps(green, COLOUR_STEP) if drifts else 0,
            _steps(red - green, COLOUR_STEP) if unbalanced else 0,
            _steps(blue - green, COLOUR_STEP) if unbalanced else 0,
            _steps(yaw, ANGLE_STEP),
            _steps(pitch, ANGLE_STEP),
            _steps(roll, ANGLE_STEP),
        )


class _Fault(NamedTuple):
    """A camera's fault as measured: the shift of its colours' odds, and its turn (3, 3)."""

    colour: OddsShift
    rotation: F64


_NO_SHIFT = OddsShift(np.zeros(3), np.zeros(3))


def _mean_of_others(shifts: dict[str, F64], named: Sequence[str]) -> F64:
    """Mean shift (3,) of the cameras that are not named, or of all when every one is."""
    others = [shift for name, shift in shifts.items() if name not in named] or list(shifts.values())
    return np.asarray(np.mean(others, axis=0))


def _steps(value: float, step: float) -> int:
    return max(-LARGEST, min(LARGEST, round(value / step)))
