"""Takes a long take through the whole path: memory, size of the scene, quality, and an encode that is killed.

    python tests/bench/long_take.py RIG WORK [--frames 1000] [--preset standard] [--threads 1]

The rig's frames are played forward and back until there are enough; every camera's video is coded without loss, so all
rounds show the same pictures, noise included. Commands run as their users run them, cam00 is left out. Steps whose
results are in the folder are not run again.

1. ``decogs-encode``; its memory is read whenever its log has another frame.
2. The same, killed (SIGKILL) when the log has half of the frames, then ``--resume``: the same bytes.
3. ``decogs-decode`` of cam00, and ``decogs-export``, of a quarter of the frames and of all: peak memory.

What is artificial about it: nothing new ever comes, so a scene that has learnt a round's pictures has seen all.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from itertools import cycle, islice
from pathlib import Path
from statistics import median

import av
import numpy as np

MEBIBYTE = 1 << 20
COMMANDS = Path(sys.executable).parent
HELD_OUT = "cam00"
EXPORTS = ("spz", "ply", "usdc")


def there_and_back(count: int) -> list[int]:
    """One round over ``count`` frames: to the last one and back to the second."""
    return [*range(count), *range(count - 2, 0, -1)]


def play(source: Path, target: Path, frames: int) -> int:
    """Writes a video's pictures forward and back, H.264 without loss; returns the frames of a round."""
    with av.open(str(source)) as video:
        stream = video.streams.video[0]
        rate, pictures = stream.average_rate, [picture.to_ndarray() for picture in video.decode(stream)]
        form, width, height = stream.pix_fmt, stream.width, stream.height
        tags = {name: getattr(stream.codec_context, name) for name in ("colorspace", "color_range")}
    order = there_and_back(len(pictures))
    with av.open(str(target), "w") as movie:
        out = movie.add_stream("libx264", rate, options={"qp": "0", "preset": "veryfast"})
        out.width, out.height, out.pix_fmt = width, height, form
        for name, value in tags.items():
            setattr(out.codec_context, name, value)
        for index in islice(cycle(order), frames):
            movie.mux(out.encode(av.VideoFrame.from_ndarray(pictures[index], form)))
        movie.mux(out.encode())
    return len(order)


def make_rig(rig: Path, target: Path, frames: int) -> int:
    """The long rig in N3DV's layout; returns the frames of a round."""
    target.mkdir(parents=True, exist_ok=True)
    (target / "poses_bounds.npy").write_bytes((rig / "poses_bounds.npy").read_bytes())
    rounds = {play(video, target / video.name, frames) for video in sorted(rig.glob("cam*.mp4"))}
    assert len(rounds) == 1
    return rounds.pop()


def resident(process: int) -> int:
    """Bytes that the process holds in memory (Linux: /proc/PID/statm, second field, in pages)."""
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def watched(command: Sequence[str | Path], log: Path, *, kill_at: int | None = None) -> list[tuple[int, int]]:
    """Runs an encode and returns (frames so far, bytes held) whenever the log grew; ``kill_at``: frames to end at."""
    seen: list[tuple[int, int]] = []
    process = subprocess.Popen([str(part) for part in command])
    while process.poll() is None:
        time.sleep(0.2)
        done = log.read_bytes().count(b"\n") if log.exists() else 0
        # Nothing is held by a process that has ended and was not waited for.
        if (not seen or done > seen[-1][0]) and (held := resident(process.pid)):
            seen.append((done, held))
        if kill_at is not None and done >= kill_at:
            process.send_signal(signal.SIGKILL)
    code = process.wait()
    assert code == (0 if kill_at is None else -signal.SIGKILL), code
    return seen


def peak(*command: str | Path) -> float:
    """Peak memory of a command in MiB, as the kernel counts it for a child of a process of its own."""
    program = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True, stdout=subprocess.DEVNULL);"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    ran = subprocess.run(
        [sys.executable, "-c", program, *map(str, command)], check=True, capture_output=True, text=True
    )
    return int(ran.stdout) * 1024 / MEBIBYTE


def growth(seen: Sequence[tuple[int, int]]) -> float:
    """Bytes a frame, by the medians of the fourth tenth of the frames and of the last: by then the scene has grown."""
    last = seen[-1][0]
    early = [held for done, held in seen if 0.3 * last <= done < 0.4 * last]
    late = [held for done, held in seen if done >= 0.9 * last]
    return (median(late) - median(early)) / (0.6 * last)


def slope(psnr: Sequence[float], frames_a_round: int) -> tuple[float, float, float]:
    """Change of the means of whole rounds over the take, its standard error, and their mean; dB.

    The first round is left out: it trains from the keyframe, the others from a round before. Raises ValueError for
    fewer than four rounds.
    """
    rounds = len(psnr) // frames_a_round
    if rounds < 4:
        raise ValueError(f"{len(psnr)} frames have {rounds} rounds; a slope needs four")
    means = np.array(psnr[: rounds * frames_a_round]).reshape(rounds, frames_a_round).mean(axis=1)[1:]
    places = np.arange(len(means)) - (len(means) - 1) / 2
    rate = float(places @ means / (places @ places))
    rest = means - means.mean() - rate * places
    error = float(np.sqrt(rest @ rest / (len(means) - 2) / (places @ places)))
    return rate * (len(means) - 1), error * (len(means) - 1), float(means.mean())


def show_log(log: Path, frames_a_round: int) -> None:
    rows = [row for row in map(json.loads, log.read_text().splitlines()) if "frame" in row]
    later = rows[1:]
    count = [row["gaussians"] for row in rows]
    print(f"Gaussians: first {count[0]}, largest {max(count)}, last {count[-1]}")
    rounds = [later[i : i + frames_a_round] for i in range(0, len(later) - frames_a_round + 1, frames_a_round)]
    for name, part in (("first round", rounds[0]), ("last round", rounds[-1])):
        size, seconds = (sum(row[key] for row in part) / len(part) for key in ("bytes", "cpu_seconds"))
        print(f"{name}: {size / 1000:.1f} kB and {seconds:.2f} CPU-s a frame")
    for key in ("training_psnr", "held_out_psnr"):
        change, error, mean = slope([row[key] for row in rows], frames_a_round)
        print(f"{key}: {mean:.2f} dB, {change:+.3f} +- {error:.3f} dB from the second round to the last")
    sizes = sum(row["bytes"] for row in later)
    print(f"later frames in all {sizes / 1e6:.2f} MB, first {rows[0]['bytes'] / 1000:.0f} kB")


def run(options: argparse.Namespace) -> None:
    work: Path = options.work
    rig, stream, log, memory = work / "rig", work / "take.dgs", work / "take.log", work / "memory.json"
    if not (work / "round").exists():
        frames_a_round = make_rig(options.rig, rig, options.frames)
        (work / "round").write_text(str(frames_a_round))
    frames_a_round = int((work / "round").read_text())
    encode = [COMMANDS / "decogs-encode", rig, "--holdout", HELD_OUT, "--preset", options.preset]
    encode += ["--threads", options.threads]
    if options.closed:
        encode += ["--segment", options.closed, "--closed"]
    if not stream.exists():
        memory.write_text(json.dumps(watched([*encode, "-o", stream, "--log", log], log)))
    seen = json.loads(memory.read_text())
    print(f"encoder: {seen[-1][1] / MEBIBYTE:.0f} MiB held at the end, {growth(seen):+.0f} bytes a frame", flush=True)
    show_log(log, frames_a_round)
    again, again_log = work / "again.dgs", work / "again.log"
    if not again.exists():
        command = [*encode, "-o", again, "--log", again_log]
        watched(command, again_log, kill_at=options.frames // 2)
        watched([*command, "--resume"], again_log)
    same = again.read_bytes() == stream.read_bytes()
    print(f"killed at half and resumed: {'the same bytes' if same else 'OTHER BYTES'}", flush=True)
    for frames in (options.frames // 4, options.frames):
        out = work / f"decoded{frames}"
        command = [COMMANDS / "decogs-decode", stream, "--view", HELD_OUT, "--frames", f":{frames}", "-o", f"{out}/"]
        print(f"decogs-decode, {frames} frames: peak {peak(*command, '--threads', '1'):.0f} MiB", flush=True)
    for kind in EXPORTS:
        for frames in (options.frames // 4, options.frames):
            out = work / f"{kind}{frames}"
            out.mkdir(exist_ok=True)
            name = out / ("take.usdc" if kind == "usdc" else f"x_####.{kind}")
            used = peak(COMMANDS / "decogs-export", stream, "--frames", f":{frames}", "-o", name)
            size = sum(file.stat().st_size for file in out.iterdir())
            print(f"decogs-export {kind}, {frames} frames: peak {used:.0f} MiB, {size / MEBIBYTE:.0f} MiB", flush=True)
            for file in out.iterdir():
                file.unlink()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rig", type=Path, help="in N3DV's layout, with a cam00")
    parser.add_argument("work", type=Path)
    parser.add_argument("--frames", type=int, default=1000)
    parser.add_argument("--preset", default="standard")
    parser.add_argument("--closed", type=int, default=0, help="frames of a closed segment (default: one open segment)")
    parser.add_argument("--threads", default="1")
    run(parser.parse_args())


if __name__ == "__main__":
    main()
