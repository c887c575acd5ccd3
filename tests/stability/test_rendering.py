"""Pictures and gradients of scenes that break the usual formulation, against the float64 twin (encoder/STABILITY.md).

Bounds are in roundings: relative errors of one float32 operation, 6e-8. A pixel is a convex combination of colours and
goes through some fifty operations; each test says where it allows more. Pixels whose thresholds float32 cannot
decide (``rasterise_cases.textbook``) are left out, two in a hundred at most.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import rasterise_cases as cases
from decogs.decoder.rasterise import render
from decogs.decoder.rasterise.native import render_planes
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.splats import Splats, empty_splats, join_splats, take_splats
from gradient_twin import FIELDS, GRADIENT_ROUNDINGS, ROW_TOLERANCE, compare_gradient, kernel_gradients, twin_gradients

SOUND = cases.scene(91, 30, 1)


def check(
    case: cases.Case,
    *,
    undrawn: int = 0,
    gradient_roundings: float = GRADIENT_ROUNDINGS,
    row: float = ROW_TOLERANCE,
    round_ones: bool = False,
) -> cases.Textbook:
    """Picture, alpha, depth and all gradients are the twin's; the last ``undrawn`` Gaussians have no part in any.

    ``round_ones``: turning them changes nothing, so there is no gradient to be off by a share of.
    """
    count = len(case.splats) - undrawn
    drawn = replace(case, splats=take_splats(case.splats, np.arange(count)))
    book = cases.textbook(drawn)
    shown = render_planes(case.splats, case.camera, case.background, 1)
    for actual, expected in zip(shown, (book.rgb, book.alpha, book.depth), strict=True):
        cases.compare(actual, expected, cases.picture_tolerance(case, expected.max()), except_at=book.doubtful)
    planes = cases.cotangents(case, book.doubtful)
    expected = twin_gradients(drawn, *planes)
    gradients = kernel_gradients(case, planes)
    for field in (*FIELDS, "view"):
        actual = getattr(gradients, field)
        assert not actual[count:].any(), field
        if round_ones and field == "quaternions":
            cases.compare(actual[:count], expected[field], gradient_roundings * cases.ROUNDING)
            continue
        compare_gradient(actual[:count], expected[field], roundings=gradient_roundings, row=row)
    return book


def stack(logit: float, sigma: float = 4.0, count: int = 10_000) -> cases.Case:
    """Wide layers one behind the other, their depths exact in float32."""
    rng = np.random.default_rng(92)
    means = np.zeros((count, 3))
    means[:, 2] = 2.5 + np.arange(count) / 4096
    splats = Splats(
        *(
            np.ascontiguousarray(values, np.float32)
            for values in (
                means,
                np.full((count, 3), np.log(sigma)),
                np.tile([1.0, 0, 0, 0], (count, 1)),
                np.full(count, logit),
                rng.normal(size=(count, 1, 3)) * 0.5,
            )
        )
    )
    return cases.Case(splats, Camera("ahead", 5, 3, 40.0, 40.0, 2.5, 1.5, np.eye(4)))


def test_gaussians_at_behind_and_a_hair_before_the_camera_centre() -> None:
    camera = replace(cases.pinhole(45, 37, 40.0), world_to_camera=np.eye(4))
    depths = np.array([1e-15, 1e-12, 1e-6, 1e-3])
    hair = cases.scene(93, 4, 1, sigma=(0.5, 1.0))
    hair = cases.edited(
        hair,
        means=np.stack([0.2 * depths, -0.1 * depths, depths], -1),
        log_scales=hair.log_scales + np.log(depths)[:, None],  # as wide as they are near: they cover the picture
        opacity_logits=[-1.5, -1.0, -0.5, -2.0],
    )
    ahead = cases.edited(SOUND, means=SOUND.means + np.float32([0, 0, 2.5]))
    nowhere = cases.scene(94, 5, 1)
    nowhere = cases.edited(nowhere, means=[[0, 0, 0], [0, 0, -1e-30], [0, 0, -1e-6], [0.1, 0, -2], [1e-3, 0, 0]])
    case = cases.Case(join_splats(join_splats(hair, ahead), nowhere), camera)
    book = check(case, undrawn=5)
    assert (book.weights.max((1, 2))[:4] > 0.01).all(), "what is a hair before the camera is to be seen"


def test_scales_from_1e_minus_8_to_1e4() -> None:
    """Each at a distance at which it may be drawn; those below a thousandth of a pixel fade, as the filter has it."""
    scales = np.geomspace(1e-8, 1e4, 60)
    splats = cases.scene(95, 60, 1, sigma=(0.7, 1.4))
    z = np.maximum(2.5, 2 * scales)
    means = splats.means * z[:, None] * 0.4
    means[:, 2] = z * (1 + np.arange(60) / 1024)
    splats = cases.edited(splats, means=means, log_scales=splats.log_scales + np.log(scales)[:, None])
    book = check(cases.Case(splats, replace(cases.pinhole(45, 37, 40.0), world_to_camera=np.eye(4)), roundings=100))
    seen = book.weights.max((1, 2)) > 0
    assert not seen[scales < 1e-5].any()
    assert seen[scales > 0.1].sum() > 15


@pytest.mark.parametrize("thin", ["blades", "threads"])
def test_needles_of_a_million_to_one(thin: str) -> None:
    """Blades have one thin axis, threads two; a thread is seen through a long lens only."""
    focal, distance = (40.0, 2.5) if thin == "blades" else (1e4, 2.5)
    splats = cases.scene(96, 40, 1, logits=(3.0, 6.0), spread=1.0 if thin == "blades" else 0.002)
    long = np.log(np.random.default_rng(97).uniform(0.3, 0.9, 40))
    million = np.log(1e6)
    scales = np.stack([long, long - (np.log(8.0) if thin == "blades" else million), long - million], -1)
    case = cases.Case(
        cases.edited(splats, log_scales=scales), cases.pinhole(45, 37, focal, offset=(0, 0, distance)), roundings=400
    )
    # Turning a thread moves its ends, 3 600 pixels away: the ellipse's own coordinates of them cancel but for 2^-24 of
    # that, times the 4 000 pixels of a unit, which is what gradients of rotations are off by: seen 3 % of the largest,
    # 7 % of a row. Blades keep to the bounds of ordinary Gaussians.
    roundings, row = (GRADIENT_ROUNDINGS, ROW_TOLERANCE) if thin == "blades" else (0.06 / cases.ROUNDING, 0.15)
    book = check(case, gradient_roundings=roundings, row=row)
    assert (book.weights.max((1, 2)) > 1e-3).sum() > 10


@pytest.mark.parametrize("norm", [1e-17, 1e-6, 1e6, 1e15, 1e19, 1e30, 3e37])
def test_quaternions_of_any_length_are_their_rotations(norm: float) -> None:
    unit = SOUND.quaternions / np.linalg.norm(SOUND.quaternions, axis=1, keepdims=True)
    camera = cases.pinhole(45, 37, 40.0)
    check(cases.Case(cases.edited(SOUND, quaternions=unit.astype(np.float64) * norm), camera))


@pytest.mark.parametrize("norm", [0.0, 1e-19, 1e-38])
def test_quaternions_next_to_zero_stand_for_no_rotation(norm: float) -> None:
    camera, unit = cases.pinhole(45, 37, 40.0), np.tile([1.0, 0, 0, 0], (len(SOUND), 1))
    tiny = cases.Case(cases.edited(SOUND, quaternions=unit[:, ::-1] * norm), camera)
    planes = cases.cotangents(tiny)
    expected = kernel_gradients(replace(tiny, splats=cases.edited(SOUND, quaternions=unit)), planes)
    actual = kernel_gradients(tiny, planes)
    for field in FIELDS:
        if field != "quaternions":
            np.testing.assert_array_equal(getattr(actual, field), getattr(expected, field))
    assert not actual.quaternions.any()
    for plane, twins in zip(render_planes(tiny.splats, camera, tiny.background, 1), cases.twin(tiny), strict=False):
        cases.compare(plane, twins, cases.picture_tolerance(tiny, twins.max()))


def test_opacity_logits_of_plus_and_minus_50() -> None:
    logits = np.where(np.arange(len(SOUND)) % 3, SOUND.opacity_logits, 50)
    faint = cases.edited(cases.scene(98, 10, 1), opacity_logits=np.full(10, -50))
    camera = cases.pinhole(45, 37, 40.0)
    opaque = cases.edited(SOUND, opacity_logits=logits, log_scales=SOUND.log_scales + np.log(4.0))
    book = check(cases.Case(join_splats(opaque, faint), camera, roundings=100), undrawn=10)
    assert book.clamped > 0
    assert not cases.twin(cases.Case(faint, camera))[1].any(), "the twin does not draw them either"


@pytest.mark.parametrize(("alpha", "drawn"), [(0.99, 6), (0.004, 2400)])
def test_ten_thousand_layers(alpha: float, drawn: int) -> None:
    """Transmittance is a product of up to 2 303 factors until a pixel is full, and the way back divides by each again:
    two roundings a layer either way, most of which cancel. At 0.99 a rounding of alpha is a hundred of 1 - alpha. A
    row may be a thousandth of the largest, and off by that much more: seen 1.2e-3 of its length."""
    case = replace(stack(float(np.log(alpha / (1 - alpha)))), roundings=2303)
    book = check(case, undrawn=len(case.splats) - drawn, gradient_roundings=2 * 2303, row=3e-3, round_ones=True)
    assert book.finished == book.alpha.size
    layers = int((book.weights.max((1, 2)) > 0).sum())
    assert layers == 2 if alpha > 0.5 else 2250 < layers < 2350


def test_equal_depths_keep_the_order_of_the_scene() -> None:
    camera = cases.pinhole(31, 23, 30.0)
    flat = cases.scene(99, 700, 0, sigma=(0.05, 0.2), logits=(-1.0, 2.0))
    means = flat.means.copy()
    means[:, 2] = np.repeat([0.25, -0.5], 350)
    flat = cases.edited(flat, means=means)
    check(cases.Case(flat, camera, roundings=100))
    swapped = take_splats(flat, np.r_[350:700, 0:350])  # planes change places, the order within each does not
    np.testing.assert_array_equal(render(flat, camera).image, render(swapped, camera).image)
    assert (render(take_splats(flat, np.arange(699, -1, -1)), camera).image != render(flat, camera).image).any()


def moved_world(scale: float, offset: float) -> cases.Case:
    """A scene and its camera, all of it scaled and then moved by ``offset`` along every axis, up to float32."""
    camera = cases.pinhole(45, 37, 40.0, turn=0.3, nod=-0.2, offset=(0.1, -0.2, 2.5))
    pose, shift = camera.world_to_camera.copy(), np.array([offset, -offset, offset])
    pose[:3, 3] = pose[:3, 3] * scale - pose[:3, :3] @ shift
    log_scales = SOUND.log_scales + np.log(scale)
    return cases.Case(
        cases.edited(SOUND, means=SOUND.means.astype(float) * scale + shift, log_scales=log_scales),
        replace(camera, world_to_camera=pose),
    )


@pytest.mark.parametrize(
    ("scale", "offset"), [(1e-3, 0.0), (1e6, 0.0), (1.0, 1e6), (1.0, 1e3), (1e3, 1e6), (1e-3, 1e3)]
)
def test_worlds_far_from_their_origin_and_of_any_unit(scale: float, offset: float) -> None:
    check(moved_world(scale, offset))


@pytest.mark.parametrize("focal", [1.0, 10.0, 1e3, 1e4, 1e5])
def test_focal_lengths_from_1_to_1e5(focal: float) -> None:
    """From where a long lens sees the scene as large as a short one; and from close by, where it sees a speck."""
    for distance in {2.5, max(2.5, focal / 16)}:
        camera = cases.pinhole(45, 37, focal, offset=(0, 0, distance))
        check(cases.Case(SOUND, camera, roundings=100))


@pytest.mark.parametrize("size", [(1, 1), (1, 97), (2, 3), (31, 37), (61, 1), (17, 53)])
def test_pictures_of_one_pixel_and_of_prime_sides(size: tuple[int, int]) -> None:
    case = cases.Case(cases.scene(7, 25, 1), cases.pinhole(*size, 0.8 * max(size)))
    check(case)
    view = CpuFixedView(CpuKernel(1), case.camera)
    view.set_scene(case.splats)
    view.redraw()
    np.testing.assert_array_equal(view.rgb, render_planes(case.splats, case.camera, (0, 0, 0), 1)[0])


@pytest.mark.parametrize("degree", [0, 3])
def test_no_gaussians_at_all(degree: int) -> None:
    camera, nothing = cases.pinhole(19, 7, 12.0), empty_splats(degree)
    shown = render(nothing, camera, (0.25, 0.5, 0.75))
    np.testing.assert_array_equal(shown.image, np.broadcast_to(np.float32([0.25, 0.5, 0.75]), shown.image.shape))
    assert not shown.alpha.any()
    kernel = CpuKernel(1)
    kernel.forward(nothing, camera)
    assert len(kernel.backward(nothing, np.ones((3, 7, 19), np.float32)).means) == 0
    view = CpuFixedView(kernel, camera)
    view.set_scene(nothing)
    assert view.redraw(np.ones((7, 19), bool)).shape == (2, 0)
    view.detach(np.zeros(0, np.int64))
    view.draw(nothing, np.zeros(0, np.int64))
    assert not view.rgb.any()


@pytest.mark.parametrize("field", FIELDS)
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_half_of_them_not_finite_is_refused_by_name(field: str, bad: float) -> None:
    array = getattr(SOUND, field).copy()
    array[::2] = bad
    spoilt = cases.edited(SOUND, **{field: array})
    camera = cases.pinhole(17, 13, 15.0)
    with pytest.raises(UsageError, match=f"{field} of 15 of 30 Gaussians are not finite") as raised:
        render(spoilt, camera)
    assert "\n" not in str(raised.value)


def test_a_scene_that_covers_the_picture_too_often_is_refused_in_training() -> None:
    """2^27 pairs of a tile and a Gaussian are the most; a run-away training must not end the process."""
    count = 2**27 // 256**2 + 1
    row = np.float32([[0, 0, 2]]), np.ones((1, 3)), np.float32([[1, 0, 0, 0]]), np.full(1, 5.0), np.zeros((1, 1, 3))
    splats = Splats(*(np.repeat(value, count, axis=0).astype(np.float32) for value in row))
    wide = Camera("wide", 4096, 4096, 4e3, 4e3, 2048.0, 2048.0, np.eye(4))
    kernel = CpuKernel(1)
    with pytest.raises(UsageError, match="4096x4096 is covered too many times"):
        kernel.forward(splats, wide)
    small = cases.CASES["17x13"]()
    planes = cases.cotangents(small)
    kernel.forward(small.splats, small.camera, small.background, depth=True)
    after = kernel.backward(small.splats, planes[0], v_alpha=planes[1], v_depth=planes[2])
    np.testing.assert_array_equal(after.means, kernel_gradients(small, planes).means, "as good as new")
