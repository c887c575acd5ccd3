"""From evidence to a decision: confidence and spans of frames."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.encoder.analysis.colour_drift import EXPOSURE_DRIFT, WHITE_BALANCE_DRIFT
from decogs.encoder.analysis.effect import Evidence, confidence, one_span


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
    assert one_span(stats, np.array([False, True, True, False, True])) == ((11, 22),)
    assert one_span(stats, np.array([True, False, False, False, False])) == ((10, 10),)
    assert one_span(stats, np.zeros(5, bool)) == ()


def test_drift_is_as_sure_as_its_evidence_and_untold_where_there_is_none() -> None:
    gains = np.zeros((1, 2, 3))
    gains[0, 1, 0] = 0.3
    for told, sure in ((np.abs(gains[..., 0]), 0.99), (np.full((1, 2), np.nan), 0.0)):
        stats = statistics_of((0, 1), cameras=1, light=SimpleNamespace(exposure=told, gains=gains))
        decision = EXPOSURE_DRIFT.decide(stats, EXPOSURE_DRIFT.evidence(stats))
        assert decision.confidence == pytest.approx(sure, abs=0.01)
        assert decision.detected == (sure > 0)
    stats = statistics_of((0, 1), cameras=1, light=SimpleNamespace(exposure=np.abs(gains[..., 0]), gains=gains))
    decision = EXPOSURE_DRIFT.decide(stats, EXPOSURE_DRIFT.evidence(stats))
    assert decision.figures["gain"]["cam00"] == pytest.approx([1.0, np.exp(0.3)])


def test_white_balance_drifts_by_red_or_blue() -> None:
    """cam01's blue falls in the last frame, cam00's hardly; brightness does not count."""
    gains = np.zeros((2, 3, 3))
    gains[:, :, 0] = 0.5
    gains[:, 2, 2] = -0.005, -0.1
    light = SimpleNamespace(white_balance=np.abs(gains[..., 2]), gains=gains)
    stats = statistics_of((0, 1, 2), cameras=2, light=light)
    decision = WHITE_BALANCE_DRIFT.decide(stats, WHITE_BALANCE_DRIFT.evidence(stats))
    assert (decision.cameras, decision.frames) == (("cam01",), ((2, 2),))
    assert decision.figures["red"] == {"cam01": [1.0, 1.0, 1.0]}
    assert decision.figures["blue"]["cam01"] == pytest.approx([1.0, 1.0, np.exp(-0.1)])
