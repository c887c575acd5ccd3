"""The named settings: what they are called, that they can be written down, and that ``paper`` is the paper's."""

from __future__ import annotations

import json

import pytest

from decogs.encoder import PRESETS, EncodeSettings
from decogs.encoder.methods.paper.stages import CACHE_ITERATIONS
from decogs.encoder.settings.presets import LADDER, preset
from decogs.encoder.training.method import GROW_GRADIENT
from decogs.formats.errors import UsageError


def test_the_names_users_know() -> None:
    assert list(PRESETS) == ["live", "draft", "standard", "high", "archive", "paper"]
    for name, settings in PRESETS.items():
        assert preset(name) is settings


def test_an_unknown_name_is_answered_with_those_there_are() -> None:
    with pytest.raises(
        UsageError,
        match=r"`settings` fast: there is no such preset; choose from live, draft, standard, high, archive, paper",
    ):
        preset("fast")


@pytest.mark.parametrize("name", PRESETS)
def test_settings_are_plain_json_that_says_everything(name: str) -> None:
    document = PRESETS[name].as_document()
    assert json.loads(json.dumps(document, allow_nan=False)) == document
    assert document["keyframe"]["iterations"] == PRESETS[name].keyframe.iterations
    assert document["frame"]["masks"]["threshold"] == PRESETS[name].frame.masks.threshold
    assert EncodeSettings().as_document().keys() == document.keys()


def test_settings_tell_of_the_method_in_use_and_not_of_the_other() -> None:
    ours, dense = (EncodeSettings(method=method).as_document() for method in ("decogs", "3dgstream"))
    assert (ours["method"], dense["method"]) == ("decogs", "3dgstream")
    assert set(ours) - set(dense) == {"frame"}
    assert set(dense) < set(ours)


def test_paper_holds_the_papers_numbers() -> None:
    """docs/METHOD.md: the DecoGS paper's defaults."""
    paper = PRESETS["paper"].frame
    assert (paper.masks.threshold, paper.masks.radius(1352), paper.masks.speck_area) == (25.0, 48, 0)
    assert (paper.selection.rule, paper.selection.min_views) == ("paper", 2)
    assert (CACHE_ITERATIONS, paper.joint_iterations) == (150, 100)
    assert (GROW_GRADIENT, paper.focus.dissimilarity) == (1e-4, 0.2)


def test_paper_is_the_papers_method_with_the_texts_reading_of_its_loss() -> None:
    """docs/METHOD.md lists what differs from the text all the same."""
    frame = PRESETS["paper"].frame
    assert (PRESETS["paper"].method, frame.focus.over) == ("paper", "picture")
    assert {PRESETS[name].method for name in LADDER} == {"decogs"}
    assert (frame.emergence.max_seeds, frame.warm_start, frame.masks.since_trained) == (0, 0.0, False)
