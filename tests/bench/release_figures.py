"""What every sample rig takes and has: the figures of the last release, that later ones are held to.

    python tests/bench/release_figures.py DATA > tests/bench/release.json

DATA holds the folder ``rigs``. Three frames each, preset ``live``, small pictures, one camera left out.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from pathlib import Path
from statistics import fmean

import numpy as np

from decogs.encoder import EncodeJob, encode
from decogs.formats.rigs import open_rig

RIGS = ("workbench", "workbench_dim", "workbench_drift", "popup", "candle", "stage", "green", "still")
FRAMES, SCALE = slice(0, 3), 0.3
_YARDSTICK_VALUES, _YARDSTICK_TIMES = 1_000_000, 60


def figures(rig: Path) -> dict[str, float]:
    """Bytes of the first and of a later frame, dB of the second camera, which is left out, and processor time in
    yardsticks of this machine."""
    held_out = open_rig(str(rig)).cameras[1].name
    before = yardstick()
    with tempfile.TemporaryDirectory() as folder:
        job = EncodeJob(rig, Path(folder) / "a.dgs", "live", frames=FRAMES, scale=SCALE, holdout=[held_out], threads=1)
        frames = encode(job).frames
    cpu = sum(frame.cpu_seconds for frame in frames)
    return {
        "first_bytes": frames[0].bytes,
        "later_bytes": round(fmean(frame.bytes for frame in frames[1:])),
        "psnr": round(fmean(frame.held_out_psnr for frame in frames if frame.held_out_psnr is not None), 3),
        "cpu": round(cpu / min(before, yardstick()), 2),
    }


def yardstick() -> float:
    """Processor seconds of work that stays the same, one thread."""
    values = np.random.default_rng(0).random(_YARDSTICK_VALUES).astype(np.float32)
    began = time.process_time()
    for _ in range(_YARDSTICK_TIMES):
        values = np.sqrt(np.sort(values * values + np.float32(0.5))[::-1].copy())
    return time.process_time() - began


if __name__ == "__main__":
    data = Path(sys.argv[1]) / "rigs"
    json.dump({name: figures(data / name) for name in RIGS}, sys.stdout, indent=2)
    print()
