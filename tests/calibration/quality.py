"""What found poses cost: ``python tests/calibration/quality.py RIG -o FOLDER``.

The rig is calibrated from its videos, and its world laid over the given one by a similarity. Both are encoded in the
same way, without points from elsewhere and without one camera, whose views are compared with what it recorded; each of
``--holdout`` in its turn. With found poses they are from where it was found, and from its given pose, which the found
world fits only as well as a similarity lays one over the other. FOLDER gets the views beside each other.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import cv2
import numpy as np
from table import found_from, rig_parser, worlds_laid_over

from decogs.bench.measures.metrics import BytePicture, psnr, square_error_map
from decogs.bench.measures.regions import held_out_pictures
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder import EncodeJob, encode
from decogs.formats.cameras import Camera
from decogs.formats.geometry.similarity import transformed_camera
from decogs.formats.rigs import Rig, open_rig

PLACED = "as-found"
"""The left-out camera's name where it was found; by its own name it stands at its given pose."""


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


def with_found(given: Rig, moved: Sequence[Camera], name: str) -> Rig:
    """The rig where its cameras were found, with camera ``name`` there twice: at its given pose, and as PLACED."""
    place = [camera.name for camera in given.cameras].index(name)
    cameras = [*moved, replace(moved[place], name=PLACED)]
    cameras[place] = given.cameras[place]
    return replace(given, cameras=tuple(cameras), sources=(*given.sources, given.sources[place]))


def measured(
    given: Rig, moved: Sequence[Camera], name: str, seed: int, options: argparse.Namespace
) -> dict[str, float]:
    """PSNR, dB, of what camera ``name`` sees with given poses, with found ones, and with these at its given pose."""
    recorded = list(held_out_pictures(given, name, range(options.frames), options.scale))
    seen = {"given": views(given, [name], options.output / "given.dgs", seed, options)[name]}
    at = views(with_found(given, moved, name), [name, PLACED], options.output / "found.dgs", seed, options)
    seen |= {"found": at[PLACED], "found, at its given pose": at[name]}
    shown = [*(pictures[0] for pictures in seen.values()), recorded[0]]
    cv2.imwrite(str(options.output / f"{name}_given_found_recorded.png"), np.hstack(shown)[..., ::-1])
    return {
        way: fmean(psnr(square_error_map(*pair)) or 0.0 for pair in zip(pictures, recorded, strict=True))
        for way, pictures in seen.items()
    }


def main() -> None:
    """Prints PSNR and differences."""
    parser = rig_parser(__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--holdout", default="cam00", help="cameras, with commas between them")
    parser.add_argument("--scale", type=float, default=0.5)
    parser.add_argument("--frames", type=int, default=2)
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    options.output.mkdir(exist_ok=True)
    rig = replace(open_rig(options.rig), points=None)
    calibration = found_from(rig, options)
    found = {one.camera.name: one.camera for one in calibration.placed}
    kept = [number for number, camera in enumerate(rig.cameras) if camera.name in found]
    given = replace(rig, cameras=tuple(rig.cameras[k] for k in kept), sources=tuple(rig.sources[k] for k in kept))
    placed = [found[camera.name] for camera in given.cameras]
    by = worlds_laid_over(calibration.points, placed, given.cameras)
    moved = [transformed_camera(camera, by) for camera in placed]
    for name in options.holdout.split(","):
        every = [measured(given, moved, name, seed, options) for seed in range(options.seeds)]
        for way in every[0]:
            values = [quality[way] for quality in every]
            changes = np.subtract(values, [quality["given"] for quality in every])
            error = changes.std(ddof=1) / np.sqrt(len(changes)) if len(changes) > 1 else 0.0
            print(
                f"{rig.path.name}, {name} left out, {way}: {fmean(values):.2f} dB, "
                f"{changes.mean():+.2f} +- {error:.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
