"""What each preset will cost and show, from a pilot: factors that were measured on other rigs (DESIGN.md)."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from typing import Any

from decogs.formats.cli.command_line import size_text

from ..output.whole import EIGHT_OF_TEN, Factor, Range, total_of
from .pilot import Pilot


@dataclass(frozen=True)
class Gain:
    """dB more than the pilot's camera that was left out: up to ``most``, and the less the better training views were
    than it, since what geometry does not know no training finds. ``spread``: dB."""

    most: float
    spread: float


@dataclass(frozen=True)
class Step:
    """A preset against the pilot: bytes of its keyframe and of later frames, processor time of the training of both,
    and quality."""

    key_bytes: Factor
    key_cpu: Factor
    frame_bytes: Factor
    frame_cpu: Factor
    gain: Gain


@dataclass(frozen=True)
class Forecast:
    """Of a whole encode: bytes, processor seconds, and dB of a camera that is left out, None where unknown."""

    preset: str
    total_bytes: Range
    cpu_seconds: Range
    psnr: Range | None


STEPS = {
    "live": Step(Factor(1.0, 0.03), Factor(1.0, 0.08), Factor(1.0, 0.10), Factor(1.0, 0.10), Gain(0.0, 0.3)),
    "draft": Step(Factor(1.39, 0.05), Factor(1.67, 0.10), Factor(1.37, 0.23), Factor(1.8, 0.30), Gain(2.4, 0.4)),
    "standard": Step(Factor(1.92, 0.05), Factor(3.85, 0.13), Factor(1.9, 0.20), Factor(3.2, 0.35), Gain(3.9, 0.75)),
    "high": Step(Factor(1.92, 0.05), Factor(3.85, 0.17), Factor(2.1, 0.22), Factor(6.3, 0.40), Gain(3.9, 0.75)),
    "archive": Step(Factor(2.08, 0.05), Factor(3.9, 0.17), Factor(3.24, 0.40), Factor(9.0, 0.50), Gain(3.9, 0.8)),
}
"""Medians of rigs, and the 80th percentile of how far they are from them, as of a normal distribution."""
_GAP_DB = 2.0
"""By which training views are better than the left-out one, where a gain is a third of the most there is."""


def forecasts(pilot: Pilot, frames: int) -> list[Forecast]:
    """Of an encode of so many frames with each preset."""
    return [_forecast(name, step, pilot, frames) for name, step in STEPS.items()]


def _forecast(name: str, step: Step, pilot: Pilot, frames: int) -> Forecast:
    key_cpu = pilot.points_cpu + step.key_cpu.mean * (pilot.key_cpu - pilot.points_cpu)
    frame_cpu = pilot.frame_cpu + (step.frame_cpu.mean - 1) * pilot.training_cpu
    psnr = None
    if pilot.psnr is not None:
        gap = max(0.0, pilot.training_psnr - pilot.psnr)
        expected = pilot.psnr + step.gain.most * math.exp(-gap / _GAP_DB)
        psnr = Range(expected - EIGHT_OF_TEN * step.gain.spread, expected + EIGHT_OF_TEN * step.gain.spread)
    return Forecast(
        name,
        total_of(
            pilot.key_bytes * step.key_bytes.mean,
            step.key_bytes,
            pilot.frame_bytes * step.frame_bytes.mean,
            step.frame_bytes,
            frames,
        ),
        total_of(key_cpu, step.key_cpu, frame_cpu, step.frame_cpu, frames),
        psnr,
    )


def table(pilot: Pilot, frames: int) -> Iterator[str]:
    """The forecasts of all presets for the user."""
    some = f"frames {pilot.frames.start} to {pilot.frames.stop - 1}"
    without = "" if pilot.left_out is None else f" with {pilot.left_out} left out"
    yield f"forecast of {frames} frames, by a short encode of {some}{without}; eight rigs of ten lay within:"
    yield f"{'preset':<10} {'stream':<22} {'CPU-s':<16} dB of a camera that is left out".rstrip()
    for each in forecasts(pilot, frames):
        size = f"{size_text(round(each.total_bytes.low))} to {size_text(round(each.total_bytes.high))}"
        cpu = f"{each.cpu_seconds.low:.0f} to {each.cpu_seconds.high:.0f}"
        psnr = "-" if each.psnr is None else f"{each.psnr.low:.1f} to {each.psnr.high:.1f}"
        yield f"{each.preset:<10} {size:<22} {cpu:<16} {psnr}"


def document(pilot: Pilot, frames: int) -> dict[str, Any]:
    """The same as plain JSON values."""
    return {
        "frames": frames,
        "pilot": [pilot.frames.start, pilot.frames.stop],
        "left_out": pilot.left_out,
        "presets": [asdict(each) for each in forecasts(pilot, frames)],
    }
