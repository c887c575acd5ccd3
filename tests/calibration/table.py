"""How far decogs-calibrate comes from given poses: ``python tests/calibration/table.py RIG``.

It gets only the rig's videos. Found cameras are laid over the given ones by the similarity that fits their poses best.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import distort_pixels
from decogs.formats.cameras import Camera, camera_centre, in_picture, project
from decogs.formats.errors import DecogsError
from decogs.formats.geometry.similarity import Similarity, transformed_camera
from decogs.formats.rigs import Rig, open_rig
from decogs.rig.calibration.boards import parse_board
from decogs.rig.calibration.calibrate import calibrate
from decogs.rig.calibration.held_out import rays_of
from decogs.rig.calibration.placed import Calibration

F64 = NDArray[np.float64]

_TRIMMED, _FAR_OFF = 5, 3.0
"""Times that points which are off by so many times the median are left out: far ones, and seen from two places."""


def found_from(rig: Rig, options: argparse.Namespace) -> Calibration:
    """The calibration found from the rig's videos alone."""
    with tempfile.TemporaryDirectory() as folder:
        for camera, source in zip(rig.cameras, rig.sources, strict=True):
            if camera.name not in options.without.split(","):
                (Path(folder) / f"{camera.name}{source.path.suffix}").symlink_to(source.path.resolve())
        return calibrate(Path(folder), board=options.board, intrinsics=options.intrinsics, frames=options.instants)


def laid_over(found: Sequence[Camera], given: Sequence[Camera]) -> list[Camera]:
    """The found cameras moved, turned and scaled as one, so that their poses come closest to the given ones."""
    turns = [two.world_to_camera[:3, :3].T @ one.world_to_camera[:3, :3] for one, two in zip(found, given, strict=True)]
    turn = nearest_rotation(np.sum(turns, axis=0))
    here, there = (np.array([camera_centre(camera) for camera in cameras]) for cameras in (found, given))
    by = with_rotation(turn, here, there)
    return [transformed_camera(camera, by) for camera in found]


def worlds_laid_over(points: F64, found: Sequence[Camera], given: Sequence[Camera]) -> Similarity:
    """What lays the points that found cameras see over where given ones see them.

    Given and found poses may differ by more than a similarity, and pictures hardly: a camera whose axis is held to be
    elsewhere in its picture is turned to make up for it.
    """
    seen = as_given_cameras_see(points, found, given)
    kept = np.isfinite(seen).all(axis=1)
    for _ in range(_TRIMMED):
        here, there = points[kept], seen[kept]
        by = with_rotation(nearest_rotation((there - there.mean(axis=0)).T @ (here - here.mean(axis=0))), here, there)
        apart = np.linalg.norm(by.scale * points @ by.rotation.T + by.shift - seen, axis=1)
        kept = apart < _FAR_OFF * np.nanmedian(apart)
    return by


def as_given_cameras_see(points: F64, found: Sequence[Camera], given: Sequence[Camera]) -> F64:
    """The places (P, 3) nearest to given cameras' rays through the pixels where found ones see ``points``, or NaN."""
    normal, right, sights = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3)), np.zeros(len(points))
    for one, two in zip(found, given, strict=True):
        pixels = seen_by(one, points)
        rows = np.flatnonzero(np.isfinite(pixels).all(axis=1))
        rays = np.column_stack([rays_of(two, pixels[rows]), np.ones(len(rows))]) @ two.world_to_camera[:3, :3]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        across = np.eye(3) - rays[:, :, None] * rays[:, None]
        normal[rows] += across
        right[rows] += across @ camera_centre(two)
        sights[rows] += 1
    places = np.full((len(points), 3), np.nan)
    known = sights >= 2
    places[known] = np.linalg.solve(normal[known], right[known][..., None])[..., 0]
    return places


def seen_by(camera: Camera, points: F64) -> F64:
    """Pixels (P, 2) of points (P, 3) through the camera's lens; NaN where they are not in its picture."""
    columns, rows, depths = project(camera, points)
    pixels = distort_pixels(camera, np.stack([columns, rows], axis=1))
    return np.where(in_picture(camera, *pixels.T, depths)[:, None], pixels, np.nan)


def shifts(points: F64, found: Sequence[Camera], given: Sequence[Camera]) -> F64:
    """By how many pixels each camera's view shifts (median) from the found world to the given one laid over it."""
    by = worlds_laid_over(points, found, given)
    moved = by.scale * points @ by.rotation.T + by.shift
    pairs = [(seen_by(one, points), seen_by(two, moved)) for one, two in zip(found, given, strict=True)]
    return np.array([np.nanmedian(np.linalg.norm(one - two, axis=1)) for one, two in pairs])


def nearest_rotation(matrix: F64) -> F64:
    """The rotation (3, 3) that is most like a matrix (3, 3)."""
    left, _, right = np.linalg.svd(matrix)
    return np.asarray(left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right)


def with_rotation(rotation: F64, here: F64, there: F64) -> Similarity:
    """The similarity with this rotation that brings places (N, 3) closest to others."""
    apart, wanted = (here - here.mean(axis=0)) @ rotation.T, there - there.mean(axis=0)
    scale = float((apart * wanted).sum() / (apart**2).sum())
    return Similarity(rotation, scale, there.mean(axis=0) - scale * rotation @ here.mean(axis=0))


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
    pixels = shifts(calibration.points, found, [given[camera.name] for camera in found])
    print(f"views shift by {np.median(pixels):.2f}, {pixels.max():.2f} px where worlds are laid over each other")


if __name__ == "__main__":
    main()
