"""docs/jobs/slurm.sh, with stand-ins for Slurm's and decogs' commands: what it runs, and after what."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "docs" / "jobs" / "slurm.sh"

SBATCH = """#!/bin/bash
echo "sbatch $*" >> "$CALLS"
step= array= words=()
for word in "$@"; do
  case $word in
    --export=*) step=${word##*STEP=} ;;
    --array=*) array=${word#--array=} ;;
    --*) [ ${#words[@]} = 0 ] || words+=("$word") ;;
    *) words+=("$word") ;;
  esac
done
for task in $(seq ${array%-*} ${array:+1} ${array#*-}) ${array:-only}; do
  [ "$task" = "$array" ] && continue
  STEP=$step SLURM_JOB_ID=7$task SLURM_ARRAY_TASK_ID=$task "${words[@]}" >> "$CALLS" || true
done
echo "1$step"
"""
NOTING = """#!/bin/bash
echo "$(basename "$0") $*" >> "$CALLS"
case "$*" in *"--only 4:6"*) exit 75 ;; esac
"""


@pytest.fixture
def calls(tmp_path: Path) -> list[str]:
    commands = tmp_path / "bin"
    commands.mkdir()
    for name, text in (("sbatch", SBATCH), *((n, NOTING) for n in ("decogs-encode", "decogs-join", "scontrol"))):
        (commands / name).write_text(text)
        (commands / name).chmod(0o755)
    environment = {**os.environ, "PATH": f"{commands}:{os.environ['PATH']}", "CALLS": str(tmp_path / "calls")}
    environment.pop("STEP", None)
    arguments = ["rig dir", str(tmp_path / "take"), "2", "2", "--preset", "live"]
    subprocess.run([SCRIPT, *arguments], env=environment, check=True, capture_output=True)
    return (tmp_path / "calls").read_text().replace(str(tmp_path), "T").splitlines()


def test_keyframe_parts_and_join_follow_each_other(calls: list[str]) -> None:
    common = "decogs-encode --segment 2 --closed --output=T/take"
    assert [line for line in calls if line.startswith("decogs")] == [
        f"{common}/key.dgs --only 0:1 --preset live -- rig dir",
        f"{common}/parts/0.dgs --keyframe=T/take/key.dgs --only 0:2 --preset live -- rig dir",
        f"{common}/parts/2.dgs --keyframe=T/take/key.dgs --only 2:4 --preset live -- rig dir",
        f"{common}/parts/4.dgs --keyframe=T/take/key.dgs --only 4:6 --preset live -- rig dir",
        "decogs-join --output=T/take/scene.dgs -- T/take/parts/*.dgs",
    ]
    submitted = [line for line in calls if line.startswith("sbatch")]
    assert "--array=0-2 --dependency=afterok:1keyframe" in submitted[1]
    assert "--dependency=afterok:1part" in submitted[2]


def test_what_may_be_tried_again_is_put_back(calls: list[str]) -> None:
    assert [line for line in calls if line.startswith("scontrol")] == ["scontrol requeue 72"]


@pytest.mark.parametrize("step", ["submit", "part"])
@pytest.mark.parametrize(
    "numbers", [("2", "a[$(touch PWNED)]"), ("a[$(touch PWNED)]", "2"), ("2", "08"), ("2", "0"), ("", "2")]
)
def test_what_stands_for_a_number_is_one(tmp_path: Path, step: str, numbers: tuple[str, str]) -> None:
    environment = {**os.environ, "STEP": step, "SLURM_ARRAY_TASK_ID": "1", "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(
        [SCRIPT, "rig", str(tmp_path / "take"), *numbers], env=environment, cwd=tmp_path, capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr.startswith("slurm.sh: LAST_SEGMENT and FRAMES_PER_SEGMENT are numbers, not")
    assert not list(tmp_path.iterdir())
