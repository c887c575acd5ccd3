"""Encodes the sample rig, decodes the camera that training never saw, exports USD, and says how good and how big it is.

Run by ``make demo``; everything is written to ``demo/`` in the current folder.
"""

from __future__ import annotations

import os
import shutil
import sys
import time
from pathlib import Path

import cv2
import numpy as np

from decogs.decoder import decode, export, info
from decogs.encoder import EncodeJob, TerminalProgress, encode
from decogs.formats.errors import DecogsError
from decogs.formats.pictures.reading import Picture, read_picture
from decogs.formats.rigs import open_rig, read_frames

RIG = Path(__file__).resolve().parent / "workbench"
OUTPUT = Path("demo")
HELD_OUT = "cam00"


def main() -> None:
    shutil.rmtree(OUTPUT, ignore_errors=True)
    OUTPUT.mkdir()
    stream, pictures, scene, beside = (OUTPUT / name for name in ("scene.dgs", HELD_OUT, "scene.usdc", "beside.png"))

    with TerminalProgress(sys.stderr) as progress:
        encoded = encode(EncodeJob(RIG, stream, holdout=(HELD_OUT,), log=OUTPUT / "encode.jsonl"), progress=progress)
    if encoded.interrupted:
        sys.exit(f"demo: interrupted; {stream} holds the first {len(encoded.frames)} frames")
    started = time.perf_counter()
    decode(stream, pictures, view=HELD_OUT)
    decoding_seconds = time.perf_counter() - started
    export(stream, scene)

    decoded = [read_picture(path) for path in sorted(pictures.glob("*.png"))]
    recorded = [frame for _, (frame,) in read_frames(open_rig(RIG), names=[HELD_OUT])]
    quality = [psnr(mine, truth) for mine, truth in zip(decoded, recorded, strict=True)]
    cv2.imwrite(str(beside), np.hstack([recorded[-1], decoded[-1]])[:, :, ::-1])

    totals = info(stream).totals
    keyframe_seconds, *later_seconds = [sum(frame.seconds.values()) for frame in encoded.frames]
    viewer = os.path.relpath(Path(sys.executable).with_name("decogs-view"))
    print(f"""
{stream}: the stream; how its encoding went is in {OUTPUT / "encode.jsonl"}
{pictures}/: the view of {HELD_OUT}, which was held out of training
{beside}: its last frame as recorded (left) and as decoded (right)
{scene}: the same scene for Blender, Houdini and usdview

PSNR of {HELD_OUT}     {np.mean(quality):.2f} dB (first frame {quality[0]:.2f}, last {quality[-1]:.2f})
bytes per frame   {totals["bytes_per_frame"]:,.0f} (keyframe {totals["mean_key_bytes"]:,.0f}, each later frame \
{totals["bytes_per_frame_without_first_key"]:,.0f})
seconds per frame {np.mean([keyframe_seconds, *later_seconds]):.1f} (keyframe {keyframe_seconds:.1f}, each later frame \
{np.mean(later_seconds):.1f}); {decoding_seconds / len(decoded):.2f} to decode and write

To look at it in the browser, from anywhere: {viewer} {stream}""")


def psnr(decoded: Picture, recorded: Picture) -> float:
    """Peak signal-to-noise ratio of 8-bit pictures over all pixels and channels, in dB."""
    error = np.mean((decoded.astype(np.float64) - recorded) ** 2)
    return float(10 * np.log10(255**2 / max(error, 1e-12)))


if __name__ == "__main__":
    try:
        main()
    except DecogsError as error:
        sys.exit(f"demo: error: {error}")
