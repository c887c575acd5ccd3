"""Draws how a later frame flows through the encoder, as docs/frame_flow.svg.

    .venv/bin/python docs/frame_flow.py

Steps, what they give and their files are those of the table in encoder/DESIGN.md. What a step's files import is read
from the import graph: a square is the room that a step is in, a dot a room or layer that it uses.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape
from pathlib import Path

import grimp

ROOT = Path(__file__).resolve().parents[1]
TABLE = ROOT / "encoder" / "DESIGN.md"
PICTURE = ROOT / "docs" / "frame_flow.svg"
ENCODER = "decogs.encoder"
LAYERS = ("rig", "decoder", "codec", "formats")

MARGIN, TOP, ROW, BOX = 16, 164, 58, 36
"""Pixels: around the picture, above the first step, from step to step, height of a step's box."""
LEFT, COLUMN = 470, 34
"""Pixels: width of the steps, and of a room's column."""


@dataclass(frozen=True)
class Step:
    """A row of the table. ``gives``: to the next step. ``files``: in encoder/ or rig/; folders end with a slash."""

    name: str
    gives: str
    files: tuple[str, ...]


@dataclass(frozen=True)
class Uses:
    """Rooms and layers by name: ``at_home`` has a step's own files, ``others`` are imported by them."""

    at_home: frozenset[str]
    others: frozenset[str]


def steps() -> list[Step]:
    """The rows of the table in encoder/DESIGN.md."""
    rows = re.findall(r"^\| (\d+ [^|]*?) \| ([^|]*?) \|([^|]*)\|$", TABLE.read_text(encoding="utf-8"), re.MULTILINE)
    return [
        Step(name, gives.split("->")[-1].replace("`", "").strip(), tuple(re.findall(r"`([^`]+)`", files)))
        for name, gives, files in rows
    ]


def uses(graph: grimp.ImportGraph, step: Step) -> Uses:
    """Raises ValueError where a file of the table is not there."""
    own = {module for name in step.files for module in modules(graph, name)}
    imported = {other for module in own for other in graph.find_modules_directly_imported_by(module)}
    at_home = frozenset(filter(None, (room(graph, module) for module in own)))
    return Uses(at_home, frozenset(filter(None, (room(graph, module) for module in imported - own))) - at_home)


def modules(graph: grimp.ImportGraph, name: str) -> Iterator[str]:
    """A file's module, or a folder's and all below it."""
    package = "decogs" if name.startswith("rig/") else ENCODER
    module = f"{package}.{name.removesuffix('/').removesuffix('.py').replace('/', '.')}"
    if module not in graph.modules:
        raise ValueError(f"{TABLE.relative_to(ROOT)}: {name} is not there; correct the table of steps")
    yield module
    if name.endswith("/"):
        yield from graph.find_descendants(module)


def room(graph: grimp.ImportGraph, module: str) -> str | None:
    """A folder of the encoder with a slash, or a layer below it; modules at the encoder's top have none."""
    names = module.split(".")
    if names[1] != "encoder":
        return names[1] if names[1] in LAYERS else None
    is_folder = len(names) > 2 and bool(graph.find_children(".".join(names[:3])))
    return f"{names[2]}/" if is_folder else None


def columns(found: list[Uses]) -> list[str]:
    """Rooms in the order in which a frame enters them, then those that are only used, then the layers."""
    homes = list(dict.fromkeys(name for use in found for name in sorted(use.at_home)))
    others = sorted({name for use in found for name in use.others} - set(homes) - set(LAYERS))
    return [*homes, *others, *LAYERS]


def drawing(rows: list[Step], found: list[Uses]) -> str:
    """The picture as SVG."""
    names = columns(found)
    width = LEFT + COLUMN * len(names) + 2 * MARGIN + 40
    height = TOP + ROW * len(rows) + MARGIN
    lines = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}" '
        'font-family="Helvetica, Arial, sans-serif" font-size="13">',
        "<title>How a later frame flows through the encoder</title>",
        f'<rect width="{width}" height="{height}" fill="#fff"/>',
        '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0 8 4 0 8z" fill="#555"/></marker></defs>',
        text(MARGIN, 28, "One later frame, from the rig to its packet", size=17, weight="bold"),
        text(MARGIN, 50, "Down: what each step gives to the next.", fill="#555"),
        text(MARGIN, 68, "Right: the rooms of encoder/ and the layers that its files import.", fill="#555"),
        f'<rect x="{MARGIN}" y="{80}" width="12" height="12" rx="2" fill="#1f5fa8"/>',
        text(MARGIN + 19, 91, "the step's own room", fill="#555"),
        f'<circle cx="{MARGIN + 166}" cy="86" r="5" fill="#e08a1e"/>',
        text(MARGIN + 178, 91, "a room or layer that it uses", fill="#555"),
        *(column(names, index, height) for index in range(len(names))),
    ]
    for number, (step, use) in enumerate(zip(rows, found, strict=True)):
        lines.extend(row(step, use, names, TOP + ROW * number, last=number == len(rows) - 1))
    return "\n".join([*lines, "</svg>", ""])


def column(names: list[str], index: int, height: int) -> str:
    """A room's name, and a line down through all steps;"""
    x = centre(names, index)
    return (
        f'<path d="M{x} {TOP - 12}V{height - MARGIN}" stroke="#e4e4e4"/>'
        f'<text x="{x + 4}" y="{TOP - 20}" transform="rotate(-50 {x + 4} {TOP - 20})">{escape(names[index])}</text>'
    )


def centre(names: list[str], index: int) -> int:
    """Where a column is; layers stand half a column apart from the encoder's rooms."""
    return MARGIN + LEFT + COLUMN * index + COLUMN // 2 + (COLUMN // 2 if names[index] in LAYERS else 0)


def row(step: Step, use: Uses, names: list[str], y: int, *, last: bool) -> Iterator[str]:
    """A step's box with its files beside it, the arrow to the next one, and its marks."""
    yield f'<rect x="{MARGIN}" y="{y}" width="168" height="{BOX}" rx="6" fill="#eaf1fa" stroke="#1f5fa8"/>'
    yield text(MARGIN + 12, y + 23, step.name, weight="bold")
    for number, name in enumerate(step.files or ("(no file of its own)",)):
        first = y + 23 - 8 * (max(len(step.files), 1) - 1)
        yield text(MARGIN + 182, first + 16 * number, name, fill="#333" if step.files else "#999", family="monospace")
    if not last:
        yield f'<path d="M{MARGIN + 24} {y + BOX}v{ROW - BOX - 1}" stroke="#555" marker-end="url(#head)"/>'
    yield text(MARGIN + 36, y + BOX + 15, step.gives, fill="#555", size=12)
    middle = y + BOX // 2
    yield f'<path d="M{MARGIN + LEFT} {middle}H{centre(names, len(names) - 1)}" stroke="#e4e4e4"/>'
    for index, name in enumerate(names):
        x = centre(names, index)
        if name in use.at_home:
            yield f'<rect x="{x - 7}" y="{middle - 7}" width="14" height="14" rx="2" fill="#1f5fa8"/>'
        elif name in use.others:
            yield f'<circle cx="{x}" cy="{middle}" r="5" fill="#e08a1e"/>'


def text(
    x: int, y: int, content: str, *, size: int = 13, weight: str = "", fill: str = "#111", family: str = ""
) -> str:
    """A line of text that begins at (x, y)."""
    more = (f' font-weight="{weight}"' if weight else "") + (f' font-family="{family}"' if family else "")
    return f'<text x="{x}" y="{y}" font-size="{size}" fill="{fill}"{more}>{escape(content)}</text>'


def picture() -> str:
    """The picture of the code as it is."""
    graph = grimp.build_graph("decogs", cache_dir=None)
    rows = steps()
    return drawing(rows, [uses(graph, step) for step in rows])


if __name__ == "__main__":
    PICTURE.write_text(picture(), encoding="utf-8")
