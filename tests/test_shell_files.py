"""The man pages and completions in share/ are those of the commands' options, and a shell takes them."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SHARE = ROOT / "share"
BASH = """
source {file}
COMP_WORDS=("$@")
COMP_CWORD=$(($# - 1))
$(complete -p $1 | sed 's/.*-F \\([^ ]*\\).*/\\1/')
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


def test_they_are_current(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")  # The script sets it; this puts it back.
    spec = importlib.util.spec_from_file_location("share_build", SHARE / "build.py")
    assert spec is not None
    assert spec.loader is not None
    build = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(build)
    expected = build.shell_files()
    there = {str(path.relative_to(SHARE)): path for path in SHARE.rglob("*") if "decogs-" in path.name}
    assert sorted(there) == sorted(expected)
    assert len(expected) == 45
    for name, path in there.items():
        assert path.read_text("utf-8") == expected[name], f"{name}: python share/build.py writes it anew"


@pytest.mark.parametrize(
    ("words", "completed"),
    [
        (["decogs-encode", "--pre"], ["--preset"]),
        (["decogs-encode", "--preset", ""], ["live", "draft", "standard", "high", "archive", "paper"]),
        (["decogs-encode", "ri"], ["rig folder"]),
        (["decogs-decode", "scene.dgs", "--codec", "h"], ["h264", "hevc"]),
        (["decogs-info", "sc"], ["scene.dgs"]),
        (["decogs-edit", "scene.dgs", "tr"], ["trim", "transform"]),
        (["decogs-bench", "ch"], ["choices"]),
        (["decogs-bench", "paper", "--keep"], ["--keep-streams"]),
    ],
)
@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
def test_bash_completes(words: list[str], completed: list[str], tmp_path: Path) -> None:
    (tmp_path / "scene.dgs").touch()
    (tmp_path / "rig folder").mkdir()
    program = BASH.format(file=SHARE / "bash-completion" / "completions" / words[0])
    run = subprocess.run(
        ["bash", "--norc", "-c", program, "bash", *words], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert run.stdout.splitlines() == completed
    assert run.stderr == ""


@pytest.mark.skipif(shutil.which("man") is None, reason="man is not installed")
def test_man_shows_a_page_with_every_option_and_no_complaint() -> None:
    run = subprocess.run(
        ["man", "--warnings", "-l", str(SHARE / "man" / "man1" / "decogs-encode.1")],
        capture_output=True,
        text=True,
        check=True,
        env={"MANWIDTH": "100", "PATH": "/usr/bin:/bin", "LC_ALL": "C.UTF-8"},
    )
    for words in ("--time-budget T", "LONG TAKES", "EXIT STATUS", "decogs 0.1.0"):
        assert words in run.stdout
    assert run.stderr == ""
