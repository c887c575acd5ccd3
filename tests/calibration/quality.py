"""What found poses cost: ``python tests/calibration/quality.py RIG -o FOLDER``.

The rig is calibrated from its videos, and laid over the given poses by a similarity. Both are encoded in the same way,
without points from elsewhere and without one camera, whose views are compared with what it recorded. With found poses
they are from where it was found, and from its given pose, which the found world fits only as well as a similarity lays
one over the other. FOLDER gets the views beside each other.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import cv2
import numpy as np
from table import deviations, found_from, laid_over

from decogs.bench.metrics import BytePicture, psnr, square_error_map
from decogs.bench.regions import held_out_pictures
from decogs.decoder.picture_output import to_8bit
from decogs.decoder.stream import open_stream
from decogs.decoder.views import render_view
from decogs.encoder import EncodeJob, encode
from decogs.formats.rigs import Rig, open_rig

PLACED = "as-found"
"""The left-out camera's name where it was found; by its own name it stands at its given pose."""
UNITS = "degrees", "% of the mean baseline", "% of focal length"


def views(
    rig: Rig, cameras: list[str], stream: Path, seed: int, options: argparse.Namespace
) -> dict[str, list[BytePicture]]:
    """Every frame as each of the left-out ``cameras`` sees it."""
    frames = slice(options.frames)
    encode(EncodeJob(rig, stream, "draft", frames=frames, scale=options.scale, holdout=cameras, seed=seed))
    with open_stream(stream) as opened:
        scenes = [frame.splats for frame in opened.frames()]
        return {
            name: [to_8bit(render_view(opened.header, scene, name, scale=options.scale).image) for scene in scenes]
            for name in cameras
        }


def main() -> None:
    """Prints PSNR and differences."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rig", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--holdout", default="cam00")
    parser.add_argument("--scale", type=float, default=0.5)
    parser.add_argument("--frames", type=int, default=2)
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    options.output.mkdir(exist_ok=True)
    rig = replace(open_rig(options.rig), points=None)
    found = {one.camera.name: one.camera for one in found_from(rig, set()).placed}
    kept = [number for number, camera in enumerate(rig.cameras) if camera.name in found]
    given = replace(rig, cameras=tuple(rig.cameras[k] for k in kept), sources=tuple(rig.sources[k] for k in kept))
    moved = laid_over([found[camera.name] for camera in given.cameras], given.cameras)
    for what, values in zip(UNITS, deviations(moved, given.cameras), strict=True):
        print(f"{np.median(values):.2f}, {values.max():.2f} {what}", flush=True)
    place = [camera.name for camera in given.cameras].index(options.holdout)
    twin = replace(moved[place], name=PLACED)
    moved[place] = given.cameras[place]
    both = replace(given, cameras=(*moved, twin), sources=(*given.sources, given.sources[place]))
    recorded = list(held_out_pictures(rig, options.holdout, range(options.frames), options.scale))
    quality: dict[str, list[float]] = {}
    for seed in range(options.seeds):
        seen = {"given": views(given, [options.holdout], options.output / "given.dgs", seed, options)[options.holdout]}
        at = views(both, [options.holdout, PLACED], options.output / "found.dgs", seed, options)
        seen |= {"found": at[PLACED], "found, at its given pose": at[options.holdout]}
        for name, pictures in seen.items():
            pairs = zip(pictures, recorded, strict=True)
            quality.setdefault(name, []).append(fmean(psnr(square_error_map(*pair)) or 0.0 for pair in pairs))
        print(
            f"seed {seed}: " + ", ".join(f"{name} {values[-1]:.2f} dB" for name, values in quality.items()), flush=True
        )
        shown = [*(pictures[0] for pictures in seen.values()), recorded[0]]
        cv2.imwrite(str(options.output / "given_found_recorded.png"), np.hstack(shown)[..., ::-1])
    for name, values in quality.items():
        changes = np.subtract(values, quality["given"])
        error = changes.std(ddof=1) / np.sqrt(len(changes)) if len(changes) > 1 else 0.0
        print(
            f"{rig.path.name}, {options.holdout} left out, {name}: {fmean(values):.2f} dB, "
            f"{changes.mean():+.2f} +- {error:.2f}"
        )


if __name__ == "__main__":
    main()
