"""The protocol of an effect, with its evidence and its decision as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ..settings.encode import EncodeSettings
from .rig_statistics import RigStatistics

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
        known = self.values[np.isfinite(self.values)]
        return float(known.max()) if known.size else float("nan")

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
    """One effect a scene may call for; every effect is one module."""

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
        """Settings of an encode that has the effect, for the cameras of the decision; the same unless overridden."""
        return settings

    def disabled(self, settings: EncodeSettings) -> EncodeSettings:
        """Settings of an encode, or of a frame, that does nothing for the effect."""
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


def spans(stats: RigStatistics, counts: BoolArray, *, gap: int = 0) -> tuple[Span, ...]:
    """Inclusive spans of rig frames for the analysed frames that count, with pauses of up to ``gap`` frames closed.

    In a thinned clip, a change may have begun right after the previous analysed frame.
    """
    found: list[Span] = []
    last = -1
    for index in np.flatnonzero(counts).tolist():
        start = stats.frames[index - 1] + 1 if index else stats.frames[0]
        if found and index - last <= gap + 1:
            found[-1] = (found[-1][0], stats.frames[index])
        else:
            found.append((start, stats.frames[index]))
        last = index
    return tuple(found)


def one_span(stats: RigStatistics, counts: BoolArray) -> tuple[Span, ...]:
    """The span from the first to the last frame that counts, for drifts that pass through zero."""
    return spans(stats, counts, gap=len(stats.frames))


def seen_together(evidence: Evidence, cameras: int = 2) -> BoolArray:
    """Frames (F,) in which the evidence reaches its limit in at least that many cameras, or in all if there are fewer.

    A change of the scene is visible in more than one view; evidence in a single view may be chance.
    """
    return np.asarray(evidence.reached.sum(axis=0) >= min(cameras, len(evidence.values)))


def in_doubt(stats: RigStatistics, evidence: Evidence) -> bool:
    """Whether all cameras are undetermined although there are frames to compare: every camera shakes."""
    return len(stats.frames) > 1 and not np.isfinite(evidence.peak)


def stated(evidence: Evidence, known: str, unknown: str) -> str:
    """A decision's reason: ``known``, or why the evidence is undetermined."""
    return known if np.isfinite(evidence.peak) else f"undetermined: {unknown}"


def decided(
    stats: RigStatistics,
    effect: Effect,
    evidence: Evidence,
    *,
    counts: BoolArray,
    frames: tuple[Span, ...] | None = None,
    reason: str,
    cost: str,
    sure: float | None = None,
    figures: Mapping[str, Any] | None = None,
) -> Decision:
    """The decision for an effect that is detected if any camera ``counts`` (cameras,).

    Other decisions have no cameras, frames and cost. ``frames``: all if not given. ``sure``: the confidence, if not
    that of the evidence.
    """
    detected = bool(counts.any())
    if frames is None:
        frames = ((stats.frames[0], stats.frames[-1]),)
    return Decision(
        effect=effect.name,
        detected=detected,
        confidence=confidence(evidence) if sure is None else sure,
        cameras=tuple(name for name, count in zip(stats.names, counts, strict=True) if count),
        frames=frames if detected else (),
        reason=reason,
        cost=cost if detected else "none",
        figures=figures or {},
    )
