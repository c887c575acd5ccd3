"""What decogs-calibrate says of focal lengths of few neighbours, and the truth: ``few_cameras.py RIG ...``.

A row for each subset: how many are placed, what their focal lengths may be off by as it says, what they are off by,
and how far matches that nothing was fitted to are from epipolar lines of found and given cameras (median), with a word
on which fit clearly better. ``--centre-off`` moves the pictures' features, as of lenses with their axis off the middle,
with ``--apart`` each to another side; ``--k1`` bends them.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import numpy as np
from table import deviations

from decogs.decoder.cameras.lens import distort_pixels, with_k1
from decogs.formats.cameras import Camera, as_pinhole, camera_centre
from decogs.formats.rigs import open_rig
from decogs.rig.calibration.by_motion import believed
from decogs.rig.calibration.features import Features, features_of, matched, sift_extractor
from decogs.rig.calibration.footage import Footage, instants_of, pictures_at
from decogs.rig.calibration.held_out import Score, score, split
from decogs.rig.calibration.structure import Matched, require_pycolmap


def subsets(cameras: list[Camera], sizes: list[int], count: int) -> Iterator[tuple[int, list[int]]]:
    """A seed and some cameras that stand next to each other, drawn at random."""
    centres = np.array([camera_centre(camera) for camera in cameras])
    draw, seen = np.random.default_rng(1), set()
    for size in sizes:
        for seed in range(count):
            distances = np.linalg.norm(centres - centres[draw.integers(len(cameras))], axis=1)
            chosen = sorted(np.argsort(distances, kind="stable")[:size].tolist())
            if tuple(chosen) not in seen:
                yield seed, chosen
            seen.add(tuple(chosen))


def changed(features: Features, camera: Camera, k1: float, off: tuple[float, float]) -> tuple[Features, Camera]:
    """The features as a lens would show them that bends, or has its axis off the middle by so many widths; and it."""
    shift = camera.width * np.array(off)
    bent = with_k1(as_pinhole(camera), k1) if k1 else camera
    pixels = distort_pixels(bent, features.pixels) if k1 else features.pixels
    return replace(features, pixels=pixels + shift), replace(bent, cx=bent.cx + shift[0], cy=bent.cy + shift[1])


def compared(found: Score, given: Score) -> str:
    """Medians, px, and which cameras fit clearly better."""
    words = f"{found.error:.2f}, {given.error:.2f} px"
    if found.is_clearly_better(given):
        return f"{words}: found"
    return f"{words}: given" if given.is_clearly_better(found) else words


def main() -> None:
    """Prints the rows."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rigs", nargs="+", type=Path)
    parser.add_argument("--frames", type=int, default=3)
    parser.add_argument("--cameras", default="3,4,5,6,8")
    parser.add_argument("--subsets", type=int, default=3, help="of each size")
    parser.add_argument("--k1", type=float, default=0)
    parser.add_argument("--centre-off", type=float, default=0)
    parser.add_argument("--apart", action="store_true", help="each camera's axis off to another side")
    parser.add_argument("--shared", action="store_true")
    options = parser.parse_args()
    require_pycolmap()
    for path in options.rigs:
        rig, extractor = open_rig(path), sift_extractor()
        footage = [Footage(camera.name, source) for camera, source in zip(rig.cameras, rig.sources, strict=True)]
        instants = instants_of(footage, options.frames)
        found = [features_of(list(pictures_at(one, instants)), extractor) for one in footage]
        pairs = {(a, b): matched(found[a], found[b]) for a, b in combinations(range(len(found)), 2)}
        ways = (
            np.random.default_rng(2).uniform(0, 2 * np.pi, len(found)) if options.apart else np.full(len(found), -0.64)
        )
        bent = [
            changed(*one, options.k1, (options.centre_off * np.cos(way), options.centre_off * np.sin(way)))
            for *one, way in zip(found, rig.cameras, ways, strict=True)
        ]
        for seed, chosen in subsets(
            list(rig.cameras), [int(size) for size in options.cameras.split(",")], options.subsets
        ):
            few, features = [footage[number] for number in chosen], [bent[number][0] for number in chosen]
            links = {(a, b): pairs[chosen[a], chosen[b]] for a, b in combinations(range(len(chosen)), 2)}
            start = Matched(
                [one.name for one in few], [one.size for one in few], features, split(features, links), options.shared
            )
            mapped, calibration = believed(start, few, seed)
            head = f"{path.name} | {len(chosen)} from {chosen[0]} | {len(calibration.placed)}"
            if mapped is None or len(calibration.placed) < 3:
                print(f"| {head} | refused | | | |", flush=True)
                continue
            cameras = [one.camera for one in calibration.placed]
            every = dict(enumerate(bent[number][1] for number in chosen))
            given = [every[start.names.index(camera.name)] for camera in cameras]
            said = 100 * np.array([mapped.focal_errors[start.names.index(camera.name)] for camera in cameras])
            degrees, centres, focal = deviations(cameras, given)
            silent = "  <- in silence" if ((focal > 2) & (said < 2)).any() else ""
            word = "in doubt" if calibration.doubts else "accepted"
            truth = f"{np.median(focal):.1f}, {focal.max():.1f} % | {degrees.max():.2f} degrees, {centres.max():.1f} %"
            matches = compared(
                score(mapped.cameras, features, start.pairs),
                score({number: every[number] for number in mapped.cameras}, features, start.pairs),
            )
            print(
                f"| {head} | {word} | {np.median(said):.1f}, {said.max():.1f} % | {truth} | {matches} |{silent}",
                flush=True,
            )


if __name__ == "__main__":
    main()
