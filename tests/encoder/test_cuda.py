"""The CUDA backend's kernel against the native one: on a GPU through gsplat where there is one, and always on the CPU.

On the CPU a stand-in for gsplat (`cuda_cases`) lets everything of ours run: layout, spherical harmonics, gradients.
Only a GPU shows that gsplat's kernels do what their documentation says; there the same tests run on them.
"""

from __future__ import annotations

import inspect
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import gradient_twin
import rasterise_cases as cases
from cuda_cases import (
    BACKENDS,
    CAMERA,
    FIELDS,
    RATES,
    Backend,
    StandIn,
    assert_same_gradients,
    assert_same_picture,
    small_scene,
)
from decogs.encoder.backends import cuda, gradients_like, training_kernel
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cuda.cuda_kernel import CudaKernel
from decogs.formats.errors import UsageError
from decogs.formats.splats import take_splats


@pytest.mark.parametrize(
    "name",
    ["degree-0", "degree-1", "degree-2", "degree-3", "black", "clamped-colours", "near", "one-pixel", "17x13", "tiles",
     "around", "stack", "edges", "clones"],
)  # fmt: skip
def test_whole_pictures_and_gradients_are_the_native_ones(backend: Backend, name: str) -> None:
    case = cases.CASES[name]()
    if backend is BACKENDS["gsplat"] and name in ("stack", "edges"):
        pytest.skip("alphas beyond 0.99, where gsplat's differ by design")
    native, kernel = CpuKernel(1), backend.make()
    book = cases.textbook(case)
    cotangents = dict(zip(("v_rgb", "v_alpha", "v_depth"), cases.cotangents(case, book.doubtful), strict=True))
    pictures, gradients = [], []
    for each in (native, kernel):
        pictures.append(each.forward(case.splats, case.camera, case.background, depth=True))
        gradients.append(each.backward(case.splats, **cotangents))
        only_rgb = each.backward(case.splats, cotangents["v_rgb"])
        gradients.append(only_rgb)
    for plane in ("rgb", "alpha", "depth"):
        assert_same_picture(getattr(pictures[1], plane), getattr(pictures[0], plane), backend.picture)
    assert_same_gradients(gradients[2], gradients[0], backend.gradient)
    assert_same_gradients(gradients[3], gradients[1], backend.gradient)
    expected, found = native.centres(len(case.splats)), kernel.centres(len(case.splats))
    for theirs, ours in zip(expected, found, strict=True):
        both = np.isfinite(theirs) & np.isfinite(ours)
        assert both.sum() >= 0.9 * np.isfinite(theirs).sum()  # a box may meet the picture where its ellipse does not
        np.testing.assert_allclose(ours[both], theirs[both], rtol=1e-5, atol=1e-3)
    assert np.isnan(found[0][book.weights.max((1, 2)) == 0]).any() == np.isnan(expected[0]).any()


@pytest.mark.parametrize("name", ["degree-3", "black", "clamped-colours", "near", "tiles", "clones"])
def test_on_the_processor_gradients_are_those_of_the_float64_twin(name: str) -> None:
    """What is trained in place is drawn; the tolerances are the native kernel's."""
    case, kernel = cases.CASES[name](), CudaKernel(device="cpu", gsplat=StandIn())
    planes = cases.cotangents(case, cases.textbook(case).doubtful)
    optimiser = kernel.optimiser(case.splats)
    kernel.forward(optimiser, case.camera, case.background, depth=True)
    found = kernel.backward(optimiser, planes[0], v_alpha=planes[1], v_depth=planes[2]).host()
    for field, expected in gradient_twin.twin_gradients(case, *planes).items():
        gradient_twin.compare_gradient(getattr(found, field), expected)


def test_what_is_trained_is_drawn_in_place(backend: Backend) -> None:
    """As its values are, before and after a step; a whole picture and a view's."""
    scene, rows, kernel = small_scene(5), np.arange(20, 50), backend.make()
    optimiser, view = kernel.optimiser(take_splats(scene, rows)), kernel.fixed_view(CAMERA)
    view.set_scene(scene)
    view.redraw()
    view.detach(rows)
    cotangent, seen = np.random.default_rng(1).normal(size=(3, 61, 83)).astype(np.float32), []
    for _ in range(2):
        pictures, gradients = [], []
        for drawn in (optimiser, optimiser.splats):
            pictures.append(kernel.forward(drawn, CAMERA).rgb)
            gradients.append(kernel.backward(drawn, cotangent))
            view.draw(drawn, rows)
            pictures.append(view.rgb.copy())
            gradients.append(view.backward(cotangent))
        assert_same_picture(pictures[0], pictures[2], backend.picture)
        assert_same_picture(pictures[1], pictures[3], backend.picture)
        assert_same_gradients(gradients[0], gradients[2], backend.gradient)
        assert_same_gradients(gradients[1], gradients[3], backend.gradient)
        optimiser.step(gradients[3], RATES, max_stretch=4.0)
        seen.append(pictures[0])
    assert np.abs(seen[1] - seen[0]).max() > 0.01


def test_gradients_can_be_put_into_the_hosts_arrays(backend: Backend) -> None:
    scene, kernel = small_scene(1), backend.make()
    cotangent = np.random.default_rng(1).normal(size=(3, 61, 83)).astype(np.float32)
    kernel.forward(scene, CAMERA)
    room = gradients_like(scene)
    assert kernel.backward(scene, cotangent, out=room) is room
    assert_same_gradients(room, kernel.backward(scene, cotangent), backend.gradient)


def test_fewer_degrees_than_stored_leave_the_rest_without_gradient(backend: Backend) -> None:
    scene, kernel, native = small_scene(1, degree=2), backend.make(), CpuKernel(1)
    cotangent = np.random.default_rng(1).normal(size=(3, 61, 83)).astype(np.float32)
    for degree in (0, 1, 5):
        expected = native.forward(scene, CAMERA, sh_degree=degree).rgb
        assert_same_picture(kernel.forward(scene, CAMERA, sh_degree=degree).rgb, expected, backend.picture)
        gradients = kernel.backward(scene, cotangent).host()
        assert_same_gradients(gradients, native.backward(scene, cotangent), backend.gradient)
        assert (gradients.sh[:, (degree + 1) ** 2 :] == 0).all()


def test_what_cannot_be_drawn_and_zero_quaternions_do_no_harm(backend: Backend) -> None:
    scene, camera = small_scene(3), replace(CAMERA, world_to_camera=np.eye(4))
    scene.means[:, 2] += 2.5
    scene.means[5] = 0  # the camera's place: no depth, no direction
    scene.means[6, 2] = -1
    scene.quaternions[7] = 0
    cotangent = np.random.default_rng(1).normal(size=(3, 61, 83)).astype(np.float32)
    native, kernel = CpuKernel(1), backend.make()
    expected = native.forward(scene, camera).rgb
    assert_same_picture(kernel.forward(scene, camera).rgb, expected, backend.picture)
    gradients = kernel.backward(scene, cotangent).host()
    assert_same_gradients(gradients, native.backward(scene, cotangent), backend.gradient)
    for name in FIELDS:
        assert (getattr(gradients, name)[5:7] == 0).all(), name


def test_the_difference_of_gsplats_largest_alpha_is_as_stated() -> None:
    # Two opaque layers: 0.999 instead of 0.99 lets 0.009 less through of what is behind.
    case = cases.CASES["stack"]()
    native = CpuKernel(1).forward(case.splats, case.camera).rgb
    picture = CudaKernel(device="cpu", gsplat=StandIn(alpha_max=0.999)).forward(case.splats, case.camera).rgb
    assert 1e-3 < np.abs(picture - native).max() <= 0.009 * native.max() + 2e-5


@pytest.mark.slow
def test_a_whole_encode_runs_on_it(backend: Backend, encode: Any, moving_rig: Path, tiny_settings: Any) -> None:
    """Keyframe and a later frame, cache included. Roundings grow as training goes on (seen: 0.01 dB)."""
    settings = replace(
        tiny_settings,
        keyframe=replace(tiny_settings.keyframe, iterations=14, cap=400, grow_every=6, settle_iterations=4),
        frame=replace(tiny_settings.frame, joint_iterations=4),
    )
    encoded = encode(moving_rig, settings=settings, stop=2, kernel=backend.make())
    native = encode(moving_rig, settings=settings, stop=2)
    for ours, theirs in zip(encoded.report.frames, native.report.frames, strict=True):
        assert ours.kind == theirs.kind
        assert ours.training_psnr == pytest.approx(theirs.training_psnr, abs=0.1)


def test_signatures_with_gsplat_installed() -> None:
    """The stand-in takes nothing that the installed gsplat does not take in the same place or by the same name."""
    gsplat = pytest.importorskip("gsplat", reason="gsplat is not installed")
    names = "fully_fused_projection", "spherical_harmonics", "isect_tiles", "isect_offset_encode", "rasterize_to_pixels"
    for name in names:
        theirs = [p.replace("n_cameras", "n_images") for p in inspect.signature(getattr(gsplat, name)).parameters]
        for index, (ours, about) in enumerate(inspect.signature(getattr(StandIn(), name)).parameters.items()):
            assert ours in theirs if about.default is not about.empty else theirs[index] == ours, f"{name}: {ours}"


@pytest.mark.parametrize("name", ["degree-3", "near", "tiles", "around"])
def test_projections_and_lists_of_the_installed_gsplats_own_twin_serve_as_well(name: str) -> None:
    """gsplat's readable twin of its kernels, in float32 on the CPU: its conventions, not our reading of them."""
    twin = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")

    def project(means: Tensor, _: None, quats: Tensor, scales: Tensor, *camera: Any, **options: Any) -> Any:
        covariances, _ = twin._quat_scale_to_covar_preci(quats, scales, True, False)
        del options["packed"], options["opacities"]
        return twin._fully_fused_projection(means, covariances, *camera, **options)

    functions = StandIn()
    functions.fully_fused_projection = project  # type: ignore[method-assign]
    functions.isect_tiles = twin._isect_tiles  # type: ignore[method-assign]
    functions.isect_offset_encode = twin._isect_offset_encode  # type: ignore[method-assign]
    case, kernels = cases.CASES[name](), (CpuKernel(1), CudaKernel(device="cpu", gsplat=functions))
    cotangent = cases.cotangents(case, cases.textbook(case).doubtful)[0]
    pictures = [kernel.forward(case.splats, case.camera).rgb for kernel in kernels]
    assert_same_picture(pictures[1], pictures[0], 1e-5)
    gradients = [kernel.backward(case.splats, cotangent) for kernel in kernels]
    assert_same_gradients(gradients[1], gradients[0], 3e-5)


def test_the_device_is_chosen_or_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("auto", "cpu"):
        assert isinstance(training_kernel(name, 1), CpuKernel)
    with pytest.raises(UsageError, match="`device` tpu: choose from auto, cpu, cuda"):
        training_kernel("tpu")
    with monkeypatch.context() as without_torch:
        without_torch.delitem(sys.modules, "decogs.encoder.backends.cuda.cuda_kernel")
        without_torch.setitem(sys.modules, "torch", None)
        with pytest.raises(UsageError, match="`device` cuda: torch cannot be imported"):
            training_kernel("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(UsageError, match=r"`device` cuda: torch .* finds no CUDA device; install"):
        training_kernel("cuda")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    for name in ("gsplat", "gsplat.cuda", "gsplat.cuda._backend"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(UsageError, match="`device` cuda: gsplat cannot be imported"):
        training_kernel("cuda")
    found = {name: ModuleType(name) for name in ("gsplat", "gsplat.cuda", "gsplat.cuda._backend")}
    found["gsplat.cuda._backend"]._C = None  # type: ignore[attr-defined]
    for name, module in found.items():
        monkeypatch.setitem(sys.modules, name, module)
    with pytest.raises(UsageError, match="`device` cuda: gsplat has no compiled kernels"):
        training_kernel("cuda")
    found["gsplat.cuda._backend"]._C = object()  # type: ignore[attr-defined]
    assert cuda.missing() is None
