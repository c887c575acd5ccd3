"""Seeds of new objects: on their surface, in their colours, few, repeatable; none where the light alone changes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.decoder.subject.hull import BoolArray
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.encoder.change.masks import FrameMask
from decogs.encoder.keyframe.first_points import FirstPoints
from decogs.encoder.keyframe.missed_surfaces import missed_surfaces
from decogs.encoder.keyframe.train import train_keyframe
from decogs.encoder.settings.frame import EmergenceSettings, FrameSettings
from decogs.encoder.settings.keyframe import KeyframeSettings
from decogs.encoder.training import seeding
from decogs.encoder.training.seeding import SearchView, enough_missed_pixels, missed_pixels
from decogs.formats.cameras import Camera
from decogs.formats.splats import SH_C0, Splats, join_splats, take_splats
from decogs.rig.numerics import bilinear
from decogs.rig.pictures.ingest import View
from one_frame import sparse_trainer, train

SETTINGS = EmergenceSettings()
KEYFRAME = KeyframeSettings(
    iterations=240, cap=4500, grow_every=1000, validation_fraction=0.0, settle_iterations=0, sh_degree=0
)
CENTRE, RADIUS = np.array([0.1, -0.05, -0.2]), 0.28
WIDTH, HEIGHT = 128, 96


def cameras() -> list[Camera]:
    """Two rows of four on an arc of 60 degrees, 2 units before the origin."""
    made = []
    for angle, height in zip(np.radians(np.linspace(-30, 30, 8)), np.tile([-0.35, 0.35], 4), strict=True):
        pose = np.eye(4)
        pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        tilt = np.arctan2(height, 2.0)
        pose[:3, :3] = [[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]] @ pose[:3, :3]
        pose[:3, 3] = [0, 0, 2.1]
        made.append(Camera(f"cam{len(made):02d}", WIDTH, HEIGHT, 110.0, 110.0, WIDTH / 2, HEIGHT / 2, pose))
    return made


def sphere(count: int = 1500) -> Splats:
    """Opaque Gaussians evenly on a sphere (Fibonacci lattice), in smooth bands of colour."""
    index = np.arange(count) + 0.5
    polar, around = np.arccos(1 - 2 * index / count), np.pi * (1 + 5**0.5) * index
    normals = np.stack([np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1)
    colours = 0.5 + 0.4 * np.sin(np.array([5.0, 7.0, 6.0]) * normals + np.array([0.0, 1.0, 2.0]))
    values = (
        CENTRE + RADIUS * normals,
        np.full((count, 3), np.log(0.02)),
        np.tile([1.0, 0, 0, 0], (count, 1)),
        np.full(count, 4.0),
        ((colours - 0.5) / SH_C0)[:, None],
    )
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


@pytest.fixture(scope="module")
def wall(tiny_rig: Any) -> Splats:
    """Smooth stripes: where overlapping Gaussians differ in colour, a wall of them looks different from every side."""
    scene: Splats = tiny_rig.patch((0, 0, 0.6), 70, 50, 0.06, 1)
    bands = scene.means[:, :2] @ np.array([[9.0, 3.0, 5.0], [4.0, 8.0, -6.0]])
    scene.sh[:, 0] = 0.35 * np.sin(bands + np.array([0.0, 1.0, 2.0])) / SH_C0
    return scene


@pytest.fixture(scope="module")
def kernel() -> CpuKernel:
    return CpuKernel(2)


def search_view(kernel: CpuKernel, camera: Camera, shown: Splats, rendered: Splats) -> SearchView:
    picture = kernel.forward(rendered, camera, depth=True)
    assert picture.depth is not None
    seen, focus = kernel.forward(shown, camera), np.ones(picture.alpha.shape, bool)
    return SearchView(camera, seen.rgb, picture.rgb, picture.alpha, picture.depth, focus)


def search_views(kernel: CpuKernel, shown: Splats, rendered: Splats) -> list[SearchView]:
    return [search_view(kernel, camera, shown, rendered) for camera in cameras()]


@pytest.fixture(scope="module")
def appeared(kernel: CpuKernel, wall: Splats) -> list[SearchView]:
    return search_views(kernel, join_splats(wall, sphere()), wall)


def find_seeds(search_views: list[SearchView], settings: EmergenceSettings, sh_degree: int) -> Splats:
    return seeding.find_seeds(search_views, [missed_pixels(view) for view in search_views], settings, sh_degree)


def relit(scene: Splats) -> Splats:
    """The same surfaces under a light that fades to the left, down to a half."""
    other = take_splats(scene, np.arange(len(scene)))
    gain = np.clip(0.75 + 0.5 * other.means[:, :1], 0.5, 1)
    other.sh[:, 0] = ((0.5 + SH_C0 * other.sh[:, 0]) * gain - 0.5) / SH_C0
    return other


def bits(splats: Splats) -> bytes:
    return b"".join(array.tobytes() for array in vars(splats).values())


def test_seeds_lie_on_the_new_surface_all_around_it_as_far_as_it_is_seen(appeared: list[SearchView]) -> None:
    found = find_seeds(appeared, SETTINGS, 0)
    assert len(found) > 100
    off = np.linalg.norm(found.means - CENTRE, axis=1) - RADIUS
    pixel = 2.0 / 110
    # Along the ray a pixel's disparity over the rig's baseline of 2 units at depth 2 is about a pixel; windows of three
    # pixels and smooth colours leave a few.
    assert np.median(np.abs(off)) < 2 * pixel
    assert np.percentile(np.abs(off), 95) < 6 * pixel
    spread = found.means.max(axis=0) - found.means.min(axis=0)
    assert (spread[:2] > 1.5 * RADIUS).all()


def test_seeds_have_the_colours_of_the_nearest_true_points(appeared: list[SearchView]) -> None:
    truth, found = sphere(), find_seeds(appeared, SETTINGS, 0)
    distance = np.linalg.norm(found.means[:, None] - truth.means[None], axis=2)
    error = np.abs(found.sh[:, 0] - truth.sh[distance.argmin(axis=1), 0]) * SH_C0
    assert np.median(error) < 0.06  # the bands change by 0.04 a pixel


def test_seeds_have_the_scenes_harmonics_and_half_transparent_round_shapes(appeared: list[SearchView]) -> None:
    found = find_seeds(appeared, SETTINGS, 2)
    assert found.sh.shape == (len(found), 9, 3)
    assert not found.sh[:, 1:].any()
    assert np.ptp(found.log_scales, axis=1).max() == 0
    np.testing.assert_allclose(1 / (1 + np.exp(-found.opacity_logits)), 0.3, rtol=1e-5)
    # Between one and four pixels wide at depths of 1.5 to 2.2.
    assert (np.exp(found.log_scales) > 0.8 * 1.5 / 110).all()
    assert (np.exp(found.log_scales) < 4 * 2.2 / 110).all()


def test_what_is_rendered_already_needs_no_seeds(kernel: CpuKernel, wall: Splats) -> None:
    whole = join_splats(wall, sphere())
    same = search_views(kernel, whole, whole)
    assert not enough_missed_pixels([missed_pixels(view) for view in same])
    assert len(find_seeds(same, SETTINGS, 0)) == 0


def test_a_change_of_light_on_old_surfaces_needs_no_seeds(kernel: CpuKernel, wall: Splats) -> None:
    whole = join_splats(wall, sphere())
    changed = search_views(kernel, relit(whole), whole)
    assert enough_missed_pixels([missed_pixels(view) for view in changed])
    # At the silhouette a pixel's mean depth is of neither surface: some rays are fooled (27), at most 2 %.
    assert len(find_seeds(changed, SETTINGS, 0)) < 0.02 * SETTINGS.max_rays


def test_what_disappears_needs_no_seeds(kernel: CpuKernel, wall: Splats) -> None:
    assert len(find_seeds(search_views(kernel, wall, join_splats(wall, sphere())), SETTINGS, 0)) < 10


def test_views_that_contradict_each_other_give_no_seeds(kernel: CpuKernel, wall: Splats) -> None:
    """A different blot in every picture is no object."""
    random = np.random.default_rng(3)
    blotted = []
    for view in search_views(kernel, wall, wall):
        picture = view.picture.copy()
        x, y = random.integers(0, WIDTH - 30), random.integers(0, HEIGHT - 30)
        picture[:, y : y + 20, x : x + 20] = random.uniform(0, 1, (3, 1, 1))
        blotted.append(replace(view, picture=picture))
    assert len(find_seeds(blotted, SETTINGS, 0)) == 0


def test_seeds_lie_before_what_the_other_views_show(appeared: list[SearchView]) -> None:
    """A surface just before most cameras hides what would be there: agreeing colours behind it are chance."""
    hidden = [
        one if index in (0, 4) else replace(one, depth=np.full_like(one.depth, 0.5))
        for index, one in enumerate(appeared)
    ]
    assert len(find_seeds(hidden, SETTINGS, 0)) == 0


def test_only_pixels_in_the_focus_count(appeared: list[SearchView]) -> None:
    outside = [replace(view, focus=np.zeros_like(view.focus)) for view in appeared]
    assert len(find_seeds(outside, SETTINGS, 0)) == 0


def test_one_pixel_wide_edges_do_not_count(appeared: list[SearchView]) -> None:
    view = appeared[0]
    lines = view.rendered.copy()
    lines[:, ::5] += 0.5
    assert not missed_pixels(replace(view, picture=lines)).any()


@pytest.mark.parametrize("most", [0, 1, 60])
def test_there_are_never_more_than_asked_for(appeared: list[SearchView], most: int) -> None:
    found = find_seeds(appeared, replace(SETTINGS, max_seeds=most), 0)
    assert len(found) <= most
    assert len(found) >= 0.3 * most


def test_the_same_pictures_give_the_same_seeds(appeared: list[SearchView]) -> None:
    assert bits(find_seeds(appeared, SETTINGS, 0)) == bits(find_seeds(appeared, SETTINGS, 0))


def test_no_view_may_be_empty_of_depth_to_fail(appeared: list[SearchView]) -> None:
    """Nothing rendered anywhere: everything is in front of nothing."""
    bare = [replace(view, rendered=np.zeros_like(view.rendered), depth=np.zeros_like(view.depth)) for view in appeared]
    assert np.isfinite(find_seeds(bare, SETTINGS, 0).means).all()


def trained(
    kernel: CpuKernel, wall: Splats, shown: Splats, emergence: EmergenceSettings, **other: Any
) -> tuple[Splats, float]:
    """The Gaussians a frame adds, and the mean square error it ends with."""
    views = [View(camera, camera, None) for camera in cameras()]
    pictures = [kernel.forward(shown, view.pinhole).rgb for view in views]
    everywhere = np.ones((HEIGHT, WIDTH), bool)
    settings = FrameSettings(joint_iterations=40, grow_fraction=0.0, emergence=emergence)
    box = (np.full(3, -3.0), np.full(3, 3.0))
    watch = [CpuFixedView(kernel, view.pinhole) for view in views]
    for watching in watch:
        watching.set_scene(wall)
        watching.redraw()
    trainer = sparse_trainer(kernel, views, watch, settings, box=box, **other)
    selected = np.abs(wall.means[:, 0]) < 0.1
    frame = train(
        trainer,
        wall,
        selected,
        pictures,
        [FrameMask(everywhere, everywhere)] * len(views),
        frame=1,
    )
    scene = take_splats(wall, np.arange(len(wall)))
    for name, array in vars(scene).items():
        array[frame.kept] = getattr(frame.values, name)
    scene = join_splats(scene, frame.added)
    errors = [
        ((kernel.forward(scene, view.pinhole).rgb - p) ** 2).mean() for view, p in zip(views, pictures, strict=True)
    ]
    return frame.added, float(np.mean(errors))


def test_a_trained_frame_shows_the_new_object(kernel: CpuKernel, wall: Splats) -> None:
    shown = join_splats(wall, sphere())
    added, error = trained(kernel, wall, shown, SETTINGS)
    none, without = trained(kernel, wall, shown, replace(SETTINGS, max_seeds=0))
    assert len(none) == 0
    assert len(added) > 100
    assert error < 0.25 * without  # 6 dB
    # Seeds that faded while training are left out.
    assert (added.opacity_logits > np.log(FrameSettings().prune_opacity)).all()


@pytest.mark.parametrize("room", [0, 40])
def test_the_scene_never_outgrows_its_bound(kernel: CpuKernel, wall: Splats, room: int) -> None:
    added, _ = trained(kernel, wall, join_splats(wall, sphere()), SETTINGS, max_gaussians=len(wall) + room)
    assert len(added) <= room
    assert (len(added) > 0) == (room > 0)


def test_a_trained_frame_without_anything_new_adds_nothing(kernel: CpuKernel, wall: Splats) -> None:
    assert len(trained(kernel, wall, wall, SETTINGS)[0]) == 0


@pytest.mark.parametrize(("width", "height"), [(200, 150), (129, 65), (64, 128), (5, 3)])
def test_a_picture_smoothed_where_it_is_asked_for_is_the_one_smoothed_whole(width: int, height: int) -> None:
    random = np.random.default_rng(3)
    planes = random.random((3, height, width), np.float32)
    camera = Camera("cam", width, height, 100.0, 100.0, width / 2, height / 2, np.eye(4))
    smoothed = seeding._Smoothed(camera, lambda rows, columns: planes[:, rows, columns])
    whole = cv2.blur(cv2.merge(list(planes)), (3, 3))
    # Positions up to the borders, on pixel centres, between them, and a rounding away from the next block.
    u = np.concatenate(
        [random.random(300) * width, [0, 0.5, width, width - 0.5], [64.4999, 64.5, 64.51] * (width > 65)]
    )
    v = np.resize(np.concatenate([random.random(300) * height, [0, height, 64.4999, 63.99]]), len(u)).clip(0, height)
    for _ in range(2):  # The second time nothing is left to make.
        assert np.array_equal(smoothed.between(u, v), bilinear(whole, u, v))
        pixels = random.integers(0, width * height, 50)
        assert np.array_equal(smoothed.pixels(pixels), whole.reshape(-1, 3)[pixels])
    few = seeding._Smoothed(camera, lambda rows, columns: planes[:, rows, columns])
    assert np.array_equal(few.between(u[:1], v[:1]), bilinear(whole, u[:1], v[:1]))


def points_of(scene: Splats) -> FirstPoints:
    rgb, spacing = 0.5 + SH_C0 * scene.sh[:, 0], np.exp(scene.log_scales[:, 0]) * 2
    everywhere = np.ones(len(scene), bool)
    return FirstPoints(scene.means, rgb, spacing, everywhere.astype(np.float32), everywhere[None], everywhere)


def keyframe(wall: Splats, shown: Splats, **settings: Any) -> Splats:
    kernel, views = CpuKernel(2), [View(camera, camera, None) for camera in cameras()]
    pictures = [kernel.forward(shown, view.pinhole).rgb.copy() for view in views]
    return train_keyframe(kernel, views, pictures, points_of(wall), replace(KEYFRAME, **settings), seed=0).splats


def on_sphere(scene: Splats) -> BoolArray:
    return np.asarray(np.abs(np.linalg.norm(scene.means - CENTRE, axis=1) - RADIUS) < 0.3 * RADIUS)


@pytest.mark.parametrize("cap", [4500, 3500], ids=["room", "none"])
def test_a_thing_without_first_points_is_found(wall: Splats, cap: int) -> None:
    scene = keyframe(wall, join_splats(wall, sphere()), cap=cap)
    assert len(scene) <= cap
    assert on_sphere(scene).sum() > 100
    early = keyframe(wall, join_splats(wall, sphere()), cap=cap, iterations=40)
    assert on_sphere(early).sum() < 0.3 * on_sphere(scene).sum(), "a schedule that is so short searches for nothing"


def test_where_nothing_is_missed_nothing_is_added(wall: Splats) -> None:
    kernel, views = CpuKernel(2), [View(camera, camera, None) for camera in cameras()]

    def found(scene: Splats, shown: Splats) -> int:
        pictures = [kernel.forward(shown, view.pinhole).rgb.copy() for view in views]
        return len(missed_surfaces(kernel, kernel.optimiser(scene), views, pictures))

    with_ball = join_splats(wall, sphere())
    assert found(wall, wall) == 0
    missed = found(wall, with_ball)
    assert missed > 100
    unseen = take_splats(wall, np.zeros(400 * missed, np.intp))
    large = join_splats(wall, replace(unseen, means=unseen.means - np.float32([0, 0, 1000])))
    assert found(large, with_ball) == 0, "so few are left out"
