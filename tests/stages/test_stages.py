"""The stages that tests encode are what they say: the same every time, with poses and mattes that fit the pictures."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.formats.cameras import project
from decogs.formats.rigs import open_rig, read_frames
from stages.false_points import false_points
from stages.make import light_on_backdrop, look, render, write_stage
from stages.ray import Array, Body, light
from stages.scenes import LAMPS, STAGES, ball, cameras, on_stage

SIZE = (45, 60)
VIEWS = cameras(SIZE)[:4]


@pytest.fixture(scope="module")
def green(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_stage("green", tmp_path_factory.mktemp("stages") / "green", VIEWS, frames=1)


def test_the_same_seed_gives_the_same_files(green: Path, tmp_path: Path) -> None:
    again = write_stage("green", tmp_path / "again", VIEWS[:1], frames=1)
    for file in ("cam00/0000.png", "truth/mattes/cam00/0000.png"):
        assert (green / file).read_bytes() == (again / file).read_bytes()


def test_what_is_outside_the_mattes_is_backdrop_or_stool(green: Path) -> None:
    rig = open_rig(green)
    _, pictures = next(read_frames(rig, 0, 1))
    for camera, picture in zip(rig.cameras, pictures, strict=True):
        matte = cv2.imread(str(green / f"truth/mattes/{camera.name}/0000.png"), cv2.IMREAD_UNCHANGED)
        is_green = picture[..., 1] > 1.2 * picture[..., [0, 2]].max(-1)
        assert is_green[matte == 0].mean() > 0.97, camera.name  # the stool has less than 3 % of a picture
        assert is_green[matte == 255].mean() < 0.03, camera.name  # no paint is green; the noise of dark pixels may be


def test_a_ball_is_where_the_rig_s_cameras_see_it(green: Path) -> None:
    stage, thrown = STAGES["green"], ball(0)
    backdrop = light_on_backdrop(stage, [], SIZE[1])
    for camera, read in zip(VIEWS, open_rig(green).cameras, strict=True):
        _, matte = render(look(camera, stage), [thrown], backdrop)
        rows, columns = np.nonzero(matte)
        share = matte[rows, columns] / matte.sum()
        u, v, _ = project(read, thrown.centre[None])
        # A disc of 2 pixels' radius in samples half a pixel apart: its centroid is off by some hundredths of a pixel.
        assert share @ (columns + 0.5) == pytest.approx(u.item(), abs=0.1)
        assert share @ (rows + 0.5) == pytest.approx(v.item(), abs=0.1)


@pytest.mark.parametrize(("name", "frames"), [("grey", (0, 20, 40)), ("take", range(0, 300, 15))])
def test_performers_are_within_all_pictures(name: str, frames: Sequence[int]) -> None:
    stage = STAGES[name]
    for frame in frames:
        centres = np.stack([body.centre for body in stage.acting(frame, stage.clothes) if body.moves])
        for camera in cameras(SIZE):
            u, v, _ = project(camera, centres)
            assert ((u > 0) & (u < SIZE[0]) & (v > 0) & (v < SIZE[1])).all()


@pytest.mark.parametrize("name", ["grey", "wall"])
def test_rays_end_on_the_backdrop(name: str) -> None:
    for camera in VIEWS:
        view = look(camera, STAGES[name])
        distance, _ = STAGES[name].room(view.origin + view.depth * view.ways)
        assert np.abs(distance).max() < 1e-4  # metres; a float32 of 10 m has steps of 1e-6


def test_rays_enter_bodies_where_steps_along_them_do() -> None:
    body = next(body for body in on_stage(0) if len(set(body.radii.tolist())) > 1 and body.half > 0)
    random = np.random.default_rng(0)
    origins = (body.centre[:, None] + random.normal(0, 1, (3, 300))).astype(np.float32)
    origins = origins[:, _inside(body, origins) > 1]
    ways = (body.centre[:, None] + random.normal(0, 0.2, origins.shape) - origins).astype(np.float32)
    entry = body.entry(origins, ways)
    steps = np.linspace(0, 3, 3001)
    inside = np.stack([_inside(body, origins + np.float32(step) * ways) < 1 for step in steps])
    first = np.where(inside.any(0), steps[inside.argmax(0)], np.inf)
    assert 50 < np.isfinite(first).sum() < len(first) - 50
    same = np.isfinite(entry) == np.isfinite(first)
    assert (~same).sum() <= 3  # rays that graze it for less than a step
    both = np.isfinite(first) & same
    late = first[both] - entry[both]
    assert late.min() > -1e-4  # float32
    assert late.max() < 2e-3  # a step


def test_a_lamp_s_shadow_lies_on_the_floor_behind_a_ball_and_not_beside_it() -> None:
    lamp, thrown = LAMPS[0], ball(0)
    away = thrown.centre - lamp.place
    behind = lamp.place - lamp.place[2] / away[2] * away
    places = np.stack([behind, behind + np.array([0.5, 0, 0])], 1).astype(np.float32)
    up = np.array([[0, 0], [0, 0], [1, 1]], np.float32)
    clear, shadowed = light(places, up, [lamp], []), light(places, up, [lamp], [thrown])
    assert (clear > 0).all()
    assert (shadowed == clear * [0, 1]).all()


@pytest.mark.slow
def test_a_plain_stage_has_fewer_false_first_points(tmp_path: Path) -> None:
    """12 and 7 %; 14 and 8 % without level planes."""
    alone, encoded, is_plain = false_points(write_stage("grey", tmp_path / "grey", cameras((120, 160)), frames=1))
    assert is_plain
    assert 0 < encoded < 0.7 * alone


def _inside(body: Body, points: Array) -> Array:
    """Distance from its axis, 1 on the surface."""
    place = body.own(points) / body.radii[:, None]
    place[2] -= np.clip(place[2], -body.half, body.half)
    return np.sqrt((place * place).sum(0))
