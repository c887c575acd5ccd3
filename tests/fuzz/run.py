"""``make fuzz``: hostile inputs by the hundred thousand; exit code 1 when one of them misbehaves.

Whole streams are mutated at random, structured and raw, to be opened and to be edited; the parsers of the container,
the header and the payloads are fuzzed guided by coverage when atheris is installed (``pip install atheris``), else by
raw mutation alone. The same seed gives the same mutants. An input that misbehaves is left in build/fuzz, with a line
that says what it did; mend the cause and keep the input in tests/fuzz/found.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from random import Random

sys.path.insert(0, str(Path(__file__).parent))
import hostile

FOLDER = Path(__file__).resolve().parents[2] / "build" / "fuzz"
SHARES = {"streams": 0.08, "edits": 0.02, "container": 0.3, "header": 0.15, "payload": 0.45}
"""Of the inputs: whole streams cost several times what a parser's input does."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=210_000, help="in all (default 210000)")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    guided = importlib.util.find_spec("atheris") is not None
    if not guided:
        print("atheris is not installed: the parsers are fuzzed by random mutation, not guided by coverage")
    shutil.rmtree(FOLDER, ignore_errors=True)
    FOLDER.mkdir(parents=True)
    total, failed = 0, False
    for name, share in SHARES.items():
        began, inputs = time.monotonic(), int(options.inputs * share)
        try:
            figures = run(name, inputs, options.seed, guided)
        except hostile.Misbehaved as error:
            print(f"{name}: {error}")
            failed = True
            continue
        total += figures["inputs"]
        print(
            f"{name}: {figures['inputs']} inputs in {time.monotonic() - began:.0f} s, the slowest "
            f"{figures['slowest'] * 1e3:.0f} ms of processor time, the largest {figures['memory'] / 2**20:.1f} MiB "
            f"(limits: {hostile.MAX_SECONDS:g} s, {hostile.MAX_MEMORY >> 20} MiB)",
            flush=True,
        )
    print(f"{total} inputs, {'some misbehaved: see build/fuzz' if failed else 'none misbehaved'}")
    return int(failed)


def run(name: str, inputs: int, seed: int, guided: bool) -> dict[str, float]:
    """Tries so many inputs on one target; raises Misbehaved after keeping the input."""
    if name not in ("streams", "edits"):
        if guided:
            return run_guided(name, inputs, seed)
        target, seeds = hostile.parsers()[name]
        return run_random(name, target, seeds, islice(raw_mutants(seeds, seed), inputs))
    with tempfile.TemporaryDirectory() as folder:
        seeds = hostile.seed_streams()
        target = (hostile.FileTarget if name == "streams" else hostile.EditTarget)(Path(folder) / "x.dgs")
        return run_random(name, target, seeds, islice(hostile.mutants(seeds, seed), inputs))


def run_random(
    name: str, target: Callable[[bytes], None], seeds: list[bytes], inputs: Iterator[bytes]
) -> dict[str, float]:
    for data in seeds:
        target(data)
    judge = hostile.Judge(target)
    data = b""
    try:
        for data in inputs:
            judge.try_one(data)
    except hostile.Misbehaved as error:
        path = FOLDER / f"{name}-{hashlib.sha256(data).hexdigest()[:12]}"
        path.write_bytes(data)
        raise hostile.Misbehaved(f"{path}: {error}") from error
    return judge.figures()


def raw_mutants(seeds: list[bytes], seed: int) -> Iterator[bytes]:
    random = Random(seed)
    while True:
        yield hostile.mutated_bytes(random, random.choice(seeds))


def run_guided(name: str, inputs: int, seed: int) -> dict[str, float]:
    folder = FOLDER / name
    program = Path(__file__).with_name("guided.py")
    command = [sys.executable, str(program), name, str(inputs), str(seed), str(folder)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    if ended.returncode:
        raise hostile.Misbehaved(f"in {folder}:\n{ended.stderr[-4000:]}")
    return dict(json.loads((folder / "figures.json").read_text()))


if __name__ == "__main__":
    sys.exit(main())
