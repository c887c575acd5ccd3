"""The picture of a frame's flow in CONTRIBUTING.md is what its script makes of imports and of the design's table."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def script() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "docs" / "frame_flow.py"))


def test_the_committed_picture_is_what_the_script_makes(script: dict[str, Any]) -> None:
    made = script["picture"]()
    assert script["PICTURE"].read_text("utf-8") == made, "run python docs/frame_flow.py and commit docs/frame_flow.svg"


def test_the_table_has_ten_steps_whose_marks_are_imports(script: dict[str, Any]) -> None:
    graph = script["grimp"].build_graph("decogs", cache_dir=None)
    steps = script["steps"]()
    assert [step.name.split()[0] for step in steps] == [str(number) for number in range(1, 11)]
    reading = script["uses"](graph, script["Step"]("1 read", "", ("rig/pictures/ingest.py",)))
    assert reading.at_home == {"rig"}
    assert {"formats", "decoder"} <= reading.others
    assert "training/" not in reading.others


def test_a_file_of_the_table_that_is_not_there_is_named(script: dict[str, Any]) -> None:
    graph = script["grimp"].build_graph("decogs", cache_dir=None)
    with pytest.raises(ValueError, match=r"input/gone\.py is not there"):
        script["uses"](graph, script["Step"]("1 read", "", ("input/gone.py",)))
