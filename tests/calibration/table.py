"""How far decogs-calibrate comes from given poses: ``python tests/calibration/table.py RIG``.

It gets only the rig's videos. Found cameras are laid over the given ones by the similarity that fits their poses best.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.encoder.calibration.boards import parse_board
from decogs.encoder.calibration.calibrate import calibrate
from decogs.encoder.calibration.placed import Calibration
from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.errors import DecogsError
from decogs.formats.rigs import Rig, open_rig

F64 = NDArray[np.float64]


def found_from(rig: Rig, options: argparse.Namespace) -> Calibration:
    """The calibration found from the rig's videos alone."""
    with tempfile.TemporaryDirectory() as folder:
        for camera, source in zip(rig.cameras, rig.sources, strict=True):
            if camera.name not in options.without.split(","):
                (Path(folder) / f"{camera.name}{source.path.suffix}").symlink_to(source.path.resolve())
        return calibrate(Path(folder), board=options.board, intrinsics=options.intrinsics, frames=options.instants)


def laid_over(found: Sequence[Camera], given: Sequence[Camera]) -> list[Camera]:
    """The found cameras moved, turned and scaled as one, so that they come closest to the given ones."""
    turns = [two.world_to_camera[:3, :3].T @ one.world_to_camera[:3, :3] for one, two in zip(found, given, strict=True)]
    left, _, right = np.linalg.svd(np.sum(turns, axis=0))
    turn = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    here, there = (np.array([camera_centre(camera) for camera in cameras]) for cameras in (found, given))
    apart, wanted = (here - here.mean(axis=0)) @ turn.T, there - there.mean(axis=0)
    centres = there.mean(axis=0) + apart * (apart * wanted).sum() / (apart**2).sum()
    moved = []
    for camera, centre in zip(found, centres, strict=True):
        pose = np.eye(4)
        pose[:3, :3] = camera.world_to_camera[:3, :3] @ turn.T
        pose[:3, 3] = -pose[:3, :3] @ centre
        moved.append(replace(camera, world_to_camera=pose))
    return moved


def deviations(found: Sequence[Camera], given: Sequence[Camera]) -> tuple[F64, F64, F64]:
    """Of each camera: degrees of its rotation, its centre in % of the mean baseline, its focal length in %."""
    pairs = list(zip(laid_over(found, given), given, strict=True))
    turns = np.array([one.world_to_camera[:3, :3] @ two.world_to_camera[:3, :3].T for one, two in pairs])
    degrees = np.degrees(np.arccos(np.clip((np.trace(turns, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    here, there = (np.array([camera_centre(pair[side]) for pair in pairs]) for side in (0, 1))
    baseline = np.linalg.norm(there[:, None] - there[None], axis=2).sum() / (len(there) * (len(there) - 1))
    focal = [abs(one.fx / two.fx - 1) for one, two in pairs]
    return degrees, 100 * np.linalg.norm(here - there, axis=1) / baseline, 100 * np.array(focal)


def rig_parser(description: str | None) -> argparse.ArgumentParser:
    """Options of a script that calibrates a rig."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("rig", type=Path)
    parser.add_argument("--board", type=parse_board)
    parser.add_argument("--intrinsics", type=Path)
    parser.add_argument("--instants", type=int, help="of the take that the calibration looks at")
    parser.add_argument("--without", default="", help="names of cameras, with commas between them")
    return parser


def main() -> None:
    """Prints the rig's row of the table, and one for each camera."""
    options = rig_parser(__doc__).parse_args()
    rig, start = open_rig(options.rig), time.process_time()
    try:
        calibration = found_from(rig, options)
    except DecogsError as error:
        print(error)
        print(f"| {options.rig.name} | refused | | | | {time.process_time() - start:.0f} |")
        return
    seconds, given = time.process_time() - start, {camera.name: camera for camera in rig.cameras}
    found = [one.camera for one in calibration.placed]
    rows = np.stack(deviations(found, [given[camera.name] for camera in found]), axis=1)
    for camera, (degrees, centre, focal) in zip(found, rows, strict=True):
        print(f"{camera.name}: rotation {degrees:.2f} degrees, centre {centre:.1f} %, focal {focal:.1f} %")
    for name, reason in (*calibration.not_connected.items(), *calibration.doubts.items()):
        print(f"{name}: {reason}")
    print(calibration.way)
    print("| rig | cameras | rotation, median, worst | centres, median, worst | focal, median, worst | CPU-s |")
    pairs = [f"{np.median(column):.2f}, {column.max():.2f}" for column in rows.T]
    print(f"| {options.rig.name} | {len(found)} of {len(given)} | {' | '.join(pairs)} | {seconds:.0f} |")


if __name__ == "__main__":
    main()
