"""Runs are packed for a release as they lie, and unpack to the same files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

SCRIPT = Path(__file__).with_name("archive.py")


def archive(report: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), str(report)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_runs_of_all_reports_come_back_as_they_were(tmp_path: Path) -> None:
    files = {"runs/a-1.json": b"{}", "runs/a-1.png": b"png", "popup/runs/a-1.json": b"[]"}
    for name, content in {**files, "runs/b.json.part": b"half", "paper.json": b"page"}.items():
        (tmp_path / "report" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "report" / name).write_bytes(content)
    result = archive(tmp_path / "report")
    assert result.returncode == 0, result.stderr
    with ZipFile(tmp_path / "report" / "runs.zip") as packed:
        assert {name: packed.read(name) for name in packed.namelist()} == files


def test_a_report_without_runs_is_an_error(tmp_path: Path) -> None:
    result = archive(tmp_path)
    assert result.returncode == 1
    assert result.stderr == f"{tmp_path}: has no runs to pack; `make report` makes them\n"
    assert not (tmp_path / "runs.zip").exists()
