"""First points: against a scene rendered here, whose surfaces are known exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import NDArray

from decogs.encoder.keyframe.first_points import FirstPoints, first_points
from decogs.encoder.keyframe.first_points.agreement import agree
from decogs.encoder.keyframe.first_points.cloud import (
    Cloud,
    ViewDepths,
    neighbour_distances,
    spread_to_count,
    take,
    too_near,
)
from decogs.encoder.keyframe.first_points.depth_filling import continues, fill_depths
from decogs.encoder.keyframe.first_points.frusta import DepthRange, shared_depths
from decogs.encoder.keyframe.first_points.guesses import guess_points, random_in_frustum
from decogs.encoder.keyframe.first_points.plane_sweep import DepthMap, choose_planes, sweep
from decogs.encoder.keyframe.first_points.views import inside, make_view, pixel_rays, project
from decogs.formats.cameras import Camera, camera_centre, scale_camera
from decogs.formats.errors import TrainingError

WIDTH, HEIGHT, FOCAL = 128, 96, 120.0
BALL = (np.array([0.0, 0.0, 0.6]), 0.6)
LATTICE = np.random.default_rng(5).random((32, 32, 32, 3))
GUESS = 0.06

Picture = NDArray[np.float32]


def look_at(name: str, centre: Sequence[float], target: Sequence[float]) -> Camera:
    """A camera at ``centre`` looking at ``target``, z up."""
    forward = np.subtract(target, centre)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = [right, np.cross(forward, right), forward]
    pose[:3, 3] = -pose[:3, :3] @ np.asarray(centre)
    return Camera(name, WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, pose)


def ring(degrees: Sequence[float], radius: float = 3.0, height: float = 1.5) -> list[Camera]:
    """Cameras around the ball, looking at it."""
    angles = np.radians(degrees)
    return [
        look_at(f"cam{i:02d}", (radius * np.cos(a), radius * np.sin(a), height + 0.3 * (i % 2)), (0.0, 0.0, 0.4))
        for i, a in enumerate(angles)
    ]


def solid_texture(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth random colours in space, (..., 3), in two octaves."""
    colours = np.zeros_like(xyz)
    for frequency, weight in ((4.0, 0.6), (11.0, 0.4)):
        cell = np.floor(xyz * frequency).astype(np.int64)
        part = xyz * frequency - cell
        for corner in np.ndindex(2, 2, 2):
            share = np.prod(np.where(corner, part, 1 - part), axis=-1, keepdims=True)
            index = (cell + corner) % 32
            colours += weight * share * LATTICE[index[..., 0], index[..., 1], index[..., 2]]
    return colours


def photograph(camera: Camera, gains: Sequence[float] = (1.0, 1.0, 1.0)) -> tuple[Picture, NDArray[np.float64]]:
    """What the camera sees of a ball on a floor (z = 0) before a far wall of the floor's texture, and its depth map."""
    finer = 2
    u, v = np.meshgrid((np.arange(WIDTH * finer) + 0.5) / finer, (np.arange(HEIGHT * finer) + 0.5) / finer)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    rays = rays @ camera.world_to_camera[:3, :3]
    origin = camera_centre(camera)
    with np.errstate(divide="ignore", invalid="ignore"):
        floor = np.where(rays[..., 2] < 0, -origin[2] / rays[..., 2], np.inf)
        across = (rays[..., :2] ** 2).sum(axis=-1)
        along = rays[..., :2] @ origin[:2]
        wall = (-along + np.sqrt(along**2 - across * (origin[:2] @ origin[:2] - 16.0))) / across
        to_ball = origin - BALL[0]
        a, b = (rays**2).sum(axis=-1), rays @ to_ball
        ball = (-b - np.sqrt(b**2 - a * (to_ball @ to_ball - BALL[1] ** 2))) / a
    depth = np.fmin(np.fmin(floor, wall), np.where(ball > 0, ball, np.nan))
    colours = solid_texture(origin + rays * depth[..., None]) * gains
    picture = colours.reshape(HEIGHT, finer, WIDTH, finer, 3).mean(axis=(1, 3))
    noise = np.random.default_rng(int(camera.name[3:])).normal(0, 0.005, picture.shape)
    return np.clip(picture + noise, 0, 1).astype(np.float32), depth[1::finer, 1::finer]


def photograph_all(cameras: Sequence[Camera]) -> list[Picture]:
    """Pictures with a different exposure and white balance in every camera."""
    random = np.random.default_rng(1)
    gains = random.uniform(0.8, 1.0, (len(cameras), 1)) * random.uniform(0.93, 1.0, (len(cameras), 3))
    return [photograph(camera, gain)[0] for camera, gain in zip(cameras, gains, strict=True)]


def distance_to_surface(xyz: NDArray[np.floating]) -> NDArray[np.float64]:
    """Distance of points to the nearest of ball, floor and wall (a cylinder of radius 4)."""
    points = xyz.astype(np.float64)
    ball = np.abs(np.linalg.norm(points - BALL[0], axis=1) - BALL[1])
    wall = np.abs(np.linalg.norm(points[:, :2], axis=1) - 4.0)
    return np.asarray(np.minimum(np.minimum(ball, np.abs(points[:, 2])), wall))


@dataclass(frozen=True)
class Given:
    """Points from elsewhere, as a rig reader gives them."""

    xyz: NDArray[np.float32]
    rgb: NDArray[np.uint8]


ARC = ring(range(-40, 41, 10))


@pytest.fixture(scope="module")
def arc_pictures() -> list[Picture]:
    return photograph_all(ARC)


@pytest.fixture(scope="module")
def arc_points(arc_pictures: list[Picture]) -> FirstPoints:
    return first_points(ARC, arc_pictures, cap=4000)


def test_points_lie_on_the_surfaces(arc_points: FirstPoints) -> None:
    confirmed = arc_points.confidence > GUESS
    assert confirmed.sum() > 2500
    error = distance_to_surface(arc_points.xyz[confirmed])
    pixel = 3.0 / FOCAL  # at the ball's distance; half of one is what sub-plane depth should reach at 10 degrees
    assert np.median(error) < 0.5 * pixel
    assert np.mean(error > 5 * pixel) < 0.02


def test_points_have_the_scenes_colours(arc_points: FirstPoints) -> None:
    confirmed = arc_points.confidence > GUESS
    truth = solid_texture(arc_points.xyz[confirmed].astype(np.float64)) * 0.9 * 0.965  # the mean gains
    assert np.median(np.abs(arc_points.rgb[confirmed] - truth)) < 0.05


def test_every_part_of_every_view_gets_points(arc_points: FirstPoints) -> None:
    for camera in ARC:
        in_camera = arc_points.xyz @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
        uv = in_camera[:, :2] / in_camera[:, 2:] * FOCAL + (camera.cx, camera.cy)
        inside = (in_camera[:, 2] > 0) & (uv > 0).all(axis=1) & (uv < (WIDTH, HEIGHT)).all(axis=1)
        cells = np.unique(uv[inside].astype(int) // 8, axis=0)
        assert len(cells) > 0.9 * (WIDTH // 8) * (HEIGHT // 8), camera.name


def test_spacing_is_about_the_distance_to_neighbours(arc_points: FirstPoints) -> None:
    chosen = np.random.default_rng(0).permutation(len(arc_points.xyz))[:300]
    apart = np.linalg.norm(arc_points.xyz[chosen, None] - arc_points.xyz[None], axis=-1)
    nearest = np.sort(apart, axis=1)[:, 1:4].mean(axis=1)
    ratio = arc_points.spacing[chosen] / nearest
    assert 0.95 < np.median(ratio) < 1.05
    assert np.isfinite(arc_points.spacing).all()
    assert (arc_points.spacing > 0).all()


def test_nothing_stands_right_in_front_of_a_camera(arc_points: FirstPoints) -> None:
    for camera in ARC:
        distance = np.linalg.norm(arc_points.xyz - camera_centre(camera), axis=1)
        assert distance.min() > 0.8  # well below half of about 2, the depth of the floor in front


@pytest.mark.parametrize(
    ("degrees", "share", "pixels"),
    [
        (range(-30, 31, 12), 0.5, 0.5),
        pytest.param(range(0, 360, 24), 0.5, 0.8, marks=pytest.mark.slow),
        ((-45, -15, 15, 45), 0.1, 1.5),
    ],
    ids=["arc", "all round", "four wide apart"],
)
def test_arrangements(degrees: Sequence[float], share: float, pixels: float) -> None:
    cameras = ring(degrees)
    points = first_points(cameras, photograph_all(cameras), cap=3000)
    confirmed = points.confidence > GUESS
    assert confirmed.sum() > share * 3000
    error = distance_to_surface(points.xyz[confirmed])
    assert np.median(error) < pixels * 3.0 / FOCAL
    assert np.quantile(error, 0.8) < 6 * pixels * 3.0 / FOCAL
    assert np.abs(points.xyz).max() < 3 * 4.0  # guesses too stay near the room, whose wall is 4 from its middle


@pytest.mark.parametrize("degrees", [range(0, 360, 45), (0, 50, 100, 150)], ids=["all round", "half round"])
def test_far_apart_a_floor_is_found_by_level_planes(degrees: Sequence[float]) -> None:
    """Planes that face the camera alone put .89 and .87 of the points on a surface, level ones too .98."""
    cameras = ring(degrees)
    points = first_points(cameras, photograph_all(cameras), cap=4000)
    confirmed = points.seen.any(axis=0)
    assert confirmed.sum() > 3000
    assert (distance_to_surface(points.xyz[confirmed]) < 2 * 3.0 / FOCAL).mean() > 0.93


@pytest.mark.parametrize("cap", [1, 37, 800])
def test_never_more_points_than_there_is_room_for(cap: int, arc_pictures: list[Picture]) -> None:
    points = first_points(ARC[:3], arc_pictures[:3], cap=cap)
    assert 0 < len(points.xyz) <= cap
    assert len(points.xyz) == len(points.rgb) == len(points.spacing) == len(points.confidence)


def test_same_seed_same_points_whatever_the_threads(arc_pictures: list[Picture]) -> None:
    one = first_points(ARC[:4], arc_pictures[:4], cap=2000, seed=3, threads=1)
    three = first_points(ARC[:4], arc_pictures[:4], cap=2000, seed=3, threads=3)
    for name in ("xyz", "rgb", "spacing", "confidence"):
        assert np.array_equal(getattr(one, name), getattr(three, name)), name
    other = first_points(ARC[:4], arc_pictures[:4], cap=2000, seed=4)
    assert not np.array_equal(one.xyz, other.xyz)


def test_views_that_share_nothing_get_guesses_in_front_of_them(arc_pictures: list[Picture]) -> None:
    apart = [look_at("cam00", (1.0, 0, 1), (9.0, 0, 1)), look_at("cam01", (-1.0, 0, 1), (-9.0, 0, 1))]
    assert shared_depths([make_view(c, p, 1.0) for c, p in zip(apart, arc_pictures, strict=False)]) == [None, None]
    points = first_points(apart, arc_pictures[:2], cap=500)
    assert len(points.xyz) > 400
    assert (points.confidence < GUESS).all()
    assert (np.abs(points.xyz[:, 0]) > 1.0).all()


def test_pictures_without_texture_get_guesses_in_the_shared_space() -> None:
    grey = [np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)] * 3
    points = first_points(ARC[:3], grey, cap=500)
    assert 0 < len(points.xyz) <= 500
    assert np.isfinite(points.xyz).all()
    assert np.allclose(points.rgb, 0.5)


def test_guesses_are_few_and_large_where_little_is_confirmed() -> None:
    camera = scale_camera(ARC[4], 4)
    view = make_view(camera, np.full((camera.height, camera.width, 3), 0.5, np.float32), 1.0)
    cloud = random_in_frustum(view, DepthRange(3.0, 3.1), 5, np.random.default_rng(0))
    row = np.arange(camera.height)[:, None] + np.zeros((1, camera.width))

    def guesses(share: float, pixels: float) -> Cloud:
        confirmed = np.where(row < share * camera.height, np.float32(1 / 3), np.float32(0))
        shown = ViewDepths(view, DepthRange(2.0, 6.0), None, confirmed, 0.1)
        every = guess_points(cloud, [shown], pixels, np.random.default_rng(1))[0]
        return take(every, project(view, every.xyz)[1] > 0.7 * camera.height)

    def apart(found: Cloud) -> float:
        return float((0.3 * view.pixels / len(found)) ** 0.5)

    little, enough = guesses(0.01, 1.0), guesses(0.2, 5.0)
    assert 0.035 * view.pixels**0.5 < apart(little) < 0.055 * view.pixels**0.5
    depth = project(view, little.xyz)[2]
    np.testing.assert_allclose(little.spacing * FOCAL * 4 / depth, apart(little), rtol=0.1)
    assert apart(guesses(0.1, 1.0)) < 0.7 * apart(little)
    assert apart(enough) == pytest.approx(2.4 * 5, rel=0.1)


def test_known_points_take_part_and_are_enough_for_one_camera(arc_pictures: list[Picture]) -> None:
    on_floor = np.random.default_rng(2).uniform(-0.5, 0.5, (50, 3)).astype(np.float32) * (1, 1, 0) + (1.3, 0, 0)
    given = Given(on_floor.astype(np.float32), np.full((50, 3), 255, np.uint8))
    points = first_points(ARC[4:5], arc_pictures[4:5], given=given, cap=1000)
    in_camera = given.xyz @ ARC[4].world_to_camera[:3, :3].T + ARC[4].world_to_camera[:3, 3]
    visible = (np.abs(in_camera[:, :2] / in_camera[:, 2:] * FOCAL) < (WIDTH / 2 - 1, HEIGHT / 2 - 1)).all(axis=1)
    found = {tuple(p) for p in points.xyz}
    assert visible.sum() > 20
    assert sum(tuple(p) in found for p in given.xyz[visible]) >= 0.9 * visible.sum()
    assert len(points.xyz) > 200  # the rest of the picture is filled up


def test_bad_arguments_are_said_in_one_line(arc_pictures: list[Picture]) -> None:
    with pytest.raises(TrainingError, match="cameras in two places"):
        first_points(ARC[:1], arc_pictures[:1], cap=100)
    with pytest.raises(TrainingError, match="cameras in two places"):
        first_points([ARC[0], replace(ARC[0], name="cam01")], arc_pictures[:2], cap=100)
    with pytest.raises(TrainingError, match="cam01: a picture of shape"):
        first_points(ARC[:2], [arc_pictures[0], arc_pictures[1][:-1]], cap=100)
    with pytest.raises(TrainingError, match="1 pictures for 2 cameras"):
        first_points(ARC[:2], arc_pictures[:1], cap=100)
    lens = replace(ARC[0], distortion_model="opencv", distortion=(0.1, 0.0, 0.0, 0.0))
    with pytest.raises(TrainingError, match="undistorted"):
        first_points([lens, ARC[1]], arc_pictures[:2], cap=100)


def test_sweep_finds_the_depth_of_the_whole_picture() -> None:
    pairs = [photograph(camera) for camera in ARC[2:7]]
    views = [make_view(camera, picture, 1.0) for camera, (picture, _) in zip(ARC[2:7], pairs, strict=True)]
    neighbours = [views[k] for k in (1, 3, 0, 4)]
    truth = pairs[2][1]
    planes = choose_planes(views[2], neighbours, DepthRange(0.8 * truth.min(), 1.2 * truth.max()), 128)
    ratio = sweep(views[2], neighbours, planes).inverse_depth * truth
    assert np.median(np.abs(ratio - 1)) < 0.01  # half a plane: planes are 1.25 px apart, about 2 % at these angles
    assert np.mean(np.abs(ratio - 1) > 0.05) < 0.25


def test_where_one_neighbour_alone_looks_it_is_believed() -> None:
    """A view of a ring and four neighbours, 40 and 80 degrees away: 15 % of it is in one other picture only."""
    cameras = ring((0, 40, -40, 80, -80))
    photographs = [photograph(camera) for camera in cameras]
    views = [make_view(camera, picture, 1.0) for camera, (picture, _) in zip(cameras, photographs, strict=True)]
    truth = photographs[0][1]
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float64), np.arange(HEIGHT, dtype=np.float64))
    xyz = views[0].centre + pixel_rays(views[0], u, v) * truth[..., None]
    looking = sum(inside(other, *project(other, xyz)[:2]).astype(int) for other in views[1:])
    alone = looking == 1
    assert alone.mean() > 0.1
    planes = choose_planes(views[0], views[1:], DepthRange(0.8 * truth.min(), 1.2 * truth.max()), 128)
    ratio = sweep(views[0], views[1:], planes).inverse_depth * truth
    assert np.mean(np.abs(ratio[alone] - 1) < 0.05) > 0.5
    exact = [DepthMap(1 / depth.astype(np.float32)) for _, depth in photographs]
    confirmed = agree(views, 0, [1, 2, 3, 4], [1, 2, 3, 4], exact[0], exact)
    assert alone[confirmed.row, confirmed.column].sum() > 0.3 * alone.sum()


def test_what_more_views_see_through_than_see_is_no_surface() -> None:
    """Of five neighbours two or three have the same depths; to the others the surface lies three times as far away."""
    photographs = [photograph(camera) for camera in ARC[1:7]]
    views = [make_view(camera, picture, 1.0) for camera, (picture, _) in zip(ARC[1:7], photographs, strict=True)]
    own, *others = (DepthMap(1 / depth.astype(np.float32)) for _, depth in photographs)
    far = [DepthMap(depths.inverse_depth / 3) for depths in others]
    kept = [len(agree(views, 0, [1, 2, 3, 4, 5], [1, 2], own, [own, *others[:same], *far[same:]])) for same in (2, 3)]
    assert kept[1] > 0.7 * WIDTH * HEIGHT
    assert kept[0] < 0.25 * kept[1], "what is left lies where the three do not look"


def test_chosen_points_are_spread_evenly() -> None:
    random = np.random.default_rng(0)
    crowded = np.concatenate([random.uniform(0, 0.2, (9000, 3)), random.uniform(0, 1, (3000, 3))]) * (1, 1, 0)
    cloud = Cloud(
        crowded, np.zeros((12000, 3), np.float32), np.full(12000, 0.005, np.float32), np.ones(12000, np.float32)
    )
    chosen, pixels = spread_to_count(cloud, 600)
    assert 400 < len(chosen) <= 600
    assert pixels > 1
    in_crowd = (chosen.xyz[:, :2] < 0.2).all(axis=1).mean()
    assert in_crowd < 0.08  # a 25th of the area, three quarters of the points
    few, _ = spread_to_count(cloud, 5)
    assert 0 < len(few) <= 5


def test_points_right_before_a_camera_are_told() -> None:
    view = make_view(ARC[0], photograph(ARC[0])[0], 1.0)
    forward = view.rotation[2]
    xyz = view.centre + forward * np.array([[0.2], [1.1], [-0.2]])
    cloud = Cloud(xyz, np.zeros((3, 3), np.float32), np.ones(3, np.float32), np.ones(3, np.float32))
    view_depths = ViewDepths(view, None, None, None, nearest=2.0)
    assert too_near(cloud, [view_depths], 0.5).tolist() == [True, False, False]


def test_neighbour_distances_equal_those_of_all_pairs() -> None:
    xyz = np.random.default_rng(0).normal(0, 1, (400, 3)) * 100 + 1000
    apart = np.sort(np.linalg.norm(xyz[:, None] - xyz[None], axis=-1), axis=1)[:, 1:4].mean(axis=1)
    np.testing.assert_allclose(neighbour_distances(xyz), apart, rtol=1e-3)  # float32 of coordinates in -1..1
    assert neighbour_distances(xyz[:1]).tolist() == [0.0]


def test_walls_go_on_as_planes_beyond_what_is_known() -> None:
    """A plane's inverse depth is linear in the picture: half of it tells the rest, up to the bounds of nearness."""
    v, u = np.mgrid[:80, :100].astype(np.float32)
    wall = 0.2 + 0.002 * u + 0.001 * v
    filled = fill_depths(np.where(u < 50, wall, 0).astype(np.float32))
    nearest = 1.1 * np.quantile(wall[:, :50], 0.99)
    np.testing.assert_allclose(filled, np.minimum(wall, nearest), rtol=1e-3)


def test_single_wrong_depths_do_not_spread() -> None:
    v, u = np.mgrid[:90, :120].astype(np.float32)
    wall = 0.2 + 0.0005 * u
    known = np.where(v > 45, wall, 0).astype(np.float32)
    known[10, 20] = known[12, 80] = 0.9
    filled = fill_depths(known)
    unknown = known == 0
    np.testing.assert_allclose(filled[unknown], wall[unknown], rtol=0.02)


def test_planes_are_trusted_to_go_on_near_what_is_known_and_no_farther() -> None:
    """A wall that is seen on the left goes on by a tenth of the width; steps of a tenth of its depth do not."""
    v, u = np.mgrid[:120, :200].astype(np.float32)
    wall = 0.2 + 0.0005 * u
    known = np.where(u < 100, wall, 0).astype(np.float32)
    trusted = continues(known)
    assert trusted[:, :118].mean() > 0.95
    assert not trusted[:, 122:].any()
    steps = known * np.where((u // 20 + v // 20) % 2 == 0, np.float32(1.1), np.float32(1))
    assert continues(steps)[:, 100:118].mean() < 0.3
    assert not continues(np.zeros((40, 60), np.float32)).any()


def test_points_go_on_over_a_wall_that_one_camera_sees(arc_points: FirstPoints) -> None:
    """They lie on the surface as nearly as confirmed ones do, though no second view tells where it is."""
    continued = arc_points.placed & ~arc_points.seen.any(axis=0)
    assert continued.sum() > 30
    pixel = 3.0 / FOCAL
    assert np.median(distance_to_surface(arc_points.xyz[continued])) < 2 * pixel


def test_gaps_between_known_depths_are_filled_and_known_ones_kept() -> None:
    known = np.zeros((40, 60), np.float32)
    known[5:10, 5:10], known[30, 50] = 2.0, 1.0
    filled = fill_depths(known)
    np.testing.assert_allclose(filled[known > 0], known[known > 0], rtol=1e-6)
    assert (filled > 0.99).all()
    assert (filled < 2.01).all()
    assert filled[7, 14] > filled[28, 48]
