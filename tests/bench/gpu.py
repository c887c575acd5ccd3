"""Measures a training step on a CUDA device, part by part, and how far its pictures and gradients are from the CPU's.

    python tests/bench/gpu.py [--rounds N] [--count N] [--size WxH]

Wall time with the device waited for at both ends of a part; medians over rounds, in which all variants run in turn.
"Queued" is a step as training takes it, waited for after many. Needs a GPU and torch with CUDA.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from statistics import median

import numpy as np
import torch

from decogs.encoder.backends import ATTRIBUTES, cuda
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cuda.cuda_kernel import CudaKernel
from decogs.encoder.backends.cuda.device import read, upload
from decogs.encoder.settings.optimiser import LearningRates
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats, take_splats
from rasterise import front_camera, random_scene
from sparse import nearest

RATES = LearningRates(1e-9, 1e-9, 1e-9, 1e-9, 1e-9, 1e-9)
"""So small that the scene stays the same from round to round."""
_QUEUED = 50
"""Steps in a row."""


def milliseconds(function: Callable[[], object]) -> float:
    torch.cuda.synchronize()
    began = time.perf_counter()
    function()
    torch.cuda.synchronize()
    return 1000 * (time.perf_counter() - began)


class DenseStep:
    """A training step of a whole scene: its parts as functions without arguments."""

    def __init__(self, kernel: CudaKernel, splats: Splats, camera: Camera) -> None:
        self.kernel, self.camera, self.optimiser = kernel, camera, kernel.optimiser(splats)
        self.target = np.random.default_rng(1).random((3, camera.height, camera.width), dtype=np.float32)
        self.parts = (self.forward, self.loss, self.backward, self.adam)

    def forward(self) -> None:
        self.kernel.forward(self.optimiser, self.camera)

    def loss(self) -> None:
        self.kernel.picture_loss(self.target, **scales(self.target))

    def backward(self) -> None:
        self.gradients = self.kernel.backward(self.optimiser)

    def adam(self) -> None:
        self.optimiser.step(self.gradients, RATES)


class SparseStep:
    """A training step of the Gaussians ``rows`` while the others rest."""

    def __init__(self, kernel: CudaKernel, splats: Splats, camera: Camera, rows: np.ndarray) -> None:
        self.rows, self.optimiser = rows, kernel.optimiser(take_splats(splats, rows))
        self.target = np.random.default_rng(1).random((3, camera.height, camera.width), dtype=np.float32)
        self.view = kernel.fixed_view(camera)
        self.view.set_scene(splats)
        self.view.redraw()
        self.view.detach(rows)
        self.parts = (self.draw, self.loss, self.backward, self.adam)

    def draw(self) -> None:
        self.view.draw(self.optimiser, self.rows)

    def loss(self) -> None:
        self.view.loss(self.target, **scales(self.target))

    def backward(self) -> None:
        self.gradients = self.view.backward()

    def adam(self) -> None:
        self.optimiser.step(self.gradients, RATES)


def scales(target: np.ndarray) -> dict[str, float]:
    """Of a mean over a whole picture."""
    return {"l1_scale": 0.8 / target.size, "ssim_scale": 0.2 / target.size}


def bench_steps(kernel: CudaKernel, splats: Splats, camera: Camera, rounds: int) -> None:
    variants: dict[str, DenseStep | SparseStep] = {"dense": DenseStep(kernel, splats, camera)}
    for share in (0.02, 0.1, 0.35):
        variants[f"{share:.0%} move"] = SparseStep(kernel, splats, camera, nearest(splats, int(share * len(splats))))
    rows: dict[str, list[list[float]]] = {name: [] for name in variants}
    for round_ in range(rounds + 3):
        for name, step in variants.items():
            times = [milliseconds(part) for part in step.parts]
            if round_ >= 3:
                rows[name].append(times)
    print(f"{'':12} {'draw':>8} {'loss':>8} {'backward':>9} {'Adam':>8} {'step':>8} {'queued':>8}  tiles met")
    for name, step in variants.items():
        parts = [median(row[i] for row in rows[name]) for i in range(4)]
        met = f"{step.view.met.mean():.0%}" if isinstance(step, SparseStep) else "100%"
        total = median(sum(row) for row in rows[name])
        numbers = (*parts, total, milliseconds(lambda step=step: many(step)) / _QUEUED)  # type: ignore[misc]
        print(f"{name:12} " + " ".join(f"{number:8.2f}" for number in numbers) + f"  {met}")


def many(step: DenseStep | SparseStep) -> None:
    for _ in range(_QUEUED):
        for part in step.parts:
            part()


def bench_transfers(splats: Splats, camera: Camera, rounds: int) -> None:
    """What copies between host and device cost at this size."""
    picture = np.random.default_rng(0).random((3, camera.height, camera.width), dtype=np.float32)
    device = torch.device("cuda")
    on_device = upload(picture, device)
    stored = [upload(getattr(splats, name), device) for name in ATTRIBUTES]
    copies = {
        "picture up": lambda: upload(picture, device),
        "picture down": lambda: read(on_device),
        "scene up": lambda: [upload(getattr(splats, name), device) for name in ATTRIBUTES],
        "scene down": lambda: [read(tensor) for tensor in stored],
    }
    for name, copy in copies.items():
        print(f"{name:14} {median(milliseconds(copy) for _ in range(rounds)):8.2f} ms")


def compare(kernel: CudaKernel, splats: Splats, camera: Camera) -> None:
    """Pictures and gradients on the device against the native kernel's."""
    native = CpuKernel(0)
    cotangent = np.random.default_rng(2).normal(size=(3, camera.height, camera.width)).astype(np.float32)
    pictures = [each.forward(splats, camera).rgb for each in (native, kernel)]
    gradients = [each.backward(splats, cotangent).host() for each in (native, kernel)]
    again = kernel.backward(splats, cotangent).host()
    same = all(np.array_equal(getattr(again, name), getattr(gradients[1], name)) for name in vars(again))
    print(f"the same gradients again: {'the same bits' if same else 'other bits'}")
    off = np.abs(pictures[1] - pictures[0])
    print(f"picture: rms {np.sqrt(np.mean(off**2)):.2e}, largest {off.max():.2e}")
    for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh", "view"):
        wanted, found = getattr(gradients[0], name), getattr(gradients[1], name)
        print(
            f"gradient of {name:15} off by {np.linalg.norm(found - wanted) / np.linalg.norm(wanted):.1e} of its length"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=21, help="measurements of each variant (default 21)")
    parser.add_argument("--count", type=int, default=150_000, help="Gaussians (default 150000)")
    parser.add_argument("--size", default="1352x1014", help="of the picture (default 1352x1014)")
    args = parser.parse_args()
    missing = cuda.missing()
    if missing:
        sys.exit(f"nothing to measure: {missing}")
    width, height = (int(side) for side in args.size.split("x"))
    kernel, splats, camera = CudaKernel(), random_scene(args.count, 1), front_camera(width, height)
    print(f"{torch.cuda.get_device_name()}, torch {torch.__version__}; {args.count} Gaussians, degree 1, {args.size}\n")
    compare(kernel, splats, camera)
    print()
    bench_steps(kernel, splats, camera, args.rounds)
    print()
    bench_transfers(splats, camera, args.rounds)


if __name__ == "__main__":
    main()
