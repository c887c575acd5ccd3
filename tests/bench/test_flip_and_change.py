"""FLIP where its package is installed, and how far changes from frame to frame are those that were recorded."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from decogs.bench.measures import flip as flip_module
from decogs.bench.measures.flip import flip
from decogs.bench.measures.quality import METRICS
from decogs.bench.measures.shot import Shot

STAND_IN = """
def evaluate(reference, test, dynamic_range, applyMagma):
    assert dynamic_range == "LDR" and not applyMagma
    assert reference.dtype == test.dtype == "float32" and reference.shape == test.shape == (4, 5, 3)
    assert 0 <= reference.min() and reference.max() <= 1
    return None, float(reference.mean() - test.mean()), {}
"""


@pytest.fixture(autouse=True)
def _anew(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.delitem(sys.modules, "flip_evaluator", raising=False)
    flip_module._package.cache_clear()
    yield
    sys.modules.pop("flip_evaluator", None)
    flip_module._package.cache_clear()


def grey(level: int) -> np.ndarray:
    return np.full((4, 5, 3), level, np.uint8)


def test_without_its_package_there_is_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(flip_module.importlib.util, "find_spec", lambda name: None)
    assert flip(grey(0), grey(9)) is None
    assert METRICS["flip"].nothing == "not installed"


def test_the_recorded_picture_is_the_reference(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "flip_evaluator.py").write_text(STAND_IN)
    monkeypatch.syspath_prepend(str(tmp_path))
    assert flip(grey(51), grey(255)) == pytest.approx(0.8)


def test_its_own_package_finds_likes_alike() -> None:
    pytest.importorskip("flip_evaluator", reason="flip-evaluator is not installed (it is part of the extra 'bench')")
    random = np.random.default_rng(0)
    picture = random.integers(0, 255, (64, 80, 3)).astype(np.uint8)
    assert flip(picture, picture) == 0
    near, far = (flip(np.clip(picture + step, 0, 255).astype(np.uint8), picture) for step in (5.0, 80.0))
    assert near is not None and far is not None  # noqa: PT018
    assert 0 < near < far < 1


def test_what_lags_behind_is_an_error_of_change() -> None:
    """A constant error is none; half of a change of a tenth is 26 dB; outside of the region nothing counts."""
    dynamic = np.zeros((4, 5), bool)
    dynamic[:, :2] = True
    regions = SimpleNamespace(dynamic=dynamic, static=~dynamic)
    before, now = np.full((4, 5, 3), 100, np.uint8), np.full((4, 5, 3), 120, np.uint8)
    seen_before, seen = before + np.uint8(30), now + np.uint8(30)
    seen[:, 3:] = 0

    def change(shown: np.ndarray, shown_before: np.ndarray | None) -> float | None:
        shot = Shot(shown, now, shown_before, regions, None, None, before)  # type: ignore[arg-type]
        return METRICS["psnr_change"].value(shot)

    same = change(seen, seen_before)
    assert same is not None
    assert same > 90
    assert change(seen - np.uint8(10), seen_before) == pytest.approx(-20 * np.log10(10 / 255))
    assert change(seen, None) is None
