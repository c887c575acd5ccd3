"""Lamp flicker: mains lamps over a rolling shutter, seen as bands that wander from frame to frame.

Lamps on alternating current pulse at twice its frequency, 100 or 120 times a second. Rows that are read one after the
other see different parts of a pulse, and frames begin at other parts. So what is left of rows' light, when what stays
and what whole pictures do is taken off, is one wave in time and rows: its frequency in time is the alias of the
lamps' at the frame rate, its wavelength in rows the readout. Other frequencies, which no mains has, are the control.
Where the alias is 0 (100 Hz at 25 or 50 frames a second), bands stand still, and time tells nothing.

Lamps of several phases and colours light parts of a picture differently: the wave's strength and phase are then told
for cells of the picture.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import ALWAYS_LIT, LAMP_STEP, LARGEST, Correction, LampWave, phase_steps
from decogs.decoder.cameras.corrections import as_recorded
from decogs.formats.cameras import Camera
from decogs.formats.splats import logit

F64 = NDArray[np.float64]
C128 = NDArray[np.complex128]
U8 = NDArray[np.uint8]

LAMP_HERTZ = (100.0, 120.0)
MIN_AMPLITUDE = 0.01
"""Of the wave, in logits, from which it counts."""
_MIN_SHARE, _MIN_RATIO = 0.05, 4.0
"""Least share of the rest that the wave explains, in all and over that of the controls."""
_STEADY_SHARE, _MORE_SHARE = 0.8, 0.1
"""Of the rest: from the first on, lamps are on all the time; by the second, more in a half tells that they are not."""
_MIN_FRAMES = 5
_MAX_FRAMES = 120
"""Frames that are looked at: mains drift by a twentieth of a turn in so many of 30 a second."""
_READOUTS = np.arange(-40, 40.5, 2) / 1000
"""Seconds from the first row to the last that are tried, below 0 from below; refined afterwards."""
_FINER = (4e-4, 1e-4, 2e-5)
_MIN_PERIODS = 0.3
"""Of the wave over a picture: less of it looks like light of the whole picture."""
_MIN_TURNS = 0.04
"""Of the wave from one frame to the next, below which it stands still over a few."""
_CONTROLS = 8
_CHANNELS = 3
_DARK, _BRIGHT = 6 / 255, 249 / 255
_COLUMNS, _ROWS = 8, 6
"""Cells of a picture for which waves are told where they differ."""
_MAP_FRAMES = 40
_MIN_APART, _MIN_APART_CHANCE = 0.15, 2.0
"""How far, by their strength and by that of chance, waves of cells must be from the picture's for that."""
_MIN_SECONDS = 1.0
"""Of a clip from which it tells how far the mains are from their frequency."""
_DRIFTS = np.arange(-0.15, 0.1501, 0.005)
"""Hertz that pulses may be off by."""


@dataclass(frozen=True)
class Lamps:
    """What a camera shows of lamps.

    ``share``: of the rest of rows' light that the wave explains; ``ratio``: to the mean of other frequencies.
    ``amplitude`` in logits. ``wave``: its constants; ``phase``: its turns at the rig's frame 0. ``seen``: in which of
    the pictures.
    """

    share: float
    ratio: float
    amplitude: float
    wave: LampWave
    seen: slice
    phase: float = 0.0

    @property
    def is_sure(self) -> bool:
        return self.share >= _MIN_SHARE and self.ratio >= _MIN_RATIO and self.amplitude >= MIN_AMPLITUDE

    def phase_at(self, frame: int, rate: float) -> float:
        """Turns in the rig's ``frame``."""
        return self.phase + self.wave.hertz * frame / rate


@dataclass(frozen=True)
class _Wave:
    """``share`` of the rest that it explains, ``amplitude`` in logits, and ``readout`` in seconds."""

    share: float
    amplitude: float
    readout: float


def standing_hertz(rate: float | None, step: int = 1) -> tuple[float, ...]:
    """Pulses in a second whose bands stand still over every ``step``-th frame, of ``rate`` in a second."""
    if rate is None:
        return ()
    turns = {hertz: hertz * step / rate for hertz in LAMP_HERTZ}
    return tuple(hertz for hertz, each in turns.items() if abs(each - round(each)) < _MIN_TURNS)


def hides_lamps(step: int, rate: float) -> bool:
    """Whether bands that wander over all frames stand still over every ``step``-th."""
    return bool(set(standing_hertz(rate, step)) - set(standing_hertz(rate)))


def find_lamps(pictures: U8, frames: Sequence[int], rate: float | None) -> Lamps | None:
    """The lamps' wave in a camera's ``pictures`` (F, H, W, 3) of the rig's ``frames``; None where nothing can be told.

    Whether it `is_sure` is for the caller to ask. Lamps that are not on all the time are found in half of the frames.
    """
    light = _row_light(pictures[:_MAX_FRAMES])
    if rate is None or len(light) < _MIN_FRAMES:
        return None
    times = np.asarray(frames[: len(light)], np.float64) / rate
    middle = len(light) // 2
    found = _lamps_in(pictures, light, times, rate, slice(0, len(light)))
    if found is None or (found.is_sure and found.share > _STEADY_SHARE) or middle < _MIN_FRAMES:
        return found
    halves = (slice(0, middle), slice(middle, len(light)))
    parts = [each for part in halves if (each := _lamps_in(pictures, light, times, rate, part)) is not None]
    best = max(parts, key=lambda each: (each.is_sure, each.share), default=found)
    return best if best.is_sure and (not found.is_sure or best.share > found.share + _MORE_SHARE) else found


def _lamps_in(pictures: U8, light: F64, times: F64, rate: float, part: slice) -> Lamps | None:
    """Those in a part of the frames."""
    rest, times = _without_slow(light[part]), times[part]
    told = [hertz for hertz in LAMP_HERTZ if _wanders(hertz * times)]
    if not told or not (rest**2).sum() > 0:
        return None
    hertz, wave = max(((each, _wave(rest, each, times)) for each in told), key=lambda found: found[1].share)
    others = _control_hertz(hertz, times, rate)
    if not others:
        return None
    control = float(np.mean([_coarse_wave(rest, each, times).share for each in others]))
    simple = LampWave(hertz, wave.readout, 1, 1, (0,) * 3, (0,) * 3)
    found = Lamps(wave.share, wave.share / max(control, 1e-12), wave.amplitude, simple, part)
    return _mapped(found, pictures[part], rest, times, others) if found.is_sure else found


def without_lamps(pictures: U8, frames: Sequence[int], rate: float, camera: Camera, lamps: Lamps) -> U8:
    """A camera's ``pictures`` (F, H, W, 3) in the lamps' mean light, where they were seen."""
    steady: U8 = pictures.copy()
    lit = range(len(pictures))
    if lamps.seen != slice(0, min(len(pictures), _MAX_FRAMES)):
        lit = lit[lamps.seen]
    for number in lit:
        picture, frame = pictures[number], frames[number]
        phase = phase_steps(lamps.phase_at(frame, rate))
        wave = Correction(lamp_phase=phase, lamp_amplitude=ALWAYS_LIT, lamp=lamps.wave)
        levels = 255 * as_recorded(picture.astype(np.float32) / 255, wave, camera, undo=True)
        steady[number] = np.rint(levels).astype(np.uint8)
    return steady


def _row_light(pictures: U8) -> F64:
    """Logits (F, H) of the rows' median brightness."""
    sums = (picture[:, ::2].sum(axis=2, dtype=np.uint16) for picture in pictures)
    medians = np.stack([np.median(each, axis=1) for each in sums]) / (255 * _CHANNELS)
    return np.asarray(logit(np.clip(medians, _DARK, _BRIGHT)), np.float64)


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
            abs(np.exp(2j * np.pi * (each - sign * lamp) * times).mean()) for lamp in LAMP_HERTZ for sign in (1, -1)
        )
        if _wanders(each * times) and max(apart) < 0.5:
            kept.append(each)
    return kept


def _coarse_wave(rest: F64, hertz: float, times: F64) -> _Wave:
    """The best wave of that frequency, nearly, over all readouts."""
    readouts = np.asarray(_READOUTS, np.float64)
    return _best_of(rest, hertz, times, readouts[np.abs(readouts) * hertz >= _MIN_PERIODS])


def _wave(rest: F64, hertz: float, times: F64) -> _Wave:
    """The best wave of that frequency over all readouts."""
    best = _coarse_wave(rest, hertz, times)
    for step in _FINER:
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


def _mapped(found: Lamps, pictures: U8, rest: F64, times: F64, others: Sequence[float]) -> Lamps:
    """With the wave's frequency, its readout from all columns, and its strength in each channel, or cell, of them.

    ``others``: frequencies that are no lamps', whose waves are chance.
    """
    hertz, readout = _frequency(found.wave, rest, times), found.wave.readout
    light, times = _local_light(pictures[:_MAP_FRAMES]), times[:_MAP_FRAMES]
    local = _local_waves(light, hertz, times)
    down = (np.arange(len(local)) + 0.5)[:, None, None] / len(local)
    for step in _FINER:
        tried = readout + step * np.arange(-5, 6)
        sums = [(local * np.exp(-2j * np.pi * hertz * each * down)).mean(axis=0) for each in tried]
        readout = float(tried[int(np.argmax([(np.abs(each) ** 2).sum() for each in sums]))])
    level = np.exp(-2j * np.pi * hertz * readout * down)
    cells, whole = _cells(local * level), _median((local * level).reshape(-1, _CHANNELS))[None, None]
    chance = np.mean([_strength(_cells(_local_waves(light, other, times) * level)) for other in others])
    differ = _strength(cells - whole) > max(_MIN_APART * _strength(whole), _MIN_APART_CHANCE * float(chance))
    waves = cells if differ else whole
    phase = float(np.angle(waves.sum()))
    waves = waves * np.exp(-1j * phase)
    sine, cosine = (np.rint(part / LAMP_STEP).clip(-LARGEST, LARGEST).astype(int) for part in (waves.real, waves.imag))
    wave = LampWave(
        hertz, readout, waves.shape[1], waves.shape[0], tuple(sine.ravel().tolist()), tuple(cosine.ravel().tolist())
    )
    return Lamps(found.share, found.ratio, float(np.abs(waves).mean()), wave, found.seen, phase / (2 * np.pi))


def _cells(waves: C128) -> C128:
    """Of complex amplitudes (H, columns, 3), the medians in cells of rows."""
    return np.stack([_median(part) for part in np.array_split(waves, _ROWS)])


def _strength(waves: C128) -> float:
    return float(np.sqrt((np.abs(waves) ** 2).mean()))


def _median(waves: C128) -> C128:
    """Over the first axis, of sines and cosines: what moves there belongs to none of the lamps."""
    return np.asarray(np.median(waves.real, axis=0) + 1j * np.median(waves.imag, axis=0))


def _frequency(wave: LampWave, rest: F64, times: F64) -> float:
    """The pulses in a second, near those of the mains' own frequency."""
    if np.ptp(times) < _MIN_SECONDS:
        return wave.hertz
    near = wave.hertz + np.asarray(_DRIFTS, np.float64)
    shares = [_best_of(rest, each, times, np.array([wave.turns / each])).share for each in near.tolist()]
    return round(float(near[int(np.argmax(shares))]), 3)


def _local_light(pictures: U8) -> F64:
    """Logits (F, H, columns, 3) of the medians over columns of pixels, row by row."""
    widths = np.array_split(np.arange(pictures.shape[2]), _COLUMNS)
    medians = np.stack([np.median(pictures[:, :, part], axis=2) for part in widths], axis=2) / 255
    return np.asarray(logit(np.clip(medians, _DARK, _BRIGHT)), np.float64)


def _local_waves(light: F64, hertz: float, times: F64) -> C128:
    """Complex amplitudes (H, columns, 3) of a wave sin(2 pi hertz t) in ``light`` (F, H, columns, 3)."""
    turn, slow = 2 * np.pi * hertz * times, np.linspace(-1, 1, len(times))
    basis = np.stack([np.sin(turn), np.cos(turn), np.ones_like(turn), slow], axis=1)
    sine, cosine = np.einsum("bf,fhwc->bhwc", np.linalg.pinv(basis)[:2], light)
    return np.asarray(sine + 1j * cosine)
