"""Rigs for the analysis: the shared synthetic ones where they are, and pictures made for the tests."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import textured_pictures
from decogs.encoder.analysis.analyse import Analysis, analyse

texture, with_noise = textured_pictures.texture, textured_pictures.with_noise

_SHARED = Path(os.environ.get("DECOGS_SHARED", Path(__file__).resolve().parents[4] / "shared"))
RIGS = _SHARED / "data" / "rigs"


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
    return KnownRig(analyse(RIGS / name, holdout=[truth["held_out"]]), truth)


@pytest.fixture(scope="session")
def known_rig() -> Callable[[str], KnownRig]:
    """Analyses a shared rig, once; skips where the rigs are not beside the checkout."""

    def known(name: str) -> KnownRig:
        if not (RIGS / name).is_dir():
            pytest.skip(f"the synthetic rig {name} is not at {RIGS}")
        return _known(name)

    return known
