"""Makes a rig of large pictures in which something moves, from a stream of a real scene: for measuring, not for tuning.

    python tests/bench/large_rig.py SCENE.dgs OUTPUT [--size 1352x1014] [--cameras 18] [--frames 30] [--part .02]

The first frame's Gaussians are seen by the stream's own cameras at the new size. A copy of those in the middle of the
picture hangs before the scene, swings by six pixels a frame at most, and turns. Noise of one level is added, and the
pictures go through H.264.

What is artificial about it: the scene is made of Gaussians, so Gaussians can show it exactly; the motion is rigid; the
light stays; nothing enters or leaves.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from budgets import rig_document
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.output.video import Movie, VideoSettings
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import Camera, in_camera, project
from decogs.formats.geometry.rotations import rotation_matrices
from decogs.formats.geometry.similarity import Similarity, transformed_splats
from decogs.formats.splats import Splats, join_splats, take_splats

FPS, CRF, NOISE = 30.0, 16.0, 1.0
NEARER = 0.35
"""How far the copy stands before the original, as a share of its depth."""
PIXELS_A_FRAME, FRAMES_A_SWING = 6.0, 30


def resized(camera: Camera, width: int, height: int) -> Camera:
    """The camera with pictures of this size, as much of the scene in them as before."""
    x, y = width / camera.width, height / camera.height
    size = {"width": width, "height": height, "fx": camera.fx * x, "fy": camera.fy * y}
    return replace(camera, **size, cx=camera.cx * x, cy=camera.cy * y, distortion_model="none", distortion=())


class Swing:
    """The scene with a moving copy of ``part`` of its Gaussians."""

    def __init__(self, scene: Splats, camera: Camera, part: float) -> None:
        self.scene = scene
        x, y, depth = project(camera, scene.means)
        seen = (
            (depth > 0)
            & (abs(x - camera.width / 2) < camera.width / 4)
            & (abs(y - camera.height / 2) < camera.height / 4)
        )
        middle = np.flatnonzero(seen)
        near = middle[np.argsort(depth[middle])[: len(middle) // 8]]
        centre = np.median(scene.means[near], axis=0)
        order = np.argsort(np.linalg.norm(scene.means - centre, axis=1))
        self.part = take_splats(scene, np.sort(order[: round(part * len(scene))]))
        self.centre = self.part.means.mean(axis=0).astype(np.float64)
        self.depth = float(in_camera(camera, self.centre[None])[0, 2])
        self.axes, self.focal = camera.world_to_camera[:3, :3], camera.fx

    def at(self, frame: int) -> Splats:
        """The scene in this frame."""
        phase = 2 * np.pi * frame / FRAMES_A_SWING
        depth = self.depth * (1 - NEARER)
        reach = PIXELS_A_FRAME * FRAMES_A_SWING / (2 * np.pi) * depth / self.focal
        aside = np.array([reach * np.sin(phase), 0.3 * reach * np.cos(2 * phase), -NEARER * self.depth]) @ self.axes
        half = 0.5 * np.sin(phase) * 0.6
        turn = rotation_matrices(np.array([[np.cos(half), *(np.sin(half) * self.axes[1])]]))[0]
        moved = transformed_splats(self.part, Similarity(turn))
        means = (moved.means + (self.centre + aside - turn @ self.centre)).astype(np.float32)
        return join_splats(self.scene, replace(moved, means=means))


def make(options: argparse.Namespace) -> None:
    width, height = (int(number) for number in options.size.split("x"))
    with open_stream(options.stream) as stream:
        header, scene = stream.header, next(iter(stream.frames())).splats
    cameras = [resized(camera, width, height) for camera in header.cameras[: options.cameras]]
    options.output.mkdir(parents=True)
    swing, random = Swing(scene, cameras[len(cameras) // 2], options.part), np.random.default_rng(0)
    settings = VideoSettings(codec="h264", crf=CRF)
    movies = [Movie(options.output / f"{camera.name}.mp4", FPS, settings) for camera in cameras]
    for frame in range(options.frames):
        shown = swing.at(frame)
        for camera, movie in zip(cameras, movies, strict=True):
            clean = to_8bit(render_view(header, shown, camera, threads=options.threads).image)
            noisy = clean + np.float32(NOISE) * random.standard_normal(clean.shape, np.float32)
            movie.write(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))
    for movie in movies:
        movie.finish()
    document = rig_document(cameras, [f"{camera.name}.mp4" for camera in cameras])
    (options.output / "rig.json").write_text(json.dumps(document))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("stream", help="a stream of a real scene")
    parser.add_argument("output", type=Path, help="the rig's folder, a new one")
    parser.add_argument("--size", default="1352x1014", help="of every picture, even numbers")
    parser.add_argument("--cameras", type=int, default=18)
    parser.add_argument("--frames", type=int, default=30)
    parser.add_argument("--part", type=float, default=0.02, help="share of the Gaussians that are copied and move")
    parser.add_argument("--threads", type=int, default=1)
    make(parser.parse_args())


if __name__ == "__main__":
    main()
