"""Methods and ablations as settings, and what leaving out the selection does to an encode."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from decogs.decoder.stream import open_stream
from decogs.encoder import PRESETS, EncodeSettings
from decogs.encoder.change.selection import SELECTION_RULES
from decogs.encoder.methods import FRAME_METHODS
from decogs.encoder.switches import ABLATIONS, with_method, with_selection, without
from decogs.formats.errors import UsageError


def test_the_names_users_know() -> None:
    assert FRAME_METHODS.names() == ("decogs", "3dgstream")
    assert ABLATIONS == ("select", "focus", "gate")
    assert SELECTION_RULES.names() == ("paper", "weight")


@pytest.mark.parametrize("name", PRESETS)
def test_a_switch_changes_its_own_setting_only(name: str) -> None:
    settings = PRESETS[name]
    assert with_method(settings, "3dgstream") == replace(settings, method="3dgstream")
    assert with_method(with_method(settings, "3dgstream"), "decogs") == settings
    for rule in SELECTION_RULES.names():
        selection = replace(settings.frame.selection, rule=rule)
        assert with_selection(settings, rule) == replace(settings, frame=replace(settings.frame, selection=selection))
    assert without(settings, []) == settings
    assert without(settings, ["gate"]) == replace(settings, frame=replace(settings.frame, ablated=("gate",)))


def test_ablations_add_up_whatever_their_order() -> None:
    everything = without(EncodeSettings(), ABLATIONS)
    assert everything.frame.ablated == ABLATIONS
    assert without(without(EncodeSettings(), ["gate", "select"]), ["focus", "gate"]) == everything


DENSE = EncodeSettings(method="3dgstream")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: with_method(EncodeSettings(), "4dgs"), "`method` 4dgs: there is no such method; choose from decogs, "),
        (
            lambda: with_selection(EncodeSettings(), "all"),
            "`selection` all: there is no such selection rule; choose from paper, ",
        ),
        (lambda: without(EncodeSettings(), ["gate", "loss"]), "`ablate` loss: there is no such part; choose from sele"),
        (lambda: without(DENSE, ["focus"]), "`ablate` focus: `method` 3dgstream has no such part; drop one of the two"),
        (lambda: with_method(without(EncodeSettings(), ["focus"]), "3dgstream"), "`method` 3dgstream: it has no focus"),
        (lambda: with_selection(DENSE, "paper"), "`selection` paper: `method` 3dgstream trains every Gaussian; drop"),
        (
            lambda: with_selection(without(EncodeSettings(), ["select"]), "paper"),
            "`selection` paper: `ablate` select takes every Gaussian; drop one of the two",
        ),
    ],
)
def test_what_does_not_exist_or_has_no_meaning_is_refused(change: Callable[[], object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        change()


def test_without_the_selection_all_are_trained_where_pictures_changed(
    encode: Any, moving: Any, moving_rig: Path, tiny_settings: Any
) -> None:
    encoded = encode(moving_rig, settings=without(tiny_settings, ["select"]), keyframe=moving.path)
    assert [frame.selected for frame in encoded.report.frames] == [1, 1, 0, 1]
    assert [frame.kind for frame in encoded.report.frames] == ["key", "delta", "skip", "delta"]
    assert encoded.selected == {}, "no rule is asked"
    with open_stream(encoded.path) as ablated, open_stream(moving.path) as whole:
        counts = [next(stream.frames(1, 2)).changes.touched for stream in (ablated, whole)]
    # Almost all move: only a change of less than half a lattice step is none.
    assert counts[0] > 0.9 * len(encoded.states[0]) > 2 * counts[1]
