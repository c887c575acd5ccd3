"""From evidence to a decision: confidence, spans of frames, votes, and what is taken for granted."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.encoder.analysis.appearance_change import AppearanceChange
from decogs.encoder.analysis.effect import Evidence, confidence, one_span, seen_together, spans
from decogs.encoder.analysis.emergence import Emergence
from decogs.encoder.analysis.exposure_drift import ExposureDrift
from decogs.encoder.analysis.motion import Motion


def statistics_of(frames: tuple[int, ...], cameras: int = 3, **measured: Any) -> Any:
    names = tuple(f"cam{k:02d}" for k in range(cameras))
    return SimpleNamespace(names=names, cameras=names, frames=frames, **measured)


def peak(value: float) -> Evidence:
    return Evidence(np.array([[np.nan, value]]), "px", 2.0)


@pytest.mark.parametrize(("value", "sure"), [(2.0, 0.5), (6.0, 0.9), (2 / 3, 0.9), (0.0, 1.0), (np.nan, 0.0)])
def test_confidence_is_told_by_the_distance_from_the_limit(value: float, sure: float) -> None:
    assert confidence(peak(value)) == pytest.approx(sure)


def test_a_span_begins_right_after_the_last_frame_looked_at() -> None:
    stats = statistics_of((10, 13, 16, 19, 22))
    assert spans(stats, np.array([False, True, True, False, True])) == ((11, 16), (20, 22))
    assert spans(stats, np.array([True, False, False, False, False])) == ((10, 10),)


def test_pauses_are_closed_up_to_a_length() -> None:
    stats = statistics_of(tuple(range(8)))
    counts = np.array([0, 1, 0, 0, 1, 0, 0, 0], bool)
    assert spans(stats, counts, gap=1) == ((1, 1), (4, 4))
    assert spans(stats, counts, gap=2) == ((1, 4),)
    assert one_span(stats, counts) == ((1, 4),)


def test_one_camera_does_not_speak_for_the_scene_unless_it_is_alone() -> None:
    one_of_three = Evidence(np.array([[0, 5.0], [0, 0], [0, np.nan]]), "px", 2.0)
    assert seen_together(one_of_three).tolist() == [False, False]
    assert seen_together(Evidence(one_of_three.values[:1], "px", 2.0)).tolist() == [False, True]


@pytest.mark.parametrize(("effect", "details"), [(Motion(), ("restructured",)), (AppearanceChange(), ("alone",))])
def test_what_cannot_be_told_because_all_cameras_shake_is_taken_for_granted(effect: Any, details: Any) -> None:
    untold = np.full((3, 4), np.nan)
    evidence = Evidence(untold, "%", 15.0, dict.fromkeys(details, untold))
    decision = effect.decide(statistics_of((0, 1, 2, 3)), evidence)
    assert (decision.detected, decision.confidence) == (True, 0.0)
    assert decision.cameras == ("cam00", "cam01", "cam02")
    assert decision.frames == ((0, 3),)


def test_two_of_twelve_cameras_are_no_emergence_and_cameras_that_do_not_tell_make_it_less_sure() -> None:
    values = np.zeros((12, 3))
    values[:2, 1] = 100
    values[6:] = np.nan
    decision = Emergence().decide(statistics_of((0, 1, 2), cameras=12), Evidence(values, "%", 60.0))
    assert not decision.detected
    assert decision.confidence < 0.5
    values[2, 1] = 100
    decision = Emergence().decide(statistics_of((0, 1, 2), cameras=12), Evidence(values, "%", 60.0))
    assert decision.detected
    assert decision.frames == ((1, 1),)
    assert decision.confidence == pytest.approx(3 / 12 * confidence(Evidence(values, "%", 60.0)))


def test_drift_is_as_sure_as_its_evidence_and_untold_where_there_is_none() -> None:
    gains = np.zeros((1, 2, 3))
    gains[0, 1, 0] = 0.3
    for told, sure in ((np.abs(gains[..., 0]), 0.99), (np.full((1, 2), np.nan), 0.0)):
        stats = statistics_of((0, 1), cameras=1, light=SimpleNamespace(exposure=told, gains=gains))
        decision = ExposureDrift().decide(stats, ExposureDrift().evidence(stats))
        assert decision.confidence == pytest.approx(sure, abs=0.01)
        assert decision.detected == (sure > 0)
    stats = statistics_of((0, 1), cameras=1, light=SimpleNamespace(exposure=np.abs(gains[..., 0]), gains=gains))
    decision = ExposureDrift().decide(stats, ExposureDrift().evidence(stats))
    assert decision.figures["gain"]["cam00"] == pytest.approx([1.0, np.exp(0.3)])
