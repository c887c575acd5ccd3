"""Figures of runs as Markdown tables: which columns there are, what each one means, and how it is written."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

from .metrics import Slope, slope
from .perceptual import NOT_INSTALLED
from .runs import Run, RunFrame

NOTHING = "–"
NOT_RUN = "not run"

_MEANS = (
    "psnr", "psnr_dynamic", "psnr_static", "ssim", "ssim_dynamic", "ssim_static", "lpips", "training_psnr",
)  # fmt: skip


@dataclass(frozen=True)
class Column:
    """A column's heading, what it means, and its value for one run of a table of runs."""

    heading: str
    meaning: str
    value: Callable[[Run, Sequence[Run]], str]


def mean(values: Iterable[float | None]) -> float | None:
    """Mean of the values there are; None when there are none."""
    known = [value for value in values if value is not None]
    return math.fsum(known) / len(known) if known else None


def mean_of(run: Run, name: str) -> float | None:
    """Mean over all frames, the keyframe included, of a field of RunFrame."""
    return mean(getattr(frame, name) for frame in run.frames)


def flicker(run: Run) -> float | None:
    """mTV x100: mean change of static pixels from frame to frame, in 0..1, times 100."""
    variation = mean_of(run, "variation")
    return None if variation is None else 100 * variation


def wall_seconds(run: Run) -> float | None:
    """Mean wall-clock seconds of a later frame, all stages but measuring."""
    return mean(math.fsum(frame.seconds.values()) for frame in later(run))


def cpu_seconds(run: Run) -> float | None:
    """Mean processor seconds of a later frame, all cores added."""
    return mean(frame.cpu_seconds for frame in later(run))


def later(run: Run) -> list[RunFrame]:
    """All frames but the keyframe."""
    return run.frames[1:]


def drift(run: Run, name: str) -> Slope | None:
    """Slope of a PSNR over the frames, dB per 100 frames of the rig."""
    known = [(frame.frame, getattr(frame, name)) for frame in run.frames if getattr(frame, name) is not None]
    return slope([frame for frame, _ in known], [value for _, value in known])


def in_common(run: Run, runs: Sequence[Run]) -> float | None:
    """Mean PSNR over the frames that every run of the table has."""
    shared = set.intersection(*({frame.frame for frame in other.frames} for other in runs))
    return mean(frame.psnr for frame in run.frames if frame.frame in shared)


def static_change(run: Run) -> float | None:
    """PSNR over the static region in the last frame less that in the first, dB."""
    first, last = run.frames[0].psnr_static, run.frames[-1].psnr_static
    return None if first is None or last is None else last - first


def number(value: float | None, digits: int, *, signed: bool = False) -> str:
    return NOTHING if value is None else f"{value:{'+' if signed else ''}.{digits}f}"


def with_error(value: Slope | None) -> str:
    return NOTHING if value is None else f"{value.per_100_frames:+.2f} ± {value.error:.2f}"


def _average(heading: str, meaning: str, name: str, digits: int) -> Column:
    return Column(heading, f"{meaning}; mean over all frames", lambda run, _: number(mean_of(run, name), digits))


COLUMNS: dict[str, Column] = {
    "psnr": _average("PSNR", "dB over the whole picture", "psnr", 2),
    "psnr_dynamic": _average("dynamic", "PSNR in dB over the dynamic region", "psnr_dynamic", 2),
    "psnr_static": _average("static", "PSNR in dB over the static region", "psnr_static", 2),
    "last_dynamic": Column(
        "dynamic, last frame",
        "PSNR in dB over the dynamic region of the last frame",
        lambda run, _: number(run.frames[-1].psnr_dynamic, 2),
    ),
    "last": Column("PSNR, last frame", "dB over the whole picture", lambda run, _: number(run.frames[-1].psnr, 2)),
    "last_static": Column(
        "static, last frame",
        "PSNR in dB over the static region of the last frame",
        lambda run, _: number(run.frames[-1].psnr_static, 2),
    ),
    "static_change": Column(
        "static, last − first",
        "PSNR of the last frame less that of the keyframe, dB over the static region",
        lambda run, _: number(static_change(run), 3, signed=True),
    ),
    "psnr_common": Column(
        "PSNR, frames of all rows",
        "dB over the whole picture, mean over the frames that every row of the table has",
        lambda run, runs: number(in_common(run, runs), 2),
    ),
    "training": _average("training PSNR", "dB over the training views, undistorted", "training_psnr", 2),
    "ssim": _average("SSIM", "over the whole picture", "ssim", 4),
    "ssim_dynamic": _average("SSIM dynamic", "SSIM map over the dynamic region", "ssim_dynamic", 4),
    "ssim_static": _average("SSIM static", "SSIM map over the static region", "ssim_static", 4),
    "lpips": Column(
        "LPIPS",
        "over the whole picture, mean over all frames",
        lambda run, _: NOT_INSTALLED if run.lpips_network is None else number(mean_of(run, "lpips"), 4),
    ),
    "mtv": Column(
        "mTV ×100",
        "flicker: change of static pixels from frame to frame",
        lambda run, _: number(flicker(run), 4),
    ),
    "seconds": Column(
        "s/frame",
        "wall clock, decoded pictures to written packet, mean of the later frames",
        lambda run, _: number(wall_seconds(run), 2),
    ),
    "cpu": Column(
        "CPU-s/frame",
        "the same in processor seconds, all cores added",
        lambda run, _: number(cpu_seconds(run), 2),
    ),
    "fps": Column(
        "render FPS",
        "1 / the median time to render the held-out view of a decoded frame",
        lambda run, _: number(1 / run.render_seconds, 1),
    ),
    "megabytes": Column(
        "MB/frame",
        "packet on disk, mean of the later frames",
        lambda run, _: number(_mega(mean(frame.bytes for frame in later(run))), 4),
    ),
    "megabytes_all": Column(
        "MB/frame, keyframe included",
        "the file over all its frames",
        lambda run, _: number(_mega(run.stream_bytes / len(run.frames)), 4),
    ),
    "selected": Column(
        "selected",
        "share of Gaussians trained, mean of the later frames",
        lambda run, _: _percent(mean(frame.selected for frame in later(run))),
    ),
    "slope": Column(
        "slope",
        "PSNR in dB per 100 frames, least squares over all frames, ± its standard error",
        lambda run, _: with_error(drift(run, "psnr")),
    ),
    "slope_dynamic": Column(
        "slope dynamic",
        "the same of the dynamic region's PSNR",
        lambda run, _: with_error(drift(run, "psnr_dynamic")),
    ),
    "gaussians": Column(
        "Gaussians",
        "in the last frame",
        lambda run, _: str(run.frames[-1].gaussians),
    ),
    "keyframe_seconds": Column(
        "keyframe, s",
        "wall clock, decoded pictures to written keyframe",
        lambda run, _: number(math.fsum(run.frames[0].seconds.values()), 1),
    ),
    "keyframe_bytes": Column("keyframe, MB", "packet on disk", lambda run, _: number(run.frames[0].bytes / 1e6, 4)),
}


def figures(run: Run) -> dict[str, float | None]:
    """The figures of a run as numbers, for JSON; units as in COLUMNS."""
    slopes = {name: drift(run, field) for name, field in (("slope", "psnr"), ("slope_dynamic", "psnr_dynamic"))}
    return {
        **{name: mean_of(run, name) for name in _MEANS},
        "last": run.frames[-1].psnr,
        "last_dynamic": run.frames[-1].psnr_dynamic,
        "last_static": run.frames[-1].psnr_static,
        "static_change": static_change(run),
        "mtv": flicker(run),
        "seconds": wall_seconds(run),
        "cpu": cpu_seconds(run),
        "fps": 1 / run.render_seconds,
        "megabytes": _mega(mean(frame.bytes for frame in later(run))),
        "megabytes_all": run.stream_bytes / len(run.frames) / 1e6,
        "selected": mean(frame.selected for frame in later(run)),
        **{name: None if value is None else value.per_100_frames for name, value in slopes.items()},
        **{f"{name}_error": None if value is None else value.error for name, value in slopes.items()},
    }


def markdown(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table's lines; the first column to the left, figures to the right."""
    lines = ["| " + " | ".join(headings) + " |", "|---" + "|--:" * (len(headings) - 1) + "|"]
    return lines + ["| " + " | ".join(text.replace("|", "\\|") for text in row) + " |" for row in rows]


def _mega(value: float | None) -> float | None:
    return None if value is None else value / 1e6


def _percent(value: float | None) -> str:
    return NOTHING if value is None else f"{value:.1%}"
