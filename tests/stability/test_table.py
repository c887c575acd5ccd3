"""The table of hard cases (encoder/STABILITY.md) and the tests of this folder name each other."""

from __future__ import annotations

import ast
import re
from pathlib import Path

FOLDER = Path(__file__).parent
TABLE = FOLDER.parents[1] / "encoder" / "STABILITY.md"


def written() -> list[str]:
    """Names of all tests here, but for this file's."""
    files = [path for path in FOLDER.glob("test_*.py") if path != Path(__file__)]
    nodes = [node for path in files for node in ast.parse(path.read_text()).body]
    return sorted(node.name for node in nodes if isinstance(node, ast.FunctionDef) and node.name.startswith("test_"))


def rows() -> list[list[str]]:
    """The cells of every row."""
    lines = [line for line in TABLE.read_text().splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if not line.startswith("| case |")]


def test_every_row_names_a_test_that_exists_and_every_test_has_a_row() -> None:
    assert len(written()) > 40
    assert sorted(name for row in rows() for name in re.findall(r"`(test_\w+)`", row[-1])) == written()


def test_every_row_says_what_the_table_promises() -> None:
    for row in rows():
        assert len(row) == 3, row[0]
        assert all(row), row[0]
