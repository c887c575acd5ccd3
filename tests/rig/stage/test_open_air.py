"""The sky is found where a rig shows one, with the space before it, and nowhere else."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from decogs.formats.cameras import Camera, camera_centre, project, ray_slopes, turned
from decogs.formats.rigs import open_rig
from decogs.rig.pictures.ingest import Ingest, RigFrame, View
from decogs.rig.stage.open_air import OpenAir, _directions, _upper_regions, find_open_air, open_air_of
from decogs.rig.stage.views import StageView
from outdoors.make import cameras, write_meadow

SIZE, VIEWS = (96, 72), slice(0, 13, 3)
Meadow = tuple[Ingest, RigFrame, list[np.ndarray], np.ndarray]


@pytest.fixture(scope="module")
def meadow(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Meadow]:
    made: dict[str, Meadow] = {}

    def make(sky: str) -> Meadow:
        if sky not in made:
            folder = write_meadow(sky, tmp_path_factory.mktemp("meadow") / sky, cameras(SIZE, 110)[VIEWS], frames=1)
            ingest = Ingest(open_rig(folder))
            depths = [np.load(folder / f"truth/depth/{view.camera.name}.npy") for view in ingest.views]
            points = np.concatenate([_points(*each)[::7] for each in zip(ingest.views, depths, strict=True)])
            made[sky] = ingest, next(ingest.frames(0, 1)), depths, points
        return made[sky]

    return make


def _points(view: View, depths: np.ndarray) -> np.ndarray:
    """What the pixels show, in the world, but for the sky; ``depths`` are along the axis."""
    rows, columns = np.nonzero(np.isfinite(depths))
    ways = np.stack([*ray_slopes(view.pinhole, columns + 0.5, rows + 0.5), np.ones(len(rows))], axis=1)
    ways = turned(view.pinhole.world_to_camera[:3, :3].T, ways)
    return np.asarray(camera_centre(view.pinhole) + depths[rows, columns][:, None] * ways)


@pytest.mark.parametrize("sky", ["clear", "clouds", "overcast", "sun"])
def test_the_sky_is_found_and_hardly_anything_else(meadow: Callable[[str], Meadow], sky: str) -> None:
    ingest, frame, depths, points = meadow(sky)
    air = find_open_air(ingest.views, frame, points)
    assert air is not None
    for subject, depth in zip(air.hull.views, depths, strict=True):
        is_sky = np.isinf(depth)
        # A margin of a pixel and the windows' two are missed along every outline, a third of so small a picture's sky,
        # and along those of clouds.
        assert subject.subject[is_sky].mean() < (0.75 if sky == "clouds" else 0.45), subject.camera.name
        assert (~subject.subject[~is_sky]).mean() < 0.003, subject.camera.name


def test_space_before_the_sky_is_free_and_what_stands_there_is_not(meadow: Callable[[str], Meadow]) -> None:
    ingest, frame, _, points = meadow("clear")
    air = find_open_air(ingest.views, frame, points)
    assert air is not None
    # Points lie in the middle of pixels, and outlines pass through these: some in a thousand.
    assert air.free(points).mean() < 0.005
    assert not air.on_backdrop(points[np.linalg.norm(points, axis=1) < 60]).any()
    assert air.free(np.array([[0.0, 8, 6]])).all()
    dome = air.backdrop(0)
    assert air.on_backdrop(dome.means).all()
    assert not air.free(dome.means).any()


def test_the_dome_has_the_sky_s_colours(meadow: Callable[[str], Meadow]) -> None:
    ingest, frame, depths, points = meadow("clear")
    air = find_open_air(ingest.views, frame, points)
    assert air is not None
    view, picture = ingest.views[2], frame.training[2]
    ways = turned(view.pinhole.world_to_camera[:3, :3], air.ways)
    u = view.pinhole.fx * ways[:, 0] / ways[:, 2] + view.pinhole.cx
    v = view.pinhole.fy * ways[:, 1] / ways[:, 2] + view.pinhole.cy
    shown = (ways[:, 2] > 0.1) & (u > 0) & (u < SIZE[0]) & (v > 0) & (v < SIZE[1])
    rows, columns = v[shown].astype(int), u[shown].astype(int)
    in_sky = np.isinf(depths[2][rows, columns])
    difference = np.abs(air.rgb[shown] - picture[:, rows, columns].T)[in_sky]
    assert in_sky.sum() > 20
    # A cell of 1.5 degrees spans a step or two of the gradient, and a pixel has noise of 1.2 steps.
    assert 255 * np.median(difference) < 2


def test_a_scene_that_is_not_deep_has_no_sky(meadow: Callable[[str], Meadow]) -> None:
    ingest, frame, _, points = meadow("clear")
    assert find_open_air(ingest.views, frame, 0.2 * points) is None


def test_a_wall_that_stands_near_is_no_sky(meadow: Callable[[str], Meadow]) -> None:
    """The same gradient by height on a wall 12 m away: at infinity its views differ."""
    ingest, frame, depths, points = meadow("clear")
    pictures = []
    for view, picture, depth in zip(ingest.views, frame.training, depths, strict=True):
        wall = picture.copy()
        rows, columns = np.nonzero(np.isinf(depth))
        ways = np.stack([*ray_slopes(view.pinhole, columns + 0.5, rows + 0.5), np.ones(len(rows))], axis=1)
        ways = turned(view.pinhole.world_to_camera[:3, :3].T, ways)
        centre = camera_centre(view.pinhole)
        height = centre[2] + (12 - centre[1]) / np.maximum(ways[:, 1], 0.05) * ways[:, 2]
        wall[:, rows, columns] = 0.95 - 0.03 * np.clip(height, 0, 15) * np.array([[1.0], [0.8], [0.4]])
        pictures.append(wall.astype(np.float32))
    assert find_open_air(ingest.views, RigFrame(0, pictures, []), points) is None


def _with_skies(meadow: Meadow, change: Callable[[int], np.ndarray | float]) -> RigFrame:
    """The frame with another sky in each camera: ``change`` of its number is added."""
    _, frame, depths, _ = meadow
    pictures = [
        np.where(np.isinf(depth), picture + change(number), picture).astype(np.float32)
        for number, (picture, depth) in enumerate(zip(frame.training, depths, strict=True))
    ]
    return RigFrame(0, pictures, [])


def test_what_looks_different_from_every_side_is_no_sky(meadow: Callable[[str], Meadow]) -> None:
    """However far away: each camera sees it grow darker by 10 levels to another side than its neighbours do."""
    made = meadow("clear")
    darker = np.linspace(0, 0.04, SIZE[0])
    frame = _with_skies(made, lambda number: -(darker if number % 2 else darker[::-1]))
    assert find_open_air(made[0].views, frame, made[3]) is None


@pytest.mark.parametrize(("levels", "is_found"), [(6, True), (30, False)])
def test_cameras_of_slightly_other_colour_see_one_sky(
    meadow: Callable[[str], Meadow], levels: float, is_found: bool
) -> None:
    """So much less red in every second one; more is no small rest of differences between cameras."""
    made = meadow("clear")
    red = np.array([1.0, 0, 0])[:, None, None]
    frame = _with_skies(made, lambda number: -levels / 255 * (number % 2) * red)
    air = find_open_air(made[0].views, frame, made[3])
    assert (air is not None) is is_found
    if air is not None:
        alike = find_open_air(made[0].views, made[1], made[3])
        assert alike is not None
        for subject, same in zip(air.hull.views, alike.hull.views, strict=True):
            assert (subject.subject != same.subject).mean() < 0.01


def test_a_later_frame_s_subject_stands_before_the_sky(meadow: Callable[[str], Meadow]) -> None:
    ingest, frame, _, points = meadow("clear")
    air = find_open_air(ingest.views, frame, points)
    assert air is not None
    pictures = [picture.copy() for picture in frame.training]
    pictures[0][:, 4:14, 40:60] = np.array([0.8, 0.1, 0.1])[:, None, None]
    later = air.in_frame(ingest.views, RigFrame(1, pictures, []), range(len(pictures)))
    assert later.hull.views[0].subject[6:12, 43:57].all()
    assert not air.hull.views[0].subject[6:12, 43:57].any()


def test_a_keyframe_with_a_dome_has_its_sky_again(meadow: Callable[[str], Meadow]) -> None:
    ingest, frame, _, points = meadow("clear")
    air = find_open_air(ingest.views, frame, points)
    assert air is not None
    again = open_air_of(ingest.views, frame, np.concatenate([points, air.backdrop(0).means]))
    assert isinstance(again, OpenAir)
    assert all(map(np.array_equal, [v.subject for v in air.hull.views], [v.subject for v in again.hull.views]))
    assert open_air_of(ingest.views, frame, points) is None


def test_directions_are_those_of_the_pixels_centres() -> None:
    camera = cameras(SIZE, 110)[0]
    height, width = camera.height, camera.width
    view = StageView(camera, np.zeros((height, width, 3), np.float32), np.ones((height, width), bool))
    u, v, _ = project(camera, camera_centre(camera) + _directions(view))
    rows, columns = np.indices((height, width)).reshape(2, -1)
    np.testing.assert_allclose([u - columns, v - rows], 0.5, atol=1e-6)  # doubles


def test_the_sky_reaches_what_a_lens_recorded_first() -> None:
    """The left half of a straightened picture begins lower; its sky is apart from that of the right half."""
    picture, recorded = np.zeros((64, 64, 3), np.float32), np.ones((64, 64), bool)
    picture[:, 30:34] = np.random.default_rng(1).random((64, 4, 3))
    recorded[:10, :32] = False
    above = np.arange(64)[:, None] + np.zeros(64) < 30
    sky = _upper_regions(StageView(Camera("a", 64, 64, 60.0, 60.0, 32.0, 32.0, np.eye(4)), picture, recorded), above)
    assert sky[15:25, 5:20].all()
    assert sky[5:25, 42:60].all()
    assert not sky[~(above & recorded)].any()
