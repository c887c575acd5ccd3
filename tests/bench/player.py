"""Times the player in headless Chromium: what a frame costs, the first picture, and seeking; medians, milliseconds.

    python tests/bench/player.py [STREAM.dgs ...] [--page FOLDER] [--rounds N]

Without a STREAM: 300 000 Gaussians of which 10 % change, at SH degree 0 and 1 (player_stream.py), and six frames of
the rigs workbench and panoptic_basketball at half size where the folder of larger rigs has them. ``decode``, ``pack``,
``sort`` and ``upload`` make a ``frame`` of kind delta. ``first`` goes from setting ``src``, in a page that is loaded,
to textures ready to be drawn: the worker's script, the stream and its first frame. ``seek`` goes to keyframes. Nothing
is drawn: in software that takes seconds, and the processors. ``--page`` times another build, for a figure before and
after.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).parents[2]
SHARED = Path(os.environ.get("DECOGS_SHARED", ROOT.parent / "shared"))
RIGS = ("data/rigs/workbench", "data/real/panoptic_basketball")
PLAYER = ROOT / "player"
PAGE = ROOT / "decoder" / "viewing" / "page"
FIGURES = ("decode", "pack", "sort", "upload", "frame", "first", "seek")
NO_CHROMIUM = 77


def streams(folder: Path) -> Iterator[Path]:
    """The streams that are timed, made in a folder."""
    script = Path(__file__).with_name("player_stream.py")
    for degree in (0, 1):
        path = folder / f"300000_degree{degree}.dgs"
        options = ["--degree", str(degree), "--frames", "24", "--segment", "8"]
        subprocess.run([sys.executable, str(script), str(path), *options], check=True)
        yield path
    for rig in (SHARED / name for name in RIGS):
        if not rig.is_dir():
            print(f"skipped {rig.name}: {rig} is missing")
            continue
        path = folder / f"{rig.name}.dgs"
        encode = [str(Path(sys.executable).with_name("decogs-encode")), str(rig), "-o", str(path)]
        options = ["--preset", "live", "--scale", ".5", "--frames", ":6", "--threads", "1"]
        run = subprocess.run([*encode, *options], capture_output=True, text=True, check=False)
        if run.returncode == 0:
            yield path
        else:
            print(f"skipped {rig.name}: {run.stderr.strip().splitlines()[-1]}")


def time_streams(paths: Iterable[Path], page: Path, rounds: int) -> None:
    """Prints a line for each stream."""
    script = PLAYER / "tests" / "browser" / "bench.mjs"
    print(f"{'player, ms':26}{'Gaussians':>10}{'change':>8}", *(f"{name:>7}" for name in FIGURES), flush=True)
    for path in paths:
        command = ["node", str(script), str(page), str(rounds), str(path)]
        run = subprocess.run(command, capture_output=True, text=True, check=False)
        if run.returncode == NO_CHROMIUM:
            print(f"skipped: {run.stderr.strip()}")
            return
        if run.returncode != 0:
            sys.exit(run.stderr)
        row = json.loads(run.stdout)
        changing = "" if row["changing"] is None else f"{row['changing']:.1%}"
        figures = ("" if row[name] is None else f"{row[name]:.1f}" for name in FIGURES)
        print(f"{path.stem:26}{row['gaussians']:>10}{changing:>8}", *(f"{figure:>7}" for figure in figures), flush=True)
    print(f"load of this machine's {os.cpu_count()} processors: {os.getloadavg()[0]:.1f}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("streams", type=Path, nargs="*")
    parser.add_argument("--page", type=Path, default=PAGE)
    parser.add_argument("--rounds", type=int, default=5)
    given = parser.parse_args()
    if shutil.which("node") is None or not (PLAYER / "node_modules").is_dir():
        print("player: skipped, Node or player/node_modules is missing (make player gets it)")
        return
    with tempfile.TemporaryDirectory() as folder:
        time_streams(given.streams or streams(Path(folder)), given.page, given.rounds)


if __name__ == "__main__":
    main()
