"""How well decogs-sync finds starts that are known: ``python tests/synchronisation/table.py RIG``.

Each camera of RIG, which is in step, is written as a video that begins some frames later, drawn at random. With
``--every 2`` they have every second frame, and begin halves of a frame apart. With ``--claps`` two claps are heard,
beside what the cameras look at, later by the sound's way to each camera.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path[:0] = [str(Path(__file__).parents[1]), str(Path(__file__).parents[1] / "faults")]

from make import rig_document  # noqa: E402

from decogs.formats.cameras import Camera, camera_centre  # noqa: E402
from decogs.formats.rigs import open_recordings, open_rig, read_frames  # noqa: E402
from decogs.rig.synchronisation import find_starts  # noqa: E402
from videos_with_sound import claps, write_video  # noqa: E402

F64 = NDArray[np.float64]
FPS = 30
METRES_A_SECOND = 343
BESIDE = np.array([0.3, 0.2, 0.1])
"""Of a world unit, here a metre, from what the cameras look at to the claps."""


def looked_at(cameras: Sequence[Camera]) -> F64:
    """The point that the optical axes pass nearest."""
    across = [np.eye(3) - np.outer(camera.world_to_camera[2, :3], camera.world_to_camera[2, :3]) for camera in cameras]
    pulls = [keep @ camera_centre(camera) for keep, camera in zip(across, cameras, strict=True)]
    return np.asarray(np.linalg.solve(np.sum(across, axis=0), np.sum(pulls, axis=0)))


def heard_by(camera: Camera, seconds: float, times: Sequence[float], source: F64) -> NDArray[np.float32]:
    """Claps at ``times`` seconds after the camera's start, as they come from ``source``."""
    late = float(np.linalg.norm(camera_centre(camera) - source)) / METRES_A_SECOND
    rng = np.random.default_rng(int(1e6 * late))
    return claps(seconds, [time + late for time in times], rng, rate=48000, gain=float(rng.uniform(0.3, 2)))


def write_shifted(
    cameras: Sequence[Camera], pictures: Sequence[NDArray[np.uint8]], starts: F64, every: int, folder: Path, sound: bool
) -> None:
    """A rig of videos of every ``every``-th picture (F, H, W, 3), each from its start, in frames that are left, on."""
    source = looked_at(cameras) + BESIDE
    for camera, own, start in zip(cameras, pictures, starts, strict=True):
        taken = own[round(start * every) :: every]
        times = [(share * len(own) / every - start) / FPS for share in (0.55, 0.8)]
        heard = heard_by(camera, len(taken) / FPS, times, source) if sound else None
        write_video(folder / f"{camera.name}.mp4", taken, heard, fps=FPS)
    (folder / "rig.json").write_text(json.dumps(rig_document(cameras) | {"length_unit": "m"}))


def main() -> None:
    """Prints a line for each draw, and one for all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rig", type=Path)
    parser.add_argument("--up-to", type=float, default=8, help="frames that are left; 0: in step")
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--claps", action="store_true")
    parser.add_argument("--draws", type=int, default=3)
    options = parser.parse_args()
    rig = open_rig(options.rig)
    frames = [pictures for _, pictures in read_frames(rig)]
    pictures = [np.stack([frame[row] for frame in frames]) for row in range(len(rig.cameras))]
    errors: list[float] = []
    for seed in range(options.draws):
        drawn = np.random.default_rng(seed).integers(0, round(options.up_to * options.every) + 1, len(pictures))
        starts = drawn / options.every
        with tempfile.TemporaryDirectory() as folder:
            write_shifted(rig.cameras, pictures, starts, options.every, Path(folder), options.claps)
            found = find_starts(open_recordings(folder)).cameras
        apart = np.array([np.nan if one.offset is None else one.offset for one in found]) - starts
        off = np.abs(apart - np.nanmedian(apart))
        ways = sorted({one.method for one in found if one.method})
        print(f"draw {seed}: {', '.join(ways)}: {' '.join(f'{error:.2f}' for error in off)}", flush=True)
        errors += off.tolist()
    known = np.array(errors)[~np.isnan(errors)]
    print(
        f"{rig.path.name}: {len(errors)} cameras, {len(errors) - len(known)} unknown, {(known >= 0.5).sum()} off by "
        f"half a frame or more, median {np.median(known):.2f}, worst {known.max():.2f} frames"
    )


if __name__ == "__main__":
    main()
