"""Time per frame and PSNR as goals of an encode: how they are asked for and kept, and what stays as it is."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decogs.encoder.training.schedule as schedule
from decogs.bench.methods.threedgstream import BaselineConfig
from decogs.codec.scene.digest import digest
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import PRESETS, EncodeSettings, Switches, Targets
from decogs.encoder.coding.time_control import (
    TIME_TOLERANCE,
    TimeControl,
    counted_seconds,
    over_time,
    with_target_psnr,
    with_time_budget,
)
from decogs.encoder.commands import encode_main
from decogs.encoder.job.option_texts import seconds_per_frame
from decogs.encoder.job.switches import with_method
from decogs.encoder.settings.frame import SignificanceSettings
from decogs.encoder.training.schedule import MIN_STEPS
from decogs.formats.errors import UsageError
from encode_rig import encode_rig
from noting_kernel import NotingKernel
from packets import iterate_packets

BUDGET = 1.0


# How it is asked for


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1.5s/frame", 1.5),
        ("1.5", 1.5),
        ("500ms/frame", 0.5),
        (" 500 ms / frame", 0.5),
        ("2s", 2.0),
        ("1e3ms", 1.0),
    ],
)
def test_times_are_read(text: str, seconds: float) -> None:
    assert seconds_per_frame(text) == seconds


@pytest.mark.parametrize(
    "text", ["", "s", "0", "-1s", "1h", "1s/second", "inf", "nan", "1,5", "1s 2", "1.5/framed", "\u0663s", "1_0"]
)
def test_what_is_no_time_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match=r"not a duration; write 1\.5s/frame or 500ms/frame"):
        seconds_per_frame(text)


def test_methods_with_a_fixed_schedule_are_refused() -> None:
    dense = with_method(PRESETS["standard"], "3dgstream")
    with pytest.raises(UsageError, match="`time_budget`: `method` 3dgstream trains a fixed number of steps; drop one"):
        with_time_budget(dense, 1.0)
    with pytest.raises(UsageError, match="`target_psnr`: `method` 3dgstream trains a fixed number of steps; drop one"):
        with_target_psnr(dense, 30.0)


def test_goals_are_in_the_settings_when_they_are_set() -> None:
    standard = PRESETS["standard"]
    assert not {"time_budget", "target_psnr"} & standard.as_document().keys()
    document = with_target_psnr(with_time_budget(standard, 1.5), 30.0).as_document()
    assert (document["time_budget"], document["target_psnr"]) == (1.5, 30.0)


# The control, against frames that take what measured ones do


def clip(frames: int, needs: Callable[[int], float], noise: float = 0.0) -> list[dict[str, float]]:
    """Seconds by stage of frames whose training goes on to its deadline, or for as long as it needs."""
    control, random, spent = TimeControl(BUDGET), np.random.default_rng(3), []
    for frame in range(frames):
        seconds = {"masks": 0.1, "selection": 0.05}
        if needs(frame):
            left = control.deadline(seconds) - time.perf_counter()
            seconds["training"] = min(needs(frame), max(left, 0.05)) * float(np.exp(random.normal(0, noise)))
            seconds |= {"write": 0.08, "commit": 0.04}
        seconds["measure"] = 5.0
        control = control.record_time(seconds)
        spent.append(seconds)
    return spent


@pytest.mark.parametrize("frames", [12, 30])
@pytest.mark.parametrize("noise", [0.0, 0.2])
def test_a_clip_keeps_its_budget(frames: int, noise: float) -> None:
    spent = clip(frames, lambda frame: 100.0, noise)
    assert np.mean([counted_seconds(seconds) for seconds in spent]) == pytest.approx(BUDGET, rel=TIME_TOLERANCE)


def test_time_that_is_not_needed_is_not_taken_nor_thrown_at_the_first_frame_that_moves() -> None:
    spent = [counted_seconds(s) for s in clip(40, lambda frame: 100.0 if frame >= 20 else 0.0)]
    assert spent[:20] == pytest.approx([0.15] * 20)
    assert max(spent) < 2.2 * BUDGET
    assert np.mean(spent) <= BUDGET * (1 + TIME_TOLERANCE)


def test_what_takes_longer_again_and_again_is_learned() -> None:
    """Every third frame searches for what emerges, which its deadline is given back for."""
    control, spent = TimeControl(BUDGET), []
    for frame in range(15):
        left = control.deadline({}) - time.perf_counter()
        spent.append({"training": max(left, 0.05) + 0.4 * (frame % 3 == 0), "write": 0.05})
        control = control.record_time(spent[-1])
    assert over_time(spent, BUDGET) < TIME_TOLERANCE


def deferred_clip(frames: int, masks: float, least: float) -> tuple[list[float], list[bool], list[float]]:
    """Of frames that train to their deadline but ``least`` seconds at least: seconds, deferred or not, training's."""
    control, spent, deferred, trained = TimeControl(BUDGET), [], [], []
    for frame in range(frames):
        seconds = {"masks": masks}
        deferred.append(control.defers(seconds, least if frame else 0.0))
        if not deferred[-1]:
            seconds["training"] = max(control.deadline(seconds) - time.perf_counter(), least)
            trained.append(seconds["training"])
            seconds |= {"write": 0.08, "commit": 0.04}
        control = control.record_time(seconds, deferred=deferred[-1])
        spent.append(counted_seconds(seconds))
    return spent, deferred, trained


def test_of_a_frame_that_ends_early_only_what_follows_training_is_learned() -> None:
    """Not that it took less than it might have: the next one may need all its time."""
    early = TimeControl(1.0).record_time({"masks": 0.1, "training": 0.2, "write": 0.1, "commit": 0.05})
    assert early.beyond == pytest.approx(0.15)
    late = early.record_time({"training": 1.2, "write": 0.1, "commit": 0.05})
    assert late.beyond is not None
    assert late.beyond > 0.15


@pytest.mark.parametrize(("least", "share"), [(0.9, 0.5), (1.8, 2 / 3), (3.0, 0.8)])
def test_frames_are_deferred_where_the_least_training_takes_longer_than_there_is(least: float, share: float) -> None:
    spent, deferred, trained = deferred_clip(60, 0.1, least)
    assert np.mean(deferred[10:]) == pytest.approx(share, abs=0.1)
    assert np.mean(spent) == pytest.approx(BUDGET, rel=2 * TIME_TOLERANCE)
    assert min(trained[1:]) >= least
    if least < 1:
        assert np.mean(trained[5:]) > 1.3 * least, "a frame has the time of the one deferred before it as well"


@pytest.mark.parametrize("least", [0.0, 0.3, 0.7])
def test_no_frame_is_deferred_while_the_least_training_fits(least: float) -> None:
    assert not any(deferred_clip(40, 0.1, least)[1])


def test_a_freeze_is_bounded_however_little_time_there_is() -> None:
    _, deferred, _ = deferred_clip(64, 0.1, 1e3)
    assert "".join("d" if each else "t" for each in deferred) == "t" + "dddddddt" * 7 + "ddddddd"


@pytest.mark.parametrize(("saved", "fits", "too_much"), [(-1.2, 0.9, 1.1), (0.0, 0.9, 1.1), (3.0, 1.4, 1.6)])
def test_a_frame_has_its_own_time_at_least_before_it_is_deferred(saved: float, fits: float, too_much: float) -> None:
    """And a share of what was saved. What little was overspent is paid back by shorter training."""
    control = TimeControl(1.0, saved=saved)
    assert not control.defers({}, fits)
    assert control.defers({}, too_much)


def test_a_frame_deferred_for_what_is_overspent_pays_and_keeps_nothing_for_the_next() -> None:
    seconds = {"masks": 0.25, "measure": 9.0}
    waits, paid = (
        TimeControl(1.0).record_time(seconds, deferred=True),
        TimeControl(1.0, saved=-3.0).record_time(seconds, deferred=True),
    )
    assert (waits.saved, waits.kept, waits.deferred) == (0.0, 0.75, 1)
    assert (paid.saved, paid.kept, paid.deferred) == (-2.25, 0.0, 1)


def test_a_miss_is_told_by_its_share() -> None:
    seconds = {"masks": 1.0, "training": 0.5, "measure": 9.0}
    assert over_time([seconds, seconds], 1.2) == pytest.approx(0.25)
    assert over_time([seconds], 2.0) == over_time([], 1.0) == 0.0


# Encodes


@pytest.fixture(scope="module")
def patient(tiny_settings: EncodeSettings) -> EncodeSettings:
    """The tiny settings with a long stage 2 and changes judged, as the presets have them."""
    frame = replace(
        tiny_settings.frame,
        joint_iterations=60,
        significance=SignificanceSettings(threshold=6.5),
    )
    return replace(tiny_settings, frame=frame)


@pytest.fixture(scope="module")
def restless_rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A square that moves to and fro in every one of 12 later frames."""
    return tiny_rig.write(tmp_path_factory.mktemp("rigs") / "restless", frames=[0, *[1, 0] * 6])


def steps_of(path: Path) -> dict[int, int]:
    """Training steps of each frame, from what --convergence-log wrote."""
    steps: dict[int, int] = {}
    for line in path.read_text().splitlines():
        frame = json.loads(line)["frame"]
        steps[frame] = steps.get(frame, 0) + 1
    return steps


@pytest.fixture
def slow_drawing(monkeypatch: pytest.MonkeyPatch) -> NotingKernel:
    """A kernel, and a clock of the test's own that only its drawing moves: 10 ms for every picture."""
    kernel = NotingKernel()
    monkeypatch.setattr(time, "perf_counter", lambda: 0.01 * kernel.times["draw"])
    return kernel


def test_a_clip_keeps_its_time_and_its_changes_are_still_judged(
    encode: Any, moving: Any, restless_rig: Path, patient: EncodeSettings, slow_drawing: NotingKernel
) -> None:
    free, steps, kernel = encode(restless_rig, settings=patient, keyframe=moving.path), list[int](), slow_drawing
    timed = encode(
        restless_rig,
        settings=with_time_budget(patient, 0.3),
        keyframe=moving.path,
        kernel=kernel,
        on_frame=lambda _: steps.append(kernel.times["backward"]),
    )
    spent = [counted_seconds(frame.seconds) for frame in timed.report.frames[1:]]
    assert np.mean(spent) == pytest.approx(0.3, rel=TIME_TOLERANCE)
    assert kernel.times["freeze"] == 12, "changes are judged once a frame"
    assert all(MIN_STEPS <= count < 60 for count in np.diff(steps))
    with open_stream(timed.path) as stream:
        assert stream.complete
        assert stream.header.settings["time_budget"] == 0.3
        assert len(list(stream.frames())) == 13
    assert len(timed.data) < 1.3 * len(free.data), "unjudged, frames take much more"


def test_a_deferred_frame_is_taken_up_by_the_next_one(
    encode: Any, moving: Any, patient: EncodeSettings, tiny_rig: Any, tmp_path: Path, slow_drawing: NotingKernel
) -> None:
    """The square stands until there is time, then it is where it should be."""
    rig = tiny_rig.write(tmp_path / "rig", frames=[0, *[1, 3, 0] * 4])
    timed = encode(rig, settings=with_time_budget(patient, 0.11), keyframe=moving.path, kernel=slow_drawing)
    later = timed.report.frames[1:]
    deferred = [frame for frame in later if not frame.effects]
    trained = [frame for frame in later if frame.effects]
    assert 4 <= len(deferred) <= 8
    assert {frame.kind for frame in deferred} == {"skip"}
    assert {frame.kind for frame in trained} == {"delta"}
    assert np.mean([counted_seconds(frame.seconds) for frame in later]) < 0.13
    assert min(frame.training_psnr for frame in trained) > max(frame.training_psnr for frame in deferred) + 0.1


def test_few_steps_still_get_as_far_as_things_move(
    encode: Any, moving: Any, restless_rig: Path, patient: EncodeSettings, slow_drawing: NotingKernel
) -> None:
    """Rates grow where only a few of the steps fit."""
    most = []
    for settings, kernel in ((patient, NotingKernel()), (with_time_budget(patient, 0.22), slow_drawing)):
        encode(restless_rig, settings=settings, keyframe=moving.path, stop=2, kernel=kernel)
        most.append(max(rates.log_scales for rates in kernel.rates))
    # 12 to 20 steps instead of 60: strides of 3 to 5.
    assert 1.5 < most[1] / most[0] <= schedule._MAX_RATE_GAIN * (1 + 1e-9)


def test_time_enough_gives_the_states_of_no_budget(
    encode: Any, moving: Any, moving_rig: Path, patient: EncodeSettings
) -> None:
    free = encode(moving_rig, settings=patient, keyframe=moving.path)
    timed = encode(moving_rig, settings=with_time_budget(patient, 1e4), keyframe=moving.path)
    assert list(map(digest, timed.states)) == list(map(digest, free.states))


def test_a_time_that_cannot_be_met_is_told(
    moving: Any,
    moving_rig: Path,
    patient: EncodeSettings,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(PRESETS, "patient", patient)
    arguments = [str(moving_rig), "-o", str(tmp_path / "x.dgs"), "--preset", "patient", "--holdout", "cam02", "-q"]
    arguments += ["--keyframe", str(moving.path), "--time-budget"]
    assert encode_main([*arguments, "1000"]) == 0
    assert capfd.readouterr().err == ""
    assert encode_main([*arguments, "1us/frame"]) == 2
    assert "--time-budget 1us/frame: not a duration" in capfd.readouterr().err
    assert encode_main([*arguments, "0.1ms/frame"]) == 0
    warning = capfd.readouterr().err
    assert warning.startswith("decogs-encode: warning: frames after the first take ")
    assert "% more than the budget of 0.0001; " in warning
    assert "masks, selection and coding take a fixed" in warning
    assert warning.count("\n") == 1
    with open_stream(tmp_path / "x.dgs") as stream:
        assert len(list(stream.frames())) == 4


def test_a_timed_encode_can_be_gone_on_with(
    encode: Any, moving: Any, moving_rig: Path, patient: EncodeSettings, tmp_path: Path
) -> None:
    given = {"settings": with_time_budget(patient, 1e-4), "keyframe": moving.path}
    whole = encode(moving_rig, **given)
    with whole.path.open("rb") as file:
        ends = [packet.offset + packet.size for packet in iterate_packets(file)]
    (tmp_path / "scene.dgs.part").write_bytes(whole.data[: ends[2] + 3])
    resumed = encode(moving_rig, output=tmp_path / "scene.dgs", resume=True, **given)
    assert resumed.data[: ends[2]] == whole.data[: ends[2]]
    assert [frame.replayed for frame in resumed.report.frames] == [True, True, False, False]
    with open_stream(resumed.path) as stream:
        assert len(list(stream.frames())) == 4


# A target


def test_a_target_ends_training_and_the_same_seed_still_gives_the_same_bytes(
    moving: Any, moving_rig: Path, patient: EncodeSettings, tiny_rig: Any, tmp_path: Path
) -> None:
    given = {"holdout": [tiny_rig.held_out], "settings": patient}
    steps, data = {}, {}
    for target in (None, 20.0, 20.0, 21.5):
        path = tmp_path / "x.dgs"
        encode_rig(moving_rig, path, **given, targets=Targets(target_psnr=target), convergence_log=tmp_path / "any")
        steps[target] = steps_of(tmp_path / "any")
        assert data.setdefault(target, path.read_bytes()) == path.read_bytes()
    whole, low, high = (steps[target] for target in (None, 20.0, 21.5))
    assert whole[0] == patient.keyframe.iterations + patient.keyframe.settle_iterations
    assert low[0] < high[0] < whole[0], "the keyframe's, too"
    assert low[1] <= high[1] <= whole[1] == 60
    assert low[1] + low[3] < whole[1] + whole[3]


def test_changes_are_judged_before_a_target_ends_training(
    encode: Any, moving: Any, moving_rig: Path, patient: EncodeSettings
) -> None:
    kernel, views = NotingKernel(), 4
    encode(moving_rig, settings=with_target_psnr(patient, 10.0), keyframe=moving.path, stop=2, kernel=kernel)
    done = [what for what, _ in kernel.done if what in ("backward", "freeze")]
    assert done.index("freeze") == views + 1, "at once when every view was seen to be good enough"
    assert done.count("freeze") == 1
    assert views <= len(done[views + 2 :]) <= 2 * views, "and then until each has been seen again"


def test_a_target_out_of_reach_changes_nothing(
    encode: Any, moving: Any, moving_rig: Path, patient: EncodeSettings
) -> None:
    free = encode(moving_rig, settings=patient, keyframe=moving.path)
    aimed = encode(moving_rig, settings=with_target_psnr(patient, 100.0), keyframe=moving.path)
    assert list(map(digest, aimed.states)) == list(map(digest, free.states))


# The loss inside a frame


def test_anytime_tells_every_step_and_changes_no_byte(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: EncodeSettings, tmp_path: Path
) -> None:
    path = tmp_path / "any.jsonl"
    encode_rig(
        moving_rig, tmp_path / "x.dgs", holdout=[tiny_rig.held_out], settings=tiny_settings, convergence_log=path
    )
    assert (tmp_path / "x.dgs").read_bytes() == moving.data
    records = [json.loads(line) for line in path.read_text().splitlines()]
    assert all(record.keys() == {"frame", "stage", "iteration", "seconds", "loss"} for record in records)
    keyframe, frame = tiny_settings.keyframe, tiny_settings.frame
    later = {"joint": frame.joint_iterations}
    expected = {0: {"keyframe": keyframe.iterations, "settle": keyframe.settle_iterations}, 1: later, 3: later}
    for index, stages in expected.items():
        own = [record for record in records if record["frame"] == index]
        assert [(r["stage"], r["iteration"]) for r in own] == [(s, i) for s, n in stages.items() for i in range(n)]
        seconds = [record["seconds"] for record in own]
        assert seconds == sorted(seconds)
        assert 0 < seconds[0] < seconds[-1]
        losses = [record["loss"] for record in own]
        assert np.mean(losses[-5:]) < np.mean(losses[:5])
    assert {record["frame"] for record in records} == set(expected), "frame 2 changes nothing and is not trained"


def test_anytime_tells_of_the_baseline(
    moving: Any, moving_rig: Path, tiny_rig: Any, tiny_settings: EncodeSettings, tmp_path: Path
) -> None:
    given = {"holdout": [tiny_rig.held_out], "settings": tiny_settings, "keyframe": moving.path}
    encode_rig(
        moving_rig,
        tmp_path / "x.dgs",
        frames=slice(2),
        **given,
        switches=Switches("3dgstream"),
        convergence_log=tmp_path / "any",
    )
    records = [json.loads(line) for line in (tmp_path / "any").read_text().splitlines()]
    steps = [record["iteration"] for record in records if record["stage"] == "cache"]
    assert steps == list(range(BaselineConfig().cache_iterations))
    assert {record["stage"] for record in records} <= {"cache", "joint"}


def test_a_file_that_cannot_be_written_is_refused(moving_rig: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"`convergence_log` .*x/any: No such file or directory; name a file"):
        encode_rig(moving_rig, tmp_path / "x.dgs", convergence_log=tmp_path / "x" / "any")
    assert list(tmp_path.iterdir()) == []
