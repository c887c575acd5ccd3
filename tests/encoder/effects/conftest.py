"""Rigs for the analysis: the shared synthetic ones where they are, and pictures made here."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.encoder.effects.analysis import Analysis, analyse

RIGS = Path(__file__).resolve().parents[4] / "shared" / "data" / "rigs"


@dataclass(frozen=True)
class KnownRig:
    """A shared rig's analysis beside what its scene.json says; the product never reads that file."""

    analysis: Analysis
    truth: dict[str, Any]

    def true_frames(self, effect: str) -> tuple[int, int] | None:
        """First and last frame of an effect, over all its entries; None when the rig does not have it."""
        spans = [entry["frames"] for entry in self.truth["effects"] if entry["effect"] == effect]
        return (min(s[0] for s in spans), max(s[1] for s in spans)) if spans else None

    def true_cameras(self, effect: str) -> set[str]:
        entries = [entry for entry in self.truth["effects"] if entry["effect"] == effect]
        return {camera for entry in entries for camera in entry["cameras"]} - {self.truth["held_out"]}


@cache
def _known(name: str) -> KnownRig:
    truth = json.loads((RIGS / name / "scene.json").read_text())
    return KnownRig(analyse(RIGS / name, holdout=truth["held_out"]), truth)


@pytest.fixture(scope="session")
def known_rig() -> Callable[[str], KnownRig]:
    """Analyses a shared rig, once; skips where the rigs are not beside the checkout."""

    def known(name: str) -> KnownRig:
        if not (RIGS / name).is_dir():
            pytest.skip(f"the synthetic rig {name} is not at {RIGS}")
        return _known(name)

    return known


@pytest.fixture(scope="session")
def texture() -> np.ndarray:
    """A picture (120, 160, 3) uint8 with detail at several sizes and colours, from 40 to 200."""
    random = np.random.default_rng(3)
    picture = np.zeros((120, 160, 3), np.float32)
    for size in (4, 8, 16, 40):
        small = random.normal(0, 1, (120 // size + 2, 160 // size + 2, 3)).astype(np.float32)
        picture += cv2.resize(small, (160, 120), interpolation=cv2.INTER_CUBIC)
    return np.clip(120 + 25 * picture, 40, 200).astype(np.uint8)


@pytest.fixture(scope="session")
def with_noise() -> Callable[..., np.ndarray]:
    """Adds sensor noise of ``deviation`` levels to a picture, another for every ``seed``."""

    def noisy(picture: np.ndarray, seed: int, deviation: float = 1.2) -> np.ndarray:
        noise = np.random.default_rng(seed).normal(0, deviation, picture.shape)
        return np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8)

    return noisy
