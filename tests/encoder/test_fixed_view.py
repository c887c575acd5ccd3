"""The sparse path of training: bits of a whole rendering, whatever moves, comes, goes and settles."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import rasterise_cases as cases
from decogs.encoder.backends import gradients_like
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.formats.splats import Splats, join_splats, take_splats

FIELDS = ("means", "log_scales", "quaternions", "opacity_logits", "sh", "view")
CAMERA = cases.pinhole(83, 61, 70.0)
GRADIENT_ROUNDINGS = 50


def small_scene(seed: int, count: int = 300) -> Splats:
    return cases.scene(seed, count, 1, sigma=(0.02, 0.08))


def jittered(splats: Splats, rng: np.random.Generator, size: float) -> Splats:
    """All attributes somewhat elsewhere."""
    return Splats(
        *(
            np.ascontiguousarray(a + rng.normal(0, size, a.shape), np.float32)
            for a in (splats.means, splats.log_scales, splats.quaternions, splats.opacity_logits, splats.sh)
        )
    )


def with_rows(scene: Splats, rows: np.ndarray, moving: Splats) -> Splats:
    """The whole scene that ``moving`` at ``rows`` stands for; detached rows left out must have been hidden before."""
    grown = join_splats(scene, take_splats(moving, np.arange(int((rows < len(scene)).sum()), len(rows))))
    for name in FIELDS[:-1]:
        getattr(grown, name)[rows] = getattr(moving, name)
    return grown


def hidden(scene: Splats, rows: np.ndarray) -> Splats:
    logits = scene.opacity_logits.copy()
    logits[rows] = -80
    return cases.edited(scene, opacity_logits=logits)


@pytest.mark.parametrize("seed", range(6))
def test_draws_and_gradients_are_the_dense_ones_bit_for_bit(seed: int) -> None:
    """Random detached rows, moves, removals and additions; the set of moving Gaussians changes between draws too."""
    rng = np.random.default_rng(seed)
    scene = small_scene(seed)
    kernel, dense = CpuKernel(2), CpuKernel(1)
    view = CpuFixedView(kernel, CAMERA)
    view.set_scene(scene)
    for share in (0.05, 0.0, 0.3, 1.0, 0.1):
        weights = view.redraw()
        assert_shows(view, scene, dense, depth=True)
        assert np.array_equal(weights, fresh_weights(scene, None))
        rows = detached = np.flatnonzero(rng.random(len(scene)) < share)
        view.detach(detached)
        moving = take_splats(scene, rows)
        for step in range(4):
            if step == 2:  # some are taken away, others come
                stay = rng.random(len(rows)) < 0.8
                new = take_splats(small_scene(seed + 100), np.arange(7))
                moving = join_splats(take_splats(moving, stay), new)
                rows = np.concatenate([rows[stay], np.arange(len(scene), len(scene) + len(new))])
            moving = jittered(moving, rng, 0.05)
            now = with_rows(hidden(scene, detached), rows, moving)
            view.draw(moving, rows, depth=step == 3)
            assert_shows(view, now, dense, depth=step == 3)
            cotangent = rng.normal(size=view.rgb.shape).astype(np.float32)
            sparse, whole = view.backward(cotangent), dense.backward(now, cotangent)
            for name in FIELDS:
                assert np.array_equal(getattr(sparse, name), getattr(whole, name)[rows]), name
        gone = np.setdiff1d(detached, rows)
        stays = np.setdiff1d(np.arange(len(now)), gone)
        scene = take_splats(now, stays)
        renumbered = np.full(len(now), -1, np.int64)
        renumbered[stays] = np.arange(len(stays))
        view.commit(scene, renumbered[rows], renumbered[: len(now) - len(new)] if len(gone) else None)


def assert_shows(view: CpuFixedView, scene: Splats, dense: CpuKernel, *, depth: bool) -> None:
    picture = dense.forward(scene, CAMERA, depth=True)
    assert np.array_equal(view.rgb, picture.rgb)
    if depth:
        assert np.array_equal(view.alpha, picture.alpha)
        assert picture.depth is not None
        assert np.array_equal(view.depth, picture.depth)


def fresh_weights(scene: Splats, marks: np.ndarray | None) -> np.ndarray:
    """Weights of a view that has no history."""
    view = CpuFixedView(CpuKernel(1), CAMERA)
    view.set_scene(scene)
    return view.redraw(marks)


@pytest.mark.parametrize("name", ["degree-0", "around", "stack", "crowd", "clamped-colours"])
def test_weights_are_the_textbooks(name: str) -> None:
    case = cases.CASES[name]()
    book = cases.textbook(case)
    marks = np.random.default_rng(4).random((case.camera.height, case.camera.width)) < 0.3
    view = CpuFixedView(CpuKernel(2), case.camera)
    view.set_scene(case.splats)
    weights = view.redraw(marks)
    for got, counted in zip(weights, (np.ones_like(marks), marks), strict=True):
        expected = (book.weights * counted).sum((1, 2))
        slack = (book.doubtful & counted).sum()  # a doubtful pixel's weight may be there or not
        cases.compare(got, expected, GRADIENT_ROUNDINGS * cases.ROUNDING * max(1.0, expected.max()) + slack)


def test_marks_are_weighed_whatever_was_drawn_before() -> None:
    scene, rng = small_scene(3), np.random.default_rng(3)
    view = CpuFixedView(CpuKernel(2), CAMERA)
    view.set_scene(scene)
    for share in (0.0, 0.01, 0.5, 1.0):
        marks = rng.random((CAMERA.height, CAMERA.width)) < share
        assert np.array_equal(view.redraw(marks), fresh_weights(scene, marks))


def test_any_byte_but_0_is_a_mark() -> None:
    scene = small_scene(3)
    marks = np.random.default_rng(3).random((CAMERA.height, CAMERA.width)) < 0.01
    view = CpuFixedView(CpuKernel(1), CAMERA)
    view.set_scene(scene)
    view.redraw()
    weights = view.redraw((marks * np.uint8(254)).view(np.bool_))
    assert np.array_equal(weights, fresh_weights(scene, marks))


@pytest.mark.parametrize("name", FIELDS)
def test_room_of_another_shape_is_refused(name: str) -> None:
    scene, rows, kernel = small_scene(3), np.arange(9), CpuKernel(1)
    view = CpuFixedView(kernel, CAMERA)
    view.set_scene(scene)
    view.detach(rows)
    view.draw(take_splats(scene, rows), rows)
    kernel.forward(scene, CAMERA)
    for drawn, way_back in ((take_splats(scene, rows), view.backward), (scene, partial(kernel.backward, scene))):
        room = gradients_like(drawn)
        wrong = replace(room, **{name: getattr(room, name)[1:]})
        with pytest.raises(ValueError, match=f"gradients `{name}` of"):
            way_back(np.zeros_like(view.rgb), out=wrong)


def test_only_tiles_that_change_are_drawn_again() -> None:
    scene = small_scene(1)
    view = CpuFixedView(CpuKernel(1), CAMERA)
    view.set_scene(scene)
    view.redraw()
    rows = np.array([17], np.int64)
    view.detach(rows)
    view.rgb[:] = -1
    view.draw(take_splats(scene, rows), rows)
    tiles = view.met.reshape(-(-CAMERA.height // 16), -(-CAMERA.width // 16)).astype(bool)
    drawn = np.kron(tiles, np.ones((16, 16), bool))[: CAMERA.height, : CAMERA.width]
    assert 0 < tiles.sum() < tiles.size
    assert (view.rgb[:, ~drawn] == -1).all()
    assert (view.rgb[:, drawn] >= 0).all()


def test_the_loss_of_some_tiles_has_the_gradient_of_the_whole() -> None:
    rng = np.random.default_rng(8)
    kernel = CpuKernel(2)
    for width, height in ((83, 61), (200, 150), (16, 16), (300, 40)):
        image, target = (rng.random((3, height, width)).astype(np.float32) for _ in range(2))
        focus = (rng.random((height, width)) < 0.5).astype(np.float32)
        weight = rng.random((height, width)).astype(np.float32)
        scales = {"l1_scale": 0.8, "ssim_scale": 0.2, "l1_weight": weight, "focus": focus}
        whole, expected = kernel.loss(image, target, **scales)
        shape = (-(-height // 16), -(-width // 16))
        parts = 0.0
        chosen = rng.random(shape) < 0.4
        for tiles in (chosen, ~chosen):
            drawn = np.kron(tiles, np.ones((16, 16), bool))[:height, :width]
            untouched = np.full_like(image, 7)
            value, gradient = kernel.loss(image, target, **scales, tiles=tiles.astype(np.uint8), gradient=untouched)
            assert np.array_equal(gradient[:, drawn], expected[:, drawn])
            assert (gradient[:, ~drawn] == 7).all()
            parts += value.total
        assert parts == pytest.approx(whole.total, rel=1e-6)  # float32 sums of a row each, added in another order


def test_the_loss_of_what_was_drawn_leads_back_as_its_gradient_does() -> None:
    rng, scene, rows = np.random.default_rng(6), small_scene(6), np.arange(0, 300, 9)
    kernel = CpuKernel(2)
    view = CpuFixedView(kernel, CAMERA)
    view.set_scene(scene)
    view.redraw()
    view.detach(rows)
    target, weight = rng.random(view.rgb.shape).astype(np.float32), rng.random(view.depth.shape).astype(np.float32)
    given = {"l1_scale": 0.8, "ssim_scale": 0.2, "l1_weight": weight, "focus": weight}
    for _ in range(2):
        moving = jittered(take_splats(scene, rows), rng, 0.05)
        view.draw(moving, rows)
        with pytest.raises(ValueError, match="the draw's loss or a cotangent"):
            view.backward()
        value, cotangent = kernel.loss(view.rgb, target, tiles=view.met, **given)
        assert view.loss(target, **given).sums == value.sums
        found, expected = view.backward(), view.backward(np.nan_to_num(cotangent))
        for name in FIELDS:
            assert np.array_equal(getattr(found, name), getattr(expected, name)), name


def test_misuse_is_refused() -> None:
    view = CpuFixedView(CpuKernel(1), CAMERA)
    scene = small_scene(2)
    view.set_scene(scene)
    with pytest.raises(ValueError, match="ascend"):
        view.detach(np.array([3, 1], np.int64))
    with pytest.raises(ValueError, match="in the scene"):
        view.detach(np.array([len(scene)], np.int64))
    with pytest.raises(ValueError, match="int64"):
        view.detach(np.array([1], np.int32))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="draw before"):
        view.backward(view.rgb)
    with pytest.raises(ValueError, match="marks"):
        view.redraw(np.zeros((3, 3), bool))
    with pytest.raises(ValueError, match="rows"):
        view.draw(scene, np.array([1], np.int64))
    with pytest.raises(ValueError, match="new numbers"):
        view.commit(scene, np.zeros(0, np.int64), np.zeros(3, np.int64))
    with pytest.raises(ValueError, match="tiles"):
        CpuKernel(1).loss(view.rgb, view.rgb, l1_scale=1, ssim_scale=1, tiles=np.zeros(3, np.uint8))
