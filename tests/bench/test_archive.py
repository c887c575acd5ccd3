"""Reports and runs are packed for a release as they lie, and unpack to the same files."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from zipfile import ZipFile

SCRIPT = Path(__file__).with_name("archive.py")


def archive(report: Path) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(SCRIPT), str(report)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def test_reports_and_runs_come_back_as_they_were(tmp_path: Path) -> None:
    files = {"runs/a-1.json": b"{}", "pictures/a.png": b"png", "popup/runs/a-1.json": b"[]", "paper.md": b"page"}
    for name, content in {**files, "runs/b.json.part": b"half", "streams/a.dgs": b"stream"}.items():
        (tmp_path / "full" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "full" / name).write_bytes(content)
    result = archive(tmp_path / "full")
    assert result.returncode == 0, result.stderr
    with ZipFile(tmp_path / "full.zip") as packed:
        assert {name: packed.read(name) for name in packed.namelist()} == files


def test_a_folder_without_reports_is_an_error(tmp_path: Path) -> None:
    result = archive(tmp_path / "full")
    assert result.returncode == 1
    assert result.stderr == f"{tmp_path / 'full'}: has no reports to pack; `make report` makes them\n"
    assert not (tmp_path / "full.zip").exists()
