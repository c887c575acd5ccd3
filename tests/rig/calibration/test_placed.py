"""The world that cameras are written in: its unit, and which way is up."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from board_videos import write_board_videos
from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.errors import RigError, UsageError
from decogs.rig.calibration.footage import check_copies, open_footage, unequal_lengths
from decogs.rig.calibration.page import page_of
from decogs.rig.calibration.placed import (
    Calibration,
    Distance,
    Edge,
    Placed,
    normalise_scale,
    parse_distance,
    rotate_up,
    scale_to_distance,
)

ANYTHING: Any = None
QUARTERS: dict[Edge, int] = {"top": 0, "left": 1, "bottom": 2, "right": 3}


def ring(edge: Edge = "top") -> Calibration:
    """Four cameras around a place, level, held so that ``edge`` of their pictures is on top."""
    roll = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    placed = []
    for number, angle in enumerate(np.radians([0, 90, 180, 270])):
        forward = np.array([np.sin(angle), 0, np.cos(angle)])
        level = np.stack([np.cross([0, 1.0, 0], forward), [0, 1.0, 0], forward])
        pose = np.eye(4)
        pose[:3, :3] = np.linalg.matrix_power(roll, QUARTERS[edge]) @ level
        pose[:3, 3] = [0, 0, 2.0]
        placed.append(Placed(Camera(f"cam{number}", 64, 48, 50, 50, 32, 24, pose), 0.2, ANYTHING))
    return Calibration(tuple(placed), {}, "board", "", points=np.array([[0.0, -1, 0]]))


@pytest.mark.parametrize("edge", QUARTERS)
def test_up_is_where_the_pictures_have_the_edge_that_is_told(edge: Edge) -> None:
    found = rotate_up(ring(edge), edge)
    for one in found.placed:
        across, down = one.camera.world_to_camera[0, :3], one.camera.world_to_camera[1, :3]
        up = {"top": -down, "bottom": down, "left": -across, "right": across}[edge]
        np.testing.assert_allclose(up, [0, -1, 0], atol=1e-9)
    np.testing.assert_allclose(found.points, [[0, -1, 0]], atol=1e-9)


def test_the_unit_is_the_mean_distance_of_two_cameras_or_the_metre() -> None:
    centres = np.array([camera_centre(one.camera) for one in normalise_scale(ring()).placed])
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=2)[np.triu_indices(4, 1)]
    assert distances.mean() == pytest.approx(1)
    found = scale_to_distance(ring(), Distance("cam0", "cam2", 3.0))
    assert found.length_unit == "metre"
    one, two = (camera_centre(found.placed[number].camera) for number in (0, 2))
    assert np.linalg.norm(one - two) == pytest.approx(3)


def test_nothing_placed_has_no_unit() -> None:
    assert normalise_scale(replace(ring(), placed=())).placed == ()


@pytest.mark.parametrize("text", ["a:b", "a:b:0", "a:b:x", "a:a:1", ":b:1", "a:b:nan", "a:b:1350", "a:b:1e-9"])
def test_a_distance_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="`distance`"):
        parse_distance(text)
    assert parse_distance("C:1:b:2.5") == Distance("C:1", "b", 2.5)


def test_a_distance_from_a_camera_that_is_not_placed_is_refused() -> None:
    with pytest.raises(UsageError, match="from cam9: there are cam0, cam1, cam2, cam3"):
        scale_to_distance(ring(), Distance("cam9", "cam0", 1.0))


def test_cameras_in_one_place_have_no_distance() -> None:
    one = ring().placed[0]
    found = replace(ring(), placed=(one, replace(one, camera=replace(one.camera, name="twin"))))
    with pytest.raises(UsageError, match="from cam0 to twin: they stand in one place"):
        scale_to_distance(found, Distance("cam0", "twin", 1.0))


def test_a_video_that_is_there_twice_is_named(tmp_path: Path) -> None:
    write_board_videos(tmp_path, frames=2)
    check_copies(open_footage(tmp_path))
    for file in (tmp_path / "a").iterdir():
        (tmp_path / "b" / file.name).write_bytes(file.read_bytes())
    with pytest.raises(RigError, match="a and b show the same pictures"):
        check_copies(open_footage(tmp_path))


def test_a_video_of_less_than_half_the_frames_of_another_is_named(tmp_path: Path) -> None:
    write_board_videos(tmp_path, frames=4)
    for last in range(2, 4):
        (tmp_path / "b" / f"{last:04d}.png").unlink()
    assert not list(unequal_lengths(open_footage(tmp_path)))
    (tmp_path / "b" / "0001.png").unlink()
    assert [said.split(":")[0] for said in unequal_lengths(open_footage(tmp_path))] == ["b has 1 frames, a has 4"]


def test_the_page_shows_every_camera_twice_and_what_is_not_connected(tmp_path: Path) -> None:
    write_board_videos(tmp_path, frames=2)
    footage = open_footage(tmp_path)[0]
    found = replace(
        ring(),
        placed=tuple(replace(one, footage=footage) for one in ring().placed),
        not_connected={"cam<9>": "sees nothing"},
        links={("cam0", "cam1"): 12, ("cam2", "cam1"): 30, ("cam1", "cam3"): 20, ("cam1", "cam9"): 50},
    )
    page = page_of(found, "rig")
    assert page.count("<polygon") == 8
    assert page.count("<line") == 2 * 3, "of what is placed"
    assert "<td>cam1 (12)</td>" in page
    assert "<td>cam2 (30), cam3 (20), cam0 (12)</td>" in page
    assert "cam&lt;9&gt;: sees nothing" in page
    green, orange = page.count("#2e7d32"), page.count("#b26a00")
    assert green > 0 == orange
    doubted = page_of(replace(found, doubts={"cam1": "sees little"}), "rig")
    assert (doubted.count("#2e7d32"), doubted.count("#b26a00")) == (green * 3 // 4, green // 4)
    assert "cam1: sees little" in doubted
