"""The job template in docs/jobs, checked and run by Open Job Description's own command.

Skipped where that is not installed: `pip install openjd-cli`, or DECOGS_OPENJD for one that lies elsewhere.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from canary.rigs import write_rig
from decogs.encoder import FrameReport
from decogs.encoder.output.open_job import OpenJobProgress

TEMPLATE = Path(__file__).parents[2] / "docs" / "jobs" / "decogs.openjd.yaml"


@pytest.fixture
def openjd() -> str:
    found = shutil.which(os.environ.get("DECOGS_OPENJD", "openjd"))
    if found is None:
        pytest.skip("openjd is not installed (pip install openjd-cli, or DECOGS_OPENJD)")
    return found


def run(openjd: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    return subprocess.run(
        [openjd, *arguments], capture_output=True, text=True, timeout=300, env={**os.environ, "PATH": path}
    )


def test_the_template_is_valid(openjd: str) -> None:
    checked = run(openjd, "check", str(TEMPLATE), "--extensions", "TASK_CHUNKING")
    assert checked.returncode == 0, checked.stdout + checked.stderr


def test_the_job_makes_the_stream_of_an_encode_in_one_go(openjd: str, small_rig: Path, tmp_path: Path) -> None:
    options = "--preset live --effects motion"
    given = {
        "Rig": small_rig,
        "Work": tmp_path / "work",
        "Segments": "0-3",
        "Segment": 1,
        "Options": options,
        "Threads": 1,
    }
    parameters = [word for name, value in given.items() for word in ("-p", f"{name}={value}")]
    job = run(
        openjd,
        "run",
        str(TEMPLATE),
        "--step",
        "Join",
        "--run-dependencies",
        "--extensions",
        "TASK_CHUNKING",
        *parameters,
    )
    assert job.returncode == 0, job.stdout + job.stderr
    assert len(list((tmp_path / "work" / "parts").glob("*.dgs"))) == 2, "four segments, two in a task"
    told = [float(found) for found in re.findall(r"openjd_progress: ([0-9.]+)", job.stdout)]
    assert told
    assert told.count(100.0) == 3, "the keyframe and two parts"
    one = tmp_path / "one.dgs"
    encode = [
        sys.executable,
        "-c",
        "import sys; from decogs.encoder.commands import encode_main; sys.exit(encode_main())",
    ]
    subprocess.run(
        [*encode, str(small_rig), "-o", str(one), "--segment", "1", "--closed", *options.split()], check=True
    )
    assert (tmp_path / "work" / "scene.dgs").read_bytes() == one.read_bytes()


HOSTILE = [
    "x$(pwned)",
    "x`pwned`",
    'x";pwned;"',
    "x'$(pwned)'",
    "x\npwned\n",
    "-x",
    "--help",
    "x {a,b} * ~",
    "$HOME",
    "\\x",
]
OPTIONS = "--preset live $(pwned) `pwned` ; pwned & --holdout 'cam 00;pwned' \"$HOME\" *"


@pytest.fixture
def commands(tmp_path: Path) -> Path:
    """A folder of stand-ins: decogs' commands note their arguments, and `pwned` that it was run."""
    folder = tmp_path / "bin"
    folder.mkdir()
    for name, text in (
        ("decogs-encode", 'printf \'%s\\0\' "$0" "$@" >> $CALLS'),
        ("decogs-join", 'printf \'%s\\0\' "$0" "$@" >> $CALLS'),
        ("pwned", "touch $CALLS.pwned"),
    ):
        (folder / name).write_text(f"#!/bin/bash\n{text}\n")
        (folder / name).chmod(0o755)
    return folder


def step(commands: Path, name: str, **given: str) -> tuple[int, list[str]]:
    """Runs a step's script as the template has it: exit code, and the command that it came to, word by word."""
    text = TEMPLATE.read_text().partition(f"  - name: {name}\n")[2].partition("\n  - name: ")[0]
    script = textwrap.dedent(text.partition("data: |\n")[2])
    assert "{{" not in script, "a parameter in a script's text is code"
    arguments = [given[word] for word in re.findall(r"{{(?:Param|Task.Param)\.(\w+)}}", text.partition("args:")[2])]
    calls = commands / "calls"
    calls.unlink(missing_ok=True)
    (commands / "run").write_text(script)
    environment = {**os.environ, "PATH": f"{commands}:{os.environ['PATH']}", "CALLS": str(calls)}
    code = subprocess.run(["bash", commands / "run", *arguments], env=environment, capture_output=True).returncode
    assert not Path(f"{calls}.pwned").exists()
    told = calls.read_text().split("\0")[:-1] if calls.exists() else []
    return code, [word.replace(str(commands) + "/", "") for word in told]


@pytest.mark.parametrize("name", HOSTILE)
def test_names_and_options_are_words_and_no_code(commands: Path, tmp_path: Path, name: str) -> None:
    work = f"{tmp_path}/{name}"
    given = {"Rig": name, "Work": work, "Segment": "30", "Threads": "4", "Options": OPTIONS, "Chunk": "4-5"}
    common = ["--progress-lines", "openjd", "--segment", "30", "--closed", "--threads", "4"]
    words = ["--preset", "live", "$(pwned)", "`pwned`", ";", "pwned", "&", "--holdout", "cam 00;pwned", "$HOME", "*"]
    rest = [*common, *words, "--", name]
    code, told = step(commands, "Keyframe", **given)
    assert (code, told) == (0, ["decogs-encode", f"--output={work}/key.dgs", "--only", "0:1", *rest])
    assert Path(work, "parts").is_dir()
    code, told = step(commands, "Parts", **given)
    part = [f"--output={work}/parts/120.dgs", f"--keyframe={work}/key.dgs", "--only", "120:180"]
    assert (code, told) == (0, ["decogs-encode", *part, *rest])
    assert (
        step(commands, "Parts", **given | {"Chunk": "3", "Options": ""})[1][5:] == ["90:120", *common, "--", name][1:]
    )
    for index in (0, 30):
        Path(work, "parts", f"{index}.dgs").touch()
    parts = [f"{work}/parts/{index}.dgs" for index in (0, 30)]
    assert step(commands, "Join", **given) == (0, ["decogs-join", f"--output={work}/scene.dgs", "--", *parts])


def test_options_that_do_not_end_are_no_options(commands: Path, tmp_path: Path) -> None:
    given = {"Rig": "x", "Work": str(tmp_path), "Segment": "30", "Threads": "4", "Options": "--holdout 'cam"}
    code, told = step(commands, "Keyframe", **given)
    assert code != 0
    assert not told


@pytest.mark.parametrize("name", HOSTILE[:4])
def test_a_folder_is_found_by_its_name(openjd: str, small_rig: Path, tmp_path: Path, name: str) -> None:
    rig = small_rig.rename(tmp_path / name)
    given = [f"Rig={rig}", f"Work={tmp_path}/w{name}", "Segments=0-0", "Segment=1", "Threads=1"]
    given.append("Options=--preset live --effects motion --frames :1")
    words = [word for value in given for word in ("-p", value)]
    job = run(openjd, "run", str(TEMPLATE), "--step", "Keyframe", "--extensions", "TASK_CHUNKING", *words)
    assert job.returncode == 0, job.stdout + job.stderr
    assert (tmp_path / f"w{name}" / "key.dgs").exists()


@pytest.fixture
def small_rig(tmp_path: Path) -> Path:
    return write_rig("arc", tmp_path / "rig")


def test_progress_is_told_as_the_specification_has_it() -> None:
    """A line of its own for each: a token, a colon and a space, and a number from 0 to 100 or a text."""
    output = io.StringIO()
    lines = OpenJobProgress(output)
    lines.started({"frames": [4, 6]})
    lines.keyframe_step(1, 2, 0.5)
    for frame in (0, 4, 5):
        lines.frame(report(frame))
    lines.finished({})
    lines.failed("it fails")
    told = output.getvalue().splitlines()
    assert all(re.fullmatch(r"openjd_(progress: \d+\.\d|(status|fail): .+)", line) for line in told)
    progress = [float(line.split()[1]) for line in told if "progress" in line]
    assert progress == [12.5, 25.0, 62.5, 100.0]
    assert "openjd_status: encoding frames 4 to 5" in told
    assert told[-1] == "openjd_fail: it fails"
    lines.failed("/data/x\nopenjd_env: PATH=/tmp: no such folder")
    assert output.getvalue().splitlines()[len(told) :] == ["openjd_fail: /data/x openjd_env: PATH=/tmp: no such folder"]


def report(frame: int) -> FrameReport:
    return FrameReport(frame, "delta", 1, 1, 0.0, 1.0, None, {}, {}, 0.0)
