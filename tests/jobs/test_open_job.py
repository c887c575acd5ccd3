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


def report(frame: int) -> FrameReport:
    return FrameReport(frame, "delta", 1, 1, 0.0, 1.0, None, {}, {}, 0.0)
