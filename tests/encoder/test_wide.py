"""Training through very wide pinholes: losses and gradients are those of the faces, views agree, an encode is exact."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rasterise import render
from decogs.decoder.rendering.views import render_view
from decogs.encoder.backends import ATTRIBUTES, training_kernel
from decogs.encoder.backends.wide import WideKernel, WideView
from decogs.formats.cameras import Camera, project
from decogs.formats.splats import Splats, take_splats
from random_splats import random_splats

WIDE = Camera("wide", 96, 72, 14.0, 14.0, 47.0, 37.0, np.eye(4), near=0.01)
SCALES = {"l1_scale": 0.8e-4, "ssim_scale": 0.2e-4}


@pytest.fixture
def kernel() -> WideKernel:
    return WideKernel(training_kernel("cpu", 1))


@pytest.fixture
def scene() -> Splats:
    splats = random_splats(60, 4, seed=1)
    around = np.random.default_rng(2).normal(size=(60, 3))
    around[:, 2] = np.abs(around[:, 2]) + 0.2
    return replace(splats, means=(3 * around / np.linalg.norm(around, axis=1)[:, None]).astype(np.float32))


@pytest.fixture
def target() -> np.ndarray:
    return np.random.default_rng(3).uniform(0, 1, (3, WIDE.height, WIDE.width)).astype(np.float32)


def test_a_wide_picture_is_the_decoders(kernel: WideKernel, scene: Splats) -> None:
    picture, decoded = kernel.forward(scene, WIDE, depth=True), render(scene, WIDE)
    np.testing.assert_allclose(picture.rgb.transpose(1, 2, 0), decoded.image, atol=1e-5)
    np.testing.assert_allclose(np.clip(picture.alpha, 0, 1), decoded.alpha, atol=1e-5)


def test_others_are_the_kernels_own(kernel: WideKernel, scene: Splats, target: np.ndarray) -> None:
    narrow, plain = replace(WIDE, fx=80.0, fy=80.0), training_kernel("cpu", 1)
    np.testing.assert_array_equal(kernel.forward(scene, narrow).rgb, plain.forward(scene, narrow).rgb)
    assert kernel.picture_loss(target, **SCALES).total == plain.picture_loss(target, **SCALES).total
    np.testing.assert_array_equal(kernel.backward(scene).host().means, plain.backward(scene).host().means)
    np.testing.assert_array_equal(kernel.centres(60)[1], plain.centres(60)[1])
    assert not isinstance(kernel.fixed_view(narrow), WideView)


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_gradients_are_the_losss_slopes(kernel: WideKernel, scene: Splats, target: np.ndarray, name: str) -> None:
    """Along a random direction, by differences of absolute errors and SSIM as they are (float32)."""
    weights = {"l1_weight": (target[0] > 0.3).astype(np.float32), "focus": (target[0] > 0.3).astype(np.float32)}

    def loss(splats: Splats) -> float:
        kernel.forward(splats, WIDE)
        return kernel.picture_loss(target, **SCALES, **weights).total

    loss(scene)
    gradient = getattr(kernel.backward(scene).host(), name).copy()
    direction = gradient / np.linalg.norm(gradient)
    step = np.float32(1e-3) * direction
    value = getattr(scene, name)
    slope = (loss(replace(scene, **{name: value + step})) - loss(replace(scene, **{name: value - step}))) / 2e-3
    assert slope == pytest.approx(np.linalg.norm(gradient), rel=0.05)


def test_a_view_has_the_kernels_loss_gradients_and_centres(
    kernel: WideKernel, scene: Splats, target: np.ndarray
) -> None:
    view, everything = kernel.fixed_view(WIDE), np.arange(60)
    view.set_scene(scene)
    view.refresh()
    np.testing.assert_array_equal(view.rgb, kernel.forward(scene, WIDE).rgb)
    np.testing.assert_array_equal(view.centres(), kernel.centres(60)[0])
    u, v, depth = project(WIDE, scene.means)
    seen = np.isfinite(view.centres()[:, 0])
    assert seen.sum() > 20
    np.testing.assert_allclose(view.centres()[seen], np.stack([u, v], axis=1)[seen], rtol=1e-5)
    assert (depth[seen] > 0).all()
    view.detach(everything)
    view.draw(scene, everything)
    value, gradients = view.loss(target, **SCALES), view.backward().host()
    kernel.forward(scene, WIDE)
    assert value.total == pytest.approx(kernel.picture_loss(target, **SCALES).total, rel=1e-4)
    theirs = kernel.backward(scene).host()
    for field in fields(gradients):
        mine = getattr(gradients, field.name)
        np.testing.assert_allclose(
            mine, getattr(theirs, field.name), atol=1e-3 * np.abs(mine).max(), err_msg=field.name
        )
    square = ((np.clip(view.rgb, 0, 1) - target) ** 2).sum(dtype=np.float64)
    assert view.squared_error(target) == pytest.approx(square)


def test_weights_are_of_what_was_recorded_and_marked(kernel: WideKernel, scene: Splats) -> None:
    left = np.zeros((WIDE.height, WIDE.width), bool)
    left[:, :48] = True
    view, half = kernel.fixed_view(WIDE), kernel.fixed_view(WIDE, left)
    for each in (view, half):
        each.set_scene(scene)
    whole, marked = view.redraw(left)
    assert 0 < marked.sum() < whole.sum()
    np.testing.assert_allclose(half.redraw()[0], marked, rtol=1e-5, atol=1e-5)


def test_a_view_follows_what_changes(kernel: WideKernel, scene: Splats) -> None:
    view, rows = kernel.fixed_view(WIDE), np.arange(0, 60, 3)
    view.set_scene(scene)
    view.refresh()
    means = scene.means.copy()
    means[rows] += np.float32(0.3)
    after = replace(scene, means=means)
    view.detach(rows)
    view.draw(take_splats(after, rows), rows, depth=True)
    drawn = view.rgb.copy()
    view.commit(after, rows)
    view.refresh()
    fresh = kernel.forward(after, WIDE, depth=True)
    np.testing.assert_allclose(drawn, fresh.rgb, atol=1e-5)
    np.testing.assert_allclose(view.rgb, fresh.rgb, atol=1e-5)
    np.testing.assert_allclose(view.depth, fresh.depth, atol=1e-4)


@pytest.fixture(scope="module")
def fisheye_rig(tmp_path_factory: pytest.TempPathFactory, tiny_rig: Any) -> Path:
    """The tiny rig through fisheyes whose corners are 85 degrees off the axis."""
    folder, lens = tmp_path_factory.mktemp("fisheyes"), {"distortion_model": "fisheye", "distortion": (0.0,) * 4}
    views = [replace(tiny_rig.camera(index), fx=27.0, fy=27.0, **lens) for index in range(tiny_rig.cameras)]
    for view in views:
        (folder / view.name).mkdir()
        shown = SimpleNamespace(cameras=(view,), background=(0.0, 0.0, 0.0), subject=False, camera_colours={})
        for frame in range(3):
            seen: Any = render_view(shown, tiny_rig.scene_at(frame), view.name)  # type: ignore[arg-type]
            tiny_rig.write_png(folder / view.name / f"{frame:04d}.png", to_8bit(seen.image))
    (folder / "rig.json").write_text(json.dumps(tiny_rig.values(views)))
    return folder


def test_a_take_of_fisheyes_is_exact_and_follows_what_moves(fisheye_rig: Path, encode: Callable[..., Any]) -> None:
    one = encode(fisheye_rig, threads=1, name="one.dgs")
    two = encode(fisheye_rig, threads=2, name="two.dgs")
    assert one.path.read_bytes() == two.path.read_bytes()
    first, *_, last = one.report.frames
    assert last.held_out_psnr > first.held_out_psnr - 1
    assert 0 < one.report.frames[1].selected < 0.5
    assert one.report.frames[2].selected == 0, "nothing moves from frame 1 to 2"
