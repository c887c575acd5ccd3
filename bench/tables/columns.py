"""Figures of runs as Markdown tables: which columns there are, what each one means, and how it is written."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from statistics import fmean

from ..estimates import NOTHING, Estimate, estimate, mean, written
from ..measures.metrics import slope
from ..measures.quality import METRICS
from ..measures.shot import Metric
from ..runs.run import Run, RunFrame

NOT_RUN = "not run"

Figure = float | Estimate | None


@dataclass(frozen=True)
class Column:
    """A column's heading, what it means, its figure for one run of a table of runs, and how that is written.

    ``form``: a format specification. ``nothing``: what stands where there is no figure.
    """

    heading: str
    meaning: str
    figure: Callable[[Run, Sequence[Run]], Figure]
    form: str
    nothing: str = NOTHING

    def over(self, runs: Iterable[Run], table: Sequence[Run]) -> Estimate | None:
        """The figure of a row's ``runs``, one for each seed: its mean and error over them; a single run's as it is.

        ``table``: the runs of all rows, for figures relative to others.
        """
        figures = [self.figure(run, table) for run in runs]
        if len(figures) == 1 and isinstance(figures[0], Estimate):
            return figures[0]
        return estimate(figure.mean if isinstance(figure, Estimate) else figure for figure in figures)

    def value(self, runs: Iterable[Run], table: Sequence[Run]) -> str:
        """The text of a row's cell."""
        return written(self.over(runs, table), self.form, self.nothing)


def mean_of(run: Run, name: str) -> float | None:
    """Mean over all frames, the keyframe included, of a field of RunFrame."""
    return mean(getattr(frame, name) for frame in run.frames)


def wall_seconds(run: Run) -> float | None:
    """Mean wall-clock seconds of a later frame, all stages but measuring."""
    return mean(math.fsum(frame.seconds.values()) for frame in later(run))


def cpu_seconds(run: Run) -> float | None:
    """Mean processor seconds of a later frame, all cores added."""
    return mean(frame.cpu_seconds for frame in later(run))


def decode_fps(run: Run) -> float | None:
    """Frames that one core takes from packet to picture in a second, of the held-out view."""
    return None if run.decode_cpu_seconds is None else 1 / run.decode_cpu_seconds


def later(run: Run) -> list[RunFrame]:
    """All frames but the keyframe."""
    return run.frames[1:]


def drift(run: Run, name: str) -> Estimate | None:
    """Slope of a PSNR over the frames and its error, dB per 100 frames of the rig."""
    values = [(frame.frame, getattr(frame, name)) for frame in run.frames if getattr(frame, name) is not None]
    line = slope([frame for frame, _ in values], [value for _, value in values])
    return None if line is None else Estimate(line.per_100_frames, line.error)


def in_common(run: Run, runs: Sequence[Run]) -> float | None:
    """Mean PSNR over the frames that every run of the table has."""
    shared = set.intersection(*({frame.frame for frame in other.frames} for other in runs))
    return mean(frame.psnr for frame in run.frames if frame.frame in shared)


def psnr_of_views(run: Run) -> list[list[float]]:
    """PSNR over the whole picture in dB, frame by frame of every held-out camera; empty in files from before it."""
    if "," not in run.camera:
        return [[frame.psnr] for frame in run.frames if frame.psnr is not None]
    return [frame.psnr_of_views for frame in run.frames if frame.psnr_of_views is not None]


def psnr_of_cameras(run: Run) -> list[float]:
    """The means of that over all frames, camera by camera."""
    return [fmean(camera) for camera in zip(*psnr_of_views(run), strict=True)]


def worst_pictures(run: Run, share: float) -> float | None:
    """The mean of the lowest ``share`` of all frames of all cameras, at least one of them, dB."""
    lowest = sorted(psnr for views in psnr_of_views(run) for psnr in views)
    return fmean(lowest[: math.ceil(share * len(lowest)) or 1]) if lowest else None


def static_change(run: Run) -> float | None:
    """PSNR over the static region in the last frame less that in the first, dB."""
    first, last = run.frames[0].psnr_static, run.frames[-1].psnr_static
    return None if first is None or last is None else last - first


def number(specification: str, nothing: str = NOTHING) -> Callable[[float | None], str]:
    """Writes a figure as a format specification says."""
    return lambda value: nothing if value is None else format(value, specification)


def _column(name: str, metric: Metric) -> Column:
    """The mean of a metric over all frames."""

    def figure(run: Run, _: Sequence[Run]) -> float | None:
        value = mean_of(run, name)
        return None if value is None else metric.units * value

    meaning = f"{metric.meaning}; mean over all frames"
    return Column(metric.heading, meaning, figure, f".{metric.digits}f", metric.nothing)


COLUMNS: dict[str, Column] = {
    **{metric.column or name: _column(name, metric) for name, metric in METRICS.items()},
    "last_dynamic": Column(
        "dynamic, last frame",
        "PSNR in dB over the dynamic region of the last frame",
        lambda run, _: run.frames[-1].psnr_dynamic,
        ".2f",
    ),
    "first": Column("PSNR, first frame", "dB over the whole picture", lambda run, _: run.frames[0].psnr, ".2f"),
    "last": Column("PSNR, last frame", "dB over the whole picture", lambda run, _: run.frames[-1].psnr, ".2f"),
    "psnr_worst_camera": Column(
        "worst camera",
        "PSNR in dB over the whole picture, mean over all frames, of the held-out camera where that is lowest",
        lambda run, _: min(psnr_of_cameras(run), default=None),
        ".2f",
    ),
    "psnr_worst_frame": Column(
        "worst frame",
        "the lowest PSNR in dB over the whole picture of any frame of any held-out camera",
        lambda run, _: worst_pictures(run, 0),
        ".2f",
    ),
    "psnr_worst_5": Column(
        "worst 5 %",
        "the same, mean of the worst 5 % of all frames of all held-out cameras, at least one",
        lambda run, _: worst_pictures(run, 0.05),
        ".2f",
    ),
    "last_static": Column(
        "static, last frame",
        "PSNR in dB over the static region of the last frame",
        lambda run, _: run.frames[-1].psnr_static,
        ".2f",
    ),
    "static_change": Column(
        "static, last − first",
        "PSNR of the last frame less that of the keyframe, dB over the static region",
        lambda run, _: static_change(run),
        "+.3f",
    ),
    "psnr_common": Column(
        "PSNR, frames of all rows",
        "dB over the whole picture, mean over the frames that every row of the table has",
        in_common,
        ".2f",
    ),
    "training": Column(
        "training PSNR",
        "dB over the training views, undistorted; mean over all frames",
        lambda run, _: mean_of(run, "training_psnr"),
        ".2f",
    ),
    "seconds": Column(
        "s/frame",
        "wall clock, decoded pictures to written packet, mean of the later frames",
        lambda run, _: wall_seconds(run),
        ".2f",
    ),
    "cpu": Column(
        "CPU-s/frame",
        "the same in processor seconds, all cores added",
        lambda run, _: cpu_seconds(run),
        ".2f",
    ),
    "fps": Column(
        "render FPS",
        "1 / the median time to render the held-out view of a decoded frame",
        lambda run, _: 1 / run.render_seconds,
        ".1f",
    ),
    "decode_fps": Column(
        "decode FPS, one core",
        "1 / the median processor seconds to read a frame's packet, reconstruct its Gaussians and render the held-out "
        "view, all cores added, so that other work on the machine does not show",
        lambda run, _: decode_fps(run),
        ".1f",
    ),
    "megabytes": Column(
        "MB/frame",
        "packet on disk, mean of the later frames",
        lambda run, _: mean(frame.bytes / 1e6 for frame in later(run)),
        ".4f",
    ),
    "megabytes_all": Column(
        "MB/frame, keyframe included",
        "the file over all its frames",
        lambda run, _: run.stream_bytes / len(run.frames) / 1e6,
        ".4f",
    ),
    "selected": Column(
        "selected",
        "share of Gaussians trained, mean of the later frames",
        lambda run, _: mean(frame.selected for frame in later(run)),
        ".1%",
    ),
    "slope": Column(
        "slope",
        "PSNR in dB per 100 frames, least squares over all frames, ± its standard error; of several seeds, theirs",
        lambda run, _: drift(run, "psnr"),
        "+.2f",
    ),
    "slope_dynamic": Column(
        "slope dynamic",
        "the same of the dynamic region's PSNR",
        lambda run, _: drift(run, "psnr_dynamic"),
        "+.2f",
    ),
    "gaussians": Column("Gaussians", "in the last frame", lambda run, _: run.frames[-1].gaussians, ".0f"),
    "keyframe_seconds": Column(
        "keyframe, s",
        "wall clock, decoded pictures to written keyframe",
        lambda run, _: math.fsum(run.frames[0].seconds.values()),
        ".1f",
    ),
    "keyframe_bytes": Column("keyframe, MB", "packet on disk", lambda run, _: run.frames[0].bytes / 1e6, ".4f"),
}


def figures(runs: Sequence[Run]) -> dict[str, float | None]:
    """The figures of a row's runs as numbers, for JSON: keys and units as in COLUMNS, an error beside its figure."""
    by_key: dict[str, float | None] = {}
    for key, column in COLUMNS.items():
        if key == "psnr_common":  # a table's figure, not a row's
            continue
        figure = column.over(runs, runs)
        by_key[key] = None if figure is None else figure.mean
        if figure is not None and figure.error is not None:
            by_key[f"{key}_error"] = figure.error
    return by_key


def markdown(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """A table's lines; the first column to the left, figures to the right."""
    lines = ["| " + " | ".join(headings) + " |", "|---" + "|--:" * (len(headings) - 1) + "|"]
    return lines + ["| " + " | ".join(text.replace("|", "\\|") for text in row) + " |" for row in rows]
