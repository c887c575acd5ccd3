"""No change makes a sample rig larger, worse or slower than the last release had it, unless release.json says so."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from release_figures import RIGS, figures

RELEASE: dict[str, dict[str, float]] = json.loads(Path(__file__).with_name("release.json").read_text())
MOST_BYTES = 1.03
"""Other processors round otherwise: bytes of one encode differ by a percent between them."""
LEAST_PSNR = -0.5
"""Another processor rounds otherwise, and one camera of one keyframe had up to .48 dB more or less for it."""
MOST_CPU = 1.5
"""Yardstick and encode differ by a quarter from run to run where others use the machine, too."""


def test_every_sample_rig_has_figures() -> None:
    assert set(RELEASE) == set(RIGS)


def test_the_bundled_rig() -> None:
    held_to("workbench", Path(__file__).parents[1] / "demo" / "workbench")


@pytest.mark.slow
@pytest.mark.parametrize("rig", [name for name in RIGS if name != "workbench"])
def test_the_other_sample_rigs(rig: str, shared_data: Any) -> None:
    held_to(rig, shared_data(f"rigs/{rig}"))


def held_to(rig: str, path: Path) -> None:
    was, now = RELEASE[rig], figures(path)
    told = f"{rig} was {was}, is {now}"
    assert now["first_bytes"] <= MOST_BYTES * was["first_bytes"], told
    assert now["later_bytes"] <= MOST_BYTES * was["later_bytes"], told
    assert now["psnr"] >= was["psnr"] + LEAST_PSNR, told
    assert now["cpu"] <= MOST_CPU * was["cpu"], told
