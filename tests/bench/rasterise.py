"""Measures the training step's kernel: projection, binning, forward, backward to all stored values, loss, Adam.

    python tests/bench/rasterise.py [--rounds N]

One thread, process time, median over rounds; in every round all variants run in turn, so that a busy machine slows them
alike: compare columns of one run, not numbers of two. Two threads against one: wall time.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from statistics import median

import numpy as np

from decogs.encoder.backends.cpu import native
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats
from decogs.formats.system.kernels import INSTRUCTION_SETS, best_instruction_set

SIZES = ((30_000, 338, 254), (30_000, 676, 507), (150_000, 338, 254), (150_000, 676, 507))
PROTOTYPE = {"base": (38.6, 97.3, 80.6, 139.0), "avx2": (27.1, 59.9, 66.3, 105.0), "avx512": (20.1, 42.0, 54.8, 80.5)}
"""Milliseconds of the prototype's step, degree 0, on this class of machine (2 cores); its scenes were not recorded."""


def morton_order(means: np.ndarray) -> np.ndarray:
    """Rows along a Z-order curve, as the codec stores them."""
    cells = ((means - means.min(0)) / np.ptp(means, axis=0) * 1023).astype(np.int64)
    keys = np.zeros(len(means), np.int64)
    for bit in range(10):
        for axis in range(3):
            keys |= ((cells[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(keys, kind="stable")


def random_scene(count: int, degree: int) -> Splats:
    """Gaussians that fill a cube of half size 1; their sigmas, 0.005 to 0.02 for 30 000, go with count ** (-1/3)."""
    rng = np.random.default_rng(0)
    size = (30_000 / count) ** (1 / 3)
    means = rng.uniform(-1, 1, (count, 3))
    arrays = (
        means[morton_order(means)],
        np.log(rng.uniform(0.005 * size, 0.02 * size, (count, 3))),
        rng.normal(size=(count, 4)),
        rng.normal(size=count),
        rng.normal(size=(count, (degree + 1) ** 2, 3)) * 0.3,
    )
    return Splats(*(np.ascontiguousarray(a, np.float32) for a in arrays))


def front_camera(width: int, height: int) -> Camera:
    """Sees the cube from distance 3; focal length one picture width."""
    pose = np.eye(4)
    pose[2, 3] = 3.0
    return Camera("bench", width, height, float(width), float(width), width / 2, height / 2, pose)


@contextmanager
def instruction_set(name: str) -> Iterator[None]:
    """Kernels made inside run on this instruction set."""
    before = os.environ.get("DECOGS_INSTRUCTION_SET")
    os.environ["DECOGS_INSTRUCTION_SET"] = name
    best_instruction_set.cache_clear()
    native.training_library.cache_clear()
    try:
        yield
    finally:
        if before is None:
            del os.environ["DECOGS_INSTRUCTION_SET"]
        else:
            os.environ["DECOGS_INSTRUCTION_SET"] = before
        best_instruction_set.cache_clear()
        native.training_library.cache_clear()


def kernels_by_instruction_set() -> dict[str, CpuKernel]:
    """One single-threaded kernel for each instruction set this machine runs."""
    kernels = {}
    for name in INSTRUCTION_SETS[: INSTRUCTION_SETS.index(best_instruction_set()) + 1]:
        with instruction_set(name):
            kernels[name] = CpuKernel(1)
    return kernels


class Step:
    """A training step of one scene: its parts as functions without arguments."""

    def __init__(self, kernel: CpuKernel, splats: Splats, camera: Camera) -> None:
        rng = np.random.default_rng(1)
        self.kernel, self.splats, self.camera = kernel, splats, camera
        self.target = rng.random((3, camera.height, camera.width), dtype=np.float32)
        self.picture = kernel.forward(splats, camera)
        self.cotangent = kernel.loss(self.picture.rgb, self.target, l1_scale=0.8, ssim_scale=0.2)[1]
        self.gradients = kernel.backward(splats, self.cotangent)

    def forward(self) -> None:
        self.picture = self.kernel.forward(self.splats, self.camera)

    def loss(self) -> None:
        self.kernel.loss(self.picture.rgb, self.target, l1_scale=0.8, ssim_scale=0.2, gradient=self.cotangent)

    def backward(self) -> None:
        self.kernel.backward(self.splats, self.cotangent, out=self.gradients)


def milliseconds(function: Callable[[], None], clock: Callable[[], float]) -> float:
    start = clock()
    function()
    return (clock() - start) * 1e3


def bench_steps(kernels: dict[str, CpuKernel], rounds: int) -> None:
    """The table: milliseconds per part, instruction set, scene and SH degree."""
    best = list(kernels)[-1]
    print(f"{'scene':24} SH  " + "".join(f"| {name:^30} " for name in kernels) + f"| prototype {best}")
    print(f"{'':24}     " + "| forward backward   step   loss " * len(kernels) + "|    step  ratio")
    for degree in (0, 3):
        for index, (count, width, height) in enumerate(SIZES):
            splats, camera = random_scene(count, degree), front_camera(width, height)
            steps = {name: Step(kernel, splats, camera) for name, kernel in kernels.items()}
            times: dict[str, list[tuple[float, ...]]] = {name: [] for name in kernels}
            for _ in range(rounds):
                for name, step in steps.items():
                    parts = (step.forward, step.backward, step.loss)
                    times[name].append(tuple(milliseconds(part, time.process_time) for part in parts))
            line = f"{f'{count // 1000}k Gaussians, {width}x{height}':24} {degree:2d}  "
            for rows in times.values():
                forward, backward, loss = (median(column) for column in zip(*rows, strict=True))
                line += f"| {forward:7.1f} {backward:8.1f} {median(r[0] + r[1] for r in rows):6.1f} {loss:6.1f} "
            reference = PROTOTYPE[best][index]
            print(line + f"| {reference:7.1f}  {median(r[0] + r[1] for r in times[best]) / reference:5.2f}", flush=True)


def bench_threads(rounds: int) -> None:
    """Wall time of forward, loss and backward on one thread over that on two."""
    print("\ntwo threads against one, wall time (1 = no gain), and how many processors the two got: less than some 1.9")
    print("means that other work had them")
    for count, width, height in SIZES:
        splats, camera = random_scene(count, 0), front_camera(width, height)
        steps = {threads: Step(CpuKernel(threads), splats, camera) for threads in (1, 2)}
        ratios: list[tuple[float, ...]] = []
        for _ in range(rounds):
            wall = {}
            for threads, step in steps.items():
                busy = time.process_time()
                parts = (step.forward, step.backward, step.loss)
                wall[threads] = [milliseconds(part, time.perf_counter) for part in parts]
                busy = (time.process_time() - busy) * 1e3
            one, two = sum(wall[1]), sum(wall[2])
            ratios.append((*(a / b for a, b in zip(wall[1], wall[2], strict=True)), one / two, busy / two))
        names = ("forward", "backward", "loss", "all", "processors")
        shown = "  ".join(f"{n} {median(r):.2f}" for n, r in zip(names, zip(*ratios, strict=True), strict=True))
        print(f"{f'{count // 1000}k Gaussians, {width}x{height}':24} {shown}", flush=True)


def bench_adam(kernels: dict[str, CpuKernel], rounds: int) -> None:
    """One Adam step on 150 000 Gaussians of degree 3, 59 values each."""
    rng = np.random.default_rng(2)
    shapes = ((150_000, 3), (150_000, 3), (150_000, 4), (150_000,), (150_000, 16, 3))
    gradients = [rng.normal(size=shape).astype(np.float32) for shape in shapes]
    state = [[np.zeros_like(g) for g in gradients] for _ in range(3)]

    def step(kernel: CpuKernel) -> None:
        for gradient, *arrays in zip(gradients, *state, strict=True):
            kernel.adam(arrays[0], gradient, *arrays[1:], rate=1e-3, step=5)

    print("\nAdam, 150k Gaussians of 59 values")
    times: dict[str, list[float]] = {name: [] for name in kernels}
    for _ in range(rounds):
        for name, kernel in kernels.items():
            times[name].append(milliseconds(lambda k=kernel: step(k), time.process_time))
    for name, found in times.items():
        print(f"{name:8} {median(found):6.1f} ms")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=11, help="measurements of each variant (default 11)")
    rounds = parser.parse_args().rounds
    kernels = kernels_by_instruction_set()
    load = os.getloadavg()[0]
    print(f"Milliseconds, 1 thread, process time, median of {rounds}, variants in turn. Load average {load:.1f} on")
    print(
        f"{os.cpu_count()} processors: other work slows all columns. Scene: random, fills a cube, sigma ~ count^(-1/3),"
    )
    print("Morton order; the prototype's scenes are not recorded: its column gives the class of figures.\n")
    bench_steps(kernels, rounds)
    if len(os.sched_getaffinity(0)) > 1:
        bench_threads(rounds)
    bench_adam(kernels, rounds)


if __name__ == "__main__":
    main()
