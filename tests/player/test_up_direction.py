"""The player finds the same way up as the exports: the cases in player/tests/camera/up_cases.json hold for both."""

from __future__ import annotations

import json

import numpy as np
import pytest

from decogs.decoder.cameras.moves import looked_at
from decogs.formats.cameras import Camera
from decogs.formats.geometry.up_direction import up_of
from node import PLAYER, run_player_tests

CASES = json.loads((PLAYER / "tests/camera/up_cases.json").read_text())


def camera(rows: list[list[float]]) -> Camera:
    return Camera("c", 64, 48, 60.0, 60.0, 32.0, 24.0, np.vstack([rows, [0, 0, 0, 1]]))


@pytest.mark.parametrize("case", CASES, ids=[case["name"] for case in CASES])
def test_the_cases_are_what_python_says(case: dict[str, object]) -> None:
    cameras = tuple(camera(rows) for rows in case["cameras"])  # type: ignore[attr-defined]
    np.testing.assert_allclose(up_of(cameras), case["up"], atol=1e-9)
    if case["looked_at"] is not None:  # a rig of one place has no such point, and the player needs one
        np.testing.assert_allclose(looked_at(cameras), case["looked_at"], atol=1e-6)


def test_the_player_says_the_same() -> None:
    run_player_tests("up_direction")
