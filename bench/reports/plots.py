"""The report's pictures: PSNR and effort over time, quality over cost, and a column of pixels over time.

Needs the extra ``bench``.
"""

from __future__ import annotations

import importlib.util
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.errors import UsageError
from decogs.formats.system.extras import install

from ..runs.rivals import RatePoint
from ..runs.run import Run
from .trade import COSTS, QUALITY, Point, find_front, shown_range

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

COLOURS = ("#0072b2", "#e69f00", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#000000", "#c0b000", "#999999", "#882255")
"""Distinct for colour-blind eyes, too: Okabe and Ito's, their yellow darkened to show as a dot, and two more."""
_MARKERS = "os^Dv*P"
_DEVIATION = 12
"""8-bit levels from a pixel's own mean that are drawn as black or white."""
_CHARACTERS_PER_INCH, _HANDLE_CHARACTERS = 13, 8
"""Of a legend in matplotlib's own size, and what its line and gap take besides a label."""
_TITLE_CHARACTERS = 24
"""Of a line of the title above an error map."""


def require_plots() -> None:
    """Raises UsageError when the plotting library is missing: better now than after hours of training."""
    if importlib.util.find_spec("matplotlib") is None:
        raise UsageError(f"the report's plots need matplotlib: {install('bench')}")


def plot_quality(path: Path, runs: Mapping[str, Run]) -> None:
    """Held-out PSNR of every frame, over the whole picture and over the dynamic region; ``runs`` by label."""
    figure = _figure(10, 4)
    for index, (name, title) in enumerate((("psnr", "whole picture"), ("psnr_dynamic", "dynamic region")), 1):
        axes = _panel(figure, 1, 2, index, title, "held-out PSNR, dB")
        for (label, run), colour in zip(runs.items(), COLOURS, strict=False):
            values = [getattr(frame, name) for frame in run.frames]
            axes.plot(_frames(run), _numbers(values), color=colour, label=label)
    _save(figure, path)


def plot_effort(path: Path, runs: Mapping[str, Run]) -> None:
    """Share of Gaussians selected and processor seconds spent, frame by frame after the keyframe."""
    figure = _figure(10, 4)
    selected = _panel(figure, 1, 2, 1, "Gaussians trained", "% of all")
    effort = _panel(figure, 1, 2, 2, "time per frame", "processor seconds")
    for (label, run), colour in zip(runs.items(), COLOURS, strict=False):
        later = run.frames[1:]
        selected.plot(_frames(run)[1:], [100 * frame.selected for frame in later], color=colour, label=label)
        effort.plot(_frames(run)[1:], [frame.cpu_seconds for frame in later], color=colour, label=label)
    selected.set_ylim(bottom=0)
    effort.set_ylim(bottom=0)
    _save(figure, path)


def plot_rates(path: Path, points: Sequence[RatePoint]) -> None:
    """Held-out PSNR over the bytes of a frame after the first one, a line for each family."""
    figure = _figure(10, 4.4)
    families = dict.fromkeys(point.family for point in points)
    for index, (name, title) in enumerate((("psnr", "whole picture"), ("psnr_dynamic", "dynamic region")), 1):
        axes = figure.add_subplot(1, 2, index)
        axes.set_title(title)
        axes.set_xlabel("kB per frame after the first one")
        axes.set_ylabel("held-out PSNR, dB")
        axes.set_xscale("log")
        axes.grid(alpha=0.3)
        for family, colour in zip(families, cycle(COLOURS)):
            mine = sorted((p for p in points if p.family == family), key=lambda point: point.later_bytes)
            values = [getattr(point, name) for point in mine]
            axes.plot(
                [point.later_bytes / 1e3 for point in mine],
                _numbers(values),
                color=colour,
                label=family,
                marker="o",
                markersize=4,
            )
    _save(figure, path)


def plot_trade(path: Path, points: Sequence[Point], families: Mapping[str, str]) -> None:
    """Quality over what a frame takes to encode, to keep and to decode, each with its Pareto front.

    ``families``: their titles by key. Members of the first one are named; what is far below all of them is left out.
    Bars are standard errors over seeds.
    """
    figure = _figure(15, 5.2)
    lowest, highest = shown_range(points)
    for index, (cost, title) in enumerate(zip(COSTS, ("time to encode", "size", "speed of decoding"), strict=True), 1):
        axes = figure.add_subplot(1, len(COSTS), index)
        axes.set_title(title)
        axes.set_xlabel(cost.label + (" (dearer →)" if not cost.more_is_better else " (dearer →, axis reversed)"))
        axes.set_ylabel(f"held-out {QUALITY.label}")
        axes.set_xscale("log")
        axes.grid(alpha=0.3, which="both")
        axes.margins(0.09)
        _plain_ticks(axes)
        best = (_numbers(point.at(axis) for point in find_front(points, cost)) for axis in (cost, QUALITY))
        axes.plot(*best, color="#999999", linewidth=7, alpha=0.45, solid_capstyle="round", label="Pareto front")
        for (family, label), colour, marker in zip(families.items(), COLOURS, _MARKERS, strict=False):
            mine = [p for p in points if p.family == family and p.at(QUALITY) is not None]
            if not mine:
                continue
            x_values, y_values = (_numbers(p.at(axis) for p in mine) for axis in (cost, QUALITY))
            first = family == next(iter(families))
            x_errors, y_errors = (_numbers(p.error(axis) for p in mine) for axis in (cost, QUALITY))
            axes.errorbar(
                x_values,
                y_values,
                xerr=x_errors,
                yerr=y_errors,
                color=colour,
                label=label,
                marker=marker,
                markersize=9 if first else 6,
                linewidth=1.1,
                capsize=2,
                zorder=4 if first else 2,
            )
            for point, x, y in zip(mine, x_values, y_values, strict=True) if first else ():
                _name(axes, point.label, x, y)
        if cost.more_is_better:
            axes.invert_xaxis()
        axes.set_ylim(lowest, highest)
    _save(figure, path)


def plot_scanlines(path: Path, strips: Mapping[str, NDArray[np.uint8]], column: int, first_frame: int) -> None:
    """One image column over time, (H, T, 3) by label: as it is, and how far each pixel strays from its own mean."""
    figure = _figure(1.2 + 2.9 * len(strips), 6.4)
    for index, (label, strip) in enumerate(strips.items(), 1):
        height, frames = strip.shape[:2]
        extent = (first_frame - 0.5, first_frame + frames - 0.5, float(height), 0.0)
        shown: dict[str, Any] = {"extent": extent, "aspect": "auto", "interpolation": "nearest"}
        above = _picture(figure, len(strips), index, label, f"row of column {column}")
        above.imshow(strip, **shown)
        grey = strip.astype(np.float64).mean(axis=2)
        below = _picture(figure, len(strips), index + len(strips), "", f"± {_DEVIATION} levels from its mean")
        strayed = grey - grey.mean(axis=1, keepdims=True)
        below.imshow(strayed, cmap="gray", vmin=-_DEVIATION, vmax=_DEVIATION, **shown)
        below.set_xlabel("frame")
    _save(figure, path, legend=False)


@dataclass(frozen=True)
class ErrorMaps:
    """A run's maps of errors by camera, (H, W) in 8-bit levels, and those cameras' PSNR in dB."""

    label: str
    maps: Mapping[str, NDArray[np.float32]]
    psnr: Mapping[str, float]


def plot_errors(path: Path, recorded: Mapping[str, NDArray[np.uint8]], runs: Sequence[ErrorMaps]) -> None:
    """A row for each camera of ``recorded``: that picture (H, W, 3), and each run's errors, all on one scale."""
    columns, heights = 1 + len(runs), [picture.shape[0] / picture.shape[1] for picture in recorded.values()]
    figure = _figure(2.6 * columns + 0.8, 0.5 + sum(2.6 * height + 0.2 for height in heights))
    grid = figure.add_gridspec(len(heights), columns, height_ratios=heights)
    end = max(float(np.quantile(np.concatenate([m.ravel() for run in runs for m in run.maps.values()]), 0.995)), 1.0)
    all_axes, shown = [], None
    for row, (camera, picture) in enumerate(recorded.items()):
        first = _bare(figure, grid[row, 0], "" if row else "recorded")
        first.imshow(picture)
        first.set_ylabel(camera)
        all_axes.append(first)
        for column, run in enumerate(runs, 1):
            title = "" if row else textwrap.fill(run.label, _TITLE_CHARACTERS)
            axes = _bare(figure, grid[row, column], title)
            shown = axes.imshow(run.maps[camera], cmap="inferno", vmin=0, vmax=end, interpolation="nearest")
            axes.set_xlabel(f"{run.psnr[camera]:.2f} dB")
            all_axes.append(axes)
    assert shown is not None
    figure.colorbar(shown, ax=all_axes, label="error, 8-bit levels", extend="max", aspect=30, pad=0.01)
    _save(figure, path, legend=False)


def _bare(figure: Figure, place: SubplotSpec, title: str) -> Axes:
    """Axes of a picture, without ticks."""
    axes = figure.add_subplot(place)
    axes.set_title(title)
    axes.set_xticks([])
    axes.set_yticks([])
    return axes


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _panel(figure: Figure, rows: int, columns: int, index: int, title: str, what: str) -> Axes:
    axes = figure.add_subplot(rows, columns, index)
    axes.set_title(title)
    axes.set_xlabel("frame")
    axes.set_ylabel(what)
    axes.grid(alpha=0.3)
    _number_frames(axes)
    return axes


def _picture(figure: Figure, columns: int, index: int, title: str, what: str) -> Axes:
    axes = figure.add_subplot(2, columns, index)
    axes.set_title(title)
    _number_frames(axes)
    if index % columns == 1:
        axes.set_ylabel(what)
    else:
        axes.set_yticks([])
    return axes


def _name(axes: Axes, label: str, x: float, y: float) -> None:
    """Writes a point's name below it, legible over lines."""
    from matplotlib.patheffects import withStroke

    halo = [withStroke(linewidth=3, foreground="white")]
    axes.annotate(
        label,
        (x, y),
        (0, -9),
        textcoords="offset points",
        ha="center",
        va="top",
        fontweight="bold",
        zorder=5,
        path_effects=halo,
    )


def _plain_ticks(axes: Axes) -> None:
    """Numbers such as 0.5 and 20 along a logarithmic axis instead of powers of ten."""
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())


def _number_frames(axes: Axes) -> None:
    from matplotlib.ticker import MaxNLocator

    axes.xaxis.set_major_locator(MaxNLocator(integer=True))


def _numbers(values: Iterable[float | None]) -> list[float]:
    """Values to draw; where there is none, a gap."""
    return [np.nan if value is None else value for value in values]


def _frames(run: Run) -> Sequence[int]:
    return [frame.frame for frame in run.frames]


def _save(figure: Figure, path: Path, *, legend: bool = True) -> None:
    if legend:
        handles, labels = figure.axes[0].get_legend_handles_labels()
        columns = legend_columns(labels, figure.get_figwidth())
        figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    figure.savefig(path, dpi=110, metadata={"Software": None})
    figure.savefig(path.with_suffix(".pdf"), metadata={"CreationDate": None, "Creator": None, "Producer": None})


def legend_columns(labels: Sequence[str], inches: float) -> int:
    """How many labels stand side by side in a figure so wide: all of them if they fit, else columns of the longest."""
    room = int(_CHARACTERS_PER_INCH * inches)
    widths = [len(label) + _HANDLE_CHARACTERS for label in labels]
    return len(labels) if sum(widths) <= room else max(1, room // max(widths))
