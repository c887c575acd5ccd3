"""A report's tables for spreadsheets and papers: each as .csv and .tex, taken from the page, so that both say the same.

Needs nothing but the page's lines. LaTeX tables take the package ``booktabs``.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from decogs.formats.files.outputs import write_whole

_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_CELL = re.compile(r"(?<!\\)\|")
_WITH_ERROR = re.compile(r"(\S+) ± (\S+)")
_TEX = {"\\": r"\textbackslash{}"} | {character: f"\\{character}" for character in "&%$#_{}"}
_TEX |= {
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "±": r"$\pm$",
    "×": r"$\times$",
    "–": "--",
    "−": "$-$",
    "κ": r"$\kappa$",
}


class Table(NamedTuple):
    """A table under its ``name``; ``rows`` of cells as plain text, headings first."""

    name: str
    rows: list[list[str]]


def write_tables(lines: Sequence[str], folder: Path, page: str) -> None:
    """Writes every table of the ``page`` into the ``folder``, as PAGE-NAME.csv and .tex."""
    tables = list(tables_of(lines))
    if tables:
        folder.mkdir(exist_ok=True)
    for table in tables:
        write_whole(folder / f"{page}-{table.name}.csv", csv_text(table.rows).encode())
        write_whole(folder / f"{page}-{table.name}.tex", tex_text(table.rows).encode())


def tables_of(lines: Sequence[str]) -> Iterator[Table]:
    """The tables of a Markdown page, each named by the headings above it and, from the second on, a number."""
    headings, rows = dict[int, str](), list[list[str]]()
    used: dict[str, int] = {}
    for line in (*lines, ""):
        if line.startswith("|"):
            if not re.fullmatch(r"\|[-:| ]+\|", line):
                rows.append([_plain(cell) for cell in _CELL.split(line)[1:-1]])
            continue
        if rows:
            name = "-".join(map(_slug, filter(None, (headings.get(level) for level in (2, 3))))) or "table"
            used[name] = used.get(name, 0) + 1
            yield Table(name if used[name] == 1 else f"{name}-{used[name]}", rows)
            rows = []
        if heading := re.match(r"(#+) (.*)", line):
            level = len(heading[1])
            headings = {above: text for above, text in headings.items() if above < level} | {level: heading[2]}


def csv_text(rows: Sequence[Sequence[str]]) -> str:
    """RFC 4180; errors have columns of their own."""
    with_error = [any(_WITH_ERROR.fullmatch(row[column]) for row in rows[1:]) for column in range(len(rows[0]))]
    text = io.StringIO()
    writer = csv.writer(text)
    for number, row in enumerate(rows):
        cells = list[str]()
        for cell, has_error in zip(row, with_error, strict=True):
            found = _WITH_ERROR.fullmatch(cell) if number else None
            value, error = found.groups() if found else (cell, "" if number else f"{cell} ±".strip())
            cells += [value, error] if has_error else [cell]
        writer.writerow(cells)
    return text.getvalue()


def tex_text(rows: Sequence[Sequence[str]]) -> str:
    """A tabular; the first column to the left, figures to the right."""
    body = [" & ".join(map(_tex, row)) + r" \\" for row in rows]
    columns = "l" + "r" * (len(rows[0]) - 1)
    parts = [rf"\begin{{tabular}}{{{columns}}}", r"\toprule", body[0], r"\midrule", *body[1:], r"\bottomrule"]
    return "\n".join([*parts, r"\end{tabular}"]) + "\n"


def _plain(cell: str) -> str:
    return _LINK.sub(r"\1", cell).replace("\\|", "|").replace("**", "").replace("`", "").strip()


def _tex(cell: str) -> str:
    return "".join(_TEX.get(character, character) for character in cell)


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
