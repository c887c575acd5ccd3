"""The player's own unit tests, in Node."""

from __future__ import annotations

import pytest

from node_player import missing_for_player, run_player_tests


@pytest.mark.skipif(missing_for_player() is not None, reason=f"the player's unit tests need {missing_for_player()}")
def test_units() -> None:
    assert run_player_tests() > 0
