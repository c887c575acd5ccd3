"""A report's tables as files for others: every figure of the page, once, in forms that spreadsheets and LaTeX read."""

from __future__ import annotations

import csv
import io
from pathlib import Path

from decogs.bench.reports.tables import csv_text, tables_of, tex_text, write_tables

PAGE = """\
# Choices, measured

## workbench

### Which rule selects?

| | dB | kB | how |
|---|--:|--:|--:|
| **weight** (the preset) | 29.46 ± .07 | 7.0 | [one](runs/a.json) |
| paper \\| 2 | 28.10 ± .20 | – | not run |

Some words.

| a | b_c |
| --- | ---: |
| 50 % & more | × 2 |

## popup

| x |
|---|
| 1 |
""".splitlines()


def test_tables_are_named_by_the_headings_above_them() -> None:
    names = [table.name for table in tables_of(PAGE)]
    assert names == ["workbench-which-rule-selects", "workbench-which-rule-selects-2", "popup"]
    assert next(tables_of(PAGE)).rows[1:] == [
        ["weight (the preset)", "29.46 ± .07", "7.0", "one"],
        ["paper | 2", "28.10 ± .20", "–", "not run"],
    ]


def test_errors_have_a_column_of_their_own() -> None:
    rows = list(csv.reader(io.StringIO(csv_text(next(tables_of(PAGE)).rows))))
    assert rows == [
        ["", "dB", "dB ±", "kB", "how"],
        ["weight (the preset)", "29.46", ".07", "7.0", "one"],
        ["paper | 2", "28.10", ".20", "–", "not run"],
    ]


def test_latex_has_nothing_that_it_would_take_for_a_command() -> None:
    _, table, _ = tables_of(PAGE)
    assert tex_text(table.rows) == (
        "\\begin{tabular}{lr}\n\\toprule\na & b\\_c \\\\\n\\midrule\n50 \\% \\& more & $\\times$ 2 \\\\\n"
        "\\bottomrule\n\\end{tabular}\n"
    )


def test_files(tmp_path: Path) -> None:
    write_tables(PAGE, tmp_path / "tables", "choices")
    assert len(list((tmp_path / "tables").glob("choices-*"))) == 6
    write_tables(["no table"], tmp_path / "none", "choices")
    assert not (tmp_path / "none").exists()
