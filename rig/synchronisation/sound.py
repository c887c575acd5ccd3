"""When each camera starts, by what its microphone heard.

What counts is onsets: claps, steps, consonants. Their moments survive a microphone's gain, its colour and the room's
echo, which waveforms do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.geometry.axes import point_nearest_axes
from decogs.formats.sound.tracks import RATE, Sound

from .joint import StartEstimate

F64 = NDArray[np.float64]

SECONDS = 120.0
"""Of sound that are compared."""
SPEED = 343.0
"""Metres a second, in air of 20 degrees."""
_TICKS = 1000
"""Of the onsets' clock, a second."""
_BAND = 300.0, 6000.0
"""Hertz: above the rumble of rooms and hands, and what any microphone hears."""
_RISE = 4
"""Ticks over which sound rises to an onset."""
_PARTNERS = 8
"""Cameras that each one is compared with."""
_MIN_LEAD = 8.0
"""Height of a pair's correlation, in deviations of all its lags: of a minute of noise the highest has 4.5."""
_SAME = 0.01
"""Seconds within which a pair agrees with the others' verdict."""
_UNPLACED = 1.0
"""Metres by which the distances to a source differ from those to what the cameras look at, one standard error."""


def starts_by_sound(cameras: Sequence[Camera], sounds: Sequence[Sound | None], metres: float | None) -> StartEstimate:
    """The starts of cameras in seconds; NaN for those without sound, or whose sound the others did not hear.

    ``metres``: of a world unit, to take off how long sound takes to each camera from what they look at; None if nobody
    knows, when nothing is taken off.
    """
    heard = [row for row, sound in enumerate(sounds) if sound is not None and len(sound.samples) > RATE // 10]
    onsets = {row: onsets_of(sound.samples) for row in heard if (sound := sounds[row]) is not None}
    pairs = [pair for one, two in _partners(heard) if (pair := _pair(one, two, onsets, sounds)) is not None]
    starts, errors, votes = _joint(len(cameras), pairs)
    distances = _distances(cameras)
    late = np.zeros(len(cameras)) if metres is None else distances * metres / SPEED
    unsure = _UNPLACED if metres is not None else 2 * _UNPLACED
    return StartEstimate(starts + late, np.hypot(errors, unsure / SPEED), votes)


def onsets_of(samples: NDArray[np.float32]) -> F64:
    """How steeply the sound rises (N,), on a clock of _TICKS a second, in natural logarithms, without the mean."""
    spectrum = np.fft.rfft(samples)
    hertz = np.fft.rfftfreq(len(samples), 1 / RATE)
    spectrum[(hertz < _BAND[0]) | (hertz > _BAND[1])] = 0
    band = np.fft.irfft(spectrum, len(samples))
    hop = RATE // _TICKS
    energy = (band[: len(band) // hop * hop].reshape(-1, hop) ** 2).sum(axis=1)
    # Between the noise and the loudest, also of a synthetic track that is silent in between.
    floor = max(float(np.median(energy)), 1e-4 * float(energy.max()), 1e-12)
    loud = np.log1p(energy / floor)
    rise = np.zeros(len(loud))
    rise[_RISE:] = np.maximum(loud[_RISE:] - loud[:-_RISE], 0)
    return np.asarray(rise - rise.mean())


@dataclass(frozen=True)
class _Pair:
    """``lag``: seconds by which the second camera starts after the first; ``lead``: how far it stands out."""

    first: int
    second: int
    lag: float
    lead: float


def _partners(rows: Sequence[int]) -> list[tuple[int, int]]:
    count = len(rows)
    pairs = {(k, (k + step) % count) for k in range(count) for step in range(1, min(_PARTNERS, count - 1) + 1)}
    return sorted({(rows[min(pair)], rows[max(pair)]) for pair in pairs})


def _pair(first: int, second: int, onsets: dict[int, F64], sounds: Sequence[Sound | None]) -> _Pair | None:
    """Where two cameras' onsets agree best; None where that is no better than chance, or nothing was heard."""
    first_onsets, second_onsets, delays = (
        onsets[first],
        onsets[second],
        [getattr(sounds[row], "delay", 0.0) for row in (first, second)],
    )
    size = 1 << (len(first_onsets) + len(second_onsets)).bit_length()
    product = np.fft.rfft(first_onsets, size) * np.conj(np.fft.rfft(second_onsets, size))
    correlation = np.fft.irfft(product, size)
    lags = np.concatenate([correlation[-len(second_onsets) + 1 :], correlation[: len(first_onsets)]])
    deviation = float(np.sqrt(np.mean(lags * lags)))
    best = int(np.argmax(lags))
    if deviation <= 0 or not 0 < best < len(lags) - 1 or lags[best] < _MIN_LEAD * deviation:
        return None
    before, top, after = lags[best - 1 : best + 2]
    fine = (before - after) / 2 / min(before - 2 * top + after, -1e-12)
    lag = (best - len(second_onsets) + 1 + float(np.clip(fine, -1, 1))) / _TICKS
    return _Pair(first, second, lag + delays[0] - delays[1], float(lags[best]) / deviation)


def _joint(count: int, pairs: Sequence[_Pair]) -> tuple[F64, F64, F64]:
    """Starts in seconds, their standard errors, and the share of the pairs that say so; NaN, NaN and 0 if none does."""
    groups, starts = np.arange(count), np.zeros(count)
    for pair in sorted(pairs, key=lambda pair: -pair.lead):
        if groups[pair.first] != groups[pair.second]:
            moved = groups == groups[pair.second]
            starts[moved] += starts[pair.first] + pair.lag - starts[pair.second]
            groups[moved] = groups[pair.first]
    system = np.zeros((len(pairs), count))
    for row, pair in zip(system, pairs, strict=True):
        row[pair.second], row[pair.first] = 1, -1
    lags, leads = np.array([pair.lag for pair in pairs]), np.array([pair.lead for pair in pairs])
    for _ in range(10 if pairs else 0):
        near = leads / np.maximum(1, np.abs(system @ starts - lags) / (_SAME / 4)) ** 2
        starts = np.linalg.solve(
            system.T @ (near[:, None] * system) + 1e-6 * np.eye(count), system.T @ (near * lags) + 1e-6 * starts
        )
    linked = (groups == np.bincount(groups).argmax()) & (np.bincount(groups).max() > 1)
    apart, own = np.abs(system @ starts - lags), np.abs(system) > 0
    pairs_of = np.maximum(own.sum(axis=0), 1)
    votes = ((apart < _SAME)[:, None] & own).sum(axis=0) / pairs_of
    errors = np.sqrt((own * np.minimum(apart, _SAME)[:, None] ** 2).sum(axis=0) / pairs_of)
    return np.where(linked, starts, np.nan), np.where(linked, errors, np.nan), np.where(linked, votes, 0.0)


def _distances(cameras: Sequence[Camera]) -> F64:
    """Of the cameras (cameras,) from the point that their optical axes pass nearest, world units."""
    centres = np.array([camera_centre(camera) for camera in cameras])
    point, _ = point_nearest_axes(cameras)
    return np.asarray(np.linalg.norm(centres - point, axis=1))
