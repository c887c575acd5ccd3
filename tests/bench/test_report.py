"""The whole command on a tiny rig: the report, going on where it stopped, and what it says when it cannot."""

from __future__ import annotations

import importlib.util
import io
import json
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.bench.commands import bench_main
from decogs.bench.questions.rates import CURVES
from decogs.bench.questions.variants import Question, Variant
from decogs.bench.reports import page
from decogs.bench.reports.plans import Contest, Plan
from decogs.bench.reports.report import CHOICES, NONE, PAPER, RATES, make_report
from decogs.bench.rivals import splat4d
from decogs.bench.rivals.float_arrays import FloatDeltas
from decogs.bench.rivals.fourdgs import FourDGS
from decogs.bench.rivals.sequences import FilePerFrame, Rival
from decogs.bench.runs import rig_bench as runs
from decogs.bench.runs.progress import BenchProgress
from decogs.bench.runs.run import BenchOptions
from decogs.codec.header.header import StreamHeader
from decogs.formats.errors import TrainingError, UsageError
from decogs.formats.splat_files.ply import Ply
from decogs.formats.splat_files.spz import Spz
from decogs.formats.system.extras import install

pytestmark = pytest.mark.usefixtures("short_presets")

OPTIONS = BenchOptions(holdout=("cam02",), preset="tiny", threads=1)
SMALL = Plan(
    "small",
    "A small report",
    (
        Question(
            "rules",
            "Rules",
            "Which one?",
            (Variant("plain", "as it is"), Variant("paper-rule", "the paper's", selection="paper")),
            (("psnr", "mtv"), ("cpu",)),
        ),
        Question("again", "Again", "", (Variant("the-same", "as it is"),), (("psnr",),)),
    ),
)


RIVALS = (
    Rival("ply", "PLY", "a .ply each", FilePerFrame(Ply())),
    Rival("spz", "SPZ", "a .spz each", FilePerFrame(Spz(2, 2, 2)), "Coarse."),
    Rival("deltas", "float32", "float32 that changes", FloatDeltas()),
)
FINE = Variant("fine", "fine", {"lattice_scale": 1.0}, own_keyframe=True)
COARSE = Variant("coarse", "coarse", {"lattice_scale": 4.0}, own_keyframe=True)
RACE = Plan(
    "race",
    "A small race",
    (Question("rates", "Rates", "", (FINE, COARSE), (("psnr",),)),),
    contest=Contest("rivals", (FINE, COARSE), RIVALS),
)


@pytest.fixture
def encoded(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the streams that get encoded."""
    names: list[str] = []
    encode_stream = runs.encode_stream

    def observed(ingest: Any, output: Path, *arguments: Any, **options: Any) -> Any:
        names.append(re.fullmatch(r"\w+-(.*)-[0-9a-f]{10}\.dgs", output.name)[1])  # type: ignore[index]
        return encode_stream(ingest, output, *arguments, **options)

    monkeypatch.setattr(runs, "encode_stream", observed)
    return names


def linked_files(markdown: str) -> set[str]:
    return set(re.findall(r"\]\(([^)]+)\)", markdown))


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("matplotlib") is None, reason="plots need the extra 'bench'")
def test_the_papers_report(
    three_frames: Path, tmp_path: Path, encoded: list[str], capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "report"
    arguments = ["paper", str(three_frames), "-o", str(folder), "--holdout", "cam02", "--preset", "tiny"]
    assert bench_main([*arguments, "--threads", "2"]) == 0
    printed = capfd.readouterr()
    assert printed.out == f"{folder / 'paper.md'}\n"
    assert all(re.match(r"three .*, seed 0: \d frames, ", line) for line in printed.err.splitlines()), "a line a run"
    assert sorted(path.name for path in folder.iterdir()) == ["paper.json", "paper.md", "pictures", "runs", "tables"]
    text = (folder / "paper.md").read_text()
    for question in PAPER.questions:
        assert f"### {question.title}\n" in text
    for sentence in (
        "Made by `decogs-bench paper three -o report --holdout cam02 --preset tiny --threads 2`.",
        "4 training views, cam02 held out (64x48), frames 0 to 2.",
        "determined from the recorded frames",
        "## DecoGS against the baseline",
    ):
        assert sentence in text
    assert "not run" not in text
    assert str(tmp_path) not in text + (folder / "paper.json").read_text()
    links = linked_files(text)
    assert all((folder / link).is_file() for link in links), "relative, and all there"
    assert {f"pictures/three-{name}.png" for name in ("quality", "effort", "scanlines", "errors")} <= links
    for path in (folder / "pictures").glob("*.png"):
        assert cv2.imread(str(path)).std() > 10, "something is drawn"
        assert path.with_suffix(".pdf").read_bytes().startswith(b"%PDF"), "and for papers"
    tables = {path.stem for path in (folder / "tables").glob("*.csv")}
    assert tables == {path.stem for path in (folder / "tables").glob("*.tex")}
    assert len(tables) >= len(PAPER.questions)
    # The preset itself (tau 10, r 1; all parts; every frame) is run once, by its first name.
    assert sorted(encoded) == sorted(
        [
            "keyframe",
            "decogs",
            "decogs-auto",
            "decogs-paper",
            "3dgstream",
            "keyframe-held",
            "fresh-keyframe",
            "no-parts",
            "select",
            "select-focus",
        ]
        + ["selection-paper", "every-5", "every-10"]
        # Short presets search for no new objects and have one reading of the loss: these rows are others' runs.
        + [f"recipe-{name}-9" for name in ("weight", "weight-rates", "4-views", "8-views", "dilation")]
        + [f"recipe-{name}-9" for name in ("no-cache", "rates", "no-growth", "reference")]
        + [f"tau{tau}-r{r}" for tau in (10, 25, 50) for r in ("0.5", "1", "2") if (tau, r) != (10, "1")]
    )
    figures = json.loads((folder / "paper.json").read_text())["rigs"]["three"]["questions"]
    by_name = {row["variant"]: row["figures"] for row in figures["methods"]}
    assert by_name["3dgstream"]["selected"] == 1
    assert by_name["decogs"]["selected"] < 0.5
    assert by_name["decogs"]["mtv"] < by_name["3dgstream"]["mtv"], "what is frozen does not flicker"
    assert (by_name["keyframe-held"]["mtv"], by_name["keyframe-held"]["selected"]) == (0, 0)


def test_a_report_goes_on_where_it_stopped(
    three_frames: Path, tmp_path: Path, encoded: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    measure = runs.measure_scenes
    with monkeypatch.context() as patched:

        def stop_at_the_second(header: StreamHeader, *arguments: Any, **options: Any) -> Any:
            if header.settings["frame"]["selection"]["rule"] == "paper":
                raise KeyboardInterrupt
            return measure(header, *arguments, **options)

        patched.setattr(runs, "measure_scenes", stop_at_the_second)
        with pytest.raises(KeyboardInterrupt):
            make_report(SMALL, [three_frames], tmp_path, OPTIONS)
    assert encoded == ["keyframe", "plain", "paper-rule"]
    first = sorted(path.stat().st_mtime_ns for path in (tmp_path / "runs").glob("three-plain-*"))
    path = make_report(SMALL, [three_frames], tmp_path, OPTIONS)
    assert encoded == ["keyframe", "plain", "paper-rule", "paper-rule"], "the keyframe's stream was still there"
    assert sorted(path.stat().st_mtime_ns for path in (tmp_path / "runs").glob("three-plain-*")) == first
    assert not (tmp_path / "streams").exists()
    assert "not run" not in path.read_text()
    again = path.read_text()
    assert make_report(SMALL, [three_frames], tmp_path, OPTIONS).read_text() == again
    assert len(encoded) == 4


def test_only_runs_what_a_part_needs_and_writes_all_there_is(
    three_frames: Path, tmp_path: Path, encoded: list[str]
) -> None:
    text = make_report(SMALL, [three_frames], tmp_path, OPTIONS, only=["none"]).read_text()
    assert encoded == []
    assert text.count("not run") == 5
    text = make_report(SMALL, [three_frames], tmp_path, OPTIONS, only=["again"]).read_text()
    assert encoded == ["keyframe", "the-same"]
    assert "not run" not in text
    assert f"Not run: {SMALL.questions[0].title}." in text, "a table with nothing but the preset's row is none"
    assert "| as it is (the preset) | " in text


def test_a_variant_that_cannot_be_trained_is_said_and_the_others_go_on(
    three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    encode_stream = runs.encode_stream

    def failing(ingest: Any, output: Path, *arguments: Any, **options: Any) -> Any:
        if "paper-rule" in output.name:
            raise TrainingError("the loss of camera cam01 is nan; lower the learning rates")
        return encode_stream(ingest, output, *arguments, **options)

    monkeypatch.setattr(runs, "encode_stream", failing)
    said: list[str] = []
    path = make_report(SMALL, [three_frames], tmp_path, OPTIONS, on_warning=said.append)
    assert said == ["three paper-rule, seed 0: the loss of camera cam01 is nan; lower the learning rates"]
    assert "| the paper's | – | – | failed |" in path.read_text()
    assert "paper-rule failed: seed 0: the loss of camera cam01 is nan" in path.read_text()
    assert "`three-plain-" in path.read_text()
    assert json.loads((tmp_path / "small.json").read_text())["rigs"]["three"]["failures"]


@pytest.mark.slow
def test_rivals_keep_the_frames_of_the_finest_stream(
    three_frames: Path, tmp_path: Path, encoded: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    written: list[str] = []
    write = FilePerFrame.write
    monkeypatch.setattr(
        FilePerFrame, "write", lambda self, *rest: written.append(self.format.suffix) or write(self, *rest)
    )
    path = make_report(RACE, [three_frames], tmp_path, OPTIONS)
    assert encoded == ["fine", "coarse"], "one stream serves as rate point and as the rivals' source"
    assert written == [".ply", ".spz"]
    assert not (tmp_path / "streams").exists()
    rig = json.loads((tmp_path / "race.json").read_text())["rigs"]["three"]
    fine, coarse = (row["figures"] for row in rig["questions"]["rates"])
    ours, _, ply, spz, deltas = (row["figures"] for row in rig["rivals"])
    assert ours["psnr"] == pytest.approx(fine["psnr"])
    assert ours["later_bytes"] == pytest.approx(1e6 * fine["megabytes"])
    for row in (ours, ply, spz, deltas):
        assert row["first_seconds"] == pytest.approx(8 * row["first_bytes"] / 2e6)
        assert 0 < row["usable_seconds"] - row["first_seconds"] < 60
        assert row["read_ms"] > 0
        assert row["psnr_subject"] is None, "the rig has no mattes"
    assert ours["mtv"] == pytest.approx(fine["mtv"])
    assert deltas["mtv"] == pytest.approx(fine["mtv"], rel=1e-6)
    assert spz["mtv"] > 2 * fine["mtv"], "each frame is rounded by itself"
    assert coarse["megabytes"] < fine["megabytes"]
    for lossless in (ply, deltas):
        assert lossless["psnr"] == pytest.approx(fine["psnr"], rel=1e-6), "kept to seven digits"
        assert lossless["psnr_dynamic"] == pytest.approx(fine["psnr_dynamic"], rel=1e-6)
    assert spz["psnr"] < fine["psnr"] - 0.1
    assert spz["later_bytes"] < ply["later_bytes"]
    assert 1e6 * fine["megabytes"] < deltas["later_bytes"] < ply["later_bytes"]
    assert rig["bd_rate_anchor"] == "decogs"
    assert [row["rival"] for row in rig["bd_rates"]] == ["PLY", "SPZ", "float32"]
    assert rig["bd_rates"][0]["missing"]["bd_rate"] == "1 point"
    assert "### BD-rate against decogs\n" in path.read_text()
    assert ply["frame_bytes"] == pytest.approx((ply["first_bytes"] + 2 * ply["later_bytes"]) / 3)
    text = path.read_text()
    (line,) = [line for line in text.splitlines() if line.startswith("| decogs, fine |")]
    assert [cell.strip() for cell in line.split("|")][11] == "1.00", "times itself"
    assert "- spz: Coarse." in text
    named = re.findall(r"`(three-\S+-[0-9a-f]{10})`", text)
    assert all((tmp_path / "runs" / f"{name}.json").is_file() for name in named)
    assert len([name for name in named if "-rival-" in name]) == 3

    make_report(RACE, [three_frames], tmp_path, OPTIONS)
    assert (len(encoded), len(written)) == (2, 2), "all was there"
    next((tmp_path / "runs").glob("three-rival-spz-*")).write_text("{")
    make_report(RACE, [three_frames], tmp_path, OPTIONS)
    assert (encoded[2:], written[2:]) == (["fine"], [".spz"]), "its stream was gone"


def test_a_rival_that_fails_is_said_and_the_others_go_on(
    three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(self: Spz, splats: Any) -> bytes:
        raise UsageError("spz: out of luck")

    monkeypatch.setattr(Spz, "encode", failing)
    said: list[str] = []
    text = make_report(RACE, [three_frames], tmp_path, OPTIONS, on_warning=said.append).read_text()
    assert said == ["three spz: spz: out of luck"]
    assert f"| a .spz each {12 * '| – '}| spz: out of luck |" in text
    assert "| float32 that changes | – |" not in text


def test_what_is_not_installed_is_said(three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(splat4d, "splat4d_command", lambda: None)
    monkeypatch.setattr(FourDGS, "missing", lambda self: "not installed")
    text = make_report(replace(RATES, figures={}), [three_frames], tmp_path, OPTIONS, only=["none"]).read_text()
    assert text.count("| not installed |") == 4 + 4
    assert text.count("| not run |") == 2 * 4 + 11, "streams in two tables, and rivals that need nothing"


@pytest.mark.skipif(importlib.util.find_spec("matplotlib") is None, reason="plots need the extra 'bench'")
def test_rates_are_drawn(three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[str] = []
    monkeypatch.setattr(page, "plot_rates", lambda path, points: drawn.extend(p.label for p in points) or plot(path))
    plot = Path.touch
    text = make_report(replace(RACE, figures={CURVES: (FINE, COARSE)}), [three_frames], tmp_path, OPTIONS).read_text()
    assert drawn == ["fine", "coarse", "a .ply each", "a .spz each", "float32 that changes"]
    assert "pictures/three-rates.png" in linked_files(text)


@pytest.mark.slow
def test_choices_need_no_plots(three_frames: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "matplotlib" else find(name))
    folder = tmp_path / "report"
    arguments = ["choices", str(three_frames), "-o", str(folder), "--preset", "tiny", "--only", "grow-share"]
    assert bench_main(arguments) == 0
    text = (folder / "choices.md").read_text()
    three_keys = r"`three-(grow[\d.]+)-\{[0-9a-f,]{32}\}`"
    assert set(re.findall(three_keys, text)) == {"grow0", "grow0.003", "grow0.01", "grow0.03"}, (
        "three seeds of ten digits"
    )
    *others, last = CHOICES.questions
    assert re.findall("^### (.*)$", text, re.MULTILINE) == [last.title]
    assert f"Not run: {'; '.join(question.title for question in others)}." in text


@pytest.fixture
def refused(tmp_path: Path, three_frames: Path, capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Runs the command, which must fail with code 2 before anything is made, and returns its one line."""

    def command(*options: str, kind: str = "choices", rigs: tuple[str, ...] = ()) -> str:
        folder = tmp_path / "report"
        try:
            code = bench_main([kind, *(rigs or [str(three_frames)]), "-o", str(folder), "--preset", "tiny", *options])
        except SystemExit as error:
            code = error.code  # type: ignore[assignment]
        printed = capfd.readouterr()
        assert (code, printed.out) == (2, "")
        assert printed.err.count("\n") == 1
        assert not folder.is_dir()
        return printed.err

    return command


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--only", "speed"], "--only speed: there is no such part; choose from heuristics, "),
        (["--holdout", "cam9"], "--holdout cam9: "),
        (["--frames", "2:1"], "--frames: "),
        (["--frames", "-1:"], "give --frames of at least 2"),
        (["--seeds", "-1"], "--seeds: give 1 to 100 different numbers"),
        (["--seeds", "0"], "--seeds: give 1 to 100 different numbers"),
        (["--seeds", "1,1"], "--seeds: give 1 to 100 different numbers"),
        (["--seeds", "999999999999999999"], "--seeds: give 1 to 100 different numbers"),
        (["--seeds", "two"], "argument --seeds: 'two' is no whole number"),
        (["--seeds", ","], "argument --seeds: '' is no whole number"),
        (["--seed", "1"], "unrecognized arguments: --seed 1"),
        (["--scale", "0"], "--scale 0: "),
        (["--threads", "-2"], "no number of threads"),
        (["--preset", "nope"], "--preset nope: "),
        (["--speed"], "unrecognized arguments: --speed"),
    ],
)
def test_impossible_options_are_refused(refused: Callable[..., str], options: list[str], message: str) -> None:
    assert message in refused(*options)


def test_a_folder_that_is_no_rig_is_refused(refused: Callable[..., str], tmp_path: Path) -> None:
    assert "no calibration" in refused(rigs=(str(tmp_path),))


def test_rigs_of_one_name_are_refused(refused: Callable[..., str], three_frames: Path) -> None:
    assert "has the same name; give each its own report" in refused(rigs=(str(three_frames),) * 2)


def test_a_file_in_the_reports_place_is_refused(refused: Callable[..., str], tmp_path: Path) -> None:
    (tmp_path / "report").write_text("")
    assert "report: is a file; name a folder" in refused()


def test_an_unknown_kind_of_report_is_refused(refused: Callable[..., str]) -> None:
    assert "invalid choice: 'novel'" in refused(kind="novel")


def test_plots_without_their_library_are_one_line(refused: Callable[..., str], monkeypatch: pytest.MonkeyPatch) -> None:
    find = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == "matplotlib" else find(name))
    line = refused(kind="paper")
    assert line == f"decogs-bench: error: the report's plots need matplotlib: {install('bench')}\n"


def test_the_plotting_library_is_loaded_for_plots_only() -> None:
    program = "import sys, decogs.bench.reports.report; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.slow
def test_several_rigs_in_one_report(three_frames: Path, still_rig: Path, tmp_path: Path) -> None:
    path = make_report(SMALL, [three_frames, still_rig], tmp_path, OPTIONS)
    text = path.read_text()
    assert text.index("## three\n") < text.index("## still\n")
    still = json.loads((tmp_path / "small.json").read_text())["rigs"]["still"]["questions"]["rules"][0]
    assert still["figures"]["mtv"] == 0, "nothing changes, nothing is sent"


def test_progress_on_a_terminal_and_a_line_for_each_run_in_a_pipe(run_of: Any, frame_of: Any) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    for terminal in (Terminal(), io.StringIO(), None):
        with BenchProgress(2, terminal) as progress:
            progress.started("rig", "variant")
            for step in range(1, 4):
                progress.keyframe_step(step, 3, 0.1)
            progress.frame()
            progress.frame()
            progress.finished(run_of([frame_of(0), frame_of(1)]))
        if isinstance(terminal, Terminal):
            assert "rig variant:" in terminal.getvalue()
            assert "rig v, seed 0: 2 frames, 30.00 dB" in terminal.getvalue()
            assert "2/2 [" in terminal.getvalue()
        elif terminal is not None:
            assert terminal.getvalue() == "rig v, seed 0: 2 frames, 30.00 dB\n"


def test_recorded_masks_are_named_in_the_report(three_frames: Path, tmp_path: Path) -> None:
    (tmp_path / "rig").mkdir()
    for path in three_frames.iterdir():
        (tmp_path / "rig" / path.name).symlink_to(path)
    truth = tmp_path / "rig" / "truth"
    truth.mkdir()
    for kind in ("static", "changing"):
        cv2.imwrite(str(truth / f"{kind}_cam02.png"), np.full((48, 64), 255, np.uint8))
    text = make_report(SMALL, [tmp_path / "rig"], tmp_path / "report", OPTIONS, only=[NONE]).read_text()
    assert "the rig's own true masks, static_cam02.png and changing_cam02.png" in text
