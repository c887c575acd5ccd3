"""What the analysis says of plain stages: backdrop, subject, cameras, shadows, a key, and how views will look."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.encoder.analysis.analyse import Analysis, analyse
from decogs.formats.cameras import camera_centre
from decogs.rig.check.rig_check import ROUGH, WRONG
from decogs.rig.check.stage_check import RoomCheck, StageCheck
from stages import scenes
from stages.make import write_stage
from stages.ray import Paint

VIEWS = scenes.cameras((120, 160))
STAGES = {
    "grey": scenes.STAGES["grey"],
    "exposure": scenes.STAGES["exposure"],
    "floor": scenes.STAGES["floor"],
    "green": scenes.STAGES["green"],
    "worn": replace(
        scenes.STAGES["green"], clothes=(Paint((0.03, 0.2, 0.05), (0.02, 0.12, 0.03), "checks", 0.07),) * 2
    ),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    folder = tmp_path_factory.mktemp("stages")

    def stage(name: str) -> Path:
        if not (folder / name).is_dir():
            with pytest.MonkeyPatch.context() as patched:
                patched.setitem(scenes.STAGES, name, STAGES[name])
                write_stage(name, folder / name, VIEWS, frames=1)
        return folder / name

    return stage


@pytest.fixture(scope="module")
def analysed(made: Callable[[str], Path]) -> Callable[[str], Analysis]:
    return cache(lambda name: analyse(made(name)))


@pytest.fixture(scope="module")
def grey(analysed: Callable[[str], Analysis]) -> Analysis:
    return analysed("grey")


def mismatch_of(analysis: Analysis) -> Any:
    return next(finding for finding in analysis.findings if finding.decision.effect == "colour_mismatch")


@pytest.mark.parametrize("name", ["grey", pytest.param("floor", marks=pytest.mark.slow)])
def test_cameras_alike_are_not_told_apart(analysed: Callable[[str], Analysis], name: str) -> None:
    """On the floor of tiles matches are wrong by a tile, where the light is another."""
    assert not mismatch_of(analysed(name)).decision.detected


def test_the_backdrop_tells_the_gains_of_cameras(analysed: Callable[[str], Analysis]) -> None:
    found = analysed("exposure").stats.mismatch.gains
    true = np.log(1 + 0.08 * np.random.default_rng(0).uniform(-1, 1, len(VIEWS)))
    # Half a per cent: 1.2 levels of noise in windows of 25 pixels, the median of hundreds; the surfaces' own errors.
    np.testing.assert_allclose(found[:, 0], true - np.median(true), atol=0.006)
    np.testing.assert_allclose(found[:, 1:], 0, atol=0.006)
    assert mismatch_of(analysed("exposure")).decision.detected


def test_a_stage_is_told_as_it_is(grey: Analysis, made: Callable[[str], Path]) -> None:
    stage = grey.stage
    assert isinstance(stage, StageCheck)
    assert np.ptp(stage.colour) <= 4, "grey"
    assert stage.key is None
    heights = [camera_centre(camera)[2] for camera in VIEWS]
    assert stage.floor == pytest.approx(np.median(heights), abs=0.06)  # two pixels there
    assert stage.subject.keys() == {camera.name for camera in VIEWS}
    mattes = [cv2.imread(str(made("grey") / f"truth/mattes/{name}/0000.png"), 0) / 255 for name in stage.subject]
    # The stool has a per cent and no matte, a margin of 2 pixels closes gaps; shadows would add ten.
    assert 0 < np.median(list(stage.subject.values())) - np.median([matte.mean() for matte in mattes]) < 0.06
    around = np.sort([np.degrees(np.arctan2(*camera_centre(camera)[1::-1])) for camera in VIEWS])
    assert stage.gap == pytest.approx(np.diff(around, append=around[0] + 360).max(), abs=1)
    # Under the feet, where no lamp reaches, a third of the light is left; a blur of 3 pixels lifts it.
    assert 0.3 < stage.shadow < 0.8


def test_a_room_with_plain_walls_is_told_as_it_is(analysed: Callable[[str], Analysis], grey: Analysis) -> None:
    analysis = analysed("floor")
    room = analysis.stage
    assert isinstance(room, RoomCheck)
    heights = [camera_centre(camera)[2] for camera in VIEWS]
    assert room.floor == pytest.approx(np.median(heights), abs=0.08)  # a pixel has 8 cm there
    # Light falls off as much on walls a tenth farther out.
    assert room.wall == pytest.approx(scenes.ROOMS[scenes.cyclorama]["wall_radius"], rel=0.1)
    assert 0.3 < room.plain < 0.5
    assert isinstance(grey.stage, StageCheck)
    assert (room.gap, room.gap_cameras) == (pytest.approx(grey.stage.gap, abs=1), grey.stage.gap_cameras)
    written = analysis.to_json()
    assert written["stage"] is None
    assert written["room"]["floor"] == pytest.approx(room.floor, rel=1e-3)


@pytest.mark.parametrize(("name", "is_clean"), [("green", True), ("worn", False)])
def test_a_key_is_clean_unless_the_screen_s_colour_is_worn(
    analysed: Callable[[str], Analysis], name: str, is_clean: bool
) -> None:
    stage = analysed(name).stage
    assert isinstance(stage, StageCheck)
    assert stage.key is not None
    assert stage.key.is_clean == is_clean
    assert (": clean" in "".join(stage.table())) == is_clean


@pytest.mark.parametrize(("every", "expected"), [(1, ROUGH), (2, WRONG)])
def test_views_are_promised_by_how_far_the_cameras_stand_apart(
    made: Callable[[str], Path], every: int, expected: str
) -> None:
    """Where no camera stood: 34 dB of 16 cameras 22 degrees apart, 17 of every other one (240x320, `standard`)."""
    left_out = [view.name for index, view in enumerate(VIEWS) if index % every]
    check = analyse(made("grey"), holdout=left_out).check
    assert check.expected == expected
    assert all(camera.seen_by_one > 0.5 for camera in check.cameras)
    assert np.median([camera.gap for camera in check.cameras]) == pytest.approx(22.5 * every, rel=0.2)
    assert not any(camera.misplaced for camera in check.cameras)
