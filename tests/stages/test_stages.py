"""The stages that tests encode are what they say: the same every time, with poses and mattes that fit the pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.formats.cameras import project
from decogs.formats.rigs import open_rig, read_frames
from stages.make import light_on_backdrop, look, render, write_stage
from stages.scenes import STAGES, ball, cameras, on_stage

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


def test_performers_are_within_all_pictures() -> None:
    for frame in (0, 20, 40):
        centres = np.stack([body.centre for body in on_stage(frame) if body.moves])
        for camera in cameras(SIZE):
            u, v, _ = project(camera, centres)
            assert ((u > 0) & (u < SIZE[0]) & (v > 0) & (v < SIZE[1])).all()


@pytest.mark.parametrize("name", ["grey", "wall"])
def test_rays_end_on_the_backdrop(name: str) -> None:
    for camera in VIEWS:
        view = look(camera, STAGES[name])
        distance, _ = STAGES[name].room(view.origin + view.depth * view.ways)
        assert np.abs(distance).max() < 1e-4  # metres; a float32 of 10 m has steps of 1e-6
