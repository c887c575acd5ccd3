"""What is built of the effects: the words of --effects, and that what is left out is not there to cost anything."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from decogs.decoder.reading.stream import open_stream
from decogs.encoder import PRESETS
from decogs.encoder.analysis import EFFECTS, Decision, EffectChoice, effect_choice, with_effects
from decogs.encoder.methods.paper import PaperTrainer
from decogs.encoder.settings.effects import CAMERA_EFFECTS, EFFECT_NAMES, FRAME_EFFECTS, KEYFRAME_EFFECTS, RIG_EFFECTS
from decogs.encoder.settings.encode import EncodeSettings
from decogs.encoder.settings.frame import EmergenceSettings, FrameSettings
from decogs.encoder.training.method import FrameInput, FrameMethod, TrainedFrame
from decogs.formats.errors import UsageError
from decogs.formats.stream.container import PacketKind

STANDARD = PRESETS["standard"]


def decisions(*detected: str, cameras: tuple[str, ...] = ("cam01",), **figures: Any) -> list[Decision]:
    return [
        Decision(
            effect=effect.name,
            detected=effect.name in detected,
            confidence=1.0,
            cameras=cameras if effect.name in detected else (),
            frames=(),
            reason="",
            cost="",
            figures=figures,
        )
        for effect in EFFECTS
    ]


def built(text: str, found: Sequence[Decision] = (), settings: EncodeSettings = STANDARD) -> EncodeSettings:
    return with_effects(settings, effect_choice(text), ["cam01", "cam02"], lambda: found)


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("auto", EffectChoice("auto")),
        ("all", EffectChoice("all")),
        ("none", EffectChoice("none")),
        ("motion, emergence", EffectChoice("none", frozenset({"motion", "emergence"}))),
        ("auto,-camera_shake", EffectChoice("auto", dropped=frozenset({"camera_shake"}))),
        ("-motion", EffectChoice("auto", dropped=frozenset({"motion"}))),
        (" -camera_shake", EffectChoice("auto", dropped=frozenset({"camera_shake"}))),
        ("\t-camera_shake , auto\n", EffectChoice("auto", dropped=frozenset({"camera_shake"}))),
        ("motion,,", EffectChoice("none", frozenset({"motion"}))),
    ],
)
def test_words(text: str, wanted: EffectChoice) -> None:
    assert effect_choice(text) == wanted


@pytest.mark.parametrize("text", ["movement", "auto,-movement", "motion auto", "-", "--motion"])
def test_unknown_words_are_refused(text: str) -> None:
    with pytest.raises(UsageError, match=rf"`effects` (auto,)?{text}: there is no effect"):
        effect_choice(text)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "it names no effect"),
        (" , ", "it names no effect"),
        ("motion,motion", "motion is named twice"),
        ("auto,all", "auto and all exclude each other"),
        ("auto,motion,-motion", "motion is both enabled and disabled"),
        ("none,-motion", "-motion disables what is not enabled"),
        ("emergence,-motion", "-motion disables what is not enabled"),
    ],
)
def test_what_states_nothing_or_contradicts_itself_is_refused(text: str, problem: str) -> None:
    with pytest.raises(UsageError, match=f"^`effects` .*{problem}; give auto, all, none, or names"):
        effect_choice(text)


@pytest.mark.parametrize("text", ["high_dynamic_range", "auto,-high_dynamic_range"])
def test_a_former_name_is_refused_with_what_to_write(text: str) -> None:
    with pytest.raises(
        UsageError, match=f"^`effects` {text}: high_dynamic_range is no effect any more: .*; leave it out$"
    ):
        effect_choice(text)


def test_a_choice_of_effects_is_checked_and_says_itself() -> None:
    with pytest.raises(UsageError, match="there is no effect 'some'; choose auto, all, none or from motion"):
        EffectChoice("some")
    assert str(EffectChoice("auto", dropped={"camera_shake"})) == "auto,-camera_shake"
    assert str(EffectChoice("none", {"motion", "emergence"})) == "emergence,motion"
    assert str(EffectChoice("none")) == "none"


def test_auto_asks_every_frame_and_takes_what_the_scene_calls_for() -> None:
    settings = built("auto", decisions("exposure_drift"))
    assert settings.detect_per_frame
    assert settings.effects == (*FRAME_EFFECTS, "exposure_drift", *KEYFRAME_EFFECTS, *RIG_EFFECTS)
    assert settings.corrections.exposure == ("cam01",)
    assert settings.keyframe.sh_degree == STANDARD.keyframe.sh_degree, "the keyframe decides"
    plain = built("auto,-exposure_drift", decisions("exposure_drift")).corrections
    assert plain == replace(STANDARD.corrections, standing_bands=True), "which the keyframe looks for"
    assert built("auto,-lamp_flicker", decisions()).corrections == STANDARD.corrections


def test_where_most_cameras_drift_all_are_corrected() -> None:
    both = decisions("exposure_drift", "camera_shake", cameras=("cam01", "cam02"))
    assert with_effects(
        STANDARD, EffectChoice("auto"), ["cam01", "cam02", "cam03"], lambda: both
    ).corrections.exposure == (
        "cam01",
        "cam02",
        "cam03",
    )
    few = with_effects(STANDARD, EffectChoice("auto"), [f"cam{i:02}" for i in range(1, 5)], lambda: both).corrections
    assert few.exposure == few.shake == ("cam01", "cam02")


def test_a_rig_that_calls_for_nothing_changes_nothing_that_the_preset_has() -> None:
    settings = built("auto", decisions())
    plain = replace(settings.corrections, standing_bands=False)
    assert replace(settings, effects=STANDARD.effects, detect_per_frame=False, corrections=plain) == STANDARD


def test_a_fixed_choice_does_not_look_at_the_rig() -> None:
    def looked() -> Sequence[Decision]:
        raise AssertionError("the rig was looked at")

    for text in ("none", "motion,view_dependence", ",".join(FRAME_EFFECTS)):
        settings = with_effects(STANDARD, effect_choice(text), ["cam01"], looked)
        assert not settings.detect_per_frame
        assert settings.corrections == replace(STANDARD.corrections, falloff=False, rolling_shutter=False)
    sought = with_effects(STANDARD, effect_choice("lens_falloff,rolling_shutter"), ["cam01"], looked)
    assert sought.corrections == STANDARD.corrections


@pytest.mark.parametrize("name", [*CAMERA_EFFECTS, "sensor_noise", *KEYFRAME_EFFECTS, *RIG_EFFECTS, *FRAME_EFFECTS])
def test_every_effect_can_be_left_out(name: str) -> None:
    everything = built("all", decisions(*EFFECT_NAMES, k1={"cam01": -0.1}, min_threshold={"cam01": 12.0}))
    without = built(f"-{name}", decisions(*EFFECT_NAMES, k1={"cam01": -0.1}, min_threshold={"cam01": 12.0}))
    assert name not in without.effects
    assert without != replace(everything, effects=without.effects), "leaving it out changes what is done"


def test_none_trains_nothing(encode: Any, moving_rig: Path, tiny_settings: Any) -> None:
    encoded = encode(moving_rig, settings=built("none", settings=tiny_settings))
    assert {frame.kind for frame in encoded.report.frames[1:]} == {"skip"}
    assert not any({"training", "selection", "effects"} & frame.seconds.keys() for frame in encoded.report.frames)
    with open_stream(encoded.path) as stream:
        assert stream.header.effects == ()
        assert [frame.kind for frame in stream.frames()][1:] == [PacketKind.SKIP] * (len(encoded.report.frames) - 1)


def test_a_change_of_light_builds_no_cache_and_seeks_nothing_new(
    encode: Any, moving_rig: Path, moving: Any, tiny_settings: Any
) -> None:
    """Even where the preset has all of it."""
    stages, given = set[str](), list[FrameSettings]()

    class Noted(PaperTrainer):
        def train(self, frame: FrameInput, /) -> TrainedFrame:
            given.append(frame.settings)
            return super().train(frame)

    frame = replace(PRESETS["paper"].frame, masks=tiny_settings.frame.masks, warm_start=0.9)
    settings = replace(tiny_settings, method="paper", frame=replace(frame, emergence=EmergenceSettings()))
    encoded = encode(
        moving_rig,
        settings=built("appearance_change", settings=settings),
        keyframe=moving.path,
        context=lambda context: replace(
            context, method=FrameMethod(Noted), on_loss=lambda stage, *_: stages.add(stage)
        ),
    )
    assert stages == {"joint"}, "no cache is trained"
    assert given
    for asked in given:
        assert (asked.rates.means, asked.grow_fraction, asked.emergence.max_seeds, asked.warm_start) == (0, 0, 0, 0)
    deltas = [frame for frame in encoded.report.frames if frame.kind == "delta"]
    assert deltas
    for frame in deltas:
        assert frame.effects == ["appearance_change"]
        spent = {name for name, size in frame.costs.items() if size > 1 and name not in ("header", "index")}
        assert spent <= {"opacity_logits", "sh_dc", "sh_rest"}, "no byte for what does not move, but one that says none"
