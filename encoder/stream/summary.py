"""What an encode says at its end: what it wrote, and of what it warns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from decogs.formats.cli.command_line import counted
from decogs.formats.frames.ranges import frames_text

from ..output.reports import EncodeReport


def summary(report: EncodeReport) -> list[str]:
    """The lines that say what an encode wrote, how good it is and what a later frame took."""
    frames = report.frames
    if not frames:
        return [f"{report.output}: all {report.resumed} frames were already encoded, {report.total_bytes} bytes"]
    what = counted(len(frames), "frame") if report.part is None else f"part with {frames_text(report.part)}"
    lines = [f"{report.output}: {what}, {report.total_bytes} bytes"]
    if report.resumed is not None:
        lines[0] += f"; {report.resumed or 'none'} of them were already encoded"
    if report.interrupted:
        lines[0] += f"; interrupted by Ctrl-C after frame {frames[-1].frame}: the stream is complete up to it"
    lines += _held_out(report)
    later = [frame for frame in frames[1:] if not frame.replayed]
    if later:
        seconds = [sum(s for name, s in f.seconds.items() if name != "measure") for f in later]
        cpu_seconds, selected = [f.cpu_seconds for f in later], [f.selected for f in later]
        lines.append(
            f"after the first frame  {_mean([f.bytes for f in later]):.0f} bytes, {_mean(seconds):.2f} s, "
            f"{_mean(cpu_seconds):.2f} CPU-s, {_mean(selected):.1%} selected (means)"
        )
    return lines


def warnings_of(report: EncodeReport) -> Iterator[str]:
    """A line for everything in a whole encode that its user should know."""
    every = [_rejected(report), *_uncorrected(report), _full_frame_changes(report), _cut(report)]
    yield from filter(None, [*every, _missed_budget(report), _missed_time(report)])


def _held_out(report: EncodeReport) -> list[str]:
    """The held-out cameras' PSNR; with a scale, that of the scaled pictures and that of what is decoded."""
    lines = []
    for index, (name, what) in enumerate((("held_out_psnr", "scaled"), ("held_out_own_size_psnr", "own size"))):
        sizes = dict.fromkeys(each[index] for each in report.held_out_sizes.values())
        values = [value for frame in report.frames if (value := getattr(frame, name)) is not None]
        at = "" if report.frames[0].scale == 1 else f" at {', '.join(f'{w}x{h}' for w, h in sizes)} ({what})"
        if values:
            lines.append(
                f"held-out PSNR  first {values[0]:.2f}  mean {_mean(values):.2f}  last {values[-1]:.2f} dB{at}"
            )
    return lines


def _rejected(report: EncodeReport) -> str:
    at = [frame.frame for frame in report.frames if frame.rejected]
    return (
        f"training diverged in {frames_text(at)}, so the previous scene was kept; lower the learning rates"
        if at
        else ""
    )


def _uncorrected(report: EncodeReport) -> list[str]:
    return [
        f"camera {fault} keep the first frame's compensation from frame {frame.frame + 1} on; a new one gained nothing"
        for frame in report.frames
        for fault in frame.uncorrected
    ]


def _full_frame_changes(report: EncodeReport) -> str:
    at = [frame.frame for frame in report.frames if frame.full_frame_change]
    return (
        f"the masks missed a change of most of the pictures; every Gaussian was trained in {frames_text(at)}"
        if at
        else ""
    )


def _cut(report: EncodeReport) -> str:
    at = [frame.frame for frame in report.frames if frame.cut]
    return f"{frames_text(at)}: another scene than the one before, with a new keyframe" if at else ""


def _missed_budget(report: EncodeReport) -> str:
    """The warning of a stream that exceeds its byte budget; empty when it does not."""
    from ..coding.rate_control import BYTES_TOLERANCE, over_budget

    sizes, budget = [frame.bytes for frame in report.frames[1:]], report.frame_budget
    if budget is None or (over := over_budget(sizes, budget)) <= BYTES_TOLERANCE:
        return ""
    return (
        f"frames after the first take {_mean(sizes):.0f} bytes (mean), {over:.0%} more than the budget of "
        f"{budget:.0f}; raise the budget, or lower --quality, --scale or --preset"
    )


def _missed_time(report: EncodeReport) -> str:
    """The warning of frames that exceed their time budget; empty when they do not."""
    from ..coding.time_control import TIME_TOLERANCE, counted_seconds, over_time

    frames, budget = [frame.seconds for frame in report.frames[1:] if not frame.replayed], report.time_budget
    if budget is None or (over := over_time(frames, budget)) <= TIME_TOLERANCE:
        return ""
    spent, trained = _mean([counted_seconds(f) for f in frames]), _mean([f.get("training", 0.0) for f in frames])
    return (
        f"frames after the first take {spent:.3g} s (mean), {over:.0%} more than the budget of {budget:.3g}; "
        f"masks, selection and coding take a fixed {spent - trained:.3g} s of it; raise the budget, or lower --scale "
        "or --preset"
    )


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)
