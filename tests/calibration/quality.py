"""What found poses cost: ``python tests/calibration/quality.py RIG -o FOLDER``.

The rig is calibrated from its videos without the camera that is left out, and laid over the given poses by a
similarity. Both are encoded in the same way, without points from elsewhere, and the left-out camera's view, from its
given pose, is compared with what it recorded. FOLDER gets the views beside each other.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import cv2
import numpy as np
from table import deviations, found_from, laid_over

from decogs.decoder.commands import decode_main
from decogs.encoder import EncodeJob, encode
from decogs.formats.rigs import Rig, open_rig


def measured(rig: Rig, name: str, options: argparse.Namespace) -> list[float]:
    """PSNR, dB, of every frame of the left-out camera; its views are decoded."""
    stream = options.output / f"{name}.dgs"
    report = encode(
        EncodeJob(rig, stream, "draft", frames=slice(options.frames), scale=options.scale, holdout=[options.holdout])
    )
    decode_main([str(stream), "--view", options.holdout, "-o", str(options.output / name), "-q"])
    return [frame.held_out_psnr or 0.0 for frame in report.frames]


def main() -> None:
    """Prints both PSNR and their difference."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rig", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--holdout", default="cam00")
    parser.add_argument("--scale", type=float, default=0.5)
    parser.add_argument("--frames", type=int, default=2)
    options = parser.parse_args()
    options.output.mkdir(exist_ok=True)
    rig = replace(open_rig(options.rig), points=None)
    placed = {one.camera.name: one.camera for one in found_from(rig, {options.holdout}).placed}
    kept = [number for number, camera in enumerate(rig.cameras) if camera.name in {*placed, options.holdout}]
    given = replace(rig, cameras=tuple(rig.cameras[k] for k in kept), sources=tuple(rig.sources[k] for k in kept))
    others = [camera for camera in given.cameras if camera.name != options.holdout]
    moved = {camera.name: camera for camera in laid_over([placed[camera.name] for camera in others], others)}
    found = replace(given, cameras=tuple(moved.get(camera.name, camera) for camera in given.cameras))
    found_off = deviations([moved[camera.name] for camera in others], others)
    for what, values in zip(("degrees", "% of the mean baseline", "% of focal length"), found_off, strict=True):
        print(f"{np.median(values):.2f}, {values.max():.2f} {what}", flush=True)
    figures = {name: measured(each, name, options) for name, each in (("given", given), ("found", found))}
    recorded = next(given.sources[[c.name for c in given.cameras].index(options.holdout)].read(0, 1))[..., ::-1]
    views = [cv2.imread(str(sorted((options.output / name).glob("*.png"))[0])) for name in figures]
    height, width = views[0].shape[:2]
    views.append(cv2.resize(np.ascontiguousarray(recorded), (width, height), interpolation=cv2.INTER_AREA))
    cv2.imwrite(str(options.output / "given_found_recorded.png"), np.hstack(views))
    for name, values in figures.items():
        print(f"{name}: {', '.join(f'{value:.2f}' for value in values)} dB")
    change = fmean(figures["found"]) - fmean(figures["given"])
    print(f"{rig.path.name}, {options.holdout} left out, {len(placed)} cameras: {change:+.2f} dB")


if __name__ == "__main__":
    main()
