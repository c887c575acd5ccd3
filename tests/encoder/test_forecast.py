"""Forecasts: what they are made of, and that the pilot's place, presets and length of a take count as they should."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.encoder.analyze_command import analyze_main
from decogs.encoder.forecast import pilot as pilots
from decogs.encoder.forecast.ladder import STEPS, forecasts
from decogs.encoder.forecast.pilot import LATER_FRAMES, Pilot, change_shares, pilot_of
from decogs.encoder.output.progress import TerminalProgress
from decogs.encoder.output.whole import FRAMES_KNOWN, settled, whole_of
from decogs.encoder.settings.presets import LADDER
from decogs.formats.errors import UsageError
from decogs.formats.rigs import open_rig

PILOT = Pilot(range(4, 8), 200_000, 20.0, 6.0, 5_000, 0.5, 0.3, 29.0, "cam05", 28.0)


def middle(of: Any) -> float:
    return float(np.sqrt(of.low * of.high))


def test_slower_presets_take_more_and_the_pilot_s_own_is_what_it_measured() -> None:
    of = {each.preset: each for each in forecasts(PILOT, 100)}
    assert list(of) == list(LADDER)
    live = of["live"]
    assert middle(live.total_bytes) == pytest.approx(200_000 + 99 * 5_000 * settled(100))
    assert middle(live.cpu_seconds) == pytest.approx(20 + 99 * 0.5 * settled(100))
    for less, more in pairwise(LADDER):
        assert middle(of[less].total_bytes) <= middle(of[more].total_bytes)
        assert middle(of[less].cpu_seconds) < middle(of[more].cpu_seconds)
    # The search for first points is the same for all.
    searching = {each.preset: each for each in forecasts(replace(PILOT, key_cpu=120.0, points_cpu=106.0), 100)}
    for name in LADDER:
        assert middle(searching[name].cpu_seconds) == pytest.approx(middle(of[name].cpu_seconds) + 100)


def test_more_training_gains_where_training_views_are_not_far_better() -> None:
    def gain(training_psnr: float) -> float:
        of = {each.preset: each.psnr for each in forecasts(replace(PILOT, training_psnr=training_psnr), 10)}
        assert of["standard"] is not None
        return (of["standard"].low + of["standard"].high) / 2 - 28.0

    assert gain(28.5) > gain(31.0) + 0.5
    assert 0 <= gain(60.0) < 0.01
    assert gain(20.0) == gain(28.0)
    assert [each.psnr for each in forecasts(replace(PILOT, psnr=None), 10)] == [None] * len(LADDER)


def test_a_longer_take_has_cheaper_frames_and_a_wider_range() -> None:
    assert 1 > settled(20) > settled(300) > 0.5
    short, long = (forecasts(PILOT, frames)[0].total_bytes for frames in (4, 3000))
    assert long.high / long.low > 1.2 * short.high / short.low


def shown(frame: int, changed: float) -> np.ndarray:
    """A picture of which a share differs from all others."""
    picture = np.zeros((20, 50, 3), np.uint8)
    picture.reshape(-1, 3)[: round(changed * 1000)] = 30 + 25 * (frame % 2)
    return picture


def test_the_pilot_is_where_as_much_changes_as_on_average() -> None:
    """Half of the take stands, the last third moves much: between them something moves a little."""
    shares = [0.0] * 10 + [0.1] * 5 + [0.25] * 6
    pictures = np.array([shown(frame, share) for frame, share in enumerate(shares)])
    stats: Any = SimpleNamespace(
        pictures=(pictures, pictures), noise=np.zeros((2, 21)), frames=tuple(range(5, 26)), step=1
    )
    assert change_shares(stats)[14:].tolist() == pytest.approx([0.25] * 6)
    found = pilots._typical_frames(stats)
    assert len(found) == LATER_FRAMES + 1
    assert 5 + 9 <= found.start <= 5 + 12
    few: Any = SimpleNamespace(pictures=(pictures[:2],), noise=np.zeros((1, 2)), frames=(5, 6), step=1)
    assert pilots._typical_frames(few) == range(5, 7)


def test_the_camera_that_is_left_out_has_neighbours_as_usual(moving_rig: Path) -> None:
    """Not one that stands alone, nor one of a pair."""
    rig = open_rig(moving_rig)
    names = {0.0: "pair", 0.1: "twin", 1.0: "a", 2.0: "b", 3.0: "c", 9.0: "alone"}
    cameras = []
    for place, name in names.items():
        pose = np.eye(4)
        pose[0, 3] = -place
        cameras.append(replace(rig.cameras[0], name=name, world_to_camera=pose))
    several = replace(rig, cameras=tuple(cameras))
    assert pilots._left_out(several, ()) in {("a",), ("b",), ("c",)}
    assert pilots._left_out(several, ("a", "b")) == ()


def report(frame: int, kind: str, size: int, cpu: float) -> Any:
    return SimpleNamespace(
        frame=frame,
        kind=kind,
        bytes=size,
        cpu_seconds=cpu,
        seconds={"first_points": 1.0, "training": 2.0, "write": 1.0, "measure": 9.0},
        training_psnr=30.0,
        held_out_psnr=None,
        replayed=False,
    )


def test_figures_of_a_pilot() -> None:
    pilot = pilot_of([report(7, "key", 100, 8.0), report(8, "delta", 10, 4.0), report(9, "delta", 30, 2.0)], None)
    assert pilot == Pilot(range(7, 10), 100, 8.0, 2.0, 20.0, 3.0, 1.5, 30.0, None, None)
    with pytest.raises(UsageError, match="two frames at least"):
        pilot_of([report(0, "key", 100, 8.0)], None)


def test_an_encode_says_what_all_of_it_takes(capsys: pytest.CaptureFixture[str]) -> None:
    import sys

    reports = [report(0, "key", 200_000, 60.0), report(1, "delta", 7_000, 1.0), report(2, "delta", 9_000, 1.4)]
    size, cpu = whole_of(reports, 300)
    assert middle(size) == pytest.approx(200_000 + 299 * 8_000 * settled(300))
    assert middle(cpu) == pytest.approx(60 + 299 * 1.2 * settled(300))
    assert size.high / size.low < 2
    for frames, says in ((300, True), (10, False)):
        with TerminalProgress(sys.stderr) as progress:
            progress.started({"frames": [0, frames]})
            for each in reports[:FRAMES_KNOWN]:
                progress.frame(each)
        assert (" CPU-s in all" in capsys.readouterr().err) is says


def test_the_command_foretells(moving_rig: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert analyze_main([str(moving_rig), "--forecast", "-q", "--json", "-"]) == 0
    captured = capsys.readouterr()
    found = json.loads(captured.out)["forecast"]
    assert [each["preset"] for each in found["presets"]] == list(STEPS)
    assert found["frames"] == open_rig(moving_rig).frame_count
    for each in found["presets"]:
        assert 0 < each["total_bytes"]["low"] < each["total_bytes"]["high"]
    assert f"forecast of {found['frames']} frames" in captured.err
