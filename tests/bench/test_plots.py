"""The figures of a report: what is written below them is all there."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.bench.questions.paper import METHODS
from decogs.bench.reports.plots import ErrorMaps, legend_columns, plot_errors

pytest.importorskip("matplotlib")

from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure


@pytest.mark.parametrize(
    ("labels", "columns"),
    [([variant.description for variant in METHODS], None), (["decogs", "SPZ", ".splat"], 3)],
)
def test_a_legend_is_no_wider_than_its_figure(labels: list[str], columns: int | None) -> None:
    figure = Figure(figsize=(10, 4), layout="constrained")
    axes = figure.add_subplot()
    for label in labels:
        axes.plot([0, 1], label=label)
    wanted = legend_columns(labels, figure.get_figwidth())
    assert columns in (None, wanted)
    handles, texts = axes.get_legend_handles_labels()
    legend = figure.legend(handles, texts, loc="outside lower center", ncols=wanted, frameon=False)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    box = legend.get_window_extent()
    assert box.x0 >= 0
    assert box.x1 <= canvas.get_width_height()[0]


def test_errors_of_all_runs_and_cameras_are_on_one_scale(tmp_path: Path) -> None:
    """A run whose errors are small is dark beside one whose errors are large, whatever its own largest is."""
    recorded = {"wide": np.full((60, 160, 3), 90, np.uint8), "square": np.full((80, 80, 3), 90, np.uint8)}
    psnr = dict.fromkeys(recorded, 30.0)

    def run(level: float) -> ErrorMaps:
        maps = {name: np.full(seen.shape[:2], level, np.float32) for name, seen in recorded.items()}
        return ErrorMaps(f"{level:g} levels", maps, psnr)

    plot_errors(tmp_path / "errors.png", recorded, [run(4.0), run(40.0)])
    picture = cv2.imread(str(tmp_path / "errors.png"))[..., ::-1].astype(int)
    for share in (0.1, 1.0):
        colour = np.rint(255 * np.array(colormaps["inferno"](share)[:3]))
        assert (np.abs(picture - colour).max(axis=2) <= 2).mean() > 0.15, "of two cameras"
    assert (tmp_path / "errors.pdf").read_bytes().startswith(b"%PDF")
