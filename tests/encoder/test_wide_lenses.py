"""Wide lenses: all that they recorded is trained, and what they did not record counts nowhere."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.lattice import default_lattice
from decogs.decoder.cameras.lens import undistort_pixels
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.psnr import psnr_of
from decogs.encoder.backends.tiles import tiles_with
from decogs.encoder.change.flashes import changes_most
from decogs.encoder.change.masks import MaskMemory
from decogs.encoder.keyframe.first_points import first_points
from decogs.encoder.keyframe.first_points.cloud import ViewDepths
from decogs.encoder.keyframe.first_points.frusta import DepthRange
from decogs.encoder.keyframe.first_points.guesses import guess_points, random_in_frustum
from decogs.encoder.keyframe.first_points.views import make_view
from decogs.encoder.settings.frame import MaskSettings
from decogs.formats.cameras import Camera, in_picture, project

BARREL = (-0.25, 0.0, 0.0, 0.0)
"""An action camera's k1; the corners of the tiny rig's pictures are at .94 of the fold."""


@pytest.fixture(scope="module")
def wide_rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(tiny_rig.write(tmp_path_factory.mktemp("rigs") / "wide", frames=[0, 1], lens=BARREL))


def _beside_pinhole(camera: Camera) -> np.ndarray:
    """The pixels (H, W) that a pinhole of the camera's own size does not see."""
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    straight = undistort_pixels(camera, np.stack([u, v], axis=-1))
    return ~in_picture(camera, straight[..., 0], straight[..., 1], np.ones_like(u))


def test_the_border_of_a_wide_picture_is_trained_in_every_frame(
    wide_rig: Path, encode: Any, tiny_settings: Any
) -> None:
    """It is 4.5 dB below the middle, which more cameras see; with pinholes of the cameras' own size it was 12 dB."""
    keyframe = replace(tiny_settings.keyframe, iterations=300, cap=3000, settle_iterations=30)
    encoded = encode(wide_rig, settings=replace(tiny_settings, keyframe=keyframe))
    with open_stream(encoded.path) as stream:
        cameras = [camera for camera in stream.header.cameras if camera.name not in stream.header.held_out]
        for index, frame in enumerate(stream.frames()):
            border, middle = [], []
            for camera in cameras:
                shown = render_view(stream.header, frame.splats, camera.name).image
                recorded = cv2.imread(str(wide_rig / camera.name / f"{index:04d}.png"))[..., ::-1]
                error, beside = (np.clip(shown, 0, 1) - recorded / 255) ** 2, _beside_pinhole(camera)
                assert 0.1 < beside.mean() < 0.5
                border.append(error[beside].mean())
                middle.append(error[~beside].mean())
            assert psnr_of(float(np.mean(border))) > psnr_of(float(np.mean(middle))) - 6


SIZE = (48, 64)
RECORDED = np.broadcast_to(np.arange(64) < 32, SIZE)
"""The left half."""
GREY = np.full((3, *SIZE), 0.5, np.float32)


def test_what_was_not_recorded_is_no_change_and_no_part_of_a_share() -> None:
    settings, now = MaskSettings(threshold=10.0, radius_fraction=0.1), GREY.copy()
    now[:, :, 20:] += 0.2
    memory = MaskMemory.begin(
        [GREY], [GREY + np.where(RECORDED, np.float32(0.02), np.float32(0.5))], recorded=[RECORDED]
    )
    assert memory.trained_errors == pytest.approx([0.02], rel=1e-3)
    changes = memory.pixel_changes([now], settings)
    np.testing.assert_array_equal(changes[0].raw.any(axis=0), (np.arange(64) >= 20) & (np.arange(64) < 32))
    (mask,) = memory.masks([now], changes, settings)
    assert mask.dilated[:, 15:32].all()
    assert not mask.dilated[:, 32:].any()
    assert memory.shares([changes[0].raw]) == [12 / 32]
    assert memory.changed_fraction([now], [GREY], settings) == 12 / 32
    np.testing.assert_array_equal(memory.full_masks(changes)[0].dilated, RECORDED)
    now[:, :, 10:] = 0.9
    changes = memory.pixel_changes([now], settings)
    assert changes_most(memory, changes), "22 of the 32 columns that were recorded, of 64 in all"


def test_weights_are_those_of_recorded_pixels(tiny_rig: Any) -> None:
    """Against weights of all, marked so; tolerance: sums of floats in another order."""
    camera, scene = tiny_rig.camera(0), tiny_rig.scene_at(0)
    recorded = np.broadcast_to(np.arange(camera.width) < 27, (camera.height, camera.width))
    marks = np.broadcast_to(np.arange(camera.height)[:, None] < 21, recorded.shape)
    kernel = CpuKernel(1)
    views = [kernel.fixed_view(camera), kernel.fixed_view(camera, np.ascontiguousarray(recorded))]
    for view in views:
        view.set_scene(scene)
    for more in range(2):  # again, where only tiles with marks are weighed anew
        weights = views[1].redraw(np.ascontiguousarray(marks))
        np.testing.assert_allclose(weights[0], views[0].redraw(np.ascontiguousarray(recorded))[1], rtol=1e-5, atol=1e-6)
        both = np.ascontiguousarray(recorded & marks)
        np.testing.assert_allclose(weights[1], views[0].redraw(both)[1], rtol=1e-5, atol=1e-6, err_msg=str(more))
    np.testing.assert_array_equal(views[1].rgb[:, :, :27], views[0].rgb[:, :, :27])


def test_tiles_without_a_recorded_pixel_change_neither_losses_nor_gradients(tiny_rig: Any) -> None:
    camera, scene = tiny_rig.camera(0), tiny_rig.scene_at(0)
    counted = np.zeros((camera.height, camera.width), np.float32)
    counted[:20, :40] = 1
    target, found = np.full((3, *counted.shape), 0.5, np.float32), []
    tiles = tiles_with(counted > 0)
    np.testing.assert_array_equal(tiles.reshape(3, 4), [[1, 1, 1, 0], [1, 1, 1, 0], [0, 0, 0, 0]])
    for wanted in (None, tiles):
        kernel = CpuKernel(1)
        optimiser = kernel.optimiser(scene)
        kernel.forward(optimiser, camera, tiles=wanted)
        value = kernel.picture_loss(target, l1_scale=0.8, ssim_scale=0.2, l1_weight=counted, focus=counted)
        found.append((value.total, kernel.backward(optimiser).host()))
    assert found[0][0] == pytest.approx(found[1][0], rel=1e-12), "doubles, summed by other regions"
    for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh"):
        np.testing.assert_array_equal(*(getattr(gradients, name) for _, gradients in found))
    with pytest.raises(ValueError, match="tiles"):
        kernel.forward(optimiser, camera, tiles=tiles[1:])


def test_a_fixed_view_trains_without_tiles_of_which_nothing_was_recorded(tiny_rig: Any) -> None:
    camera, scene = tiny_rig.camera(0), tiny_rig.scene_at(0)
    recorded = np.zeros((camera.height, camera.width), bool)
    recorded[:20, :40] = True
    rows, found = np.arange(0, len(scene), 2), []
    for seen in (None, recorded):
        kernel = CpuKernel(1)
        view = kernel.fixed_view(camera, seen)
        view.set_scene(scene)
        view.refresh()
        view.detach(rows)
        moving = kernel.optimiser(type(scene)(*(value[rows] for value in vars(scene).values())))
        view.draw(moving, rows)
        weights = recorded.astype(np.float32)
        view.loss(np.full_like(view.rgb, 0.5), l1_scale=0.8, ssim_scale=0.2, l1_weight=weights, focus=weights)
        found.append(view.backward().host().means.copy())
        view.commit(scene, rows)
        view.refresh()
        assert view.rgb[:, recorded].any()
    np.testing.assert_array_equal(*found)


def test_no_first_point_comes_from_what_was_not_recorded(tiny_rig: Any) -> None:
    """Of a part of every picture that has another colour, on which all views agree."""
    cameras, random = [tiny_rig.camera(index) for index in range(5)], np.random.default_rng(1)
    recorded = np.broadcast_to(np.arange(64) < 40, SIZE)
    pictures = []
    for camera in cameras:
        picture = np.clip(render_view(_header(camera), tiny_rig.scene_at(0), camera.name).image, 0, 0.5)
        picture[~recorded] = (1.0, 0.0, 1.0)
        pictures.append(picture.astype(np.float32) + random.normal(0, 0.002, picture.shape).astype(np.float32))
    found = {}
    for name, given in (("all", ()), ("recorded", [recorded] * 5)):
        points = first_points(cameras, pictures, recorded=given, cap=1500)
        found[name] = (points.rgb[:, 0] > 0.8).mean()
        if given:
            seen = np.zeros(len(points.xyz), bool)
            for camera in cameras:
                u, v, depth = project(camera, points.xyz)
                seen |= in_picture(camera, u, v, depth) & (u < 41)
            assert seen.all()
    assert found["all"] > 0.1
    assert found["recorded"] == 0


def test_nothing_is_guessed_at_a_border_before_what_others_see(tiny_rig: Any) -> None:
    """One view confirms nothing but a strip; another sees a wall behind all that the first may guess there."""
    row, column = np.mgrid[: SIZE[0], : SIZE[1]]
    recorded = np.hypot(row - 24, column - 32) < 22
    grey, strip = np.full((*SIZE, 3), 0.5, np.float32), np.where(row < 8, np.float32(1 / 3), np.float32(0))
    wall = np.where(row > 30, np.float32(1 / 4), np.float32(0))  # it goes on above

    def beside(walls: Sequence[np.ndarray]) -> np.ndarray:
        views = [make_view(tiny_rig.camera(0), grey, 1.0, recorded), make_view(tiny_rig.camera(1), grey, 1.0)]
        shown = [
            ViewDepths(view, DepthRange(2.0, 6.0), None, depths, 0.1) for view, depths in zip(views, walls, strict=True)
        ]
        cloud = random_in_frustum(views[0], DepthRange(3.0, 3.1), 5, np.random.default_rng(1))
        guesses, _ = guess_points(cloud, shown, 2.0, np.random.default_rng(0))
        u, v, _ = project(views[0].camera, guesses.xyz)
        _, _, depth = project(views[1].camera, guesses.xyz)
        own = (np.hypot(v - 24, u - 32) > 18) & (np.hypot(v - 24, u - 32) < 22)
        return np.asarray(depth[own])

    assert beside([strip * recorded, strip]).min() < 0.8 * 3
    assert beside([strip * recorded, wall]).min() > 0.79 * 4


def _header(camera: Camera) -> StreamHeader:
    return StreamHeader((camera,), default_lattice(1.0))
