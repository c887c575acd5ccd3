"""``decogs-analyze``: what it prints, writes and refuses."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.encoder.analysis import EFFECTS
from decogs.encoder.analysis.analyse import analyse
from decogs.encoder.analysis.building import SHOWN
from decogs.encoder.analyze_command import analyze_main


def told(document: dict[str, Any]) -> dict[str, Any]:
    """A document without the time it took."""
    return {key: value for key, value in document.items() if key != "seconds"}


def test_a_rig_becomes_a_table_and_a_document(
    moving_rig: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "analysis.json"
    assert analyze_main([str(moving_rig), "--holdout", "cam02", "--json", str(out), "-q"]) == 0
    printed = capfd.readouterr()
    assert printed.err == "", "no progress by -q"
    lines = printed.out.splitlines()
    assert lines[0].startswith(f"{moving_rig}: 4 cameras, 4 frames, at 64x48, in ")
    shown = (*EFFECTS, *SHOWN)
    assert [line.split()[0] for line in lines[2 : 2 + len(shown)]] == [effect.name for effect in shown]
    assert lines[2 + len(shown)].startswith("decided by every frame of an encode: motion, ")
    assert [line.split()[0] for line in lines[-5:]] == ["camera", "cam00", "cam01", "cam03", "cam04"]
    document = json.loads(out.read_text())
    assert document["cameras"] == ["cam00", "cam01", "cam03", "cam04"]
    assert document["held_out"] == ["cam02"]
    assert max(map(len, lines[1:])) <= 80
    for row, line in zip(document["effects"], lines[2 : 2 + len(shown)], strict=True):
        assert line.split()[1] == ("yes" if row["detected"] else "no")
        assert {len(values) for values in row["values"].values()} == {4}
    assert document["checks"].keys() == {"cam00", "cam01", "cam03", "cam04"}
    assert all(0 <= check["seen_by_two"] <= check["seen_by_one"] <= 1 for check in document["checks"].values())
    assert [path.name for path in tmp_path.iterdir()] == ["analysis.json"]


def test_the_document_goes_to_stdout(moving_rig: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert analyze_main([str(moving_rig), "--json", "-"]) == 0
    printed = capfd.readouterr()
    assert told(json.loads(printed.out)) == told(analyse(moving_rig, shown=True).to_json())
    assert [line.split()[0] for line in printed.err.splitlines()[-6:]] == ["camera", *(f"cam{k:02d}" for k in range(5))]


def test_threads_change_nothing(moving_rig: Path) -> None:
    one, three = (told(analyse(moving_rig, threads=threads).to_json()) for threads in (1, 3))
    assert one == three


def test_a_held_out_camera_is_not_looked_at(moving_rig: Path, tmp_path: Path, tiny_rig: Any) -> None:
    poisoned = tiny_rig.poisoned(moving_rig, tmp_path / "poisoned", "cam02")
    (poisoned / "cam02" / "0001.png").write_bytes(b"no picture")
    clean = told(analyse(moving_rig, holdout=["cam02"]).to_json())
    assert told(analyse(poisoned, holdout=["cam02"]).to_json()) == clean | {"rig": str(poisoned)}


def test_progress_reaches_its_end(moving_rig: Path) -> None:
    steps: list[tuple[int, int]] = []
    analyse(moving_rig, on_step=lambda done, total: steps.append((done, total)))
    assert [done for done, _ in steps] == list(range(1, steps[-1][1] + 1))


def test_one_frame_tells_what_it_can(moving_rig: Path) -> None:
    analysis = analyse(moving_rig, frames=slice(0, 1))
    of = {finding.decision.effect: finding.decision for finding in analysis.findings}
    assert not of["exposure_drift"].detected


def test_a_clip_beyond_the_memory_is_thinned(moving_rig: Path) -> None:
    """Room for two frames of five 64x48 cameras: every second of four is looked at."""
    analysis = analyse(moving_rig, max_bytes=2 * 5 * 64 * 48 * 3)
    assert (analysis.stats.frames, analysis.stats.step) == ((0, 2), 2)
    assert "4 frames, 1 in 2 analysed" in next(iter(analysis.table()))


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["nowhere"], "there is no such folder"),
        (["RIG", "--holdout", "cam99"], "--holdout cam99"),
        (["RIG", "--frames", "9:"], "--frames"),
        (["RIG", "--frames", "x"], "no range"),
        (["RIG", "--json", "nowhere/analysis.json"], "nowhere: no such folder; create it first"),
    ],
)
def test_an_error_is_one_line(
    options: list[str],
    what: str,
    moving_rig: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert analyze_main([str(moving_rig) if option == "RIG" else option for option in options]) == 2
    printed = capfd.readouterr()
    assert printed.err.startswith("decogs-analyze: error: ")
    assert what in printed.err
    assert printed.err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_every_camera_held_out_is_refused(moving_rig: Path, capfd: pytest.CaptureFixture[str]) -> None:
    options = np.ravel([["--holdout", f"cam{k:02d}"] for k in range(5)]).tolist()
    assert analyze_main([str(moving_rig), *options]) == 2
    assert "every camera is held out" in capfd.readouterr().err
