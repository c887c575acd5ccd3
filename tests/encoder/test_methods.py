"""Methods, selection rules and ablations as settings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from decogs.codec.scene.digest import digest
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import PRESETS, EncodeSettings
from decogs.encoder.change.selection import SELECTION_RULES
from decogs.encoder.job.switches import ABLATIONS, Switches, ablate, with_method, with_selection, with_switches
from decogs.encoder.methods import FRAME_METHODS
from decogs.formats.errors import UsageError


def test_the_names_users_know() -> None:
    assert FRAME_METHODS.names()[:3] == ("decogs", "paper", "3dgstream")
    assert ABLATIONS == ("select", "focus", "gate")
    assert SELECTION_RULES.names()[:2] == ("paper", "weight")


@pytest.mark.parametrize("name", PRESETS)
def test_a_switch_changes_its_own_setting_only(name: str) -> None:
    settings = PRESETS[name]
    assert with_method(settings, "3dgstream") == replace(settings, method="3dgstream")
    assert with_method(with_method(settings, "3dgstream"), settings.method) == settings
    for rule in SELECTION_RULES.names():
        selection = replace(settings.frame.selection, rule=rule)
        assert with_selection(settings, rule) == replace(settings, frame=replace(settings.frame, selection=selection))
    assert ablate(settings, []) == settings
    assert ablate(settings, ["gate"]) == replace(settings, frame=replace(settings.frame, ablated=("gate",)))


def test_ablations_add_up_whatever_their_order() -> None:
    everything = ablate(EncodeSettings(), ABLATIONS)
    assert (everything.frame.ablated, everything.frame.selection.rule) == (("focus", "gate"), "all")
    assert ablate(ablate(EncodeSettings(), ["gate", "select"]), ["focus", "gate"]) == everything


DENSE = EncodeSettings(method="3dgstream")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda: with_method(EncodeSettings(), "4dgs"), "`method` 4dgs: there is no such method; choose from decogs, "),
        (
            lambda: with_selection(EncodeSettings(), "most"),
            "`selection` most: there is no such selection rule; choose from paper, ",
        ),
        (lambda: ablate(EncodeSettings(), ["gate", "loss"]), "`ablate` loss: there is no such part; choose from sele"),
        (lambda: ablate(DENSE, ["focus"]), "`ablate` focus: `method` 3dgstream has no such part; drop one of the two"),
        (
            lambda: with_method(ablate(EncodeSettings(), ["focus"]), "3dgstream"),
            "`ablate` focus: `method` 3dgstream",
        ),
        (lambda: with_selection(DENSE, "paper"), "`selection` paper: `method` 3dgstream trains every Gaussian; drop"),
        (
            lambda: with_switches(EncodeSettings(), Switches(ablate=["select"], selection="paper")),
            "`selection` paper: `ablate` select takes every Gaussian; drop one of the two",
        ),
    ],
)
def test_what_does_not_exist_or_has_no_meaning_is_refused(change: Callable[[], object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        change()


def test_the_papers_method_encodes_from_any_preset(
    encode: Any, moving: Any, moving_rig: Path, tiny_settings: Any
) -> None:
    encoded = encode(moving_rig, settings=with_method(tiny_settings, "paper"), keyframe=moving.path)
    with open_stream(encoded.path) as stream:
        assert stream.header.settings["method"] == "paper"
    before, after = (encoded.report.frames[index].training_psnr for index in (0, 1))
    assert [each.kind for each in encoded.report.frames] == ["key", "delta", "skip", "delta"]
    assert after > before - 1, "what moved is followed"
    assert digest(encoded.states[1]) != digest(moving.states[1]), "by other steps than the default's"
