"""Figures of a run, from frames made by hand."""

from __future__ import annotations

from typing import Any

import pytest

from decogs.bench.tables.columns import COLUMNS, figures, markdown


def value(key: str, run: Any, runs: list[Any] | None = None) -> str:
    return COLUMNS[key].value([run], runs or [run])


@pytest.fixture
def run(run_of: Any, frame_of: Any) -> Any:
    key = frame_of(
        0, bytes=5000, selected=1.0, seconds={"keyframe": 40.0}, cpu_seconds=70.0, psnr=32.0, variation=None,
        psnr_static=32.5,
    )  # fmt: skip
    return run_of([key, frame_of(1, psnr=31.0, variation=0.002), frame_of(2, psnr=30.0, psnr_dynamic=24.0)])


def test_qualities_are_means_over_all_frames(run: Any) -> None:
    assert value("psnr", run) == "31.00"
    assert value("psnr_dynamic", run) == "24.67"
    assert value("last_dynamic", run) == "24.00"
    assert value("static_change", run) == "-0.500"


def test_costs_are_means_over_later_frames(run: Any) -> None:
    assert value("seconds", run) == "1.75"
    assert value("cpu", run) == "3.00"
    assert value("selected", run) == "25.0%"
    assert value("megabytes", run) == "0.0020"
    assert value("megabytes_all", run) == "0.0030", "the file's 9000 bytes over three frames"
    assert value("keyframe_seconds", run) == "40.0"
    assert value("fps", run) == "250.0"


def test_flicker_is_the_mean_over_pairs_of_frames_times_100(run: Any) -> None:
    assert value("mtv", run) == "0.1500"


def test_slopes_are_per_100_frames_of_the_rig(run_of: Any, frame_of: Any) -> None:
    every_tenth = run_of([frame_of(10 * i, psnr=32.0 - i) for i in range(4)])
    assert value("slope", every_tenth) == "-10.00 ± 0.00"
    assert figures([every_tenth])["slope"] == pytest.approx(-10)


def test_frames_in_common(run_of: Any, frame_of: Any) -> None:
    every = run_of([frame_of(i, psnr=30.0 + i) for i in range(11)])
    tenth = run_of([frame_of(0, psnr=29.0), frame_of(10, psnr=27.0)])
    assert value("psnr_common", every, [every, tenth]) == "35.00"
    assert value("psnr_common", tenth, [every, tenth]) == "28.00"


def test_what_cannot_be_said_is_left_out(run_of: Any, frame_of: Any) -> None:
    one = run_of([frame_of(0, variation=None, psnr_dynamic=None)])
    for key in ("mtv", "seconds", "cpu", "selected", "megabytes", "slope", "psnr_dynamic", "last_dynamic"):
        assert value(key, one) == "–"


def test_lpips_says_when_it_is_not_installed(run_of: Any, frame_of: Any, run: Any) -> None:
    assert value("lpips", run) == "not installed"
    measured = run_of([frame_of(0, lpips=0.1), frame_of(1, lpips=0.2)], lpips_network="alex")
    assert value("lpips", measured) == "0.1500"


def test_the_worst_is_of_cameras_and_frames(run_of: Any, frame_of: Any) -> None:
    """Three cameras, of which the second is the worst on average, and the first in one frame; 5 % of 63 are four."""
    views = [[30.0 + i, 25.0, 28.0] for i in range(20)] + [[10.0, 24.0, 22.0]]
    run = run_of([frame_of(i, psnr=27.0, psnr_of_views=each) for i, each in enumerate(views)], camera="a,b,c")
    assert value("psnr_worst_camera", run) == f"{(20 * 25 + 24) / 21:.2f}"
    assert value("psnr_worst_frame", run) == "10.00"
    assert value("psnr_worst_5", run) == f"{(10 + 22 + 24 + 25) / 4:.2f}"


def test_the_worst_of_files_from_before_it_was_kept(run: Any, run_of: Any, frame_of: Any) -> None:
    """One camera's mean is its own; of several, nobody knows."""
    assert [value(key, run) for key in ("psnr_worst_camera", "psnr_worst_frame", "psnr_worst_5")] == [
        "31.00", "30.00", "30.00",
    ]  # fmt: skip
    several = run_of([frame_of(0), frame_of(1)], camera="a,b")
    assert [value(key, several) for key in ("psnr_worst_camera", "psnr_worst_frame", "psnr_worst_5")] == 3 * ["–"]


def test_figures_are_numbers_of_one_run(run: Any) -> None:
    numbers = figures([run])
    assert numbers["megabytes"] == 0.002
    assert numbers["psnr_dynamic"] == pytest.approx((25 + 25 + 24) / 3), "not rounded"
    assert numbers["lpips"] is None
    assert numbers["slope"] == pytest.approx(-100)
    assert numbers["slope_error"] == pytest.approx(0, abs=1e-9)
    assert "psnr_common" not in numbers, "it is a table's"


def test_a_table_in_markdown() -> None:
    assert markdown(["", "PSNR"], [["a|b", "1"]]) == ["|  | PSNR |", "|---|--:|", "| a\\|b | 1 |"]
