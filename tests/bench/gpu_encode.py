"""Measures whole encodes of a rig enlarged to a GPU's size, stage by stage.

    python tests/bench/gpu_encode.py RIG [--size WxH] [--cameras N] [--frames N] [--repeat N] [-- ENCODE_ARGS]

The pictures are enlarged once, into a folder that a later run finds again. With --repeat, the same encode runs several
times, and whether it gave the same bytes is said. ENCODE_ARGS go to decogs-encode, such as --device cuda.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from pathlib import Path
from statistics import fmean
from typing import Any

import cv2

from decogs.encoder.commands import encode_main
from decogs.rig.parallel import side_by_side


def enlarged(rig: Path, folder: Path, size: tuple[int, int], cameras: int, frames: int) -> Path:
    """A copy of the rig's first frames, with as many of its first cameras, as PNG of this size."""
    if (folder / "rig.json").exists():
        return folder
    described = json.loads((rig / "rig.json").read_text())
    described |= {"cameras": described["cameras"][:cameras], "frame_count": frames}
    with side_by_side(0) as each:
        list(each(lambda camera: enlarge_camera(rig, folder, camera, size, frames), described["cameras"]))
    (folder / "rig.json").write_text(json.dumps(described))
    return folder


def enlarge_camera(rig: Path, folder: Path, camera: dict[str, Any], size: tuple[int, int], frames: int) -> None:
    """Writes the camera's pictures, and describes them in ``camera``; pixel centres are whole numbers there."""
    video = cv2.VideoCapture(str(rig / camera["file"]))
    (folder / camera["name"]).mkdir(parents=True)
    for frame in range(frames):
        there, picture = video.read()
        if not there:
            break
        large = cv2.resize(picture, size, interpolation=cv2.INTER_CUBIC)
        cv2.imwrite(str(folder / camera["name"] / f"{frame:04d}.png"), large, [cv2.IMWRITE_PNG_COMPRESSION, 1])
    for side, focal, centre, now in (("width", "fx", "cx", size[0]), ("height", "fy", "cy", size[1])):
        factor = now / camera[side]
        camera[focal], camera[centre] = factor * camera[focal], factor * (camera[centre] + 0.5) - 0.5
        camera[side] = now
    camera["file"] = camera["name"]


def measured(rig: Path, output: Path, more: list[str]) -> None:
    """Encodes, and prints what each stage of the keyframe and of later frames took."""
    log, began = output.with_suffix(".jsonl"), time.perf_counter()
    code = encode_main([str(rig), "-o", str(output), "--log", str(log), "-q", *more])
    if code:
        sys.exit(code)
    seconds = time.perf_counter() - began
    frames = [json.loads(line) for line in log.read_text().splitlines()]
    frames = [line for line in frames if line["event"] == "frame"]
    digest = hashlib.sha256(output.read_bytes()).hexdigest()[:12]
    print(f"{seconds:.1f} s, {output.stat().st_size} bytes, sha256 {digest}")
    print_stages("keyframe", frames[:1])
    print_stages("later frames", frames[1:])


def print_stages(name: str, frames: list[dict[str, Any]]) -> None:
    if not frames:
        return
    stages = {stage: fmean(frame["seconds"].get(stage, 0.0) for frame in frames) for stage in frames[-1]["seconds"]}
    held_out = [frame["held_out_psnr"] for frame in frames if frame.get("held_out_psnr") is not None]
    psnr = f", held-out {fmean(held_out):.2f} dB" if held_out else ""
    selected = fmean(frame["selected"] for frame in frames)
    print(f"{name}: {sum(stages.values()):.3f} s, selected {selected:.1%}, {frames[-1]['gaussians']} Gaussians{psnr}")
    print("   " + ", ".join(f"{stage} {value:.3f}" for stage, value in stages.items()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("rig", type=Path)
    parser.add_argument("--size", default="1352x1014", help="of the pictures (default 1352x1014)")
    parser.add_argument("--cameras", type=int, default=19, help="the rig's first so many (default 19)")
    parser.add_argument("--frames", type=int, default=11, help="the rig's first so many (default 11)")
    parser.add_argument("--repeat", type=int, default=1, help="encodes (default 1)")
    parser.add_argument("--folder", type=Path, default=Path("build/gpu"), help="for pictures and streams")
    own, more = sys.argv[1:], []
    if "--" in own:
        own, more = own[: own.index("--")], own[own.index("--") + 1 :]
    args = parser.parse_args(own)
    width, height = (int(side) for side in args.size.split("x"))
    copy = args.folder / f"{args.rig.name}-{args.size}-{args.cameras}-{args.frames}"
    rig = enlarged(args.rig, copy, (width, height), args.cameras, args.frames)
    for run in range(args.repeat):
        measured(rig, args.folder / f"{run}.dgs", more)


if __name__ == "__main__":
    main()
