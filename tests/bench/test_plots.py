"""The figures of a report: what is written below them is all there."""

from __future__ import annotations

import pytest

from decogs.bench.questions.paper import METHODS
from decogs.bench.reports.plots import legend_columns

pytest.importorskip("matplotlib")

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
