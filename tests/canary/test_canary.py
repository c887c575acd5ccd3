"""The canary for quality: a change of what is encoded, or of how well, does not pass unseen.

When it is on purpose, ``python tests/canary/figures.py --write`` renews what is expected, after showing what changed.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from canary.figures import EXPECTED, TOLERANCE, WAYS, effects_of, measure
from canary.rigs import RIGS, write_rig

EXPECTATION: dict[str, Any] = json.loads(EXPECTED.read_text())


@pytest.fixture(scope="module", params=RIGS)
def rig(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Path]:
    return request.param, write_rig(request.param, tmp_path_factory.mktemp("canary") / request.param)


@pytest.mark.parametrize("way", WAYS)
def test_later_frames_are_what_they_were(rig: tuple[str, Path], way: str, tmp_path: Path) -> None:
    name, folder = rig
    expected, found = EXPECTATION[name][way], measure(name, way, folder, tmp_path)
    for what in ("held_out", "training"):
        assert found[what] == pytest.approx(expected[what], abs=TOLERANCE), what
    for what in ("kinds", "bytes", "digest"):
        assert found[what] == expected[what], what


def test_the_rig_calls_for_what_it_called_for(rig: tuple[str, Path]) -> None:
    name, folder = rig
    assert effects_of(folder) == EXPECTATION[name]["effects"]
