"""How well two cameras' signals agree at every lag between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_MIN_OVERLAP, _MIN_OVERLAP_SHARE = 5, 1 / 3
"""Least common span, in changes from a frame to the next, and as a share of the shorter recording's."""
_MAX_CORRELATION = 0.995
"""Beyond which agreement says no more: cameras differ by noise."""


@dataclass(frozen=True)
class Agreement:
    """Of two cameras, at the lags -D to D (2 D + 1,): frames by which the second one starts after the first.

    ``evidence``: log likelihood against signals that have nothing in common, 0 where the common span is too short.
    ``correlation``: the sum over channels; NaN there.
    """

    first: int
    second: int
    evidence: F64
    correlation: F64


def agreement(first: int, second: int, first_signal: F32, second_signal: F32, reach: int) -> Agreement:
    """Of signals (channels, F, planes), each without its mean in every plane and channel over the common span."""
    lags = range(-reach, reach + 1)
    evidence, correlation = np.zeros(len(lags)), np.full(len(lags), np.nan)
    shorter = min(first_signal.shape[1], second_signal.shape[1])
    least = max(_MIN_OVERLAP, round(_MIN_OVERLAP_SHARE * shorter))
    for column, lag in enumerate(lags):
        begin, end = max(0, lag), min(first_signal.shape[1], second_signal.shape[1] + lag)
        if end - begin < least:
            continue
        correlations = _correlations(first_signal[:, begin:end], second_signal[:, begin - lag : end - lag])
        correlation[column] = correlations.sum()
        evidence[column] = -(end - begin - 1) * np.log(1 - np.clip(correlations, 0, _MAX_CORRELATION) ** 2).sum()
    return Agreement(first, second, evidence, correlation)


def _correlations(one: F32, two: F32) -> F64:
    """Of each channel (channels,); 0 for one in which nothing happens."""
    one, two = one - one.mean(axis=1, keepdims=True), two - two.mean(axis=1, keepdims=True)
    both = np.sqrt((one * one).sum(axis=(1, 2)) * (two * two).sum(axis=(1, 2)))
    return np.asarray((one * two).sum(axis=(1, 2)) / np.maximum(both, 1e-9), np.float64)
