"""Lens distortion against OpenCV's own projection, and round trips on smooth pictures."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from decogs.decoder.cameras.lens import (
    LARGEST_AREA,
    LARGEST_WIDE_AREA,
    WIDEST,
    Redistortion,
    Undistortion,
    covering_pinhole,
    distort_pixels,
    training_pinhole,
    undistort,
    undistort_pixels,
)
from decogs.decoder.rasterise import Rendering
from decogs.decoder.rendering.views import through_lens
from decogs.formats.cameras import Camera, DistortionModel, as_pinhole, is_distorted, is_wide, project
from decogs.formats.errors import UsageError

BARREL = Camera(
    "barrel", 320, 180, 226.0, 227.0, 154.5, 98.5, np.eye(4), "opencv", (-0.332, 0.0464, -0.0043, 0.0041, 0.0666)
)
PINCUSHION = replace(BARREL, name="pincushion", fx=163.0, fy=164.0, distortion=(0.18, -0.256, 0.0032, 0.0022, 0.124))
FOUR = replace(BARREL, name="four", distortion=(-0.08, 0.01, 0.001, -0.002))
RATIONAL = replace(BARREL, name="rational", distortion=(0.3, -0.05, 0.001, -0.002, 0.01, 0.45, 0.02, 0.003))
FISHEYE = replace(
    BARREL, name="fisheye", fx=150.0, fy=151.0, distortion_model="fisheye", distortion=(0.05, -0.01, 0.002, -0.001)
)
FOLDED = replace(BARREL, name="folded", fx=190.0, fy=190.0, distortion=(-0.287, 0.0, 0.0, 0.0))
LENSES = pytest.mark.parametrize("camera", [BARREL, PINCUSHION, FOUR, RATIONAL, FISHEYE], ids=lambda c: c.name)


def projected_by_opencv(camera: Camera, directions: np.ndarray) -> np.ndarray:
    """Pixels (centres at .5) where OpenCV's own projection puts (N, 3) directions through the camera's lens."""
    matrix = np.array([[camera.fx, 0, camera.cx - 0.5], [0, camera.fy, camera.cy - 0.5], [0, 0, 1.0]])
    none = np.zeros(3)
    coefficients = np.array(camera.distortion)
    if camera.distortion_model == "fisheye":
        points, _ = cv2.fisheye.projectPoints(directions[:, None], none, none, matrix, coefficients)
    else:
        points, _ = cv2.projectPoints(directions[:, None], none, none, matrix, coefficients)
    return points.reshape(-1, 2) + 0.5


def directions_of(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """(N, 3) directions that a pinhole with the camera's intrinsics sees at these pixels."""
    x, y = (pixels[:, 0] - camera.cx) / camera.fx, (pixels[:, 1] - camera.cy) / camera.fy
    return np.stack([x, y, np.ones_like(x)], axis=1)


def grid(camera: Camera, step: int = 20, inset: int = 12) -> np.ndarray:
    u, v = np.meshgrid(
        np.arange(inset, camera.width - inset, step) + 0.3, np.arange(inset, camera.height - inset, step) + 0.8
    )
    return np.stack([u.ravel(), v.ravel()], axis=1)


def dots_at(points: np.ndarray, width: int, height: int, sigma: float = 1.5) -> np.ndarray:
    """A picture with a Gaussian dot at every point (pixel centres at .5)."""
    y, x = np.mgrid[:height, :width] + 0.5
    return np.asarray(sum(np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * sigma**2)) for u, v in points), dtype=np.float32)


def centroid(picture: np.ndarray, near: np.ndarray, radius: int = 7) -> np.ndarray:
    """Centre of mass of the dot near a point, in pixels with centres at .5."""
    left, top = (np.floor(near) - radius).astype(int)
    patch = picture[top : top + 2 * radius + 1, left : left + 2 * radius + 1].astype(np.float64)
    y, x = np.mgrid[: patch.shape[0], : patch.shape[1]] + 0.5
    return np.array([(patch * x).sum() / patch.sum() + left, (patch * y).sum() / patch.sum() + top])


def smooth(width: int, height: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A band-limited colour picture, evaluated at any pixel coordinates: (..., 3) in 0..1."""
    waves = [
        np.sin(2 * np.pi * (u * a / width + v * b / height) + p)
        for a, b, p in ((9, 4, 0.3), (3, -11, 1.0), (14, 8, 2.0))
    ]
    return np.stack([0.5 + 0.25 * waves[0] + 0.2 * waves[k % 3] * waves[1] for k in range(3)], -1).astype(np.float32)


@LENSES
def test_points_match_opencv_projection(camera: Camera) -> None:
    pixels = grid(camera)
    expected = projected_by_opencv(camera, directions_of(camera, pixels))
    np.testing.assert_allclose(distort_pixels(camera, pixels), expected, rtol=0, atol=1e-9)


@LENSES
def test_undistorting_points_inverts_opencv_projection(camera: Camera) -> None:
    pixels = grid(camera)
    distorted = projected_by_opencv(camera, directions_of(camera, pixels))
    np.testing.assert_allclose(undistort_pixels(camera, distorted), pixels, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("camera", "reach"),
    [
        (FOLDED, 1 / np.sqrt(3 * 0.287)),
        (replace(BARREL, distortion=(-0.45, 0.25, 0.0, 0.0, -0.08)), 1.192),
        # Stereographic, 2 tan(angle / 2): 85 degrees come to a radius of 1.83; OpenCV's inverse stops at pi / 2.
        (replace(FISHEYE, distortion=(1 / 12, 1 / 120, 17 / 20160, 31 / 362880)), np.tan(np.radians(85.5))),
    ],
    ids=["one coefficient", "strong barrel", "stereographic"],
)
def test_points_close_to_the_edge_of_what_a_lens_sees_are_found(camera: Camera, reach: float) -> None:
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    for share in (0.9, 0.97, 0.99):
        slopes = share * reach * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        pixels = slopes * [camera.fx, camera.fy] + [camera.cx, camera.cy]
        distorted = projected_by_opencv(camera, directions_of(camera, pixels))
        np.testing.assert_allclose(distort_pixels(camera, pixels), distorted, rtol=0, atol=1e-9)
        np.testing.assert_allclose(undistort_pixels(camera, distorted), pixels, rtol=0, atol=1e-5)


@pytest.mark.parametrize(
    ("camera", "farthest"),
    [
        (FOLDED, 2 / 3 / np.sqrt(3 * 0.287)),  # r (1 - 0.287 r^2) where its slope is 0
        (replace(FISHEYE, distortion=(-0.2, 0.0, 0.0, 0.0)), 2 / 3 / np.sqrt(3 * 0.2)),  # the same of the angle
    ],
    ids=lambda value: value.name if isinstance(value, Camera) else "",
)
def test_points_that_a_lens_never_shows_have_no_direction(camera: Camera, farthest: float) -> None:
    radius = farthest * np.linspace(1.001, 1.5, 500)[:, None] * [camera.fx, camera.fy]
    for slopes in ([1.0, 0.0], [-0.6, 0.8]):
        assert np.isnan(undistort_pixels(camera, radius * slopes + [camera.cx, camera.cy])).all()
        assert np.isfinite(undistort_pixels(camera, 0.998 * radius[:1] * slopes + [camera.cx, camera.cy])).all()


def test_no_points_are_no_points() -> None:
    for camera in (BARREL, FISHEYE):
        assert distort_pixels(camera, np.empty((0, 2))).shape == (0, 2)
        assert undistort_pixels(camera, np.empty((0, 2))).shape == (0, 2)


@LENSES
@pytest.mark.parametrize("shift", [0.0, 3.25])
def test_undistortion_looks_where_the_lens_puts_each_pixel(camera: Camera, shift: float) -> None:
    """A picture whose values are its own coordinates, through a pinhole of another principal point too.

    Tolerance: OpenCV's cubic kernel bends a ramp by up to 0.03, and rounds positions to 1/32 pixel.
    """
    pinhole = replace(as_pinhole(camera), cx=camera.cx + shift, cy=camera.cy - shift)
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float32) + np.float32(0.5)
    found = Undistortion(camera, pinhole).apply(np.stack([u, v], axis=-1))
    expected = distort_pixels(camera, np.stack([u - shift, v + shift], axis=-1).astype(np.float64))
    inner = np.all((expected > 2) & (expected < [camera.width - 2, camera.height - 2]), axis=-1)
    assert inner.mean() > 0.5
    np.testing.assert_allclose(found[inner], expected[inner], rtol=0, atol=0.07)


def test_points_of_an_undistorted_camera_stay() -> None:
    for camera in (as_pinhole(BARREL), replace(BARREL, distortion=(0.0, 0.0, 0.0, 0.0))):
        assert not is_distorted(camera)
        np.testing.assert_array_equal(distort_pixels(camera, grid(camera)), grid(camera))
        np.testing.assert_array_equal(undistort_pixels(camera, grid(camera)), grid(camera))


def test_a_fisheye_without_coefficients_is_equidistant() -> None:
    camera = replace(FISHEYE, distortion=(0.0, 0.0, 0.0, 0.0))
    assert is_distorted(camera)
    distorted = distort_pixels(camera, np.array([[camera.cx + camera.fx, camera.cy]]))  # 45 degrees off the axis
    np.testing.assert_allclose(distorted, [[camera.cx + np.pi / 4 * camera.fx, camera.cy]], rtol=0, atol=1e-9)


@LENSES
def test_undistorted_dots_lie_where_the_pinhole_sees_them(camera: Camera) -> None:
    wanted = grid(camera, step=25, inset=30)
    recorded = projected_by_opencv(camera, directions_of(camera, wanted))
    shown = np.all((recorded > 10) & (recorded < [camera.width - 10, camera.height - 10]), axis=1)
    assert shown.sum() > 20
    picture, valid = undistort(dots_at(recorded, camera.width, camera.height), camera)
    pinhole = training_pinhole(camera)
    assert picture.shape == (pinhole.height, pinhole.width)
    for point in np.stack(project(pinhole, directions_of(camera, wanted[shown]))[:2], axis=1):
        assert valid[int(point[1]), int(point[0])]
        assert np.hypot(*(centroid(picture, point) - point)) < 0.1


@LENSES
def test_redistorted_dots_lie_where_the_lens_puts_them(camera: Camera) -> None:
    plan = Redistortion(camera)
    assert plan.covered.all()
    pinhole = plan.render_camera
    pixels = grid(camera, step=25, inset=30)
    rendered_at = pixels + np.array([pinhole.cx - camera.cx, pinhole.cy - camera.cy])
    expected = projected_by_opencv(camera, directions_of(camera, pixels))
    picture = plan.apply(dots_at(rendered_at, pinhole.width, pinhole.height))
    assert picture.shape == (camera.height, camera.width)
    shown = np.all((expected > 10) & (expected < [camera.width - 10, camera.height - 10]), axis=1)
    assert shown.sum() > 20
    for point in expected[shown]:
        assert np.hypot(*(centroid(picture, point) - point)) < 0.1


@LENSES
def test_redistorted_render_equals_the_scene_seen_through_the_lens(camera: Camera) -> None:
    """Against the picture evaluated in closed form at every pixel, border included.

    Tolerance: cv2.remap's cubic kernel on waves of at least 20 pixels, positions rounded to 1/32 pixel.
    """
    plan = Redistortion(camera)
    pinhole = plan.render_camera
    v, u = np.mgrid[: pinhole.height, : pinhole.width] + 0.5
    shift_u, shift_v = pinhole.cx - camera.cx, pinhole.cy - camera.cy
    rendered = smooth(camera.width, camera.height, u - shift_u, v - shift_v)
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    seen_from = undistort_pixels(camera, np.stack([u, v], axis=-1))
    truth = smooth(camera.width, camera.height, seen_from[..., 0], seen_from[..., 1])
    error = np.abs(plan.apply(rendered) - truth)
    assert error.max() < 0.02
    assert error.mean() < 0.002


@LENSES
def test_distort_then_undistort_is_the_picture(camera: Camera) -> None:
    pinhole = covering_pinhole(camera)
    v, u = np.mgrid[: pinhole.height, : pinhole.width] + 0.5
    shift_u, shift_v = pinhole.cx - camera.cx, pinhole.cy - camera.cy
    wide = smooth(camera.width, camera.height, u - shift_u, v - shift_v)
    recorded = Redistortion(camera).apply(wide)
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    truth = smooth(camera.width, camera.height, u, v)
    own = Undistortion(camera, as_pinhole(camera))
    back, valid = own.apply(recorded), own.valid
    inner = cv2.erode(valid.astype(np.uint8), np.ones((7, 7)), borderValue=0).astype(bool)
    assert inner.mean() > 0.6
    assert np.abs(back - truth)[inner].max() < 0.03
    assert not back[~valid].any()
    whole = Undistortion(camera, pinhole)
    inner = cv2.erode(whole.valid.astype(np.uint8), np.ones((7, 7)), borderValue=0).astype(bool)
    assert inner.sum() > 0.9 * whole.valid.sum() - 7 * 2 * (pinhole.width + pinhole.height)
    np.testing.assert_allclose(whole.apply(recorded)[inner], wide[inner], atol=0.1)


def test_cubic_interpolation_is_the_choice() -> None:
    """Why cubic: on the sharpest splats a renderer makes (sigma about 0.55 to 0.8 px) it gains 3 to 7 dB over linear.

    Lanczos gains 1 to 4 dB more, far above any reconstruction's own error, for four times the time and nearly twice the
    overshoot at a hard edge (measured at 1352x1014: linear 13, cubic 19, Lanczos 83 ms).
    """
    plan = Redistortion(PINCUSHION)
    pinhole = plan.render_camera
    shift = np.array([pinhole.cx - PINCUSHION.cx, pinhole.cy - PINCUSHION.cy])
    random = np.random.default_rng(0)
    at = random.uniform([5, 5], [PINCUSHION.width - 5, PINCUSHION.height - 5], (500, 2))
    weights = random.uniform(-0.5, 0.5, 500)

    def scene(u: np.ndarray, v: np.ndarray) -> np.ndarray:
        dots = (
            w * np.exp(-((u - a) ** 2 + (v - b) ** 2) / (2 * 0.8**2)) for (a, b), w in zip(at, weights, strict=True)
        )
        return np.asarray(0.5 + sum(dots), dtype=np.float32)

    v, u = np.mgrid[: pinhole.height, : pinhole.width] + 0.5
    rendered, step = scene(u - shift[0], v - shift[1]), (u > pinhole.width / 2).astype(np.float32)
    v, u = np.mgrid[: PINCUSHION.height, : PINCUSHION.width] + 0.5
    seen_from = undistort_pixels(PINCUSHION, np.stack([u, v], axis=-1))
    truth = scene(seen_from[..., 0], seen_from[..., 1])
    to_u, to_v = np.moveaxis((seen_from + (shift - 0.5)).astype(np.float32), -1, 0)

    def resampled(image: np.ndarray, name: str) -> np.ndarray:
        return cv2.remap(image, to_u, to_v, getattr(cv2, f"INTER_{name}"), borderMode=cv2.BORDER_REPLICATE)

    names = ("LINEAR", "CUBIC", "LANCZOS4")
    decibel = {n: -10 * np.log10(np.mean((resampled(rendered, n) - truth) ** 2)) for n in names}
    overshoot = {n: float(resampled(step, n).max() - 1) for n in names}
    assert decibel["CUBIC"] > decibel["LINEAR"] + 3
    assert decibel["CUBIC"] > 45
    assert overshoot["CUBIC"] < 0.7 * overshoot["LANCZOS4"]
    np.testing.assert_allclose(plan.apply(rendered), resampled(rendered, "CUBIC"), atol=0.02)


@pytest.mark.parametrize("camera", [as_pinhole(BARREL), replace(BARREL, distortion=(0.0,) * 5)])
def test_an_undistorted_camera_costs_nothing(camera: Camera) -> None:
    picture = np.zeros((camera.height, camera.width, 3), np.uint8)
    plan = Redistortion(camera)
    assert plan.is_identity
    assert plan.apply(picture) is picture
    assert Undistortion(camera).apply(picture) is picture
    assert (plan.render_camera.width, plan.render_camera.cx) == (camera.width, camera.cx)
    assert plan.covered.all()
    assert Undistortion(camera).valid.all()


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_pictures_keep_their_type(dtype: type) -> None:
    picture = np.full((BARREL.height, BARREL.width, 3), 200, dtype)
    straight, valid = undistort(picture, BARREL)
    assert straight.dtype == dtype
    np.testing.assert_allclose(straight[valid], 200, rtol=1e-6)


def test_a_lens_that_folds_shows_nothing_twice() -> None:
    """k1 = -0.287 alone turns back at r = 1 / sqrt(3 * 0.287) = 1.078: recorded corners have no direction."""
    plan = Redistortion(FOLDED)
    corner, centre = plan.covered[0, -1], plan.covered[90, 160]
    assert (corner, centre) == (False, True)
    pinhole = plan.render_camera
    white = np.ones((pinhole.height, pinhole.width, 3), np.float32)
    picture = plan.apply(white, outside=(0.1, 0.2, 0.3))
    np.testing.assert_array_equal(picture[0, -1], np.float32([0.1, 0.2, 0.3]))
    np.testing.assert_allclose(picture[plan.covered], 1.0, rtol=1e-6)
    beyond = np.array([[FOLDED.cx + 1.08 * FOLDED.fx, FOLDED.cy]])
    assert np.isnan(distort_pixels(FOLDED, beyond)).all()
    wide = replace(as_pinhole(FOLDED), width=600, height=400, cx=300.0, cy=200.0)
    valid = Undistortion(FOLDED, wide).valid
    v, u = np.mgrid[:400, :600] + 0.5
    radius = np.hypot((u - 300) / FOLDED.fx, (v - 200) / FOLDED.fy)
    assert not valid[radius > 1.079].any()


def wide(model: DistortionModel, focal: float, *coefficients: float) -> Camera:
    return Camera("wide", 320, 240, focal, focal, 163.0, 117.5, np.eye(4), model, coefficients)


@pytest.mark.parametrize(
    ("camera", "least"),
    [
        (wide("opencv", 330.0, -0.25, 0.0, 0.0, 0.0), 1.0),
        (wide("opencv", 400.0, -0.4, 0.0, 0.002, -0.001), 1.0),
        (wide("opencv", 260.0, -0.37, 0.13, 0.0, 0.0, -0.02), 1.0),
        (wide("opencv", 260.0, 0.12, 0.0, 0.0, 0.0), 1.0),
        (wide("fisheye", 165.0, 0.0, 0.0, 0.0, 0.0), 1.0),
        (wide("fisheye", 108.0, 0.0, 0.0, 0.0, 0.0), 0.8),  # its corners look backwards, and its sides past `WIDEST`
    ],
    ids=["k1 -.25", "k1 -.4", "webcam", "pincushion", "fisheye of 111 degrees", "fisheye of 170 degrees"],
)
def test_a_training_picture_shows_every_recorded_pixel_that_can_be_rendered(camera: Camera, least: float) -> None:
    pinhole = training_pinhole(camera)
    largest = LARGEST_WIDE_AREA if is_wide(pinhole) else LARGEST_AREA
    assert pinhole.width * pinhole.height <= 1.01 * largest * camera.width * camera.height
    v, u = np.mgrid[: camera.height, : camera.width] + 0.5
    straight = (undistort_pixels(camera, np.stack([u, v], axis=-1)) - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    shown = straight * [pinhole.fx, pinhole.fy] + [pinhole.cx, pinhole.cy]
    with np.errstate(invalid="ignore"):
        inside = np.all((shown >= 0) & (shown <= [pinhole.width, pinhole.height]), axis=-1)
    np.testing.assert_array_equal(inside[Redistortion(camera).covered], True)
    assert inside.mean() >= least
    valid = Undistortion(camera).valid
    at = np.clip(shown[inside].astype(np.int64), 0, [pinhole.width - 1, pinhole.height - 1])
    # Pixels at the very border may fall on one whose centre lies outside.
    assert valid[at[:, 1], at[:, 0]].mean() > 0.98


def test_the_middle_of_a_training_picture_keeps_its_detail_up_to_two_and_a_half_pictures() -> None:
    barrel, fisheye = wide("opencv", 330.0, -0.25, 0.0, 0.0, 0.0), wide("fisheye", 120.0, 0.0, 0.0, 0.0, 0.0)
    assert training_pinhole(barrel).fx == barrel.fx
    assert 0.3 * fisheye.fx < training_pinhole(fisheye).fx < 0.8 * fisheye.fx
    flat = as_pinhole(barrel)
    assert training_pinhole(flat) == flat


def test_directions_that_a_lens_squeezes_fivefold_are_not_trained() -> None:
    """r (1 - .287 r^2) grows by less than a fifth of r from r = .964 on, to the fold at 1.078."""
    pinhole, plan = training_pinhole(FOLDED), Undistortion(FOLDED)
    v, u = np.mgrid[: pinhole.height, : pinhole.width] + 0.5
    radius = np.hypot((u - pinhole.cx) / pinhole.fx, (v - pinhole.cy) / pinhole.fy)
    assert not plan.valid[radius > 0.965].any()
    assert plan.valid[(radius < 0.963) & (radius > 0.9)].any()
    assert pinhole.width < covering_pinhole(FOLDED).width


def test_a_very_wide_lens_is_bounded() -> None:
    lens = replace(FISHEYE, fx=95.0, fy=95.0, distortion=(0.0, 0.0, 0.0, 0.0001))
    plan = Redistortion(lens)
    assert plan.render_camera.width <= WIDEST * lens.width
    assert plan.render_camera.height <= WIDEST * lens.height
    assert plan.covered[int(lens.cy), int(lens.cx)]
    assert not plan.covered.all()


def test_depth_is_not_mixed_across_edges() -> None:
    plan = Redistortion(BARREL)
    shape = plan.render_camera.height, plan.render_camera.width
    depth = np.where(np.arange(shape[1]) > shape[1] // 2, np.float32(7), np.float32(2)) * np.ones(shape, np.float32)
    seen = Rendering(np.zeros((*shape, 3), np.float32), np.zeros(shape, np.float32), depth)
    assert set(np.unique(through_lens(plan, seen, (0.0, 0.0, 0.0)).depth)) == {2.0, 7.0}


@pytest.mark.parametrize("coefficients", [(0.1, 0.2, 0.3), (0.1,) * 6, (float("nan"), 0.0, 0.0, 0.0)])
def test_coefficients_that_are_no_lens_are_named(coefficients: tuple[float, ...]) -> None:
    with pytest.raises(UsageError, match=r"camera 'barrel'.*no 'opencv' lens"):
        Redistortion(replace(BARREL, distortion=coefficients))
