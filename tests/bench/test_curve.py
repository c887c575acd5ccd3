"""The report of what accuracy costs, on a tiny rig: tables, pictures, the page to explore, and the kernel's twin."""

from __future__ import annotations

import importlib.util
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import cv2
import pytest

from decogs.bench import report, runs
from decogs.bench.plans import Plan, Trade
from decogs.bench.report import make_report
from decogs.bench.runs import BenchOptions, RigBench
from decogs.bench.trade import COSTS, QUALITIES
from decogs.bench.trade_page import inline_json
from decogs.bench.variants import Question, Variant

pytestmark = [
    pytest.mark.usefixtures("short_presets"),
    pytest.mark.skipif(importlib.util.find_spec("matplotlib") is None, reason="plots need the extra 'bench'"),
]

OPTIONS = BenchOptions(holdout=("cam02",), preset="tiny", threads=1)
OWN = Variant("own", "own </script> & <b>", own_keyframe=True)
SMALL = Variant("small", "half", scale=0.5, own_keyframe=True)
SHARED = Variant("preset", "the preset")
COLUMNS = (("psnr", "cpu", "decode_fps"),)
PLAN = Plan(
    "curve",
    "A small <curve>",
    (
        Question("kinds", "Kinds", "", (OWN, SMALL), COLUMNS),
        Question("steps", "Steps", "", (SHARED, Variant("few", "few", {"frame.joint_iterations": 3})), COLUMNS),
    ),
    trade=Trade("precision", SHARED, (SHARED, OWN)),
)


class Page(HTMLParser):
    """What a browser would find: the elements' names, links that it would fetch, and the figures."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.names: list[str] = []
        self.fetched: list[tuple[str, str | None]] = []
        self.title = self.data = ""
        self._open = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.names.append(tag)
        self.fetched += [(name, value) for name, value in attrs if name in ("src", "href", "srcset")]
        self._open = "data" if dict(attrs).get("id") == "data" else tag

    def handle_endtag(self, tag: str) -> None:
        self._open = ""

    def handle_data(self, data: str) -> None:
        if self._open == "data":
            self.data += data
        elif self._open == "title":
            self.title += data


def test_the_whole_report(three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: dict[str, tuple[int, float]] = {}
    encode = runs.encode_stream

    def observed(context: Any, output: Path, span: range, options: Any) -> Any:
        width = context.ingest.views[0].pinhole.width
        sizes[output.name.split("-")[1]] = (width, options.convergence is not None)
        return encode(context, output, span, options)

    monkeypatch.setattr(runs, "encode_stream", observed)
    path = make_report(PLAN, [three_frames], tmp_path, OPTIONS, command="decogs-bench curve <three>")
    assert sizes == {
        "keyframe": (64, False), "own": (64, True), "small": (32, False), "preset": (64, True), "few": (64, False)
    }  # fmt: skip
    assert sorted(p.name for p in tmp_path.iterdir()) == ["curve.html", "curve.json", "curve.md", "pictures", "runs"]
    text = path.read_text()
    for heading in ("What is best for its price", "Inside a frame", "Kernel precision"):
        assert f"### {heading}\n" in text
    assert all((tmp_path / link).is_file() for link in re.findall(r"\]\(([^)]+)\)", text))
    assert len(list((tmp_path / "pictures").iterdir())) == 3
    for picture in (tmp_path / "pictures").iterdir():
        assert cv2.imread(str(picture)).std() > 10, "something is drawn"

    bench = RigBench(three_frames, tmp_path, OPTIONS)
    small, own = bench.find(SMALL), bench.find(OWN)
    assert small is not None
    assert own is not None
    assert "--scale 0.5" in small.command
    assert "--scale" not in own.command
    assert small.scale == own.scale == 1, "measured at the same size"
    assert bench.key(OWN) != bench.key(SMALL)
    assert bench.course_of(small) is None
    course = bench.course_of(own)
    assert course is not None
    assert course.frames == 2
    assert course.views == 4

    document = json.loads((tmp_path / "curve.json").read_text())["rigs"]["three"]
    assert [point["label"] for point in document["points"]] == [OWN.description, "half", "the preset", "few"]
    assert set(document["fronts"]) == {f"{cost.key} {quality.key}" for cost in COSTS for quality in QUALITIES}
    assert set(document["courses"]) == {SHARED.description, OWN.description}
    precision = document["precision"]
    # Half of 64x48. The kernel keeps within 1e-4 of its twin (tests/decoder/rasterise/test_rasterise.py): 80 dB.
    assert (precision["width"], precision["height"], precision["frame"]) == (32, 24, 2)
    assert precision["between"] > 80
    # Two pictures 80 dB apart differ by 1e-4 at most, which is 20 log10(1 + 1e-4 / 0.03) dB of 30 dB.
    assert precision["single"] == pytest.approx(precision["double"], abs=0.05)
    assert precision["changed"] < 0.05

    page = Page((tmp_path / "curve.html").read_text())
    assert page.title == "A small <curve>"
    assert page.fetched == [], "it stands alone"
    assert page.names.count("script") == 2, "nothing embedded begins or ends one"
    assert "b" in page.names
    data = json.loads(page.data)
    assert data["command"] == "decogs-bench curve <three>"
    assert data["rigs"]["three"]["points"] == document["points"]
    assert data["rigs"]["three"]["fronts"] == document["fronts"]
    assert data["families"] == {"kinds": "Kinds", "steps": "Steps"}


def test_nothing_is_run_for_none_and_the_page_says_so(
    three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(report, "measure_precision", lambda *_: pytest.fail("not asked for"))
    text = make_report(PLAN, [three_frames], tmp_path, OPTIONS, only=["none"]).read_text()
    assert text.count("| not run |") == 4
    assert "best for its price" not in text
    data = json.loads(Page((tmp_path / "curve.html").read_text()).data)["rigs"]["three"]
    assert (data["points"], data["courses"], data["precision"]) == ([], {}, None)
    assert set(map(len, data["fronts"].values())) == {0}


def test_figures_cannot_end_their_script() -> None:
    hostile = {"label": "</script><script>alert(1)</script><!-- &amp; \u2028"}
    text = inline_json(hostile)
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == hostile
    with pytest.raises(ValueError, match="JSON"):
        inline_json([float("nan")])
