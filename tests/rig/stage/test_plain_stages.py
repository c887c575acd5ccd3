"""Plain stages: the backdrop is found where it is, performers stand in their hull, and nothing hangs between them."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from decogs.decoder.reading.stream import open_stream
from decogs.encoder.input.compensation.matching import find_colours
from decogs.encoder.keyframe import first_frame
from decogs.encoder.settings.presets import preset
from decogs.formats.cameras import Camera, camera_centre, project
from decogs.formats.rigs import open_rig
from decogs.rig.pictures.ingest import Ingest, RigFrame, View
from decogs.rig.stage.plain import plain_pixels
from decogs.rig.stage.stage import PlainRoom, PlainStage, Stage, find_stage
from encode_rig import encode_rig as encode
from stages.make import write_stage
from stages.scenes import cameras, on_stage

SIZE = (90, 120)
LEFT_OUT = "cam05"


@pytest.fixture(scope="module")
def grey(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stage("grey", tmp_path_factory.mktemp("stage") / "grey", cameras(SIZE), frames=2)


def first_pictures(rig: Path) -> tuple[Ingest, RigFrame]:
    ingest = Ingest(open_rig(rig))
    return ingest, next(iter(ingest.frames(0, 1)))


@pytest.fixture(scope="module")
def stage(grey: Path) -> PlainStage:
    ingest, frame = first_pictures(grey)
    found = find_stage(ingest.views, frame)
    assert isinstance(found, PlainStage)
    return found


def test_floor_and_wall_are_where_they_are(grey: Path, stage: PlainStage) -> None:
    truth = json.loads((grey / "scene.json").read_text())["backdrop"]
    at = stage.surfaces.middle + stage.surfaces.axes[2] * stage.surfaces.floor
    # A pixel covers 4 cm there; light falls off over metres.
    assert at[2] == pytest.approx(truth["floor_height"], abs=0.04)
    assert stage.surfaces.axes[2] @ [0, 0, 1] > np.cos(np.radians(1))
    # The wall's own light is nearly even: nothing says its place to the centimetre.
    assert stage.surfaces.radius == pytest.approx(truth["wall_radius"], rel=0.15)


def test_no_wall_stands_before_a_camera(tmp_path: Path) -> None:
    """Cameras in an arc before a wall that is nearer to what they look at than they are."""
    middle = np.array([0, 2.5, 1.0])
    arc = [
        looking_at(middle, name, [2.5 * np.sin(angle), -2, 1.2])
        for name, angle in zip("abcdef", np.arange(6) / 5, strict=True)
    ]
    rig = write_stage("grey", tmp_path / "arc", arc, frames=1)
    ingest, frame = first_pictures(rig)
    found = find_stage(ingest.views, frame, least_span=0.0)
    assert isinstance(found, PlainStage)
    assert found.surfaces.radius > np.hypot(*(camera_centre(arc[-1]) - found.surfaces.middle)[:2])
    assert (found.surfaces.clearance(np.array([camera_centre(camera) for camera in arc])) > 0).all()


def looking_at(target: NDArray[np.float64], name: str, place: list[float]) -> Camera:
    forward = target - place
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0, 0, 1])
    right /= np.linalg.norm(right)
    pose = np.eye(4)
    pose[:3, :3] = right, np.cross(forward, right), forward
    pose[:3, 3] = -pose[:3, :3] @ place
    return replace(cameras(SIZE)[0], name=name, world_to_camera=pose)


def test_bodies_are_in_the_hull_and_the_space_over_them_is_free(stage: PlainStage) -> None:
    bodies = np.stack([body.centre for body in on_stage(0)])
    assert stage.hull.holds(bodies).all()
    assert stage.free(np.array([[0.0, 0.0, 2.2], [1.5, 1.5, 1.0], [-1.5, 1.5, 1.0]])).all()


def test_a_textured_scene_is_no_stage() -> None:
    ingest, frame = first_pictures(Path(__file__).parents[2] / "demo/workbench")
    assert find_stage(ingest.views, frame) is None


def test_nobody_need_be_on_stage_in_the_first_frame(tmp_path: Path) -> None:
    """Then all that is there is the backdrop. Of a black one, nothing differs from its plate."""
    empty = write_stage("black", tmp_path / "empty", cameras((60, 80))[::2], frames=1, is_empty=True)
    ingest, frame = first_pictures(empty)
    found = find_stage(ingest.views, frame)
    assert isinstance(found, PlainStage)
    assert found.hull.share == 0
    report = encode(empty, tmp_path / "empty.dgs", "live", effects="none")
    assert report.frames[0].training_psnr > 40  # 45.8; the noise alone leaves 46.5


@pytest.fixture(scope="module")
def floor(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stage("floor", tmp_path_factory.mktemp("room") / "floor", cameras(SIZE), frames=1)


def test_a_room_with_plain_walls_has_its_floor_and_walls_where_they_are(floor: Path) -> None:
    ingest, frame = first_pictures(floor)
    room = find_stage(ingest.views, frame)
    assert isinstance(room, PlainRoom)
    truth = json.loads((floor / "scene.json").read_text())["backdrop"]
    at = room.surfaces.middle + room.surfaces.axes[2] * room.surfaces.floor
    # A pixel covers 4 cm there, a square of the floor 40.
    assert at[2] == pytest.approx(truth["floor_height"], abs=0.04)
    assert room.surfaces.radius == pytest.approx(truth["wall_radius"], rel=0.15)
    for view, beside in zip(room.views, room.beside, strict=True):
        u, v, depth = project(view.camera, np.array([[0.0, 1.5, 0.0], [1.0, -1.0, 0.0], [3.5, 0.0, 0.0], [0, 0, 0]]))
        for column, row in zip(u[depth > 0], v[depth > 0], strict=True):
            if 0 <= column < SIZE[0] and 0 <= row < SIZE[1]:
                assert beside[int(row), int(column)]
    bodies = np.stack([body.centre for body in on_stage(0)])
    assert room.hull.holds(bodies).all()
    assert room.free(np.array([[0.0, 0.0, 2.2], [1.5, 1.5, 1.6]])).all()


@pytest.mark.slow
def test_a_room_with_plain_walls_has_less_fog(floor: Path, tmp_path: Path) -> None:
    found = encode(floor, tmp_path / "room.dgs", "live", holdout=[LEFT_OUT], effects="none")
    # 28.5 dB at this size, against 24.5 without the walls, where seeds differ by up to 2.
    assert found.frames[0].held_out_psnr > 27


def test_a_picture_is_searched_for_a_stage_once(grey: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither the memory of the first frame nor closed segments, which return to it, search again."""
    searched: list[int] = []

    def noted(views: Sequence[View], frame: RigFrame) -> Stage | None:
        searched.append(frame.index)
        return find_stage(views, frame)

    monkeypatch.setattr(first_frame, "find_stage", noted)
    live = preset("live")
    few = replace(live, closed=True, segment=1, keyframe=replace(live.keyframe, iterations=20))
    others = [camera.name for camera in cameras(SIZE)[1::2]]
    encode(grey, tmp_path / "closed.dgs", few, exclude=others, effects="none")
    assert searched == [0]


def test_one_plain_wall_is_no_plain_room(tmp_path: Path) -> None:
    ingest, frame = first_pictures(write_stage("wall", tmp_path / "wall", cameras(SIZE)[::2], frames=1))
    assert find_stage(ingest.views, frame) is None


def test_walls_without_a_floor_that_can_be_found_are_no_room(floor: Path) -> None:
    ingest, frame = first_pictures(floor)
    random = np.random.default_rng(0)
    pictures = []
    for picture in frame.training:
        noisy = picture.copy()
        noisy[:, 70:] = random.random(noisy[:, 70:].shape)
        pictures.append(noisy)
    assert find_stage(ingest.views, replace(frame, training=pictures)) is None


def test_three_views_are_no_stage(grey: Path) -> None:
    """In their hull no view confirms a first point, which the encode needs."""
    for count, is_found in ((3, False), (4, True)):
        allround = [camera.name for camera in cameras(SIZE)][:: 16 // count][:count]
        others = [camera.name for camera in cameras(SIZE) if camera.name not in allround]
        ingest = Ingest(open_rig(grey), holdout=others)
        assert (find_stage(ingest.views, next(iter(ingest.frames(0, 1)))) is not None) == is_found


def test_a_backdrop_that_few_views_see_follows_the_light(grey: Path, tmp_path: Path) -> None:
    """With eight cameras all around, most of the wall is seen by one."""
    dim = Path(shutil.copytree(grey, tmp_path / "dim"))
    calibration = json.loads((dim / "rig.json").read_text())
    calibration["cameras"] = calibration["cameras"][::2]
    (dim / "rig.json").write_text(json.dumps(calibration))
    for before in dim.glob("cam*/0000.png"):
        cv2.imwrite(str(before.with_name("0001.png")), cv2.imread(str(before)) // 2)
    report = encode(dim, tmp_path / "dim.dgs", "live")
    # 30.9, and 29.5 before; 21.7 where each Gaussian that changes must be seen by two.
    assert report.frames[1].training_psnr > report.frames[0].training_psnr - 3


def test_half_a_ring_of_cameras_is_enough_and_a_narrow_arc_is_not(grey: Path) -> None:
    """Too little of a narrow arc's backdrop is seen from two sides."""
    for count, is_found in ((9, True), (6, True), (4, False)):  # of 180, 112 and 68 degrees
        others = [camera.name for camera in cameras(SIZE)[count:]]
        ingest = Ingest(open_rig(grey), holdout=others)
        found = find_stage(ingest.views, next(iter(ingest.frames(0, 1))))
        assert (found is not None) == is_found, count


def test_any_colour_is_plain_and_texture_above_noise_is_not() -> None:
    random = np.random.default_rng(0)
    shade = np.linspace(0.2, 0.7, 80)[:, None, None] * np.ones((80, 100, 3))
    for colour in ((1, 1, 1), (0.1, 0.9, 0.2), (0.02, 0.02, 0.02)):
        picture = shade * colour + random.normal(0, 2 / 255, shade.shape)
        picture[30:50, 40:60] = random.random((20, 20, 3))
        plain = plain_pixels(picture.astype(np.float32))
        assert plain[:20].mean() > 0.8
        assert not plain[32:48, 42:58].any()


def test_what_was_not_recorded_is_plain() -> None:
    """Straightened pictures are 0 there to the last bit, where a window's variance is rounded to less than 0."""
    random = np.random.default_rng(0)
    for _ in range(5):  # which windows do depends on what is beside them
        picture = np.zeros((60, 80, 3), np.float32)
        picture[20:40, 30:50] = random.random((20, 20, 3))
        plain = plain_pixels(picture)
        assert plain[:10].all()
        assert plain[50:].all()
        assert not plain[24:36, 34:46].any()


def test_gains_of_cameras_are_found_on_the_backdrop(grey: Path, stage: PlainStage) -> None:
    ingest, frame = first_pictures(grey)
    gains = np.linspace(-0.08, 0.08, len(ingest.views))
    logit = [np.log(p / (1 - p)) + gain for p, gain in zip(np.clip(frame.training, 0.01, 0.99), gains, strict=True)]
    pictures = [(1 / (1 + np.exp(-values))).astype(np.float32) for values in logit]
    gained = find_stage(ingest.views, replace(frame, training=pictures))
    assert isinstance(gained, PlainStage)
    found = find_colours(ingest.views, pictures, *gained.shared_points())
    exposures = [found[view.camera.name].exposure / 4096 if view.camera.name in found else 0 for view in ingest.views]
    # A hundredth: the step of the noise of 1.2 levels, averaged over hundreds of points, is far below.
    assert np.array(exposures) == pytest.approx(gains - np.median(gains), abs=0.01)


@pytest.mark.slow
def test_no_fog_before_half_a_ring_of_cameras(grey: Path, tmp_path: Path) -> None:
    others = [camera.name for camera in cameras(SIZE)[9:]]
    job = {"holdout": [LEFT_OUT], "exclude": others, "effects": "none", "frames": slice(0, 1)}
    with_stage = encode(grey, tmp_path / "stage.dgs", "live", **job)
    # 32.4 dB at this size, against 20.6 without the stage.
    assert with_stage.frames[0].held_out_psnr > 28


def test_no_fog(grey: Path, tmp_path: Path) -> None:
    """The left-out view is as it was seen, and next to nothing hangs in the free space of either frame."""
    with_stage = encode(grey, tmp_path / "stage.dgs", "live", holdout=[LEFT_OUT], effects="none")
    # 30.9 dB at this size, against 23.8 without the stage.
    assert with_stage.frames[0].held_out_psnr > 27
    ingest = Ingest(open_rig(grey))
    found: Stage | None = None
    with open_stream(tmp_path / "stage.dgs") as stream:
        for decoded, frame in zip(stream.frames(), ingest.frames(0, 2), strict=True):
            found = found or find_stage(ingest.views, frame)
            assert found is not None
            now = found.in_frame(ingest.views, frame, range(len(ingest.views)))
            assert now.free(decoded.splats.means).mean() < 0.005
