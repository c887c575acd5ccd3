"""The tables of the pages in report/ are filled from full reports: figures, errors, several rigs; other tables stay."""

from __future__ import annotations

import json
import runpy
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = "Before.\n\n<!-- table {} -->\n| old |\n<!-- end -->\n\nAfter.\n"


@pytest.fixture
def script() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "report" / "tables.py"))


@pytest.fixture
def full(tmp_path: Path) -> Path:
    """A report on two rigs; `b` has two seeds, and its second variant is the same run as its first."""

    def rig(*dynamic: float, **more: float) -> dict[str, Any]:
        rows = [
            {
                "variant": f"v{place}",
                "description": f"{place} steps",
                "figures": {"psnr_dynamic": value, "megabytes": 0.0079, **more},
            }
            for place, value in enumerate(dynamic)
        ]
        return {"questions": {"steps": rows, "other": rows[:1]}}

    report = {"rigs": {"a": rig(27.616, 27.5), "b": rig(30.0, 30.0, psnr_dynamic_error=0.126)}}
    (tmp_path / "some.json").write_text(json.dumps(report))
    return tmp_path


def table(text: str) -> list[str]:
    return [line for line in text.splitlines() if line.startswith("|")]


def test_a_question_gets_a_row_for_each_variant(script: dict[str, Any], full: Path) -> None:
    page = PAGE.format("some.json:a some.json:b | psnr_dynamic megabytes\nsteps:")
    made = script["filled"](page, full)
    assert table(made) == [
        "|  | `a`: dB where things move, kB | `b` |",
        "| --- | --- | --- |",
        "| 0 steps | 27.62, 7.9 | 30.00 ± 0.13, 7.9 |",
        "| 1 steps | 27.50, 7.9 | = |",
    ]
    assert made.startswith("Before.")
    assert made.endswith("After.\n")
    assert script["filled"](made, full) == made


def test_a_single_rig_gets_a_column_for_each_figure(script: dict[str, Any], full: Path) -> None:
    page = PAGE.format("some.json:b | psnr_dynamic mtv megabytes\nsteps:")
    assert table(script["filled"](page, full)) == [
        "|  | dB where things move | kB |",
        "| --- | --- | --- |",
        "| 0 steps | 30.00 ± 0.13 | 7.9 |",
        "| 1 steps | 30.00 ± 0.13 | 7.9 |",
    ]


def test_several_questions_get_a_row_each(script: dict[str, Any], full: Path) -> None:
    page = PAGE.format("some.json:a | psnr_dynamic\nsteps: training steps\nother: the other")
    assert table(script["filled"](page, full))[2:] == [
        "| training steps | 0 steps: 27.62<br>1 steps: 27.50 |",
        "| the other | 0 steps: 27.62 |",
    ]


def test_a_table_without_its_sources_stays(script: dict[str, Any], full: Path) -> None:
    page = PAGE.format("some.json:a gone.json:a | psnr_dynamic\nsteps:")
    assert script["filled"](page, full) == page


@pytest.mark.parametrize("comment", ["gone | psnr_dynamic\nsteps:", "a | gone\nsteps:", "a | psnr_dynamic\ngone:"])
def test_a_rig_figure_or_question_that_is_not_there_is_named(script: dict[str, Any], full: Path, comment: str) -> None:
    with pytest.raises(SystemExit, match="names 'gone', which its reports do not have"):
        script["filled"](PAGE.format(f"some.json:{comment}"), full)


def test_every_table_of_the_pages_has_known_figures_and_rows(script: dict[str, Any]) -> None:
    found = [
        table for page in sorted((ROOT / "report").glob("*.md")) for table in script["TABLE"].findall(page.read_text())
    ]
    assert len(found) >= 10
    for opening, _, keys, _, rows, _ in found:
        assert set(keys.split()) <= set(script["FIGURES"]), opening
        assert rows.count("\n|") >= 3, opening
