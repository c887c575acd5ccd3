"""One HTML page to explore what accuracy costs: figures, style and script in the file, nothing fetched.

Chosen: plots drawn by a small script of our own into SVG, so that the page opens anywhere, for years, from a mail's
attachment. Rejected: a plotting library (megabytes in every page, or a network). Fronts come with the figures: the
script finds none of its own.
"""

from __future__ import annotations

import html
import json
from collections.abc import Sequence
from importlib import resources
from typing import Any

from ..estimates import about_seeds
from ..runs.results import Plan, RigResults
from .plots import COLOURS
from .trade import axes_document, trade_document

_TITLE, _DATA = "{{title}}", "{{data}}"


def trade_page(plan: Plan, results: Sequence[RigResults], command: str) -> str:
    """The page for the rows there are; ``command`` is what made it."""
    template = resources.files("decogs.bench.reports").joinpath("trade_page.html").read_text("utf-8")
    data = {
        "command": command,
        "axes": axes_document(),
        "colours": COLOURS,
        "families": {question.key: question.title for question in plan.questions},
        "seeds": about_seeds(results[0].bench.options.seeds),
        "rigs": {result.bench.name: _rig(plan, result) for result in results},
    }
    return template.replace(_TITLE, html.escape(plan.title)).replace(_DATA, inline_json(data))


def _rig(plan: Plan, result: RigResults) -> dict[str, Any]:
    bench, runs = result.bench, result.runs.values()
    return {
        "held_out": ", ".join(bench.cameras),
        "frames": [bench.frames.start, bench.frames.stop],
        "machines": sorted({f"{r.machine['cpu']}, {r.machine['cores']} cores, {r.threads} used" for r in runs}),
        **trade_document(plan, result),
    }


def inline_json(data: Any) -> str:
    """JSON that can stand inside a script element: whatever its strings hold, they cannot end it.

    Raises ValueError for numbers that JSON does not have.
    """
    text = json.dumps(data, allow_nan=False, separators=(",", ":"))
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text
