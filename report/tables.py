"""Fills tables and pictures of the pages in this folder from the full reports, as the last step of `make report`.

    .venv/bin/python report/tables.py [FULL]        FULL: where they are, report/full

A table stands between two comments. The first one says where its figures come from (files and rigs), which figures, and
beneath them the questions of the report, each with its name here. A table with sources that are not there stays.

    <!-- table choices.json:workbench | psnr_dynamic last_dynamic megabytes
    warm-start: warm start
    beta: weights of whole picture and focus -->
    <!-- end -->

A question with a name gets one row; of one without, each variant gets a row.
"""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
TABLE = re.compile(r"(<!-- table ([^|]+)\|([^\n]+)\n(.*?)-->\n)(.*?)(<!-- end -->)", re.DOTALL)


@dataclass(frozen=True)
class Figure:
    """Its unit as a heading says it, and how it is written."""

    heading: str
    write: Callable[[float], str]


def kilobytes(megabytes: float) -> str:
    return f"{1000 * megabytes:.{1 if megabytes < 0.1 else 0}f}"


FIGURES = {
    "psnr": Figure("dB of the whole picture", "{:.2f}".format),
    "psnr_aligned": Figure("dB of the whole picture", "{:.2f}".format),
    "psnr_dynamic": Figure("dB where things move", "{:.2f}".format),
    "psnr_static": Figure("where nothing does", "{:.2f}".format),
    "last_dynamic": Figure("last frame", "{:.2f}".format),
    "psnr_subject": Figure("of the subject", "{:.2f}".format),
    "mtv": Figure("flicker", "{:.4f}".format),
    "cpu": Figure("CPU-s", "{:.2f}".format),
    "megabytes": Figure("kB", kilobytes),
    "keyframe_bytes": Figure("kB of the keyframe", kilobytes),
    "keyframe_seconds": Figure("s of the keyframe", "{:.0f}".format),
    "first_bytes": Figure("kB of the first frame", lambda size: kilobytes(size / 1e6)),
    "first_seconds": Figure("s to it at 2 Mbit/s", "{:.1f}".format),
    "later_bytes": Figure("kB", lambda size: kilobytes(size / 1e6)),
    "read_ms": Figure("CPU-ms to read a frame", "{:.0f}".format),
    "gaussians": Figure("Gaussians", lambda count: f"{count:,.0f}".replace(",", " ")),
    "decode_fps": Figure("decoded frames a second", "{:.0f}".format),
    "selected": Figure("selected", "{:.1%}".format),
}
"""Those of a report's JSON that tables here have; bytes and CPU-s are per later frame."""


def filled(page: str, full: Path) -> str:
    """The page with each table made anew whose sources are all in ``full``."""

    def table(found: re.Match[str]) -> str:
        opening, sources, keys, names, _, end = found.groups()
        reports = [source.rsplit(":", 1) for source in sources.split()]
        if not all((full / file).exists() for file, _ in reports):
            return found[0]
        questions = dict(tuple(line.partition(":")[::2]) for line in names.strip().splitlines())
        try:
            rigs = {rig: json.loads((full / file).read_text("utf-8"))["rigs"][rig] for file, rig in reports}
            return opening + "\n".join(lines(rigs, questions, keys.split())) + "\n" + end
        except KeyError as unknown:
            raise SystemExit(f"{opening}names {unknown}, which its reports do not have; correct it") from None

    return TABLE.sub(table, page)


def lines(rigs: dict[str, dict[str, Any]], questions: dict[str, str], keys: list[str]) -> list[str]:
    """A table with a column for each rig, of one rig for each figure, where questions have no names.

    ``questions``: by their keys, their names here; ``keys``: of FIGURES.
    """
    named = any(name.strip() for name in questions.values())
    if len(rigs) == 1 and not named:
        return by_figure(*rigs.values(), questions, keys)
    units = ", ".join(FIGURES[key].heading for key in keys)
    headings = [f"`{rig}`" + (f": {units}" if number == 0 else "") for number, rig in enumerate(rigs)]
    if named:
        rows = [[name.strip(), *(variants(rig, key, keys) for rig in rigs.values())] for key, name in questions.items()]
    else:
        rows = [row for key in questions for row in row_each(rigs, key, keys)]
    return ["| " + " | ".join(row) + " |" for row in [["", *headings], ["---"] * (len(rigs) + 1), *rows]]


def variants(rig: dict[str, Any], question: str, keys: list[str]) -> str:
    """All variants in one cell, a line each."""
    return "<br>".join(f"{row['description']}: {cell(row, keys)}" for row in rows_of(rig, question))


def by_figure(rig: dict[str, Any], questions: dict[str, str], keys: list[str]) -> list[str]:
    """A row for each variant, a column for each figure that any of them has."""
    rows = {identity(row): row for question in questions for row in rows_of(rig, question) if "figures" in row}
    units = {key: FIGURES[key].heading for key in keys}
    shown = [key for key in keys if any(row["figures"].get(key) is not None for row in rows.values())]
    cells = [[row["description"], *(written(row["figures"], key) for key in shown)] for row in rows.values()]
    headings = ["", *(units[key] for key in shown)]
    return ["| " + " | ".join(row) + " |" for row in [headings, ["---"] * len(headings), *cells]]


def row_each(rigs: dict[str, dict[str, Any]], question: str, keys: list[str]) -> list[list[str]]:
    """A row for each variant; what is as in the first row is "=", and a row of nothing else is left out."""
    by_rig = [{identity(row): cell(row, keys) for row in rows_of(rig, question)} for rig in rigs.values()]
    names = {identity(row): row["description"] for row in rows_of(next(iter(rigs.values())), question)}
    first, *others = [[name, *(cells.get(key, "–") for cells in by_rig)] for key, name in names.items()]
    marked = [["=" if now == then else now for now, then in zip(row, first, strict=True)] for row in others]
    return [first, *(row for row in marked if set(row[1:]) != {"="})]


def identity(row: dict[str, Any]) -> str:
    name: str = row["variant"] if "variant" in row else row["rival"]
    return name


def rows_of(rig: dict[str, Any], question: str) -> list[dict[str, Any]]:
    """The rows of a question; rivals are beside the questions."""
    found: list[dict[str, Any]] = rig[question] if question in rig else rig["questions"][question]
    return found


def cell(row: dict[str, Any], keys: list[str]) -> str:
    """The figures of a row, with their standard errors where several seeds were run; a dash where none was."""
    figures = row.get("figures", {})
    return ", ".join(written(figures, key) for key in keys) if figures else "–"


def written(figures: dict[str, Any], key: str) -> str:
    value, error = figures.get(key), figures.get(f"{key}_error")
    if value is None:
        return "–"
    return FIGURES[key].write(value) + ("" if error is None else f" ± {FIGURES[key].write(error)}")


def main(full: Path) -> None:
    """Tables of all pages, and the pictures that they show, as far as ``full`` has them."""
    for page in sorted(HERE.glob("*.md")):
        before = page.read_text("utf-8")
        after = filled(before, full)
        if after != before:
            page.write_text(after, "utf-8")
            print(f"{page.name}: tables made anew")
        for picture in re.findall(r"\]\((pictures/[^)]+)\)", after):
            if (full / picture).exists():
                shutil.copyfile(full / picture, HERE / picture)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "full")
