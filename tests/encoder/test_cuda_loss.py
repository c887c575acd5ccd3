"""The CUDA backend's loss, on tiles and fused, against the native kernel's."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from decogs.encoder.backends import cuda
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cuda.photometric import TiledLoss, photometric_loss


@pytest.mark.parametrize("size", [(2, 1), (11, 5), (50, 61), (65, 127)])
@pytest.mark.parametrize("ssim_scale", [0.0, 0.2])
@pytest.mark.parametrize("weighted", [False, True])
def test_the_loss_is_the_native_kernels(size: tuple[int, int], ssim_scale: float, weighted: bool) -> None:
    rng = np.random.default_rng(5)
    image, target = (rng.random((3, *size)).astype(np.float32) for _ in range(2))
    target[:, 0] = image[:, 0]  # no gradient of L1 where there is no difference
    weight = rng.random(size).astype(np.float32) if weighted else None
    focus = (rng.random(size) < 0.5).astype(np.float32) if weighted else None
    tiles = rng.random((-(-size[0] // 16), -(-size[1] // 16))) < 0.6
    wanted = np.kron(tiles, np.ones((16, 16), bool))[: size[0], : size[1]]
    given = {"l1_scale": 0.8, "ssim_scale": ssim_scale}
    expected, gradient = CpuKernel(1).loss(
        image, target, **given, l1_weight=weight, focus=focus, tiles=tiles.astype(np.uint8)
    )
    tensors = [None if a is None else torch.from_numpy(a) for a in (image, target, weight, focus)]
    assert tensors[0] is not None
    assert tensors[1] is not None
    value, found = photometric_loss(
        tensors[0], tensors[1], tensors[2], tensors[3], wanted=torch.from_numpy(wanted), **given
    )
    assert value.tolist() == pytest.approx(expected.sums, rel=1e-5, abs=1e-9)
    # Both in float32, some sixty operations on sums up to 1 (`test_loss`).
    ours, theirs = found.numpy()[:, wanted], gradient[:, wanted]
    assert np.abs(ours - theirs).max(initial=0) <= 120 * 2.0**-24 * np.abs(theirs).max(initial=0)


@pytest.mark.skipif(cuda.missing() is not None, reason=f"the fused loss needs a GPU: {cuda.missing()}")
@pytest.mark.parametrize("size", [(1, 2), (5, 11), (61, 50), (127, 65)])
@pytest.mark.parametrize("ssim_scale", [0.0, 0.2])
@pytest.mark.parametrize("weighted", [False, True])
def test_the_fused_loss_on_a_gpu_is_its_twin(size: tuple[int, int], ssim_scale: float, weighted: bool) -> None:
    from decogs.encoder.backends.cuda.photometric_fused import FusedLoss

    rng, (width, height) = np.random.default_rng(6), size
    on_gpu = lambda values: torch.tensor(np.asarray(values, np.float32), device="cuda")  # noqa: E731
    image, target = on_gpu(rng.random((height, width, 4))), on_gpu(rng.random((3, height, width)))
    weight = on_gpu(rng.random((height, width))) if weighted else None
    focus = on_gpu(rng.random((height, width)) < 0.5) if weighted else None
    tiles = torch.tensor(rng.random((-(-height // 16), -(-width // 16))) < 0.6, device="cuda")
    makers, given = (TiledLoss, FusedLoss), {"l1_scale": 0.8, "ssim_scale": ssim_scale}
    for wanted in (None, tiles):
        losses = [make(width, height, torch.device("cuda")) for make in makers]
        (twin, expected), (value, found) = (
            each(image, target, weight, focus, wanted=wanted, **given) for each in losses
        )
        np.testing.assert_allclose(value.tolist(), twin.tolist(), rtol=1e-5, atol=1e-6)
        pixels = torch.ones((height, width), dtype=torch.bool, device="cuda")
        if wanted is not None:
            pixels = wanted.repeat_interleave(16, 0).repeat_interleave(16, 1)[:height, :width]
        # Both in float32, some sixty operations on sums up to 1 (`test_loss`).
        off, largest = (found - expected).abs()[pixels], expected.abs()[pixels]
        if pixels.any():
            assert float(off.max()) <= 120 * 2.0**-24 * float(largest.max())
        assert not found[~pixels].any()
