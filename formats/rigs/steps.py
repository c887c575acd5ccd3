"""Frame k of every camera is one instant: checked where nothing is known of the cameras' starts, made so where it is.

A start says when a camera's first picture was taken, on a clock that the rig shares (`timeline`). Whole frames are
passed over when reading, and the span is used that all cameras recorded; what is below a frame stays, and is said.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import RigError
from .gaps import with_gaps
from .rig import Rig, more, usual, with_rates
from .sources import CutSource, FrameSource, PictureSource
from .timeline import CameraClock, RecordedIndex, RigTime

_SAME_RATE = 5e-4
"""Relative; 29.97 and 30 frames per second are 1e-3 apart, and out of step by a frame after 33 seconds."""
_NEAR_RATE = 0.01
"""Relative difference of rates that are read as one, with a warning."""
MAX_START = float(1 << 40)
"""Frames: a day's clock at any rate is below, and fractions of a frame are still exact."""
_SAID_REST = 0.05
"""Frames below which what remains is not worth a line: less than the motion estimate can tell."""


def in_step(rig: Rig, starts: Mapping[str, RigTime]) -> Rig:
    """The rig with the frames that all cameras recorded, of one instant each.

    ``starts``: by camera; cameras that it lacks are taken to start with most others.
    Without any, all recordings must have the same frames. Raises RigError for what differs and cannot be brought in
    step, and where there is no common span.
    """
    rig = replace(rig, sources=with_gaps(rig.sources))
    if not starts:
        rate = rig.fps if rig.fps is not None else _one_rate(rig.sources)
        _check_frame_counts(rig.sources)
        _check_frame_numbers(rig.sources)
        count = rig.sources[0].frame_count
        return replace(rig, fps=rate, frame_count=count, warnings=(*_odd_rates(rig.sources), *rig.warnings))
    steps = steps_of(rig)
    named = {camera.name: starts.get(camera.name) for camera in rig.cameras}
    given = [start for start in named.values() if start is not None]
    if not given:
        raise RigError(f"{rig.path}: the starts name none of its cameras; name {rig.cameras[0].name} and the others")
    ordinary = given[usual([round(start) for start in given])]
    times = [ordinary if start is None else start for start in named.values()]
    span = _common_span(rig, times, steps)
    sources = [_cut(*each, span.count) for each in zip(rig.sources, span.firsts, steps, strict=True)]
    warnings = _warnings_of(
        rig, span, [name for name, start in named.items() if start is None], max(times) - min(times)
    )
    slowest = min((fps for _, fps in with_rates(rig.sources)), default=None)
    clocks = [
        CameraClock(RecordedIndex(first), step, RigTime(rest if abs(rest) > _SAID_REST else 0.0))
        for first, step, rest in zip(span.firsts, steps, span.rests, strict=True)
    ]
    return replace(
        rig,
        sources=tuple(sources),
        recordings=dict(zip(named, rig.sources, strict=True)),
        fps=slowest if rig.fps is None else rig.fps,
        frame_count=span.count,
        warnings=(*_odd_rates(sources), *rig.warnings, *warnings),
        timeline=replace(rig.timeline, clocks=dict(zip(named, clocks, strict=True))),
    )


def steps_of(rig: Rig) -> list[int]:
    """Every how many frames of each camera one is taken, so that all have the rate of the slowest.

    Raises RigError for a rate that is no multiple of it.
    """
    slowest = min(with_rates(rig.sources), key=lambda pair: pair[1], default=None)
    steps = []
    for source in rig.sources:
        ratio = 1.0 if slowest is None or source.fps is None or source.frame_count < 2 else source.fps / slowest[1]
        if slowest is not None and abs(ratio - round(ratio)) > _NEAR_RATE * ratio:
            raise RigError(
                f"{source.path}: {source.fps:.3f} frames per second is no multiple of the {slowest[1]:.3f} of "
                f"{slowest[0].path.name}; bring all videos to one rate"
            )
        steps.append(round(ratio))
    return steps


@dataclass(frozen=True)
class _Span:
    """``count`` frames; of each camera the recording's frame that is the first, and by how many frames it is late."""

    count: int
    firsts: tuple[int, ...]
    rests: tuple[float, ...]


def _common_span(rig: Rig, times: Sequence[float], steps: Sequence[int]) -> _Span:
    """The frames between the last camera's start and the first one's end, on the clock of which least remains."""

    def beginning_at(phase: float) -> tuple[list[int], list[float]]:
        opening = max(math.ceil(time - phase - 0.5 / step - 1e-9) for time, step in zip(times, steps, strict=True))
        firsts = [round((opening + phase - time) * step) for time, step in zip(times, steps, strict=True)]
        ends = zip(times, firsts, steps, strict=True)
        return firsts, [time + first / step - opening - phase for time, first, step in ends]

    phases = sorted({round(time % 1.0, 6) for time in times})
    firsts, rests = min((beginning_at(phase) for phase in phases), key=lambda span: float(np.abs(span[1]).sum()))
    left = [
        math.ceil((source.frame_count - first) / step)
        for source, first, step in zip(rig.sources, firsts, steps, strict=True)
    ]
    if min(left) < 1:
        ended, begun = rig.cameras[int(np.argmin(left))].name, rig.cameras[int(np.argmax(times))].name
        raise RigError(
            f"{rig.path}: camera {ended} ends before camera {begun} starts, so that they share no frame; correct the "
            "starts, or leave one out"
        )
    return _Span(min(left), tuple(firsts), tuple(rests))


def _warnings_of(rig: Rig, span: _Span, unknown: Sequence[str], apart: float) -> Iterator[str]:
    """What a user should know of the span: how long it is, what remains, and whose start nobody knows."""
    if span.count != max(source.frame_count for source in rig.sources) or any(span.firsts):
        yield (
            f"{rig.path}: cameras start up to {apart:.3g} frames apart; the {span.count} frames that all of them "
            "recorded are used"
        )
    late = sorted(zip(span.rests, (camera.name for camera in rig.cameras), strict=True), key=lambda pair: -abs(pair[0]))
    late = [(rest, name) for rest, name in late if abs(rest) > _SAID_REST]
    if late:
        yield (
            f"{rig.path}: camera {late[0][1]}{more(late)} stays out of step by up to {abs(late[0][0]):.2f} of a "
            "frame, which whole frames cannot correct; what moves fast will be blurred"
        )
    if unknown:
        yield (
            f"{rig.path}: no start is known of camera {unknown[0]}{more(unknown)}, taken to start as most others; "
            "leave it out if it does not"
        )


def _cut(source: FrameSource, first: int, step: int, count: int) -> FrameSource:
    """``count`` frames of a source, from ``first`` on, every ``step``-th."""
    if isinstance(source, PictureSource):
        return replace(source, files=source.files[first::step][:count])
    return source if (first, step, count) == (0, 1, source.frame_count) else CutSource(source, first, step, count)


def _check_frame_counts(sources: Sequence[FrameSource]) -> None:
    counts = [source.frame_count for source in sources]
    most = usual(counts)
    for source in sources:
        if source.frame_count != counts[most]:
            raise RigError(
                f"{source.path}: {source.frame_count} frames, but {sources[most].path.name} has {counts[most]}; "
                "cut all cameras to the same frames, or find out when each one starts (decogs-sync)"
            )


def _check_frame_numbers(sources: Sequence[FrameSource]) -> None:
    """Picture folders with as many files, but not of the same frames, would be out of step."""
    numbered = [
        (source, numbers)
        for source in sources
        if isinstance(source, PictureSource) and source.frame_count > 1 and (numbers := source.frame_numbers())
    ]
    if not numbered:
        return
    usual_source, usual_numbers = numbered[usual([tuple(numbers) for _, numbers in numbered])]
    for source, numbers in numbered:
        lacking = sorted(set(usual_numbers) - set(numbers))
        if lacking:
            frame = " ".join(map(str, lacking[0]))
            raise RigError(
                f"{source.path}: no picture of frame {frame}, which {usual_source.path.name} has; "
                "give all cameras the same frames"
            )


def _one_rate(sources: Sequence[FrameSource]) -> float | None:
    timed = with_rates(sources)
    if not timed:
        return None
    usual_source, most = timed[usual([round(fps, 1) for _, fps in timed])]
    for source, fps in timed:
        if abs(fps - most) > _NEAR_RATE * most:
            raise RigError(
                f"{source.path}: {fps:.3f} frames per second, but {usual_source.path.name} has {most:.3f}; "
                "bring all videos to one rate"
            )
    return most


def _odd_rates(sources: Sequence[FrameSource]) -> Iterator[str]:
    timed = with_rates(sources)
    if timed:
        usual_source, most = timed[usual([round(fps, 2) for _, fps in timed])]
        others = [(source, fps) for source, fps in timed if abs(fps - most) > _SAME_RATE * most]
        if others:
            yield (
                f"{others[0][0].path}{more(others)}: {others[0][1]:.3f} frames per second, but "
                f"{usual_source.path.name} has {most:.3f}; frames of one number are taken as one instant"
            )
