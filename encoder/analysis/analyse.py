"""Analysis of a rig, effect by effect: statistics, evidence and decisions, as a table and as JSON."""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, is_dataclass
from typing import Any

import numpy as np

from decogs.formats.frames.ranges import Frames
from decogs.formats.rigs import Rig, open_rig
from decogs.formats.system.callbacks import OnProgress
from decogs.formats.system.threads import thread_count
from decogs.rig.check.rig_check import RigCheck, check_rig, in_columns
from decogs.rig.check.rig_statistics import MAX_BYTES, RigStatistics, gather_statistics
from decogs.rig.check.stage_check import RoomCheck, StageCheck, check_backdrop
from decogs.rig.parallel import side_by_side
from decogs.rig.pictures.ingest import frame_span

from ..settings.effects import FRAME_EFFECTS
from . import EFFECTS
from .building import SHOWN
from .effect import Decision, Evidence, Span


@dataclass(frozen=True)
class Finding:
    """One effect's evidence and decision."""

    evidence: Evidence
    decision: Decision


@dataclass(frozen=True)
class Analysis:
    """Result of an analysis: a finding for every effect, in the order of EFFECTS, and what the rig is good for.

    ``stage``: the plain stage or room, None where there is neither. ``seconds``: its duration.
    """

    path: str
    layout: str
    held_out: tuple[str, ...]
    frame_count: int
    stats: RigStatistics
    findings: tuple[Finding, ...]
    check: RigCheck
    stage: StageCheck | RoomCheck | None
    seconds: float

    @property
    def decisions(self) -> tuple[Decision, ...]:
        """The decision on each effect, in the order of EFFECTS."""
        return tuple(finding.decision for finding in self.findings)

    def table(self) -> Iterator[str]:
        """A table for the user: the rig, a row for each effect, a plain stage, the verdict, a row for each camera."""
        stats = self.stats
        thinned = f", 1 in {stats.step} analysed" if stats.step > 1 else ""
        sizes = " and ".join(sorted({f"{camera.width}x{camera.height}" for camera in stats.cameras}))
        yield (
            f"{self.path}: {len(stats.cameras)} cameras, {self.frame_count} frames{thinned}, at {sizes}, "
            f"in {self.seconds:.1f} s"
        )
        rows = [_HEADINGS, *(_row(finding) for finding in self.findings)]
        widths = [max(len(row[column]) for row in rows) for column in range(len(_HEADINGS))]
        for row, finding in zip(rows, (None, *self.findings), strict=True):
            yield "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            if finding is not None and finding.decision.detected:
                yield from in_columns(f"  {_detected(stats, finding.decision)}")
        yield from in_columns(_DECIDED_LATER)
        yield ""
        for line in () if self.stage is None else self.stage.table():
            yield from in_columns(line)
        yield from self.check.table()

    def to_json(self) -> dict[str, Any]:
        """The same with every figure per camera and frame; None where nothing could be determined."""
        stats = self.stats
        return {
            "rig": self.path,
            "layout": self.layout,
            "cameras": list(stats.names),
            "held_out": list(self.held_out),
            "frames": list(stats.frames),
            "step": stats.step,
            "sizes": {camera.name: [camera.width, camera.height] for camera in stats.cameras},
            "seconds": round(self.seconds, 3),
            "effects": [_finding_json(stats, finding) for finding in self.findings],
            "expected": self.check.expected,
            "expected_psnr": _plain(self.check.psnr),
            "advice": self.check.advice(),
            "stage": _plain(asdict(self.stage)) if isinstance(self.stage, StageCheck) else None,
            "room": _plain(asdict(self.stage)) if isinstance(self.stage, RoomCheck) else None,
            "checks": {each.camera: _plain(each.to_json()) for each in self.check.cameras},
        }


def analyse(
    rig: str | os.PathLike[str] | Rig,
    *,
    frames: Frames = None,
    holdout: Sequence[str] = (),
    threads: int = 0,
    on_step: OnProgress = lambda done, total: None,
    max_bytes: int = MAX_BYTES,
    shown: bool = False,
) -> Analysis:
    """Analyses a rig before anything is trained, and decides which effects are detected.

    ``rig``: its folder or calibration file, or the rig itself. ``frames``: consecutive ones, as a slice or a range; all
    when None. ``holdout``: names of cameras to leave out.
    ``threads``: 0 means all processors; results do not depend on it. ``max_bytes``: of the pictures that are kept; of a
    longer clip every n-th frame is analysed. ``shown``: also what no encode asks here, which takes a search for first
    points. Raises RigError or UsageError.
    """
    began = time.perf_counter()
    if not isinstance(rig, Rig):
        rig = open_rig(rig)
    span = frame_span(rig, frames)
    stats = gather_statistics(
        rig, holdout=holdout, frames=span, threads=thread_count(threads), on_step=on_step, max_bytes=max_bytes
    )
    findings = []
    for effect in (*EFFECTS, *(SHOWN if shown else ())):
        evidence = effect.evidence(stats)
        findings.append(Finding(evidence, effect.decide(stats, evidence)))
    with side_by_side(thread_count(threads)) as each:
        check = check_rig(stats, each)
    stage = None
    if stats.backdrop is not None:
        stage = check_backdrop(stats.backdrop, stats.cameras, [own[0] for own in stats.pictures])
    seconds = time.perf_counter() - began
    return Analysis(str(rig.path), rig.layout, tuple(holdout), len(span), stats, tuple(findings), check, stage, seconds)


_HEADINGS = ("effect", "detected", "confidence", "evidence", "threshold")
_DECIDED_LATER = f"decided by every frame of an encode: {', '.join(FRAME_EFFECTS)}; by its keyframe: view_dependence"


def _row(finding: Finding) -> tuple[str, ...]:
    evidence, decision = finding.evidence, finding.decision
    is_determined = math.isfinite(evidence.peak)
    return (
        decision.effect,
        "yes" if decision.detected else "no",
        f"{decision.confidence:.0%}",
        f"{evidence.peak:.3g} {evidence.unit}" if is_determined else "undetermined",
        f"{evidence.limit:g}",
    )


def _detected(stats: RigStatistics, decision: Decision) -> str:
    """Where an effect is, and what it costs."""
    return f"{_cameras(stats, decision.cameras)}; frames {_frames(decision.frames)}; {decision.cost}"


def _cameras(stats: RigStatistics, names: Sequence[str]) -> str:
    if not names:
        return "-"
    if len(names) == len(stats.names):
        return f"all {len(names)}"
    return " ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")


def _frames(spans: Sequence[Span]) -> str:
    return " ".join(f"{first}-{last}" if last > first else f"{first}" for first, last in spans) or "-"


def _finding_json(stats: RigStatistics, finding: Finding) -> dict[str, Any]:
    evidence, decision = finding.evidence, finding.decision
    return {
        "effect": decision.effect,
        "detected": decision.detected,
        "confidence": round(decision.confidence, 3),
        "evidence": _number(evidence.peak),
        "unit": evidence.unit,
        "counts_from": evidence.limit,
        "cameras": list(decision.cameras),
        "frames": [list(span) for span in decision.frames],
        "reason": decision.reason,
        "cost": decision.cost,
        "figures": _plain(decision.figures),
        "values": _by_camera(stats, evidence.values),
        "details": {name: _by_camera(stats, values) for name, values in evidence.details.items()},
    }


def _by_camera(stats: RigStatistics, values: np.ndarray[Any, np.dtype[np.float64]]) -> dict[str, list[float | None]]:
    return {name: [_number(v) for v in row.tolist()] for name, row in zip(stats.names, values, strict=True)}


def _plain(value: Any) -> Any:
    if is_dataclass(value) and not isinstance(value, type):
        value = asdict(value)
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(each) for each in value]
    return _number(value) if isinstance(value, float) else value


def _number(value: float) -> float | None:
    """JSON knows no NaN; six digits are more than any of these figures has."""
    return float(f"{value:.6g}") if math.isfinite(value) else None
