"""Measures the exact sparse step against the dense one, and what a scene's size costs it.

    python tests/bench/sparse.py [--rounds N] [--size 352x264] [--gaussians 40000]

One thread, process time, medians over rounds; in every round all variants run in turn. A step is the drawing of the
picture, its loss and the gradients of the moving Gaussians: the dense one draws and differentiates everything.
"""

from __future__ import annotations

import argparse
import os
import time
from statistics import median

import numpy as np

from decogs.encoder.backends import gradients_like
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats, join_splats, take_splats
from rasterise import Step, front_camera, milliseconds, random_scene

COUNT, SIZE = 40_000, "352x264"
"""Of the order of `workbench` and its keyframe."""
SHARES = (0.02, 0.05, 0.1, 0.35)
BALL = (0.0, 0.2, -0.3)
"""Where the moving Gaussians are: around this point."""


def nearest(splats: Splats, count: int) -> np.ndarray:
    """Rows of the ``count`` Gaussians nearest to the ball's centre."""
    distance = np.linalg.norm(splats.means - np.float32(BALL), axis=1)
    return np.sort(np.argsort(distance)[:count])


class SparseStep:
    """A training step of the Gaussians ``rows``; the others rest."""

    def __init__(self, kernel: CpuKernel, splats: Splats, camera: Camera, rows: np.ndarray) -> None:
        self.rows, self.moving = rows, take_splats(splats, rows)
        self.target = np.random.default_rng(1).random((3, camera.height, camera.width), dtype=np.float32)
        self.view = CpuFixedView(kernel, camera)
        self.view.set_scene(splats)
        self.view.redraw()
        self.view.detach(self.rows)
        self.gradients = gradients_like(self.moving)

    def __call__(self) -> None:
        self.view.draw(self.moving, self.rows)
        self.view.loss(self.target, l1_scale=0.8, ssim_scale=0.2)
        self.view.backward(out=self.gradients)


def bench_shares(rounds: int, count: int, width: int, height: int) -> None:
    """Dense against sparse, by the share of Gaussians that move."""
    splats, camera, kernel = random_scene(count, 1), front_camera(width, height), CpuKernel(1)
    whole = Step(kernel, splats, camera)
    steps = [SparseStep(kernel, splats, camera, nearest(splats, int(share * count))) for share in SHARES]

    def dense() -> None:
        whole.forward()
        whole.loss()
        whole.backward()

    rows = [[milliseconds(step, time.process_time) for step in (dense, *steps)] for _ in range(rounds)]
    print(f"{count} Gaussians, degree 1, {width}x{height}: dense {median(r[0] for r in rows):.1f} ms a step")
    print("moving   tiles they meet   sparse ms   dense / sparse (median of the rounds' ratios)")
    for index, (share, step) in enumerate(zip(SHARES, steps, strict=True), start=1):
        ratio = median(r[0] / r[index] for r in rows)
        print(f"{share:6.0%} {step.view.met.mean():17.0%} {median(r[index] for r in rows):11.2f} {ratio:16.1f}")


def shifted(splats: Splats, offset: float) -> Splats:
    means = splats.means + np.float32([offset, 0, 0])
    return Splats(means, splats.log_scales, splats.quaternions, splats.opacity_logits, splats.sh)


def bench_size(rounds: int, count: int, width: int, height: int) -> None:
    """The same moving Gaussians in a scene of N, of twice as many beside them, and of twice as many around them."""
    camera, kernel = front_camera(2 * width, height), CpuKernel(1)
    scene, others = random_scene(count, 1), random_scene(count, 1)
    others = take_splats(others, np.arange(count)[::-1])
    moving = nearest(scene, int(0.05 * count))
    scenes = {
        "N": scene,
        "2 N, the others beside them": join_splats(scene, shifted(others, 2.5)),
        "2 N, the others among them": join_splats(scene, shifted(others, 0.01)),
    }
    steps = {name: SparseStep(kernel, splats, camera, moving) for name, splats in scenes.items()}
    rows = [[milliseconds(step, time.process_time) for step in steps.values()] for _ in range(rounds)]
    print(f"\n{len(moving)} moving Gaussians in a scene of N = {count} or of 2 N, {2 * width}x{height}")
    for index, name in enumerate(steps):
        ratio = median(r[index] / r[0] for r in rows)
        print(f"{name:30} {median(r[index] for r in rows):6.2f} ms   {ratio:.2f} of N's")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=31, help="measurements of each variant (default 31)")
    parser.add_argument("--size", default=SIZE, help=f"of the pictures (default {SIZE})")
    parser.add_argument("--gaussians", type=int, default=COUNT, help=f"of the scene (default {COUNT})")
    options = parser.parse_args()
    rounds, scene = options.rounds, (options.gaussians, *(int(number) for number in options.size.split("x")))
    print(f"Milliseconds, 1 thread, process time, medians of {rounds}; load average {os.getloadavg()[0]:.1f}\n")
    bench_shares(rounds, *scene)
    bench_size(rounds, *scene)


if __name__ == "__main__":
    main()
