"""A recording of ten minutes, encoded live: cameras that fail on purpose, and what became of the frames.

    python tests/live/run.py RIG --fps 3 --frames 500 --scale 0.5 -o FOLDER

Cameras record RIG forth and back into FOLDER/capture; the first keyframe is trained before. Some pictures come late,
some never, some damaged, one camera dies and comes back. Printed: the age of packets when they are written, the
encoder's memory, faults that the log lacks, and whether the bytes are those of an encode of the same pictures.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import cv2
import numpy as np

from decogs.encoder import EncodeJob, encode
from decogs.formats.rigs import open_rig, read_frames
from decogs.formats.stream.container import FRAME_KINDS, PacketReader

BIN = Path(sys.executable).parent
EFFECTS = "motion,appearance_change,emergence,disappearance,view_dependence"
LATE = 0.5
"""Seconds that a camera may be behind, as in the file of sources."""
SHARE = 0.01
"""Of all pictures, that come late, never, or damaged: each."""


@dataclass(frozen=True)
class Faults:
    """Frames and cameras: pictures that are late, in seconds, missing or damaged; a camera that is dead misses them."""

    late: dict[tuple[int, str], float]
    missing: set[tuple[int, str]]
    damaged: set[tuple[int, str]]

    @property
    def lost(self) -> set[tuple[int, str]]:
        """Those that the encoder cannot have; one that is late may be there by the time it is asked for."""
        return self.missing | self.damaged


@dataclass
class Seen:
    """What was measured meanwhile: when each frame was recorded and written, and memory in bytes by frame."""

    recorded: dict[int, float] = field(default_factory=dict)
    written: dict[int, float] = field(default_factory=dict)
    memory: dict[int, int] = field(default_factory=dict)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rig", type=Path)
    parser.add_argument("--fps", type=float, default=1.0)
    parser.add_argument("--frames", type=int, default=500)
    parser.add_argument("--scale", default="0.5")
    parser.add_argument("--preset", default="live")
    parser.add_argument("--time-budget", help="of a frame, as decogs-encode has it; bytes then depend on the machine")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    folder: Path = options.output
    pictures = write_pictures(options.rig, folder / "pictures")
    names = sorted(path.name for path in (folder / "pictures").iterdir())
    order = [*range(pictures), *range(pictures - 2, 0, -1)]
    faults = chosen_faults(names, options.frames, options.fps)
    given = ["--preset", options.preset, "--scale", options.scale, "--effects", EFFECTS, "--quiet"]
    first = folder / "first.dgs"
    run("decogs-encode", options.rig, "--frames", ":1", "-o", first, *given)
    given += ["--keyframe", str(first)]
    timed = [] if options.time_budget is None else ["--time-budget", options.time_budget]
    seen = record(folder, names, order, faults, options, [*given, *timed])
    log = [json.loads(line) for line in (folder / "log.jsonl").read_text().splitlines()]
    frames = [record for record in log if record["event"] == "frame"]
    dropped = {(record["frame"], name): why for record in frames for name, why in record["dropped"].items()}
    for line in figures(seen, frames, faults, dropped):
        print(line)
    if timed:
        return
    calibration = options.rig / "poses_bounds.npy"
    same_pictures(folder, names, order, dropped, len(frames), calibration)
    rig = replace(open_rig(folder / "after"), fps=options.fps)  # which a folder of pictures does not state
    job = EncodeJob(rig, folder / "after.dgs", options.preset, effects=EFFECTS, keyframe=str(first))
    encode(replace(job, scale=float(options.scale)))
    same = (folder / "live.dgs").read_bytes() == (folder / "after.dgs").read_bytes()
    print(f"bytes              {'those of' if same else 'NOT those of'} an encode afterwards")


def run(command: str, *arguments: object) -> None:
    subprocess.run([BIN / command, *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def write_pictures(rig_dir: Path, folder: Path) -> int:
    """Each camera's frames as PNG; how many there are."""
    rig = open_rig(rig_dir)
    for index, pictures in read_frames(rig):
        for camera, picture in zip(rig.cameras, pictures, strict=True):
            (folder / camera.name).mkdir(parents=True, exist_ok=True)
            bgr = np.ascontiguousarray(picture[..., ::-1])
            assert cv2.imwrite(str(folder / camera.name / f"{index}.png"), bgr)
    return rig.frame_count


def chosen_faults(names: list[str], frames: int, fps: float) -> Faults:
    """The same ones every time; the first and the last second have none, and the last camera dies for a tenth."""
    chance = random.Random(1)
    late: dict[tuple[int, str], float] = {}
    missing, damaged = set(), set()
    for frame in range(1 + round(fps), frames - 1 - round(fps)):
        for name in names[:-1]:
            kind = chance.random()
            if kind < SHARE:
                late[frame, name] = chance.choice([0.4 * LATE, 1.6 * LATE])
            elif kind < 2 * SHARE:
                missing.add((frame, name))
            elif kind < 3 * SHARE:
                damaged.add((frame, name))
    missing |= {(frame, names[-1]) for frame in range(frames * 2 // 5, frames // 2)}
    return Faults(late, missing, damaged)


def record(
    folder: Path, names: list[str], order: list[int], faults: Faults, options: argparse.Namespace, given: list[str]
) -> Seen:
    """Records and encodes at the same time, the stream through a pipe."""
    lines = [f'calibration = "{options.rig.resolve()}"', f"fps = {options.fps}", f"late = {LATE}", "end = 20"]
    lines += ["[cameras]", *(f'{name} = "capture/{name}/{{:06d}}.png"' for name in names)]
    (folder / "sources.toml").write_text("\n".join(lines))
    for name in names:
        (folder / "capture" / name).mkdir(parents=True)
    seen = Seen()
    command = [BIN / "decogs-encode", "--live", folder / "sources.toml", "-o", "-", "--log", folder / "log.jsonl"]
    with subprocess.Popen([*command, *given], stdout=subprocess.PIPE) as encoder:
        cameras = threading.Thread(target=deliver, args=(folder, names, order, faults, options, seen))
        cameras.start()
        watch(encoder, seen, folder / "live.dgs")
        cameras.join()
        assert encoder.wait() == 0
    return seen


def deliver(
    folder: Path, names: list[str], order: list[int], faults: Faults, options: argparse.Namespace, seen: Seen
) -> None:
    """What the cameras do: every picture when it is due."""
    begun = time.monotonic() + 1
    due = [
        (frame / options.fps + faults.late.get((frame, name), 0.0), frame, name)
        for frame in range(options.frames)
        for name in names
        if (frame, name) not in faults.missing
    ]
    for at, frame, name in sorted(due):
        time.sleep(max(0.0, begun + at - time.monotonic()))
        seen.recorded.setdefault(frame, time.monotonic())
        source = folder / "pictures" / name / f"{order[frame % len(order)]}.png"
        target = folder / "capture" / name / f"{frame:06d}.png"
        if (frame, name) in faults.damaged:
            target.write_bytes(source.read_bytes()[: source.stat().st_size // 2])
        else:
            os.link(source, target)


def watch(encoder: subprocess.Popen[bytes], seen: Seen, copy: Path) -> None:
    """Reads the packets as they come."""
    assert encoder.stdout is not None
    with copy.open("wb") as file:
        reader = PacketReader(Copied(encoder.stdout, file))  # type: ignore[arg-type]
        for packet in iter(reader.next, None):
            if packet.kind in FRAME_KINDS:
                seen.written[packet.frame] = time.monotonic()
                seen.memory[packet.frame] = memory_of(encoder.pid)


class Copied:
    """A pipe whose bytes are kept in a file."""

    def __init__(self, pipe: object, file: object) -> None:
        self._pipe, self._file = pipe, file

    def read(self, size: int) -> bytes:
        data: bytes = self._pipe.read(size)  # type: ignore[attr-defined]
        self._file.write(data)  # type: ignore[attr-defined]
        return data


def memory_of(process: int) -> int:
    """Bytes that a process has in memory."""
    with open(f"/proc/{process}/status") as status:
        return next(int(line.split()[1]) * 1024 for line in status if line.startswith("VmRSS"))


def same_pictures(
    folder: Path, names: list[str], order: list[int], dropped: dict[tuple[int, str], str], count: int, calibration: Path
) -> None:
    """A rig of the pictures that the live encode had."""
    for name in names:
        target, last = folder / "after" / name, order[0]
        target.mkdir(parents=True)
        for frame in range(count):
            last = last if (frame, name) in dropped else order[frame % len(order)]
            os.link(folder / "pictures" / name / f"{last}.png", target / f"{frame:06d}.png")
    shutil.copy(calibration, folder / "after")


def figures(seen: Seen, frames: list[dict], faults: Faults, dropped: dict[tuple[int, str], str]) -> Iterator[str]:
    """What is printed, line by line; ages in seconds of the recording's frames that were encoded."""
    ages = np.array([seen.written[frame] - seen.recorded[frame] for frame in sorted(seen.written) if frame])
    yield f"frames             {len(frames)}"
    middle, most = np.quantile(ages, [0.5, 0.95])
    yield f"age of a packet    median {middle:.2f}, 95 % {most:.2f}, worst {ages.max():.2f} s"
    spent = [record["cpu_seconds"] for record in frames[1:]]
    untrained = sum(record["kind"] == "skip" for record in frames)
    yield f"left as they were  {untrained} frames"
    yield f"CPU of a frame     mean {np.mean(spent):.2f} s"
    places = [frame for frame in (20, 100, 200, 300, 400, len(frames) - 1) if frame in seen.memory]
    yield "memory             " + ", ".join(f"{seen.memory[at] / 2**20:.0f} MB at {at}" for at in places)
    lost, late = faults.lost, faults.late.keys()
    counts = f"{len(faults.missing)} missing, {len(faults.damaged)} damaged, {len(faults.late)} late"
    too_late = sum(seconds > LATE for seconds in faults.late.values())
    yield f"faults             {counts}, {too_late} of them by more than was to be waited"
    yield f"lost, not in the log   {len(lost - dropped.keys())} of {len(lost)}"
    yield f"late, in the log       {len(dropped.keys() & late)}"
    yield f"neither, in the log    {len(dropped.keys() - lost - late)}"


if __name__ == "__main__":
    main()
