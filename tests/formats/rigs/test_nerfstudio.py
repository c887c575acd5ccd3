"""transforms.json as it comes: which entries are frames of one camera, paths of other systems, lenses, masks."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.formats.errors import RigError
from decogs.formats.rigs import Rig, nerfstudio, open_rig, read_frames

NAMES = ["cam00", "cam01", "cam02"]
Entries = list[tuple[int, str, dict[str, Any]]]


def write(folder: Path, make: Any, paths: Entries, **fields: Any) -> Path:
    """transforms.json of (camera, file_path, more fields)."""
    values = make.transforms_values([path for _, path, _ in paths], indices=[index for index, _, _ in paths]) | fields
    for frame, (_, _, more) in zip(values["frames"], paths, strict=True):
        frame |= more
    (folder / "transforms.json").write_text(json.dumps(values))
    return folder


def pictures(folder: Path, make: Any, path: str, frames: int = 3) -> None:
    """``path`` with {camera} and {frame}, in three cameras' pictures."""
    for name in NAMES:
        make.pictures(folder / "made", frames=frames)
        for k in range(frames):
            file = folder / path.format(camera=name, number=name[3:], frame=k)
            file.parent.mkdir(parents=True, exist_ok=True)
            (folder / "made" / f"{k:04d}.png").rename(file)
    (folder / "made").rmdir()


def check(rig: Rig, make: Any, names: list[str] = NAMES, frames: int = 3) -> None:
    assert [camera.name for camera in rig.cameras] == names
    for i, camera in enumerate(rig.cameras):
        expected = np.linalg.inv(make.camera_to_world(i))
        np.testing.assert_allclose(camera.world_to_camera, expected, atol=1e-8)  # the noise of some
    assert rig.frame_count == frames
    for index, seen in read_frames(rig):
        for picture in seen:
            assert (picture == np.array([40, 30, 20]) + 20 * index).all()


# --- entries of one camera ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("timed", [lambda k: {"time": k / 2}, lambda k: {"time": 1.7e9 + k / 30}, lambda k: {}])
@pytest.mark.parametrize(
    ("path", "names"),
    [
        ("{camera}/{frame:04d}.png", NAMES),
        ("{camera}/images/{frame}.png", NAMES),
        ("images/{camera}_{frame:04d}.png", NAMES),
        ("images/{camera}-{frame}.png", NAMES),
        ("{camera}_{frame:04d}.png", NAMES),
        ("images/{frame:04d}/{camera}.png", NAMES),
        ("{frame}/images/{camera}.png", NAMES),
        ("images/{frame:04d}/{camera}_{frame:04d}.png", NAMES),
        ("time{frame}/{camera}/rgb.png", NAMES),
        ("images/{number}.{frame}.png", ["00", "01", "02"]),
    ],
)
def test_pictures_of_one_pose_are_the_frames_of_a_camera(
    tmp_path: Path, make: Any, path: str, names: list[str], timed: Callable[[int], dict[str, float]]
) -> None:
    pictures(tmp_path, make, path)
    entries = [
        (i, path.format(camera=name, number=name[3:], frame=k), timed(k))
        for k in (2, 0, 1)  # in any order
        for i, name in enumerate(NAMES)
    ]
    check(open_rig(write(tmp_path, make, entries)), make, names)


def test_cameras_that_no_name_tells_apart_are_numbered(tmp_path: Path, make: Any) -> None:
    make.pictures(tmp_path / "images", frames=9)
    entries = [(k % 3, f"images/{k:04d}.png", {"time": k // 3}) for k in range(9)]
    rig = open_rig(write(tmp_path, make, entries))
    assert ([camera.name for camera in rig.cameras], rig.frame_count) == (NAMES, 3)


def test_poses_that_differ_by_rounding_are_one(tmp_path: Path, make: Any) -> None:
    random = np.random.default_rng(5)
    path = "images/{frame:04d}/{camera}.png"
    pictures(tmp_path, make, path)
    entries: Entries = [(i, path.format(camera=name, frame=k), {}) for k in range(3) for i, name in enumerate(NAMES)]
    values = json.loads((write(tmp_path, make, entries) / "transforms.json").read_text())
    for k, frame in enumerate(values["frames"]):
        pose = np.array(frame["transform_matrix"])
        pose[:3] += random.uniform(-1e-9, 1e-9, (3, 4)) * (k > 2)
        pose[pose == 0] = -0.0 if k % 2 else 0.0
        frame["transform_matrix"] = pose.tolist()
        frame["time"] = k // 3 or (-0.0 if k else 0.0)
        frame["fl_x"] = 60 + 1e-9 * k
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    check(open_rig(tmp_path), make)


def test_parallel_cameras_far_from_the_origin_are_several(tmp_path: Path, make: Any) -> None:
    """As in survey coordinates: 20 cm apart, 4000 km off."""
    make.pictures(tmp_path / "images", frames=3)
    values = make.transforms_values([f"images/{k:04d}.png" for k in range(3)])
    for k, frame in enumerate(values["frames"]):
        frame["transform_matrix"] = [[1, 0, 0, 4e6 + 0.2 * k], [0, 1, 0, 5e5], [0, 0, 1, 100], [0, 0, 0, 1]]
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    assert len(open_rig(tmp_path).cameras) == 3


def test_cameras_out_of_step_are_refused(tmp_path: Path, make: Any) -> None:
    path = "images/{camera}_{frame:04d}.png"
    pictures(tmp_path, make, path)
    entries = [(i, path.format(camera=n, frame=k), {"time": k / 2}) for i, n in enumerate(NAMES) for k in range(3)]
    for change, pattern in (
        ({"time": 0.25}, "camera cam00 has no picture of the time 0.25, but others have; give all the same frames"),
        ({"time": 0.0}, "camera cam01 has no picture of the time 0.5, but others have; give all the same frames"),
    ):
        changed = [(i, p, more | (change if p == "images/cam01_0001.png" else {})) for i, p, more in entries]
        with pytest.raises(RigError, match=pattern):
            open_rig(write(tmp_path, make, changed))
    again = [*entries, *((i, path.format(camera="again", frame=i), {"time": 0.5}) for i in range(3))]
    pictures(tmp_path, make, "images/again_{number}.png", frames=1)
    for i in range(3):
        (tmp_path / f"images/again_{i:02d}.png").rename(tmp_path / f"images/again_{i:04d}.png")
    with pytest.raises(RigError, match=r"camera cam\d\d has several pictures of the time 0\.5; keep one"):
        open_rig(write(tmp_path, make, again))


@pytest.mark.parametrize("path", ["{k:04d}/{i:04d}.png", "frames/{k:02d}/images/{i:02d}.png"])
def test_instants_that_are_called_as_cameras_are(tmp_path: Path, make: Any, path: str) -> None:
    paths = {(i, k): path.format(i=i, k=k) for i in range(3) for k in range(3)}
    make.pictures(tmp_path / "made", frames=3)
    for (_, k), name in paths.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(tmp_path / f"made/{k:04d}.png", tmp_path / name)
    rig = open_rig(write(tmp_path, make, [(i, name, {}) for (i, _), name in paths.items()]))
    check(rig, make, [Path(paths[i, 0]).stem for i in range(3)])


def test_a_folder_per_instant_where_one_camera_lacks_an_instant(tmp_path: Path, make: Any) -> None:
    path = "images/{frame:04d}/{camera}.png"
    pictures(tmp_path, make, path)
    entries: Entries = [(i, path.format(camera=n, frame=k), {}) for i, n in enumerate(NAMES) for k in range(3)]
    lacking = ["images/0000/cam00.png", "images/0002/cam01.png", "images/0000/cam02.png"]
    with pytest.raises(RigError, match=r"camera cam00 has no picture of .*images/0000, but others have; give all"):
        open_rig(write(tmp_path, make, [entry for entry in entries if entry[1] not in lacking]))


def test_folders_that_are_instants_and_cameras(tmp_path: Path, make: Any) -> None:
    path = "time{frame}/{camera}/left/rgb.png"
    pictures(tmp_path, make, path)
    entries: Entries = [(i, path.format(camera=n, frame=k), {}) for i, n in enumerate(NAMES) for k in range(3)]
    check(open_rig(write(tmp_path, make, entries)), make)  # numbered


@pytest.mark.parametrize("key", ["fl_x", "cy", "k1", "k6", "camera_angle_x"])
def test_a_lens_that_changes_is_refused(tmp_path: Path, make: Any, key: str) -> None:
    path = "{camera}/{frame}.png"
    pictures(tmp_path, make, path)
    entries: Entries = [
        (i, path.format(camera=n, frame=k), {key: 1.5} if n == "cam01" and k == 2 else {})
        for i, n in enumerate(NAMES)
        for k in range(3)
    ]
    with pytest.raises(RigError, match=rf"frames\[5\]: '{key}' is not what camera cam01 has in its first picture"):
        open_rig(write(tmp_path, make, entries))


def test_a_file_listed_twice(tmp_path: Path, make: Any) -> None:
    make.video(tmp_path / "cam00.mp4")
    with pytest.raises(RigError, match=r"frames\[1\]: .*cam00\.mp4 is listed twice; remove one"):
        open_rig(write(tmp_path, make, [(0, "cam00.mp4", {}), (1, "./cam00.mp4", {})]))


def test_endless_poses_are_of_a_moving_camera(tmp_path: Path, make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(nerfstudio, "_MAX_POSES", 8)
    (tmp_path / "images").mkdir()
    values = make.transforms_values([f"images/{k}.png" for k in range(10)], indices=[0] * 10)
    for k, frame in enumerate(values["frames"]):
        (tmp_path / frame["file_path"]).touch()
        frame["transform_matrix"] = [[1, 0, 0, k], [0, 1, 0, 0], [0, 0, 1, 0]]
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    with pytest.raises(RigError, match=r"frames\[8\]: more than 8 poses, as of a moving camera; a rig needs fixed"):
        open_rig(tmp_path)


# --- paths ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", ["images\\{}.png", ".\\images\\{}.png", "images\\{}", "a\\..\\images\\{}.png"])
def test_paths_as_windows_spells_them(tmp_path: Path, make: Any, path: str) -> None:
    pictures(tmp_path, make, "images/{camera}.png", frames=1)
    (tmp_path / "a").mkdir()
    check(open_rig(write(tmp_path, make, [(i, path.format(n), {}) for i, n in enumerate(NAMES)])), make, frames=1)


@pytest.mark.parametrize("path", ["C:\\rig\\cam00.png", "d:/rig/cam00.png", "\\\\server\\share\\rig\\cam00.png"])
def test_places_on_a_windows_machine_are_named_as_such(tmp_path: Path, make: Any, path: str) -> None:
    with pytest.raises(RigError, match=r"frames\[0\]: 'file_path' is .*, a place on a Windows machine .*; correct"):
        open_rig(write(tmp_path, make, [(0, path, {})]))


@pytest.mark.skipif(os.name == "nt", reason="a backslash separates folders there")
def test_a_backslash_in_a_name_that_exists(tmp_path: Path, make: Any) -> None:
    pictures(tmp_path, make, "left\\{camera} 100%.png", frames=1)
    entries: Entries = [(i, f"left\\{name} 100%.png", {}) for i, name in enumerate(NAMES)]
    # No name for a camera, but found.
    with pytest.raises(RigError, match="no usable camera name"):
        open_rig(write(tmp_path, make, entries))


# --- lenses ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", ["SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV"])
def test_coefficients_count_whatever_the_model_is_called(tmp_path: Path, make: Any, model: str) -> None:
    camera = open_rig(make.nerfstudio(tmp_path, {**entries_of_videos(make), "camera_model": model})).cameras[0]
    assert (camera.distortion_model, camera.distortion) == ("opencv", (0.1, -0.02, 0.003, -0.004, 0.0))


@pytest.mark.parametrize(
    ("change", "last"),
    [
        ({"k3": 0.01, "k4": 0.02, "k5": 0.03, "k6": 0.04}, (0.01, 0.02, 0.03, 0.04)),
        ({"k5": 0.03}, (0.0, 0.0, 0.03, 0.0)),
        ({"camera_model": "FULL_OPENCV", "k4": 0.02}, (0.0, 0.02, 0.0, 0.0)),
        ({"camera_model": "PINHOLE", "k6": 0.04}, (0.0, 0.0, 0.0, 0.04)),
    ],
)
def test_the_rational_lens(tmp_path: Path, make: Any, change: dict[str, Any], last: tuple[float, ...]) -> None:
    camera = open_rig(make.nerfstudio(tmp_path, entries_of_videos(make) | change)).cameras[0]
    assert (camera.distortion_model, camera.distortion) == ("opencv", (0.1, -0.02, 0.003, -0.004, *last))


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        ({"camera_model": "OPENCV_FISHEYE"}, "'p1' is no coefficient of OPENCV_FISHEYE, which has k1 to k4"),
        ({"camera_model": "FISHEYE", "p1": 0, "p2": 0, "k5": 0.1}, "'k5' is no coefficient of FISHEYE"),
        ({"is_fisheye": True, "camera_model": "PINHOLE"}, "'is_fisheye' is true, but 'camera_model' is 'PINHOLE'"),
        ({"ftheta_p0": 0.0}, "'ftheta_p0' is set, which is not supported; undistort"),
        ({"equirectangular": True}, "'equirectangular' is set, which is not supported; undistort"),
        ({"k4": 0.1}, "'k4' is a fourth radial coefficient"),
        ({"distortion_params": [0.1, 0, 0, 0, 0, 0]}, "'distortion_params' is not read; known are k1, k2"),
        ({"s1": 0.1}, "'s1' is not read; known are k1, k2"),
        ({"skew": 0.1}, "'skew' is not read; known are k1, k2"),
    ],
)
def test_lens_fields_are_not_dropped(tmp_path: Path, make: Any, change: dict[str, Any], pattern: str) -> None:
    with pytest.raises(RigError, match=pattern):
        open_rig(make.nerfstudio(tmp_path, entries_of_videos(make) | change))


def test_lens_fields_of_zero_bend_nothing(tmp_path: Path, make: Any) -> None:
    zeros = {"distortion_params": [0, 0, 0, 0, 0, 0], "s1": 0, "skew": 0.0}
    assert open_rig(make.nerfstudio(tmp_path, entries_of_videos(make) | zeros)).cameras[0].distortion[0] == 0.1


@pytest.mark.parametrize(
    "model", ["OPENCV_FISHEYE", "SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE"]
)
def test_fisheye_models(tmp_path: Path, make: Any, model: str) -> None:
    values = entries_of_videos(make) | {"camera_model": model, "p1": 0, "p2": 0}
    camera = open_rig(make.nerfstudio(tmp_path, values)).cameras[0]
    assert (camera.distortion_model, camera.distortion) == ("fisheye", (0.1, -0.02, 0, 0))


def entries_of_videos(make: Any) -> dict[str, Any]:
    values: dict[str, Any] = make.transforms_values([f"{name}.mp4" for name in NAMES])
    return values


# --- masks ----------------------------------------------------------------------------------------------------------


def test_masks_are_listed_by_camera_and_a_crop_is_said(tmp_path: Path, make: Any) -> None:
    values = entries_of_videos(make)
    rig = open_rig(make.nerfstudio(tmp_path, values | {"mask_path": None}))
    assert (rig.warnings, rig.ignore_masks) == ((), {})
    values["frames"][1]["mask_path"] = "masks/cam01.png"
    values["fisheye_crop_radius"] = 20.0
    rig = open_rig(make.nerfstudio(tmp_path, values))
    (warning,) = rig.warnings
    assert "transforms.json: fisheye_crop_radius is not used" in warning
    assert rig.ignore_masks == {"cam01": (tmp_path / "masks/cam01.png",)}
    rig = open_rig(make.nerfstudio(tmp_path, entries_of_videos(make) | {"mask_path": "mask.png"}))
    assert rig.ignore_masks == {camera.name: (tmp_path / "mask.png",) for camera in rig.cameras}
