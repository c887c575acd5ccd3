"""Variants as plain data: what they change of the settings, and what cannot be."""

from __future__ import annotations

import re

import pytest

from decogs.bench.questions import choices, paper, rates
from decogs.bench.questions.variants import Question, Times, Variant, settings_of
from decogs.bench.tables.columns import COLUMNS
from decogs.encoder import PRESETS
from decogs.formats.errors import UsageError


def test_a_variant_without_anything_is_the_preset() -> None:
    assert settings_of(Variant("v", ""), "standard") == PRESETS["standard"]


def test_settings_are_replaced_or_multiplied_where_the_path_says() -> None:
    changes = {"frame.masks.threshold": 50.0, "frame.masks.radius_fraction": Times(2), "frame.rates": Times(0.5)}
    settings = settings_of(Variant("v", "", changes), "standard")
    before, after = PRESETS["standard"].frame, settings.frame
    assert after.masks.threshold == 50.0
    assert after.masks.radius_fraction == 2 * before.masks.radius_fraction
    assert after.masks.speck_area == before.masks.speck_area
    assert (after.rates.means, after.rates.sh_rest) == (before.rates.means / 2, before.rates.sh_rest / 2)
    assert settings.keyframe == PRESETS["standard"].keyframe


def test_a_count_stays_a_count() -> None:
    settings = settings_of(Variant("v", "", {"frame.joint_iterations": Times(0.5)}), "standard")
    assert settings.frame.joint_iterations == PRESETS["standard"].frame.joint_iterations // 2
    assert isinstance(settings.frame.joint_iterations, int)


def test_method_parts_and_rule_are_applied_on_top() -> None:
    assert settings_of(Variant("v", "", method="3dgstream"), "standard").method == "3dgstream"
    assert settings_of(Variant("v", "", ablate=("gate", "focus")), "standard").frame.ablated == ("focus", "gate")
    assert settings_of(Variant("v", "", selection="paper"), "standard").frame.selection.rule == "paper"
    finer = settings_of(Variant("v", "", quality=66, own_keyframe=True), "standard")
    assert finer.frame.significance.threshold == PRESETS["standard"].frame.significance.threshold / 2


def test_another_preset_trains_its_frames_but_shares_the_keyframe() -> None:
    shared = settings_of(Variant("v", "", preset="paper"), "draft")
    assert shared.frame == PRESETS["paper"].frame
    assert shared.keyframe == PRESETS["draft"].keyframe
    assert settings_of(Variant("v", "", preset="paper", own_keyframe=True), "draft") == PRESETS["paper"]


@pytest.mark.parametrize(
    ("variant", "message"),
    [
        (Variant("v", "", {"frame.tau": 1}), r"variant v: there is no setting 'frame\.tau'"),
        (Variant("v", "", {"frame.warm_start.share": 1}), r"variant v: there is no setting 'frame\.warm_start\.share'"),
        (Variant("v", "", {"keyframe.cap": 1}), r"variant v: changes keyframe\.cap but shares the keyframe"),
        (Variant("v", "", quality=30), "variant v: changes quality but shares the keyframe; set own_keyframe"),
        (Variant("v", "", preset="fast"), "`settings` fast: "),
        (Variant("v", "", method="3dgstream", ablate=("gate",)), "`ablate` gate: "),
    ],
)
def test_impossible_variants_are_refused(variant: Variant, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        settings_of(variant, "standard")


@pytest.mark.parametrize(
    "questions", [paper.QUESTIONS, choices.QUESTIONS, rates.QUESTIONS], ids=["paper", "choices", "rates"]
)
@pytest.mark.parametrize("preset", sorted(PRESETS))
def test_every_question_can_be_asked_of_every_preset(questions: tuple[Question, ...], preset: str) -> None:
    assert len({question.key for question in questions}) == len(questions)
    for question in questions:
        assert {key for columns in question.columns for key in columns} <= set(COLUMNS)
        for variant in question.variants:
            settings_of(variant, preset)
            assert re.fullmatch(r"[\w.-]+", variant.name), "names become file names"


@pytest.mark.parametrize(
    "questions", [paper.QUESTIONS, choices.QUESTIONS, rates.QUESTIONS], ids=["paper", "choices", "rates"]
)
def test_a_name_means_one_variant(questions: tuple[Question, ...]) -> None:
    by_name: dict[str, Variant] = {}
    for variant in (variant for question in questions for variant in question.variants):
        assert by_name.setdefault(variant.name, variant) == variant


def test_the_defaults_are_among_the_answers() -> None:
    """Each table of choices has the standard preset's own answer as a row, but for the keyframe's."""
    standard = PRESETS["standard"]
    for question in choices.QUESTIONS:
        assert standard in [settings_of(variant, "standard") for variant in question.variants], question.key
