"""Lamp flicker: mains lamps over a rolling shutter, seen as bands that wander from frame to frame.

Lamps on alternating current pulse at twice its frequency, 100 or 120 times a second. Rows that are read one after the
other see different parts of a pulse, and frames begin at other parts. So what is left of rows' light, when what stays
and what whole pictures do is taken off, is one wave in time and rows: its frequency in time is the alias of the
lamps' at the frame rate, its wavelength in rows the readout. Other frequencies, which no mains has, are the control.
Where the alias is 0 (100 Hz at 25 or 50 frames a second), bands stand still, and time tells nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import logit
from decogs.rig.check.rig_statistics import RigStatistics

from ..settings.encode import EncodeSettings
from .effect import F64, Decision, Evidence, cameras_beyond, make_decision, reason_of

_LAMP_HERTZ = (100.0, 120.0)
_MIN_FRAMES = 5
_MAX_FRAMES = 120
"""Frames that are looked at: mains drift by a twentieth of a turn in so many of 30 a second."""
_READOUTS = np.arange(-40, 40.5, 0.5) / 1000
"""Seconds from the first row to the last that are tried, below 0 from below; refined afterwards."""
_MIN_PERIODS = 0.3
"""Of the wave over a picture: less of it looks like light of the whole picture."""
_MIN_SHARE, _MIN_RATIO, _MIN_AMPLITUDE = 0.05, 4.0, 0.01
"""Least share of the rest that the wave explains, in all and over that of the controls, and of its amplitude."""
_CONTROLS = 8
_DARK, _BRIGHT = 6 / 255, 249 / 255


@dataclass(frozen=True)
class _Wave:
    """``share`` of the rest that it explains, ``amplitude`` in logits, and ``readout`` in seconds."""

    share: float
    amplitude: float
    readout: float


@dataclass(frozen=True)
class _Bands:
    """What a camera shows of lamps: the ``wave``, the lamps' ``hertz``, ``ratio`` to the best of other frequencies."""

    hertz: float
    wave: _Wave
    ratio: float

    @property
    def is_sure(self) -> bool:
        wave = self.wave
        return wave.share >= _MIN_SHARE and self.ratio >= _MIN_RATIO and wave.amplitude >= _MIN_AMPLITUDE


class LampFlicker:
    """Cameras whose rows show the pulse of mains lamps."""

    name = "lamp_flicker"

    def evidence(self, stats: RigStatistics) -> Evidence:
        shape = (len(stats.cameras), len(stats.frames))
        values, names = np.full(shape, np.nan), ("share", "ratio", "hertz", "readout_ms")
        details = {name: np.full(shape, np.nan) for name in names}
        for row, pictures in enumerate(stats.pictures):
            found = _bands(_row_light(pictures), stats.frames, stats.rate)
            if found is None:
                continue
            values[row, 0] = 100 * found.wave.amplitude if found.is_sure else 0.0
            each = (found.wave.share, found.ratio, found.hertz, 1000 * found.wave.readout)
            for name, value in zip(names, each, strict=True):
                details[name][row, 0] = value
        return Evidence(values, "% of light", 100 * _MIN_AMPLITUDE, details)

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        counts = cameras_beyond(evidence)
        cost = ""
        if counts.any():
            strongest = int(np.nan_to_num(evidence.values[:, 0]).argmax())
            hertz, readout = (evidence.details[name][:, 0] for name in ("hertz", "readout_ms"))
            mains = round(float(np.median(hertz[counts])) / 2)
            cost = (
                f"lamps at {2 * mains} Hz: {stats.names[strongest]} reads its rows in {abs(readout[strongest]):.1f} ms "
                f"and sees their light change by {evidence.peak:.0f} %; later frames take several times the bytes. "
                f"A shutter of 1/{2 * mains} or 1/{mains} s avoids it"
            )
        return make_decision(
            stats,
            self,
            evidence,
            counts=counts,
            reason=reason_of(
                evidence,
                f"rows' light changes by up to {evidence.peak:.1f} % at twice the mains' frequency",
                "fewer than five frames, no frame rate, or bands that would stand still",
            ),
            cost=cost,
        )

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        """The same: bands are told, and stay."""
        return settings

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        return settings


def _row_light(pictures: NDArray[np.uint8]) -> F64:
    """Logits (F, H) of the rows' median brightness; ``pictures`` (F, H, W, 3)."""
    kept = pictures[:_MAX_FRAMES]
    medians = np.stack([np.median(picture.mean(axis=2), axis=1) for picture in kept]) / 255
    return np.asarray(logit(np.clip(medians, _DARK, _BRIGHT)), np.float64)


def _bands(light: F64, frames: tuple[int, ...], rate: float | None) -> _Bands | None:
    """The lamps' wave in rows' ``light`` (F, H); None where nothing can be told."""
    if rate is None or len(light) < _MIN_FRAMES:
        return None
    turns = np.asarray(frames[: len(light)], np.float64) / rate
    rest = _without_slow(light)
    if not (rest**2).sum() > 0:
        return None
    told = [hertz for hertz in _LAMP_HERTZ if _wanders(hertz * turns)]
    if not told:
        return None
    hertz, wave = max(((each, _wave(rest, each, turns)) for each in told), key=lambda found: found[1].share)
    others = _control_hertz(hertz, turns, rate)
    if not others:
        return None
    control = float(np.mean([_wave(rest, each, turns).share for each in others]))
    return _Bands(hertz, wave, wave.share / max(control, 1e-12))


def _without_slow(light: F64) -> F64:
    """Without what stays, what whole pictures do, and what changes evenly."""
    time = np.linspace(-1, 1, len(light))[:, None]
    rest = light - light.mean(axis=0)
    rest = rest - time * (time * rest).sum(axis=0) / (time**2).sum()
    return np.asarray(rest - rest.mean(axis=1, keepdims=True))


def _wanders(turns: F64) -> bool:
    """Whether a wave of so many turns at each frame does not stand still over the frames."""
    return bool(abs(np.exp(2j * np.pi * turns).mean()) < 0.5)


def _control_hertz(hertz: float, times: F64, rate: float) -> list[float]:
    """Frequencies near the lamps' whose aliases are neither theirs nor stand still."""
    candidates = hertz + rate * (np.arange(_CONTROLS) + 0.5) / _CONTROLS
    kept = []
    for each in candidates.tolist():
        apart = (
            abs(np.exp(2j * np.pi * (each - sign * lamp) * times).mean()) for lamp in _LAMP_HERTZ for sign in (1, -1)
        )
        if _wanders(each * times) and max(apart) < 0.5:
            kept.append(each)
    return kept


def _wave(rest: F64, hertz: float, times: F64) -> _Wave:
    """The best wave of that frequency over all readouts."""
    readouts = np.asarray(_READOUTS, np.float64)
    best = _best_of(rest, hertz, times, readouts[np.abs(readouts) * hertz >= _MIN_PERIODS])
    for step in (1e-4, 2e-5):
        best = _best_of(rest, hertz, times, np.asarray(best.readout + step * np.arange(-5, 6), np.float64))
    return best


def _best_of(rest: F64, hertz: float, times: F64, readouts: F64) -> _Wave:
    """Of waves with these readouts (R,), by least squares of their sines and cosines, that which explains most."""
    rows = (np.arange(rest.shape[1]) + 0.5) / rest.shape[1]
    shapes = np.exp(2j * np.pi * hertz * readouts[:, None] * rows)
    shapes -= shapes.mean(axis=1, keepdims=True)
    projected = np.einsum("h,rh->r", np.exp(-2j * np.pi * hertz * times) @ rest, shapes.conj())
    power = len(rest) * (np.abs(shapes) ** 2).sum(axis=1)
    double = np.exp(4j * np.pi * hertz * times).sum() * (shapes**2).sum(axis=1)
    # Of 2 x 2 normal equations [power + Re double, Im double; Im double, power - Re double] / 2.
    cosine, sine = projected.real, -projected.imag
    determinant = np.maximum((power**2 - np.abs(double) ** 2) / 4, 1e-9 * power**2)
    a = ((power - double.real) * cosine - double.imag * sine) / (2 * determinant)
    b = ((power + double.real) * sine - double.imag * cosine) / (2 * determinant)
    explained = a * cosine + b * sine
    best = int(explained.argmax())
    share = float(explained[best] / (rest**2).sum())
    return _Wave(share, float(np.hypot(a[best], b[best])), float(readouts[best]))
