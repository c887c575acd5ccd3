"""The CUDA backend's loss against the native kernel's."""

from __future__ import annotations

import numpy as np
import pytest

from cuda_cases import Backend
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cuda.device import read_floats


@pytest.mark.parametrize("size", [(2, 1), (11, 5), (50, 61), (65, 127)])
@pytest.mark.parametrize("ssim_scale", [0.0, 0.2])
@pytest.mark.parametrize("weighted", [False, True])
def test_the_loss_is_the_native_kernels(
    backend: Backend, size: tuple[int, int], ssim_scale: float, weighted: bool
) -> None:
    rng, kernel = np.random.default_rng(5), backend.make()
    image, target = (rng.random((3, *size)).astype(np.float32) for _ in range(2))
    target[:, 0] = image[:, 0]  # no gradient of L1 where there is no difference
    weight = rng.random(size).astype(np.float32) if weighted else None
    focus = (rng.random(size) < 0.5).astype(np.float32) if weighted else None
    some = rng.random((-(-size[0] // 16), -(-size[1] // 16))) < 0.6
    on_device = [None if a is None else kernel.upload(a) for a in (image, target, weight, focus)]
    for tiles in (None, some):
        every = np.ones_like(some) if tiles is None else tiles
        wanted = np.kron(every, np.ones((16, 16), bool))[: size[0], : size[1]]
        marks = None if tiles is None else tiles.astype(np.uint8)
        expected, gradient = CpuKernel(1).loss(
            image, target, l1_scale=0.8, ssim_scale=ssim_scale, l1_weight=weight, focus=focus, tiles=marks
        )
        wanted_there = None if marks is None else kernel.upload(marks)
        value, found = kernel.compare(on_device[0], on_device[1:], wanted_there, 0.8, ssim_scale)
        assert value.sums == pytest.approx(expected.sums, rel=1e-5, abs=1e-9)
        # Both in float32, some sixty operations on sums up to 1 (`test_loss`).
        ours, theirs = read_floats(found)[:, wanted], gradient[:, wanted]
        assert np.abs(ours - theirs).max(initial=0) <= 120 * 2.0**-24 * np.abs(theirs).max(initial=0)
