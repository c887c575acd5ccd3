"""Pose files: the three ways to give a pose agree, camera paths, and one clear line for everything else."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.decoder.cameras.path import CameraPath, shown_frames
from decogs.decoder.cameras.pose_file import read_free_cameras
from decogs.formats.cameras import camera_centre
from decogs.formats.errors import UsageError

LENS: dict[str, Any] = {"width": 640, "height": 360, "fx": 500.0}
LOOK: dict[str, Any] = {"position": [1, 2, 3], "look_at": [1, 2, 8], "up": [0, -1, 0]}


def read_path(folder: Path, content: Any) -> CameraPath:
    path = folder / "pose.json"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return read_free_cameras(path)


def read(folder: Path, content: Any) -> Any:
    return read_path(folder, content).cameras


def test_looking_along_z_with_y_down_is_the_identity_rotation(tmp_path: Path) -> None:
    (camera,) = read(tmp_path, LENS | LOOK)
    expected = np.eye(4)
    expected[:3, 3] = [-1, -2, -3]
    np.testing.assert_array_equal(camera.world_to_camera, expected)
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (500.0, 500.0, 320.0, 180.0)
    assert camera.distortion_model == "none"


def test_target_is_in_the_centre_and_up_is_up(tmp_path: Path) -> None:
    pose = {"position": [2, -1, 0.5], "look_at": [-3, 4, 2], "up": [0.1, 0.2, 1]}
    (camera,) = read(tmp_path, LENS | pose)
    rotation = camera.world_to_camera[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)
    np.testing.assert_allclose(camera_centre(camera), [2, -1, 0.5], atol=1e-12)
    target = camera.world_to_camera @ [-3, 4, 2, 1]
    np.testing.assert_allclose(target[:2], 0, atol=1e-12)
    assert target[2] == pytest.approx(np.linalg.norm([5, 5, 1.5]))
    above = rotation @ [0.1, 0.2, 1]
    assert above[0] == pytest.approx(0, abs=1e-12)
    assert above[1] < 0


def test_three_ways_to_give_a_pose_agree(tmp_path: Path) -> None:
    (looked,) = read(tmp_path, LENS | {"position": [2, -1, 0.5], "look_at": [-3, 4, 2], "up": [0, 0, 1]})
    (by_world,) = read(tmp_path, LENS | {"world_to_camera": looked.world_to_camera.tolist()})
    (by_camera,) = read(tmp_path, LENS | {"camera_to_world": np.linalg.inv(looked.world_to_camera).tolist()})
    np.testing.assert_allclose(by_world.world_to_camera, looked.world_to_camera, atol=1e-12)
    np.testing.assert_allclose(by_camera.world_to_camera, looked.world_to_camera, atol=1e-12)


def test_field_of_view_is_vertical_and_in_degrees(tmp_path: Path) -> None:
    (camera,) = read(tmp_path, {"width": 640, "height": 360, "fov_y": 90} | LOOK)
    assert (camera.fx, camera.fy) == pytest.approx((180.0, 180.0))


def test_a_near_plane_is_read_and_is_0_without_one(tmp_path: Path) -> None:
    for given, near in (({}, 0.0), ({"near": 0.25}, 0.25)):
        (camera,) = read(tmp_path, LENS | LOOK | given)
        assert camera.near == near


def test_a_list_is_a_camera_path(tmp_path: Path) -> None:
    path = [LENS | LOOK | {"position": [t, 0, 0]} for t in range(3)]
    cameras = read(tmp_path, path)
    np.testing.assert_allclose([camera_centre(c)[0] for c in cameras], [0, 1, 2], atol=1e-12)


def test_entries_may_have_times_and_show_the_nearest_frame(tmp_path: Path) -> None:
    times = [2, 2, 0.4, 0.5, 0.6, 1.49]
    path = read_path(tmp_path, [LENS | LOOK | {"frame": time} for time in times])
    assert path.times == tuple(times)
    assert shown_frames(path, 3) == [2, 2, 0, 1, 1, 1]
    assert read_path(tmp_path, [LENS | LOOK]).times is None


def test_a_time_outside_the_stream_is_named(tmp_path: Path) -> None:
    path = read_path(tmp_path, [LENS | LOOK | {"frame": time} for time in (0, 2.5)])
    with pytest.raises(UsageError, match=r"pose.json: camera 1 shows frame 2\.5, and the stream has frames 0 to 2"):
        shown_frames(path, 3)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("{", "not valid JSON"),
        ("[" * 100_000, "not valid JSON"),
        ([], "empty"),
        (3, "must be a JSON object"),
        (LENS, "pose in one way"),
        (LENS | LOOK | {"world_to_camera": np.eye(4).tolist()}, "pose in one way"),
        (LENS | {"position": [0, 0, 0]}, "pose in one way"),
        (LENS | LOOK | {"fovy": 40}, "unknown field 'fovy'"),
        (LENS | LOOK | {"fov_y": 40}, "either fx"),
        ({"width": 64, "height": 64} | LOOK, "either fx"),
        ({"width": 64, "height": 64, "fov_y": 180} | LOOK, "between 1e-06 and 180"),
        (LENS | LOOK | {"fx": -1}, "above 0"),
        (LENS | LOOK | {"fy": 0}, "above 0"),
        (LENS | LOOK | {"near": -0.1}, "near is -0.1"),
        (LENS | LOOK | {"width": 0}, "whole number of pixels"),
        (LENS | LOOK | {"width": 6.5}, "whole number of pixels"),
        (LENS | LOOK | {"width": True}, "width must be a number"),
        (LENS | LOOK | {"width": "640"}, "width must be a number"),
        ({"fx": 5} | LOOK, "width is missing"),
        (LENS | LOOK | {"position": [0, 0]}, "position must be 3 numbers"),
        (LENS | LOOK | {"position": [0, [0], 0]}, "position must be 3 numbers"),
        (LENS | LOOK | {"position": [0, 0, float("nan")]}, "finite"),
        (LENS | LOOK | {"look_at": [1, 2, 3]}, "must differ from position"),
        (LENS | LOOK | {"up": [0, 0, 2]}, "line of sight"),
        (LENS | LOOK | {"up": [0, 0, 0]}, "line of sight"),
        ({"width": 64, "height": 36, "fov_y": 1e-323} | LOOK, "fov_y is 9.88131e-324 degrees"),
        ({"width": 64, "height": 36, "fov_y": 1e-310} | LOOK, "fov_y is 1e-310 degrees"),
        (LENS | {"world_to_camera": (2 * np.eye(4)).tolist()}, "last row"),
        (LENS | {"world_to_camera": np.diag([1, 1, -1, 1]).tolist()}, "not rigid"),
        (LENS | {"world_to_camera": np.diag([1, 2, 1, 1]).tolist()}, "not rigid"),
        (LENS | {"camera_to_world": np.eye(3).tolist()}, "4 by 4 numbers"),
        ([LENS | LOOK, LENS | LOOK | {"width": 32}], "one size"),
        ([LENS | LOOK | {"frame": 1}, LENS | LOOK], "camera 1: has no frame"),
        ([LENS | LOOK | {"frame": -1}], "camera 0: frame is -1"),
        ([LENS | LOOK | {"frame": "1"}], "frame must be a number"),
        ([LENS | LOOK, LENS], "camera 1: give the pose"),
    ],
)
def test_what_is_wrong_is_said_in_one_line(tmp_path: Path, content: Any, message: str) -> None:
    with pytest.raises(UsageError, match=message) as caught:
        read(tmp_path, content)
    assert "pose.json" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_field_that_is_named_twice_is_refused(tmp_path: Path) -> None:
    (tmp_path / "pose.json").write_text('{"width": 640, "height": 360, "width": 64}')
    with pytest.raises(UsageError, match=r"pose\.json: is not valid JSON \(it names the field 'width' twice\)"):
        read_free_cameras(tmp_path / "pose.json")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"none\.json: cannot be read"):
        read_free_cameras(tmp_path / "none.json")
