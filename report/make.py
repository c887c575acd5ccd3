"""Makes every report that pages here cite, into report/full; what is there, made by the same code, is not made again.

    .venv/bin/python report/make.py DATA [RUNS ...] [--jobs 2]

DATA holds the folders ``rigs`` and ``real``; RUNS choose among those below. Each rig of each of them is a process with
one thread: two side by side do not count each other's work.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

FULL = Path(__file__).resolve().parent / "full"


@dataclass(frozen=True)
class Rig:
    """A rig below DATA, the cameras left out of every encode of it, and the frame at which runs begin."""

    folder: str
    left_out: tuple[str, ...]
    first: int = 0

    @property
    def name(self) -> str:
        return Path(self.folder).name


ARC = ("cam00", "cam03", "cam09")
WORKBENCH, POPUP, CANDLE = Rig("rigs/workbench", ARC), Rig("rigs/popup", ARC, 8), Rig("rigs/candle", ARC, 6)
STILL, DIM, DRIFT = Rig("rigs/still", ARC), Rig("rigs/workbench_dim", ARC, 6), Rig("rigs/workbench_drift", ARC[:2])
STAGE, GREEN = Rig("rigs/stage", ("cam00", "cam04", "cam08")), Rig("rigs/green", ("cam00", "cam05"))
DOME = Rig("real/panoptic_basketball", ("cam00", "cam10", "cam26"))
OTHERS = (
    Rig("rigs/hdr", ("cam00",)),
    Rig("real/mouse_cage_8cam", ("cam02", "cam05")),
    Rig("real/desk_charuco_4cam", ("cam01",)),
    Rig("real/balance_4cam", ("cam00",)),
)
FOUR = (DOME, WORKBENCH, POPUP, CANDLE)  # the one that takes longest first, so that no process waits for it at the end
FIVE = (*FOUR, STAGE)
ALL = (*FIVE, STILL, DIM, DRIFT, GREEN, *OTHERS)


@dataclass(frozen=True)
class Runs:
    """A kind of report on several rigs: its parts, frames, size of the pictures, preset, and number of seeds."""

    name: str
    kind: str
    rigs: tuple[Rig, ...]
    only: tuple[str, ...] = ()
    frames: int | None = None
    scale: float = 0.5
    preset: str = "standard"
    seeds: int = 3

    def command(self, rig: Rig, data: Path) -> list[str]:
        stop = "" if self.frames is None else rig.first + self.frames
        options = ["--frames", f"{rig.first}:{stop}", "--scale", f"{self.scale:g}", "--preset", self.preset]
        options += ["--seeds", f"{self.seeds}" if self.seeds > 1 else "0,", "--threads", "1", "--quiet"]
        options += [part for camera in rig.left_out for part in ("--holdout", camera)]
        options += ["--only", ",".join(self.only)] if self.only else []
        bench = str(Path(sys.executable).with_name("decogs-bench"))
        return [bench, self.kind, str(data / rig.folder), "-o", str(FULL / self.name / rig.name), *options]


SINGLE = ("iterations", "resolution", "gaussians", "sh", "quality")
RUNS = (
    Runs("results", "paper", FOUR, ("default",), frames=20, scale=1.0),
    Runs("rigs", "paper", ALL, ("default",), frames=8),
    Runs("paper", "paper", FOUR, ("methods", "fresh", "components"), frames=12),
    Runs("recipe", "paper", (WORKBENCH, POPUP), ("recipe", "sweep", "frame-rate")),
    Runs("presets", "curve", FIVE, ("presets",), frames=4),
    Runs("single", "curve", (WORKBENCH,), SINGLE, frames=8),
    Runs("steps", "curve", (DOME, STAGE), ("iterations",), frames=8),
    Runs("heuristics", "choices", FIVE, ("heuristics",), frames=8),
    Runs("choices", "choices", (WORKBENCH,), frames=8),
    Runs("effects", "effects", (STILL, CANDLE, POPUP, WORKBENCH, DRIFT), frames=12, preset="draft"),
    Runs("rates", "rates", (WORKBENCH, GREEN), frames=10, preset="draft", seeds=1),
)


def make(runs: Runs, rig: Rig, data: Path) -> bool:
    """Whether all went well; says what was made and how long it took."""
    (FULL / runs.name / rig.name).mkdir(parents=True, exist_ok=True)
    began = time.monotonic()
    done = subprocess.run(runs.command(rig, data), stdout=subprocess.DEVNULL).returncode == 0
    print(f"{runs.name}/{rig.name}: {time.monotonic() - began:.0f} s{'' if done else ', FAILED'}", flush=True)
    return done


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(description="Make the reports that pages of report/ cite.")
    parser.add_argument("data", type=Path, metavar="DATA")
    parser.add_argument("runs", nargs="*", metavar="RUNS", choices=[[], *(runs.name for runs in RUNS)])
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="processes side by side (default 2)")
    options = parser.parse_args(arguments)
    chosen = [runs for runs in RUNS if not options.runs or runs.name in options.runs]
    with ThreadPoolExecutor(options.jobs) as pool:
        made = [pool.submit(make, runs, rig, options.data) for runs in chosen for rig in runs.rigs]
        return 0 if all(each.result() for each in made) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
