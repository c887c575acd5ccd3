"""Fills the tables of README.md and of pages in this folder from reports of decogs-bench; `make report` ends with it.

    .venv/bin/python report/tables.py [FULL]        FULL: where reports are, report/full

What the pages cite of these reports is kept in report/figures, which git has; tables are made of that alone, so that
a test can see whether any figure is another one than its run's. A table stands between two comments. The first one says
its kind, where its figures come from (folders of report/full, each a rig's), which figures, and beneath them the rows:

    <!-- table choices/workbench | psnr_dynamic last_dynamic megabytes
    warm-start: warm start
    beta: weights of whole picture and focus -->
    <!-- end -->

table
    A row for each question, a column for each rig. Of a question without a name each variant gets a row; of one rig
    each figure then gets a column.
rigs
    A row for each rig, by its name here; the line beneath names the variant: `methods/decogs-auto`.
differences
    A row for each variant of a question, a column for each rig: what it has more than the question's reference, seed by
    seed, mean ± standard error, in bold beyond two; dB, then per cent.
against
    A row for each rig: the first variant beneath against the second: dB more, and the share of flicker, time and bytes.
made
    One line, without rows: which code, which day, which machine, how long.

A figure within a sentence stands between comments, too; the second row is taken off the first:

    <!--= paper/workbench psnr_dynamic components/select - components/no-parts -->+0.07<!--/-->

A picture that a page shows as pictures/RUNS/RIG/NAME is that of this report.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
KEPT = HERE / "figures"
TABLE = re.compile(
    r"(?P<opening><!-- (?P<kind>table|rigs|differences|against|made) (?P<sources>[^|\n]+?)"
    r"(?: \|(?P<keys>[^\n]*)\n(?P<rows>.*?))? ?-->\n)(?P<old>.*?)(?P<end><!-- end -->)",
    re.DOTALL,
)

INLINE = re.compile(r"(<!--= (\S+) (\S+) (\S+?)(?: - (\S+))? -->)[^<]*(<!--/-->)")
PICTURE = re.compile(r"\]\(pictures/([^/)]+)/([^/)]+)/([^/)]+)\)")


@dataclass(frozen=True)
class Figure:
    """Its unit as a heading says it, and how it is written."""

    heading: str
    write: Callable[[float], str]


def kilobytes(megabytes: float) -> str:
    return f"{1000 * megabytes:.{1 if megabytes < 0.1 else 0}f}"


FIGURES = {
    "psnr": Figure("dB of the whole picture", "{:.2f}".format),
    "first": Figure("first frame", "{:.2f}".format),
    "last": Figure("last frame", "{:.2f}".format),
    "psnr_worst_5": Figure("worst 5 %", "{:.2f}".format),
    "psnr_aligned": Figure("dB of the whole picture", "{:.2f}".format),
    "psnr_dynamic": Figure("dB where things move", "{:.2f}".format),
    "psnr_static": Figure("where nothing does", "{:.2f}".format),
    "last_dynamic": Figure("last frame", "{:.2f}".format),
    "psnr_subject": Figure("of the subject", "{:.2f}".format),
    "psnr_change": Figure("dB of the change there", "{:.2f}".format),
    "flip": Figure("FLIP", "{:.4f}".format),
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
    "selected": Figure("% selected", lambda share: f"{100 * share:.1f}"),
    "bd_rate": Figure("whole picture", "{:+.0f} %".format),
    "bd_rate_dynamic": Figure("where things move", "{:+.0f} %".format),
    "bd_rate_later": Figure("whole picture, later frames", "{:+.0f} %".format),
    "bd_rate_later_dynamic": Figure("where things move, later frames", "{:+.0f} %".format),
}
"""Those of a report's JSON that tables here have; bytes and CPU-s are per later frame, BD-rates per cent of bytes."""

AGAINST = ("psnr_dynamic", "mtv", "cpu", "megabytes")
DIFFERENCES = ("psnr_dynamic", "megabytes", "cpu")


@dataclass(frozen=True)
class Table:
    """What a comment asks for. ``sources``: RUNS/RIG; ``rows``: the lines beneath, key and name."""

    kind: str
    sources: tuple[str, ...]
    keys: tuple[str, ...]
    rows: tuple[tuple[str, str], ...]

    def rigs(self, folder: Path) -> dict[str, dict[str, Any]]:
        """What the sources' reports in ``folder`` say, by the rig's name."""
        return {Path(source).name: kept(folder, source)["rig"] for source in self.sources}


def table_of(found: re.Match[str]) -> Table:
    rows = [line.partition(":") for line in (found["rows"] or "").strip().splitlines()]
    return Table(
        found["kind"],
        tuple(found["sources"].split()),
        tuple((found["keys"] or "").split()),
        tuple((key.strip(), name.strip()) for key, _, name in rows),
    )


def kept(folder: Path, source: str) -> dict[str, Any]:
    """What pages cite of a rig's report, as `keep` wrote it."""
    cited: dict[str, Any] = json.loads((folder / f"{source}.json").read_text("utf-8"))
    return cited


def filled(page: str, folder: Path = KEPT) -> str:
    """The page with each table made anew from the reports in ``folder``."""

    def text(found: re.Match[str]) -> str:
        table = table_of(found)
        try:
            return found["opening"] + "\n".join(KINDS[table.kind](table, folder)) + "\n" + found["end"]
        except (KeyError, FileNotFoundError) as unknown:
            raise SystemExit(f"{found['opening']}names {unknown}, which its reports do not have; correct it") from None

    return INLINE.sub(lambda found: sentence_figure(found, folder), TABLE.sub(text, page))


def sentence_figure(found: re.Match[str], folder: Path) -> str:
    opening, source, key, one, other, end = found.groups()
    rig = kept(folder, source)["rig"]
    value = row_of(rig, one)["figures"][key]
    text = FIGURES[key].write(value) if other is None else f"{value - row_of(rig, other)['figures'][key]:+.2f}"
    return opening + text + end


def lines(table: Table, folder: Path) -> list[str]:
    """A table with a column for each rig, of one rig for each figure, where questions have no names."""
    rigs, named = table.rigs(folder), any(name for _, name in table.rows)
    if len(rigs) == 1 and not named:
        return by_figure(*rigs.values(), table)
    units = ", ".join(FIGURES[key].heading for key in table.keys)
    headings = [f"`{rig}`" + (f": {units}" if number == 0 else "") for number, rig in enumerate(rigs)]
    if named:
        rows = [[name, *(variants(rig, key, table.keys) for rig in rigs.values())] for key, name in table.rows]
    else:
        rows = [row for key, _ in table.rows for row in row_each(rigs, key, table.keys)]
    return markdown(["", *headings], rows)


def by_figure(rig: dict[str, Any], table: Table) -> list[str]:
    """A row for each variant, a column for each figure that any of them has."""
    rows = {identity(row): row for key, _ in table.rows for row in rows_of(rig, key) if "figures" in row}
    units = {key: FIGURES[key].heading for key in table.keys}
    shown = [key for key in units if any(row["figures"].get(key) is not None for row in rows.values())]
    cells = [[row["description"], *(written(row["figures"], key) for key in shown)] for row in rows.values()]
    return markdown(["", *(units[key] for key in shown)], cells)


def by_rig(table: Table, folder: Path) -> list[str]:
    """A row for each rig, a column for each figure of one variant."""
    ((path, _),) = table.rows
    cells = [
        [f"`{name}`", *(written(row_of(rig, path)["figures"], key) for key in table.keys)]
        for name, rig in table.rigs(folder).items()
    ]
    return markdown(["", *(FIGURES[key].heading for key in table.keys)], cells)


def differences(table: Table, folder: Path) -> list[str]:
    """A row for each variant that has differences on any rig, a column for each rig."""
    rigs, ((key, _),) = table.rigs(folder), table.rows
    by_rig = [{identity(row): row for row in rows_of(rig, key)} for rig in rigs.values()]
    names = {identity(row): row["description"] for rig in rigs.values() for row in rows_of(rig, key)}
    cells = [
        [name, *(changes(rows.get(variant, {}).get("differences", {})) for rows in by_rig)]
        for variant, name in names.items()
    ]
    return markdown(["", *(f"`{rig}`" for rig in rigs)], [row for row in cells if set(row[1:]) != {"–"}])


def changes(row: dict[str, Any]) -> str:
    """dB with its error, in bold beyond two of them, and per cent of bytes and time; a dash where there are none."""
    shown = [row[key] for key in DIFFERENCES if key in row]
    if len(shown) < len(DIFFERENCES):
        return "–"
    moving, *shares = shown
    error = moving["error"]
    text = f"{moving['mean']:+.2f}" + ("" if error is None else f" ± {error:.2f}")
    clear = error is not None and abs(moving["mean"]) > 2 * error and text[1:5] != "0.00"
    return ", ".join([f"**{text}**" if clear else text, *(f"{share['mean']:+.0f} %" for share in shares)])


def against(table: Table, folder: Path) -> list[str]:
    """A row for each rig: the first variant against the second."""
    (ours, _), (theirs, _) = table.rows
    rows = [
        [f"`{name}`", *shares(row_of(rig, ours)["figures"], row_of(rig, theirs)["figures"])]
        for name, rig in table.rigs(folder).items()
    ]
    return markdown(["", "dB where things move", "flicker", "CPU-s", "bytes"], rows)


def shares(ours: dict[str, float], theirs: dict[str, float]) -> list[str]:
    """dB more, and one part in so many of what the other takes."""
    moving, *others = AGAINST
    return [f"{ours[moving] - theirs[moving]:+.2f}", *(f"1/{theirs[key] / ours[key]:.3g}" for key in others)]


def made(table: Table, folder: Path) -> list[str]:
    """Which code made the reports, when, on what, and in how long."""
    facts = [kept(folder, source)["made"] for source in table.sources]
    codes = " and ".join(dict.fromkeys(fact["commit"] for fact in facts))
    days = " to ".join(sorted({fact["day"] for fact in facts}))
    machines = "; ".join(dict.fromkeys(fact["machine"] for fact in facts))
    seconds = sum(fact["processor_seconds"] for fact in facts)
    return [f"*Made {days} by commit {codes} on {machines}: {seconds / 60:.0f} processor minutes of encoding.*"]


KINDS: dict[str, Callable[[Table, Path], list[str]]] = {
    "table": lines,
    "rigs": by_rig,
    "differences": differences,
    "against": against,
    "made": made,
}


def markdown(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return ["| " + " | ".join(row) + " |" for row in [headings, ["---"] * len(headings), *rows]]


def variants(rig: dict[str, Any], question: str, keys: Sequence[str]) -> str:
    """All variants in one cell, a line each."""
    return "<br>".join(f"{row['description']}: {cell(row, keys)}" for row in rows_of(rig, question))


def row_each(rigs: dict[str, dict[str, Any]], question: str, keys: Sequence[str]) -> list[list[str]]:
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


def row_of(rig: dict[str, Any], path: str) -> dict[str, Any]:
    """The row that ``QUESTION/VARIANT`` names."""
    question, _, variant = path.partition("/")
    return {identity(row): row for row in rows_of(rig, question)}[variant]


def cell(row: dict[str, Any], keys: Sequence[str]) -> str:
    """The figures of a row, with their standard errors where several seeds were run; a dash where none was."""
    figures = row.get("figures", {})
    return ", ".join(written(figures, key) for key in keys) if figures else "–"


def written(figures: dict[str, Any], key: str) -> str:
    value, error = figures.get(key), figures.get(f"{key}_error")
    if value is None:
        return "–"
    return FIGURES[key].write(value) + ("" if error is None else f" ± {FIGURES[key].write(error)}")


def tables(pages: Sequence[Path]) -> Iterator[Table]:
    """All that pages cite; a sentence's figure as a table of one or two rows."""
    for page in pages:
        text = page.read_text("utf-8")
        yield from map(table_of, TABLE.finditer(text))
        for _, source, key, *rows, _ in INLINE.findall(text):
            yield Table("table", (source,), (key,), tuple((row, "") for row in rows if row))


def pages() -> list[Path]:
    return [HERE.parent / "README.md", *sorted(HERE.glob("*.md"))]


def keep(full: Path) -> None:
    """Writes into report/figures what the pages cite of the reports that ``full`` has."""
    wanted = list(tables(pages()))
    for source in sorted({source for table in wanted for source in table.sources}):
        for path in (full / source).glob("*.json"):
            report = json.loads(path.read_text("utf-8"))
            (rig,) = report["rigs"].values()
            cited: dict[str, Any] = {"questions": {}}
            for table in wanted:
                if source in table.sources:
                    keep_rows(rig, cited, table)
            target = KEPT / f"{source}.json"
            made = facts(report, path.parent)
            if target.exists() and (before := kept(KEPT, source)["made"])["code"] == made["code"]:
                made["commit"] = before["commit"]  # commits since then changed no code that a run depends on
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_text(json.dumps({"made": made, "rig": cited}, indent=1) + "\n", "utf-8")


def keep_rows(rig: dict[str, Any], kept: dict[str, Any], table: Table) -> None:
    """Adds the rows of the table's questions to those ``kept``, with the figures that it has."""
    keys = [*table.keys, *(AGAINST if table.kind == "against" else ())]
    names = {*keys, *(f"{key}_error" for key in keys)}
    for question in dict.fromkeys(key.partition("/")[0] for key, _ in table.rows):
        rows = rows_of(rig, question)
        there = kept["questions"].setdefault(question, [row_alone(row) for row in rows])
        for row, mine in zip(rows, there, strict=True):
            figures = {
                key: value for key, value in row.get("figures", {}).items() if key in names and value is not None
            }
            mine["figures"] = mine.get("figures", {}) | {key: rounded(value) for key, value in figures.items()}
            if table.kind == "differences" and "differences" in row:
                mine["differences"] = {key: value for key, value in row["differences"].items() if key in DIFFERENCES}


def row_alone(row: dict[str, Any]) -> dict[str, Any]:
    return {key: row[key] for key in ("variant", "rival", "description") if key in row}


def rounded(value: float) -> float:
    return float(f"{value:.6g}")


def facts(report: dict[str, Any], folder: Path) -> dict[str, Any]:
    """What `made` says: the commit that is checked out, the machine, and processor seconds of all the report's runs."""
    machine = report["machine"]
    runs = {
        run
        for rig in report["rigs"].values()
        for rows in rig["questions"].values()
        for row in rows
        for run in row.get("runs", {}).values()
    }
    seconds = sum(
        frame["cpu_seconds"] for run in runs for frame in json.loads((folder / run).read_text("utf-8"))["frames"]
    )
    commit = subprocess.run(
        ["git", "-C", str(HERE), "rev-parse", "--short", "HEAD"], capture_output=True, text=True, check=True
    )
    return {
        "command": report["command"],
        "commit": commit.stdout.strip(),
        "code": report["code"],
        "day": report["written"][:10],
        "machine": f"{machine['cores']} cores of {machine['cpu']}, Python {machine['python']}",
        "processor_seconds": round(seconds),
    }


def pictures(page: str, full: Path) -> Iterator[tuple[Path, Path]]:
    """Where each picture that the page shows was made, and where it lies here."""
    for runs, rig, name in PICTURE.findall(page):
        yield full / runs / rig / "pictures" / name, HERE / "pictures" / runs / rig / name


def main(full: Path) -> None:
    """Keeps what pages cite, makes their tables, and copies pictures that they show, as far as ``full`` has them."""
    keep(full)
    for page in pages():
        before = page.read_text("utf-8")
        after = filled(before)
        if after != before:
            page.write_text(after, "utf-8")
            print(f"{page.name}: tables made anew")
        for made, shown in pictures(after, full):
            if made.exists():
                shown.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(made, shown)


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "full")
