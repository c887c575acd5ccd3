"""The protocol of an effect, with its evidence and its decision as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from decogs.rig.check.rig_statistics import RigStatistics

from ..settings.encode import EncodeSettings

F64 = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
Span = tuple[int, int]


@dataclass(frozen=True)
class Evidence:
    """Strength of an effect per camera and analysed frame.

    ``values`` (cameras, frames) float64 in ``unit``, in the order of the statistics' cameras and frames; NaN:
    undetermined. A value counts from ``limit`` on. ``details``: further arrays of the same shape, by name, for the
    decision and the JSON.
    """

    values: F64
    unit: str
    limit: float
    details: Mapping[str, F64] = field(default_factory=dict)

    @property
    def peak(self) -> float:
        """The largest value; NaN when nothing could be determined."""
        finite = self.values[np.isfinite(self.values)]
        return float(finite.max()) if finite.size else float("nan")

    @property
    def reached(self) -> BoolArray:
        """Whether the values reach the limit, (cameras, frames)."""
        return np.asarray(np.nan_to_num(self.values, nan=-np.inf) >= self.limit)

    @property
    def camera_peaks(self) -> F64:
        """Each camera's largest value (cameras,); NaN for an undetermined camera."""
        with_floor = np.where(np.isfinite(self.values), self.values, -np.inf).max(axis=1)
        return np.asarray(np.where(np.isfinite(with_floor), with_floor, np.nan))


@dataclass(frozen=True)
class Decision:
    """Decision on an effect, with its confidence, cameras, frames, reason and cost.

    ``confidence``: 0.5 for evidence at its limit, 0.9 at three times or a third of it; 0 if undetermined. ``cameras``:
    names. ``frames``: inclusive spans in the rig's own numbers, from the first frame whose picture differs. ``reason``
    and ``cost`` are one line each. ``figures``: parameters for the encoder.
    """

    effect: str
    detected: bool
    confidence: float
    cameras: tuple[str, ...]
    frames: tuple[Span, ...]
    reason: str
    cost: str
    figures: Mapping[str, Any] = field(default_factory=dict)


class Effect(Protocol):
    """One effect that the analysis of a rig decides about."""

    @property
    def name(self) -> str:
        """One of EFFECT_NAMES."""
        ...

    def evidence(self, stats: RigStatistics) -> Evidence:
        """Strength of the effect in the pictures."""
        ...

    def decide(self, stats: RigStatistics, evidence: Evidence) -> Decision:
        """Decision from the evidence."""
        ...

    def enabled(self, settings: EncodeSettings, decision: Decision) -> EncodeSettings:
        """Settings of an encode that has the effect, for the cameras of the decision."""
        ...

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        """Settings of an encode that does nothing for the effect."""
        ...


def confidence(evidence: Evidence) -> float:
    """Confidence by the ratio of peak and limit: 1/2 at 1, 9/10 at 3 and 1/3; 0 if undetermined."""
    peak = evidence.peak
    if not np.isfinite(peak):
        return 0.0
    square = min((max(peak, 0.0) / evidence.limit) ** 2, 1e6)
    return max(square, 1.0) / (1.0 + square)


def cameras_beyond(evidence: Evidence) -> BoolArray:
    """Cameras (C,) whose evidence reaches the limit in any frame."""
    return np.asarray(evidence.reached.any(axis=1))


def one_span(stats: RigStatistics, counts: BoolArray) -> tuple[Span, ...]:
    """The inclusive span of rig frames from the first to the last analysed frame that counts (F,): drifts pass zero.

    In a thinned clip, a change may have begun right after the previous analysed frame.
    """
    rows = np.flatnonzero(counts).tolist()
    if not rows:
        return ()
    first = stats.frames[rows[0] - 1] + 1 if rows[0] else stats.frames[0]
    return ((first, stats.frames[rows[-1]]),)


def reason_of(evidence: Evidence, reason: str, unknown: str) -> str:
    """A decision's reason: the given ``reason``, or why the evidence is undetermined."""
    return reason if np.isfinite(evidence.peak) else f"undetermined: {unknown}"


def make_decision(
    stats: RigStatistics,
    effect: Effect,
    evidence: Evidence,
    *,
    counts: BoolArray,
    frames: tuple[Span, ...] | None = None,
    reason: str,
    cost: str,
    figures: Mapping[str, Any] | None = None,
) -> Decision:
    """The decision for an effect that is detected if any camera ``counts`` (cameras,).

    Other decisions have no cameras, frames and cost. ``frames``: all if not given.
    """
    detected = bool(counts.any())
    if frames is None:
        frames = ((stats.frames[0], stats.frames[-1]),)
    return Decision(
        effect=effect.name,
        detected=detected,
        confidence=confidence(evidence),
        cameras=tuple(name for name, count in zip(stats.names, counts, strict=True) if count),
        frames=frames if detected else (),
        reason=reason,
        cost=cost if detected else "none",
        figures=figures or {},
    )
