"""Quality, budgets and lossless encodes: what they change, how close a budget is kept, and that it can be resumed."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.codec.scene.lattice import default_lattice, dequantise, quantise
from decogs.codec.scene.state import take_rows
from decogs.encoder import PRESETS, EncodeSettings, Targets
from decogs.encoder.coding.changes import quantise_changes
from decogs.encoder.coding.rate_control import (
    BYTES_TOLERANCE,
    RateControl,
    over_budget,
    with_budget,
    with_lossless,
    with_quality,
)
from decogs.encoder.commands import encode_main
from decogs.encoder.job.switches import with_method
from decogs.encoder.settings.frame import SignificanceSettings
from decogs.formats.errors import UsageError
from decogs.formats.splats import Splats
from decogs.formats.stream.container import PacketKind
from encode_rig import encode_rig
from packets import iterate_packets

BUDGET = 10_000
Content = Callable[[int], float]


# Quality


@pytest.mark.parametrize("name", PRESETS)
def test_a_quality_of_50_is_the_preset(name: str) -> None:
    assert with_quality(PRESETS[name], 50) == PRESETS[name]


def test_16_less_is_worth_twice_as_much_and_coarser_by_a_fourth_root_of_two() -> None:
    standard = PRESETS["standard"]
    bit = standard.keyframe.rd_lambda
    for quality, factor, lattice in ((34, 2, 1.18921), (66, 0.5, 0.840896), (82, 0.25, 0.707107)):
        settings = with_quality(standard, quality)
        assert settings.frame.significance.threshold == pytest.approx(
            factor * standard.frame.significance.threshold, rel=1e-5
        )
        assert settings.lattice_scale == lattice
        for name in ("rd_lambda", "colour_rd_lambda"):
            usual = getattr(standard.frame.significance, name)
            assert getattr(settings.frame.significance, name) == pytest.approx(factor * usual, rel=1e-5)
        significance = standard.frame.significance
        assert settings.keyframe.rd_lambda == pytest.approx(bit * lattice**2, rel=1e-5)  # six digits
        keyframe, frame = replace(settings.keyframe, rd_lambda=bit), replace(settings.frame, significance=significance)
        assert replace(settings, lattice_scale=1.0, keyframe=keyframe, frame=frame) == standard
    thresholds = [with_quality(standard, quality).frame.significance.threshold for quality in range(101)]
    assert thresholds == sorted(thresholds, reverse=True)
    assert len(set(thresholds)) == 101


@pytest.mark.parametrize("settings", [PRESETS["paper"], with_method(PRESETS["standard"], "3dgstream")])
def test_where_every_change_is_sent_the_lattice_follows(settings: EncodeSettings) -> None:
    assert with_quality(settings, 34).lattice_scale == 1.18921
    with pytest.raises(UsageError, match=r"drop one of the two|these settings code every change"):
        with_budget(settings, BUDGET)


# The controller, against scenes that answer as measured ones do


def response(exponent: float, content: Content, noise: float = 0.0) -> Callable[[int, float], int]:
    """A frame's bytes at a factor of the threshold: content * factor^-exponent, in budgets, with noise of that size in
    log."""
    random = np.random.default_rng(3)
    return lambda frame, factor: round(
        BUDGET * content(frame) * factor**-exponent * float(np.exp(random.normal(0, noise)))
    )


def controlled(frames: int, answer: Callable[[int, float], int]) -> tuple[list[int], list[float]]:
    """Sizes and factors of a clip's later frames."""
    control, sizes, factors = RateControl(BUDGET, 0), [], []
    for frame in range(frames):
        factors.append(control.factor)
        sizes.append(answer(frame, control.factor))
        control = control.after(PacketKind.DELTA, sizes[-1])
    return sizes, factors


def doubling(frame: int) -> float:
    return 1.0 if frame < 15 else 2.0


@pytest.mark.parametrize("exponent", [0.4, 0.6, 0.9])
@pytest.mark.parametrize("level", [0.5, 1.0, 2.0])
def test_a_clip_keeps_its_budget_although_motion_doubles_in_its_middle(exponent: float, level: float) -> None:
    sizes, _ = controlled(30, response(exponent, lambda frame: level * doubling(frame), noise=0.15))
    assert np.mean(sizes) == pytest.approx(BUDGET, rel=BYTES_TOLERANCE)


@pytest.mark.parametrize("exponent", [0.3, 0.6, 1.0])
def test_frames_settle_at_the_budget(exponent: float) -> None:
    sizes, factors = controlled(60, response(exponent, lambda frame: 3.0))
    assert np.abs(np.array(sizes[40:]) / BUDGET - 1).max() < 0.03, "the grid of factors is 1/32 octave"
    assert factors[0] == 1
    assert factors[-1] == pytest.approx(3.0 ** (1 / exponent), rel=0.05)


@pytest.mark.parametrize(("content", "factor"), [(1e-4, 1 / 256), (1e4, 256)])
def test_the_threshold_is_bounded(content: float, factor: float) -> None:
    sizes, factors = controlled(40, response(0.6, lambda frame: content))
    assert factors[-1] == factor
    assert (over_budget(sizes, BUDGET) > BYTES_TOLERANCE) == (content > 1)


def test_a_bit_is_worth_more_the_more_changes_must_be_worth() -> None:
    settings = PRESETS["standard"].frame.significance
    for size, threshold in (
        (BUDGET, settings.threshold),
        (BUDGET * 100, 256 * settings.threshold),
        (1, settings.threshold / 256),
    ):
        control = RateControl(BUDGET, 0)
        for _ in range(30):
            control = control.after(PacketKind.DELTA, size)
        significance = control.significance(settings)
        factor = threshold / settings.threshold
        for name in ("threshold", "rd_lambda", "colour_rd_lambda"):
            assert getattr(significance, name) == pytest.approx(factor * getattr(settings, name), rel=1e-5)


def test_what_a_still_scene_saves_is_not_thrown_at_its_first_motion() -> None:
    control = RateControl(BUDGET, 0)
    answer, sizes = response(0.6, lambda frame: 1.0), []
    for frame in range(60):
        if 10 <= frame < 30:
            control = control.after(PacketKind.SKIP, 50)
            continue
        sizes.append(answer(frame, control.factor))
        control = control.after(PacketKind.DELTA, sizes[-1])
    assert max(sizes) < 3 * BUDGET
    assert (sum(sizes) + 20 * 50) / 60 == pytest.approx(BUDGET, rel=BYTES_TOLERANCE)


@pytest.mark.parametrize("key", [1.5, 3.0, 5.0])
def test_the_frames_of_a_segment_pay_for_its_keyframe_evenly(key: float) -> None:
    control, sizes = RateControl(BUDGET, 10), []
    answer = response(0.6, lambda frame: 1.0)
    for frame in range(1, 60):
        opens = frame % 10 == 0
        sizes.append(round(key * BUDGET) if opens else answer(frame, control.factor))
        control = control.after(PacketKind.KEY if opens else PacketKind.DELTA, sizes[-1])
    for end in (29, 39, 49, 59):
        assert np.mean(sizes[:end]) == pytest.approx(BUDGET, rel=BYTES_TOLERANCE)
    paying = np.array([size for frame, size in enumerate(sizes, 1) if frame > 35 and frame % 10])
    assert paying == pytest.approx((10 - key) / 9 * BUDGET, rel=0.05)


@pytest.mark.parametrize("key", [2.9, 3.0, 40.0])
def test_a_keyframe_may_take_more_than_its_whole_segment_may(key: float) -> None:
    """Nothing is left for the other frames: they get next to nothing, as far as the threshold goes."""
    control = RateControl(BUDGET, 3)
    for _ in range(4):
        control = control.after(PacketKind.KEY, round(key * BUDGET))
        for _ in range(2):
            control = control.after(PacketKind.DELTA, BUDGET)
    assert control.factor == 256


def test_a_place_in_a_segment_is_counted_from_its_keyframe() -> None:
    """A closed segment's control begins with the keyframe, an open one's with the frame after the first."""
    closed = opened = RateControl(BUDGET, 3)
    places = []
    for kind in (PacketKind.KEY, PacketKind.DELTA, PacketKind.SKIP, PacketKind.KEY, PacketKind.DELTA):
        closed = closed.after(kind, BUDGET)
        opened = opened if kind == PacketKind.KEY and not opened.frames else opened.after(kind, BUDGET)
        places.append((closed.index, opened.index))
    assert places == [(0, 0), (1, 1), (2, 2), (3, 3), (4, 4)]


def test_a_keyframe_without_segments_is_paid_for_as_any_frame_is() -> None:
    """As after a flash or a cut."""
    control = RateControl(1000.0, 0).after(PacketKind.DELTA, 900)
    after_key, after_skip = (control.after(kind, 5000) for kind in (PacketKind.KEY, PacketKind.SKIP))
    assert after_key.octaves == after_skip.octaves > control.octaves
    assert after_key.after(PacketKind.DELTA, 900).octaves == after_skip.after(PacketKind.DELTA, 900).octaves


def test_it_knows_nothing_but_sizes() -> None:
    """The same packets, the same factors: what an encode that goes on relies on."""
    answer = response(0.6, doubling, noise=0.3)
    sizes, factors = controlled(30, answer)
    again = RateControl(BUDGET, 0)
    for size, factor in zip(sizes, factors, strict=True):
        assert again.factor == factor
        again = again.after(PacketKind.DELTA, size)


# Encodes


@pytest.fixture(scope="module")
def economical(tiny_settings: EncodeSettings) -> EncodeSettings:
    """The tiny settings with changes judged, as the presets do."""
    significance = SignificanceSettings(threshold=6.5, rd_lambda=10.0, colour_rd_lambda=2.5)
    frame = replace(tiny_settings.frame, joint_iterations=20, grow_fraction=0.0, significance=significance)
    return replace(tiny_settings, frame=frame)


@pytest.fixture(scope="module")
def restless_rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A square that moves to and fro in every one of 20 later frames."""
    return tiny_rig.write(tmp_path_factory.mktemp("rigs") / "restless", frames=[0, *[1, 0] * 10])


def later(encoded: Any) -> list[int]:
    return [frame.bytes for frame in encoded.report.frames[1:]]


def test_a_clip_keeps_its_budget_and_resumes_to_the_same_bytes(
    encode: Any, moving: Any, restless_rig: Path, economical: EncodeSettings, tmp_path: Path
) -> None:
    free = encode(restless_rig, settings=economical, keyframe=moving.path)
    budget = 0.6 * float(np.mean(later(free)))
    given = {"settings": replace(economical, frame_budget=budget), "keyframe": moving.path}
    held = encode(restless_rig, **given)
    assert np.mean(later(held)) == pytest.approx(budget, rel=BYTES_TOLERANCE)
    with held.path.open("rb") as file:
        ends = [packet.offset + packet.size for packet in iterate_packets(file)]
    (tmp_path / "scene.dgs.part").write_bytes(held.data[: ends[9] + 11])
    assert encode(restless_rig, output=tmp_path / "scene.dgs", resume=True, **given).data == held.data
    # Frames can be added to a shorter clip: its length plays no part.
    shutil.copy(encode(restless_rig, stop=12, **given).path, tmp_path / "longer.dgs")
    assert encode(restless_rig, output=tmp_path / "longer.dgs", resume=True, **given).data == held.data


@pytest.mark.parametrize("frames", [1, 2, 3, 4])
def test_segments_with_a_budget_resume_to_the_same_bytes(
    encode: Any, moving: Any, moving_rig: Path, economical: EncodeSettings, tmp_path: Path, frames: int
) -> None:
    settings = replace(economical, frame_budget=1500.0, segment=2)
    given = {"settings": settings, "keyframe": moving.path}
    whole = encode(moving_rig, **given)
    with whole.path.open("rb") as file:
        ends = [packet.offset + packet.size for packet in iterate_packets(file)]
    (tmp_path / "scene.dgs.part").write_bytes(whole.data[: ends[frames] + 3])
    assert encode(moving_rig, output=tmp_path / "scene.dgs", resume=True, **given).data == whole.data


def test_options_become_settings(
    moving: Any, moving_rig: Path, economical: EncodeSettings, tmp_path: Path, tiny_rig: Any
) -> None:
    given = {"settings": economical, "holdout": [tiny_rig.held_out], "keyframe": moving.path, "frames": slice(2)}

    def settings(**options: Any) -> dict[str, Any]:
        encode_rig(moving_rig, tmp_path / "x.dgs", **given, targets=Targets(**options), log=tmp_path / "log")
        document: dict[str, Any] = json.loads((tmp_path / "log").read_text().splitlines()[0])["settings"]
        return document

    assert "frame_budget" not in settings()
    assert settings(bytes_per_frame=2000)["frame_budget"] == 2000
    both = settings(bytes_per_frame=2000, quality=34)
    assert both["frame_budget"] == 2000
    assert both["frame"]["significance"]["threshold"] == 13.0
    assert settings(lossless=True) == with_lossless(economical).as_document()


@pytest.mark.parametrize(
    "asked", [["--max-mb-per-frame", "0.002"], ["--bitrate", "400"]], ids=["bytes", "at 25 frames per second"]
)
def test_a_budget_is_asked_for_in_either_unit(
    moving: Any, moving_rig: Path, economical: EncodeSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    asked: list[str],
) -> None:  # fmt: skip
    monkeypatch.setitem(PRESETS, "economical", economical)
    arguments = [str(moving_rig), "-o", str(tmp_path / "x.dgs"), "--preset", "economical", "--holdout", "cam02", "-q"]
    arguments += ["--keyframe", str(moving.path), "--frames", ":2", "--log", str(tmp_path / "log")]
    assert encode_main([*arguments, *asked]) == 0
    started = next(json.loads(line) for line in (tmp_path / "log").read_text().splitlines() if '"start"' in line)
    assert started["settings"]["frame_budget"] == 2000


def test_a_bitrate_wants_a_frame_rate(moving_rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rig = shutil.copytree(moving_rig, tmp_path / "rig")
    values = json.loads((rig / "rig.json").read_text())
    del values["fps"]
    (rig / "rig.json").write_text(json.dumps(values))
    assert encode_main([str(rig), "-o", str(tmp_path / "x.dgs"), "--bitrate", "500"]) == 2
    assert re.search(r"--bitrate: .* states no frame rate; use --max-mb-per-frame$", capsys.readouterr().err.strip())


def test_a_budget_that_cannot_be_met_is_told(
    moving: Any,
    moving_rig: Path,
    economical: EncodeSettings,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setitem(PRESETS, "economical", economical)
    arguments = [str(moving_rig), "-o", str(tmp_path / "x.dgs"), "--preset", "economical", "--holdout", "cam02", "-q"]
    arguments += ["--keyframe", str(moving.path), "--max-mb-per-frame"]
    assert encode_main([*arguments, "1"]) == 0
    assert capfd.readouterr().err == "", "less than asked for is no miss"
    assert encode_main([*arguments, "1e-5"]) == 0
    warning = capfd.readouterr().err
    assert warning.startswith("decogs-encode: warning: frames after the first take ")
    assert "% more than the budget of 10; raise the budget, or lower" in warning
    assert warning.count("\n") == 1


def test_lossless_writes_every_change_as_it_was_trained(
    encode: Any, moving: Any, moving_rig: Path, economical: EncodeSettings
) -> None:
    state, random = moving.states[0], np.random.default_rng(0)
    before, lattice = take_rows(state, np.arange(50)), default_lattice(1.0)
    values = dequantise(before, lattice)
    for array in vars(values).values():
        array += 1e-3 * random.standard_normal(array.shape).astype(np.float32)
    sensitivity = Splats(*(np.ones_like(array) for array in vars(values).values()))
    nearest = quantise(values, lattice, near=before)
    for settings, same in ((with_lossless(economical), True), (economical, False)):
        written = quantise_changes(values, before, lattice, sensitivity, settings.frame.significance)
        assert all(np.array_equal(array, getattr(nearest, name)) for name, array in vars(written).items()) == same
    given = {"keyframe": moving.path, "stop": 2}
    lossless = encode(moving_rig, settings=with_lossless(economical), **given)
    assert later(lossless)[0] > later(encode(moving_rig, settings=economical, **given))[0]
