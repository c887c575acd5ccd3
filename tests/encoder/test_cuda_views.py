"""The CUDA backend's fixed views: they live as the native ones do, and a step on them waits for nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from torch.utils._python_dispatch import TorchDispatchMode

import rasterise_cases as cases
from cuda_cases import (
    CAMERA,
    FIELDS,
    RATES,
    THRESHOLD,
    Backend,
    assert_same_gradients,
    assert_same_picture,
    emulated_kernel,
    small_scene,
)
from decogs.encoder.backends import FixedView
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cuda import cuda_kernel, device, fixed_view, photometric
from decogs.encoder.backends.cuda import gradients as gradients_module
from decogs.encoder.backends.cuda import optimiser as optimiser_module
from decogs.formats.splats import Splats, empty_splats, join_splats, take_splats


class Unread(TorchDispatchMode):
    """Refuses what waits for a device: reading a number, and shapes that depend on values."""

    def __torch_dispatch__(self, function: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = function.overloadpacket.__name__
        assert name not in ("_local_scalar_dense", "nonzero", "masked_select", "equal", "unique"), name
        return function(*args, **(kwargs or {}))


def test_a_step_reads_nothing_and_brings_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """After a first one, which brings the targets. Reading is `device.read`, bringing `device.upload`, and torch's own
    ways to wait."""
    scene, rows = small_scene(4), np.arange(20)
    kernel = emulated_kernel()
    target, gathered = np.zeros((3, 61, 83), np.float32), [kernel.view_gradients(n) for n in (len(scene), len(rows))]
    view, whole, part = kernel.fixed_view(CAMERA), kernel.optimiser(scene), kernel.optimiser(take_splats(scene, rows))
    part.freeze({"means": np.arange(60).reshape(20, 3) % 2 == 0})
    view.set_scene(scene)
    view.redraw()
    view.detach(rows)
    losses = []

    def step() -> None:
        kernel.forward(whole, CAMERA, sh_degree=0)
        losses.append(kernel.picture_loss(target, l1_scale=0.8, ssim_scale=0.2))
        gradients = kernel.backward(whole)
        gathered[0].add(gradients, CAMERA)
        whole.step(gradients, RATES, max_stretch=4.0)
        view.draw(part, rows)
        losses.append(view.loss(target, l1_scale=0.8, ssim_scale=0.2))
        gradients = view.backward()
        gathered[1].add(gradients, CAMERA, 2.0)
        part.step(gradients, RATES, max_stretch=4.0)

    step()
    with monkeypatch.context() as watched, Unread():
        for module in (device, cuda_kernel, fixed_view, gradients_module, optimiser_module, photometric):
            for name in ("read", "read_floats", "upload"):
                watched.setattr(module, name, None, raising=False)
        step()
        step()
        with pytest.raises(TypeError):
            losses[-1].total  # noqa: B018
    assert losses[4].total < losses[0].total
    assert losses[5].total < losses[1].total
    assert (gathered[1].mean() > 0).any()


def test_nothing_to_draw(backend: Backend) -> None:
    kernel, nothing = backend.make(), empty_splats(1)
    picture = kernel.forward(nothing, CAMERA, (0.2, 0.4, 0.6))
    np.testing.assert_allclose(picture.rgb, np.broadcast_to(np.array([[[0.2]], [[0.4]], [[0.6]]]), (3, 61, 83)))
    assert len(kernel.backward(nothing, picture.rgb).host().means) == 0
    view = kernel.fixed_view(CAMERA)
    view.set_scene(nothing)
    assert view.redraw().shape == (2, 0)
    view.draw(nothing, np.zeros(0, np.int64))
    assert not view.rgb.any()
    assert not view.met.any()
    scene = small_scene(1)
    view.draw(scene, np.arange(len(scene)))
    assert_same_picture(view.rgb, CpuKernel(1).forward(scene, CAMERA).rgb, backend.picture)


@pytest.mark.parametrize("seed", range(3))
def test_a_view_lives_as_the_native_one_does(backend: Backend, seed: int) -> None:
    """Frames of random detaches, moves, removals and additions, the calls of the training loop, side by side."""
    rng = np.random.default_rng(seed)
    scene, picture = small_scene(seed), backend.picture
    kernels = (CpuKernel(1), backend.make())
    views = [kernel.fixed_view(CAMERA) for kernel in kernels]
    for view in views:
        view.set_scene(scene)
    for share in (0.1, 0.0, 0.5):
        marks = rng.random((61, 83)) < 0.3
        weights = [view.redraw(marks) for view in views]
        for row in range(2):  # of pixels' alphas: the sum may have one more at the threshold
            assert np.abs(weights[1][row] - weights[0][row]).max() <= picture * weights[0][row].max() + 2 * THRESHOLD
            assert np.abs(weights[1][row] - weights[0][row]).sum() <= 2e-3 * weights[0][row].sum() + 4 * THRESHOLD
        assert_same_view(views, picture)
        detached = rows = np.flatnonzero(rng.random(len(scene)) < share)
        moving = take_splats(scene, rows)
        for view in views:
            view.detach(detached)
        for step in range(3):
            if step == 2:  # some are taken away, others come
                stay = rng.random(len(rows)) < 0.7
                moving = join_splats(take_splats(moving, stay), take_splats(small_scene(seed + 50), np.arange(5)))
                rows = np.concatenate([rows[stay], np.arange(len(scene), len(scene) + 5)])
            moving = jittered(moving, rng)
            for view in views:
                view.draw(moving, rows, depth=True)
            assert_same_view(views, picture)
            native_met, met = (view.met.astype(bool) for view in views)
            assert (met | ~native_met).all()
            assert_same_steps(views, rng, backend)
        scene, rows, renumbered = committed(scene, detached, moving, rows)
        for view in views:
            view.commit(scene, rows, renumbered)
        expected, found = (view.centres() for view in views)
        both = np.isfinite(expected) & np.isfinite(found)
        assert both.any()
        np.testing.assert_allclose(found[both], expected[both], rtol=1e-5, atol=1e-3)
    for view in views:
        view.redraw()
    assert_same_view(views, picture)
    assert_same_picture(views[1].rgb, kernels[0].forward(scene, CAMERA).rgb, picture)


def test_a_scene_that_is_committed_twice_brings_other_rows(backend: Backend) -> None:
    """As after frames whose changes were all taken back: the scene is the same, what was trained is not."""
    before, scene, kernel = small_scene(1), small_scene(2), backend.make()
    view = kernel.fixed_view(CAMERA)
    view.set_scene(before)
    for rows in np.split(np.arange(len(scene)), 2):
        view.detach(rows)
        view.commit(scene, rows)
    view.redraw()
    assert_same_picture(view.rgb, CpuKernel(1).forward(scene, CAMERA).rgb, backend.picture)


def jittered(splats: Splats, rng: np.random.Generator) -> Splats:
    values = (splats.means, splats.log_scales, splats.quaternions, splats.opacity_logits, splats.sh)
    return Splats(*(np.ascontiguousarray(a + rng.normal(0, 0.05, a.shape), np.float32) for a in values))


def committed(
    scene: Splats, detached: np.ndarray, moving: Splats, rows: np.ndarray
) -> tuple[Splats, np.ndarray, np.ndarray]:
    """The scene after a frame, the rows in it that were detached or are new, and the old rows' new numbers."""
    old = rows < len(scene)
    grown = join_splats(scene, take_splats(moving, ~old))
    for name in FIELDS[:-1]:
        getattr(grown, name)[rows] = getattr(moving, name)
    stays = np.setdiff1d(np.arange(len(grown)), np.setdiff1d(detached, rows))
    renumbered = np.full(len(grown), -1, np.int64)
    renumbered[stays] = np.arange(len(stays))
    return take_splats(grown, stays), renumbered[rows], renumbered[: len(scene)]


def assert_same_view(views: list[FixedView], tolerance: float) -> None:
    for plane in ("rgb", "alpha", "depth"):
        expected, found = (getattr(view, plane) for view in views)
        assert found.dtype == np.float32
        assert_same_picture(found, expected, tolerance)


def assert_same_steps(views: list[FixedView], rng: np.random.Generator, backend: Backend) -> None:
    """Loss and gradients of what was drawn; a cotangent outside the tiles met must not matter, whatever it is."""
    given = {"l1_scale": 0.8, "ssim_scale": 0.2, "l1_weight": rng.random((61, 83)).astype(np.float32)}
    target, focus = rng.random((3, 61, 83)).astype(np.float32), (rng.random((61, 83)) < 0.5).astype(np.float32)
    values = [view.loss(target, focus=focus, **given) for view in views]
    gradients = [view.backward() for view in views]
    assert_same_gradients(gradients[1], gradients[0], backend.gradient)
    met = views[1].met  # more tiles than the native view's, whose value is of fewer pixels
    expected, _ = CpuKernel(1).loss(views[0].rgb, target, focus=focus, tiles=met, **given)
    assert values[1].total == pytest.approx(expected.total, rel=10 * backend.picture)
    cotangent = rng.normal(size=(3, 61, 83)).astype(np.float32)
    poisoned = cotangent.copy()
    poisoned[:, ~np.kron(met.reshape(4, 6), np.ones((16, 16)))[:61, :83].astype(bool)] = np.nan
    gradients = [views[0].backward(cotangent), views[1].backward(poisoned)]
    assert_same_gradients(gradients[1], gradients[0], backend.gradient)


def test_only_tiles_that_change_are_drawn_again(backend: Backend) -> None:
    scene = small_scene(1)
    view = backend.make().fixed_view(CAMERA)
    view.set_scene(scene)
    view.redraw()
    rows = np.array([17], np.int64)
    view.detach(rows)
    before, moved = view.met.size, take_splats(scene, rows)
    moved.means[:, 0] += 1.0
    for expected in ("where it was and is", "where it is"):
        view._planes.rgb.fill_(np.nan)
        view.draw(moved, rows)
        drawn = np.isfinite(view.rgb[0, ::16, ::16]).sum()
        assert 0 < drawn < before, expected
        before = drawn
    assert before == view.met.sum()


def test_the_order_in_which_threads_come_changes_no_bit() -> None:
    """Nor, on a GPU, does time: the same seed gives the same bytes there."""
    scene, rows, target = small_scene(6), np.arange(20, 70), np.random.default_rng(1).random((3, 61, 83), np.float32)
    found = []
    for backwards in (False, True):
        kernel = emulated_kernel(backwards=backwards)
        optimiser, view = kernel.optimiser(take_splats(scene, rows)), kernel.fixed_view(CAMERA)
        view.set_scene(scene)
        values = [view.redraw(target[0] > 0.5)]
        view.detach(rows)
        for _ in range(2):
            view.draw(optimiser, rows)
            values += [view.rgb, np.array(view.loss(target, l1_scale=0.8, ssim_scale=0.2).sums)]
            gradients = view.backward()
            values += vars(gradients.host()).values()
            optimiser.step(gradients, RATES, max_stretch=4.0)
        kernel.forward(optimiser, CAMERA)
        values += vars(kernel.backward(optimiser, target).host()).values()
        found.append(values)
    for ours, theirs in zip(*found, strict=True):
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("detached", [np.arange(30), np.arange(30, 60)])
def test_equal_depths_keep_the_scenes_order(backend: Backend, detached: np.ndarray) -> None:
    case = cases.CASES["clones"]()  # rows 30 to 59 at the depths of rows 0 to 29
    view = backend.make().fixed_view(case.camera)
    view.set_scene(case.splats)
    view.detach(detached)
    view.draw(take_splats(case.splats, detached), detached)
    expected = CpuKernel(1).forward(case.splats, case.camera).rgb
    assert_same_picture(view.rgb, expected, backend.picture)


def test_the_next_frame_brings_its_own_targets(backend: Backend) -> None:
    scene, rows = small_scene(4), np.arange(20)
    view, values = backend.make().fixed_view(CAMERA), []
    view.set_scene(scene)
    for level in (0.0, 0.5):
        target = np.full((3, 61, 83), level, np.float32)  # may lie where the last one lay
        view.refresh()
        view.detach(rows)
        view.draw(take_splats(scene, rows), rows)
        values.append(view.loss(target, l1_scale=1.0, ssim_scale=0.0).total)
        expected = CpuKernel(1).loss(view.rgb, target, l1_scale=1.0, ssim_scale=0.0, tiles=view.met)[0].total
        assert values[-1] == pytest.approx(expected, rel=1e-5)
        view.commit(scene, rows)
    assert values[0] != values[1]


def test_misuse_is_refused_as_by_the_native_view() -> None:
    kernel, scene = emulated_kernel(), small_scene(2)
    view = kernel.fixed_view(CAMERA)
    view.set_scene(scene)
    with pytest.raises(ValueError, match="ascend"):
        view.detach(np.array([3, 1], np.int64))
    with pytest.raises(ValueError, match="in the scene"):
        view.detach(np.array([len(scene)], np.int64))
    with pytest.raises(ValueError, match="draw before"):
        view.backward()
    with pytest.raises(ValueError, match="marks"):
        view.redraw(np.zeros((3, 3), bool))
    with pytest.raises(ValueError, match="rows"):
        view.draw(scene, np.array([1], np.int64))
    with pytest.raises(ValueError, match="new numbers"):
        view.commit(scene, np.zeros(0, np.int64), np.zeros(3, np.int64))
    view.detach(np.arange(3))
    view.draw(take_splats(scene, np.arange(3)), np.arange(3))
    with pytest.raises(ValueError, match="the draw's loss or a cotangent"):
        view.backward()
    with pytest.raises(ValueError, match="cotangent of shape"):
        view.backward(view.alpha)
    view.loss(view.rgb, l1_scale=1.0, ssim_scale=0.0)
    view.backward()
    view.draw(take_splats(scene, np.arange(3)), np.arange(3))
    with pytest.raises(ValueError, match="the draw's loss or a cotangent"):
        view.backward()
    with pytest.raises(ValueError, match="last forward"):
        kernel.backward(scene, view.rgb)
    with pytest.raises(ValueError, match="last forward"):
        kernel.centres(3)
