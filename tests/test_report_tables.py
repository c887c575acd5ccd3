"""The tables of README.md and of the pages in report/ are made of the reports' figures, and say what these say."""

from __future__ import annotations

import json
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

from decogs.bench.reports.report import PLANS

ROOT = Path(__file__).resolve().parents[1]
PAGE = "Before.\n\n<!-- {} -->\n| old |\n<!-- end -->\n\nAfter.\n"


@pytest.fixture
def script() -> dict[str, Any]:
    return runpy.run_path(str(ROOT / "report" / "tables.py"))


def rig(*dynamic: float, **more: float) -> dict[str, Any]:
    """A report's rig: a variant for each figure; the second one has differences to the first."""
    rows: list[dict[str, Any]] = [
        {
            "variant": f"v{place}",
            "description": f"{place} steps",
            "figures": {"psnr_dynamic": value, "megabytes": 0.0079, "mtv": 0.1 + place, "cpu": 2.0 + place, **more},
        }
        for place, value in enumerate(dynamic)
    ]
    rows[-1]["differences"] = {
        "psnr_dynamic": {"mean": -0.12, "error": 0.04},
        "megabytes": {"mean": 3.2, "error": 1.0},
        "cpu": {"mean": -7.0, "error": None},
    }
    return {"questions": {"steps": rows, "other": rows[:1]}}


@pytest.fixture
def full(tmp_path: Path) -> Path:
    """What pages cite of reports on two rigs; `b` has two seeds, and both its variants are the same run."""
    rigs = {"some/a": rig(27.616, 27.5), "some/b": rig(30.0, 30.0, psnr_dynamic_error=0.126)}
    (tmp_path / "some").mkdir()
    for number, (source, figures) in enumerate(rigs.items()):
        made = {"commit": "abc", "day": f"2026-01-0{number + 1}", "machine": "2 cores", "processor_seconds": 90}
        (tmp_path / f"{source}.json").write_text(json.dumps({"made": made, "rig": figures}))
    return tmp_path


def table(text: str) -> list[str]:
    return text.split("-->\n")[1].split("\n<!-- end")[0].splitlines()


def test_a_question_gets_a_row_for_each_variant(script: dict[str, Any], full: Path) -> None:
    page = PAGE.format("table some/a some/b | psnr_dynamic megabytes\nsteps:")
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
    page = PAGE.format("table some/b | psnr_dynamic flip megabytes\nsteps:")
    assert table(script["filled"](page, full)) == [
        "|  | dB where things move | kB |",
        "| --- | --- | --- |",
        "| 0 steps | 30.00 ± 0.13 | 7.9 |",
        "| 1 steps | 30.00 ± 0.13 | 7.9 |",
    ]


def test_several_questions_get_a_row_each(script: dict[str, Any], full: Path) -> None:
    page = PAGE.format("table some/a | psnr_dynamic\nsteps: training steps\nother: the other")
    assert table(script["filled"](page, full))[2:] == [
        "| training steps | 0 steps: 27.62<br>1 steps: 27.50 |",
        "| the other | 0 steps: 27.62 |",
    ]


def test_a_variant_gets_a_row_for_each_rig(script: dict[str, Any], full: Path) -> None:
    page = PAGE.format("rigs some/a some/b | psnr_dynamic megabytes\nsteps/v1:")
    assert table(script["filled"](page, full)) == [
        "|  | dB where things move | kB |",
        "| --- | --- | --- |",
        "| `a` | 27.50 | 7.9 |",
        "| `b` | 30.00 ± 0.13 | 7.9 |",
    ]


def test_differences_beyond_two_errors_are_bold(script: dict[str, Any], full: Path) -> None:
    page = PAGE.format("differences some/a some/b |\nsteps:")
    assert table(script["filled"](page, full)) == [
        "|  | `a` | `b` |",
        "| --- | --- | --- |",
        "| 1 steps | **-0.12 ± 0.04**, +3 %, -7 % | **-0.12 ± 0.04**, +3 %, -7 % |",
    ]


def test_one_variant_against_another(script: dict[str, Any], full: Path) -> None:
    page = PAGE.format("against some/a |\nsteps/v0:\nsteps/v1:")
    assert table(script["filled"](page, full))[2:] == ["| `a` | +0.12 | 1/11 | 1/1.5 | 1/1 |"]


def test_what_made_the_figures_is_one_line(script: dict[str, Any], full: Path) -> None:
    line = "*Made 2026-01-01 to 2026-01-02 by commit abc on 2 cores: 3 processor minutes of encoding.*"
    assert table(script["filled"](PAGE.format("made some/a some/b"), full)) == [line]


def test_a_figure_within_a_sentence(script: dict[str, Any], full: Path) -> None:
    opening = "<!--= some/a psnr_dynamic steps/v"
    page = f"A {opening}0 -->?<!--/-->, B {opening}1 - steps/v0 --><!--/-->."
    made = script["filled"](page, full)
    assert made == page.replace("?", "27.62").replace("--><!--/-->.", "-->-0.12<!--/-->.")
    assert script["filled"](made, full) == made


@pytest.mark.parametrize(
    "comment", ["some/gone | psnr_dynamic\nsteps:", "some/a | gone\nsteps:", "some/a | psnr_dynamic\ngone:"]
)
def test_a_rig_figure_or_question_that_is_not_there_is_named(script: dict[str, Any], full: Path, comment: str) -> None:
    with pytest.raises(SystemExit, match=r"gone.*, which its reports do not have"):
        script["filled"](PAGE.format(f"table {comment}"), full)


def test_what_is_kept_is_what_pages_cite(script: dict[str, Any]) -> None:
    kept: dict[str, Any] = {"questions": {}}
    page = PAGE.format("table some/a | psnr_dynamic\nsteps:")
    (found,) = script["TABLE"].finditer(page)
    script["keep_rows"](rig(27.616, 27.5), kept, script["table_of"](found))
    assert kept["questions"] == {
        "steps": [
            {"variant": "v0", "description": "0 steps", "figures": {"psnr_dynamic": 27.616}},
            {"variant": "v1", "description": "1 steps", "figures": {"psnr_dynamic": 27.5}},
        ]
    }


def test_a_picture_is_that_of_the_report_it_names(script: dict[str, Any], full: Path) -> None:
    page = "![a](pictures/some/a/a-rates.png) ![b](pictures/old.png) [c](pictures/some/a/c)"
    ((made, shown), (other, _)) = script["pictures"](page, full)
    assert made == full / "some" / "a" / "pictures" / "a-rates.png"
    assert shown == ROOT / "report" / "pictures" / "some" / "a" / "a-rates.png"
    assert other.name == "c"


def test_every_table_says_what_its_runs_say(script: dict[str, Any]) -> None:
    for page in script["pages"]():
        text = page.read_text("utf-8")
        assert script["filled"](text) == text, (
            f"{page.name}: its tables are not of report/figures; run report/tables.py"
        )


def test_the_browsable_report_has_every_page_and_needs_no_other_file() -> None:
    browse = runpy.run_path(str(ROOT / "report" / "browse.py"))
    pages = {page.stem for page in (ROOT / "report").glob("*.md")}
    text = browse["whole"]()
    assert set(re.findall(r'<section id="(\w+)"', text)) == pages
    assert {target.removeprefix("#") for target in re.findall(r'href="(#\w+)"', text)} == pages
    assert all(source.startswith("data:") for source in re.findall(r'src="([^"]*)"', text))
    assert "<table>" in text
    assert "<!--" not in text


def test_every_run_asks_for_parts_that_there_are(script: dict[str, Any]) -> None:
    make = runpy.run_path(str(ROOT / "report" / "make.py"))
    made = {f"{runs.name}/{rig.name}" for runs in make["RUNS"] for rig in runs.rigs}
    cited = {source for table in script["tables"](script["pages"]()) for source in table.sources}
    assert cited <= made
    for runs in make["RUNS"]:
        plan = PLANS[runs.kind]
        assert set(runs.only) <= {question.key for question in plan.questions}
