"""The layouts of data sets and other programs: one rig, written in each as its makers define it, comes out the same."""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from decogs.formats.cameras import Camera
from decogs.formats.errors import RigError
from decogs.formats.rigs import files_of, open_rig, read_frames
from rig_layouts import (
    CASES,
    FRAMES,
    LayoutCase,
    camera_to_world,
    cameras,
    picture,
    write_aniposelib,
    write_easyvolcap,
    write_pictures,
)

WORLD_POINTS = np.array([[0.3, 0.1, 0.5], [0.1, 0.2, 0.3], [-0.2, 0.0, 0.1]])
OF_COLMAP = ("multipleview", "colmap4d", "frame folders")
"""Layouts around COLMAP models, whose lens here, OPENCV, has no k3."""
IDS = [f"{case.layout}-{case.write.__name__}" for case in CASES]
each_layout = pytest.mark.parametrize("case", CASES, ids=IDS)


def pixels(camera: Camera) -> np.ndarray:
    """Pixels of the world points, (P, 2), by OpenCV's own projection, the centre of the first pixel at .5."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    pose, coefficients = camera.world_to_camera, np.array(camera.distortion)
    place = cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3]
    points = WORLD_POINTS[:, None]
    if camera.distortion_model == "fisheye":
        return cv2.fisheye.projectPoints(points, *place, matrix, coefficients)[0].reshape(-1, 2)
    return cv2.projectPoints(points, *place, matrix, coefficients)[0].reshape(-1, 2)


def refused(path: Path, pattern: str | None = None) -> str:
    """The one line with which a rig is refused, on opening or on reading."""
    with pytest.raises(RigError, match=pattern) as caught:
        for _ in read_frames(open_rig(path)):
            pass
    message = str(caught.value)
    assert "\n" not in message
    assert ";" in message  # the part that says what to do
    assert str(path) in message  # the file or folder
    assert len(message) < 1000
    return message


@each_layout
def test_a_known_point_falls_on_the_same_pixel(tmp_path: Path, case: LayoutCase) -> None:
    """Half pixels, axes, scales and lenses: 1e-9 pixels, or as many digits as the layout's own writer gives."""
    expected = case.rig()
    if case.layout in OF_COLMAP:
        expected = [replace(camera, distortion=camera.distortion[:4]) for camera in expected]
    if case.layout == "actorshq":  # its lens has radial terms only
        expected = [replace(camera, distortion=(*camera.distortion[:2], 0.0, 0.0)) for camera in expected]
    case.write(tmp_path, expected)
    rig = open_rig(tmp_path)
    assert (rig.layout, [camera.name for camera in rig.cameras]) == (case.layout, list(case.names))
    for camera, wanted in zip(rig.cameras, expected, strict=True):
        np.testing.assert_allclose(pixels(camera), pixels(wanted), atol=case.digits)
        np.testing.assert_allclose(camera.world_to_camera, wanted.world_to_camera, atol=1e-9)
    assert rig.frame_count == FRAMES
    for index, pictures in read_frames(rig):
        # 4 steps: what the videos' codec and JPEG do to a flat grey.
        np.testing.assert_allclose([found.mean() for found in pictures], 30 + 20 * index, atol=4)
    kept = {path.resolve() for path, _ in files_of(rig)}
    assert rig.calibration
    assert kept >= {path.resolve() for path in rig.calibration}


@each_layout
def test_the_path_of_the_calibration_says_which(tmp_path: Path, case: LayoutCase) -> None:
    case.write(tmp_path, case.rig())
    if case.layout != "frame folders":  # whose calibration is one frame's
        given = tmp_path / case.cut[0]
        assert open_rig(given.parent if case.layout in OF_COLMAP else given).layout == case.layout
    if case.layout not in ("multipleview", "colmap4d"):
        (tmp_path / "transforms.json").write_text("{}")  # which is better known, and broken
        refused(tmp_path, "transforms.json")


# --- bad input ------------------------------------------------------------------------------------------------------


DAMAGED = {
    "empty": b"",
    "zeros": b"\0" * 5000,
    "deep": b"[" * 100_000,
    "cut": b"%YAML:1.0\n---\na: [1,\n",
    "tag": b"<a>",
    "tags": b"<opencv_storage>" + b"<a>" * 100_000,
    "dashes": b"%YAML:1.0\n---\na:\n " + b"- " * 100_000,
    "entities": b'<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><opencv_storage>&b;</opencv_storage>',
    "utf-16": b"\xff\xfe\0",
}


def remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink()


@each_layout
def test_a_calibration_that_is_gone(tmp_path: Path, case: LayoutCase) -> None:
    case.write(tmp_path, case.rig())
    remove(tmp_path / case.cut[0])
    refused(tmp_path)


@each_layout
def test_frames_that_are_gone(tmp_path: Path, case: LayoutCase) -> None:
    case.write(tmp_path, case.rig())
    gone = list(tmp_path.glob(case.frames))
    assert gone
    for path in gone:
        remove(path)
    refused(tmp_path)


@each_layout
def test_a_number_too_few(tmp_path: Path, case: LayoutCase) -> None:
    case.write(tmp_path, case.rig())
    name, pattern, replacement = case.cut
    path = tmp_path / name
    if path.suffix == ".smc":
        with h5py.File(path, "r+") as file:
            del file["Camera_Parameter/00/K"]
            file["Camera_Parameter/00/K"] = np.zeros(8)
    else:
        text, count = re.subn(pattern, replacement, path.read_text(), count=1)
        assert count == 1
        path.write_text(text)
    assert str(name) in refused(tmp_path)


@each_layout
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_pose_that_is_not_finite(tmp_path: Path, case: LayoutCase, value: float) -> None:
    first, *others = case.rig()
    pose = first.world_to_camera.copy()
    pose[1, 3] = value
    with np.errstate(invalid="ignore"):
        case.write(tmp_path, [replace(first, world_to_camera=pose), *others])
    refused(tmp_path, "(?i)nan|finite|malformed|numbers")


@each_layout
def test_a_lens_that_cannot_be_inverted(tmp_path: Path, case: LayoutCase) -> None:
    first, *others = case.rig()
    case.write(tmp_path, [replace(first, fx=0.0, fy=0.0), *others])
    refused(tmp_path, "focal lengths 0, 0")


@each_layout
def test_another_size(tmp_path: Path, case: LayoutCase) -> None:
    first, *others = case.rig()
    if case.has_size:
        case.write(tmp_path, [replace(first, width=64, height=64), *others])
        refused(tmp_path, "64 x 48 pixels, but camera .* is calibrated for 64 x 64")
        return
    case.write(tmp_path, [first, *others])
    if case.layout == "technicolor":
        assert cv2.imwrite(str(tmp_path / "Scene_undist_00102_01.png"), picture(2, (64, 64)))
    else:
        with h5py.File(tmp_path / "0007_01.smc", "r+") as file:
            del file["Camera_5mp/1/color/2"]
            file["Camera_5mp/1/color/2"] = cv2.imencode(".jpg", picture(2, (64, 64)))[1].ravel()
    refused(tmp_path, "64 x 64")


@each_layout
@pytest.mark.parametrize("data", DAMAGED.values(), ids=DAMAGED)
def test_a_calibration_that_is_damaged(
    tmp_path: Path, case: LayoutCase, data: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    case.write(tmp_path, case.rig())
    (tmp_path / case.cut[0]).write_bytes(data)
    capfd.readouterr()
    refused(tmp_path)
    assert capfd.readouterr() == ("", "")


WRONG = [
    ("write_aniposelib", 'name = "leftL"', 'name = "left"', "is 'left', as that of another camera"),
    ("write_aniposelib", r"matrix = \[\[60\.0, 0\.0", "matrix = [[60.0, 7e-5", "calibrate without skew"),
    (
        "write_aniposelib",
        r"(distortions = .*)\]",
        r"\1, 0, 0, 0, 0.1, 0, 0, 0]",
        "only k1 k2 p1 p2 k3 k4 k5 k6 are read",
    ),
    ("write_aniposelib", "fisheye = false", "fisheye = true", "5 distortion coefficients, but a fisheye has 4"),
    ("write_aniposelib", "size = .*", "size = [0.0, 48.0]", "0 x 48 pixels is no usable size"),
    ("write_qualisys", "<fov_video [^>]*>", "", "<fov_video> is missing"),
    ("write_qualisys", 'serial="21002"', 'serial="21001"', "two cameras have one serial"),
    ("write_qualisys", "Miqus Video", "Miqus M5", "lists no video camera"),
    ("write_immersive", '"fisheye"', '"equirect"', "'projection_type' is 'equirect', which is read as 'fisheye'"),
    ("write_immersive", r"-0\.02, 0\.0\]", "-0.02, 0.5]", "'projection_type' is 'fisheye', which is read as"),
    ("write_panoptic", '"hd"', '"vga"', "lists no camera of type 'hd'"),
    ("write_actors_hq", "Cam002", "Cam001", "two cameras are called 'Cam001'"),
    (
        "write_colmap4d",
        r"\n4 40000000\n",
        "\n4 60000003\n",
        "camera cam01 is 0.0200 s out of step|out of step with cam01",
    ),
    ("write_colmap4d", r"\n4 40000000\n", "\n", "5 times of camera cam02, but 4 of cam01"),
]


@pytest.mark.parametrize(("writer", "old", "new", "message"), WRONG)
def test_what_no_calibration_says(tmp_path: Path, writer: str, old: str, new: str, message: str) -> None:
    case = next(case for case in CASES if case.write.__name__ == writer)
    case.write(tmp_path, case.rig())
    path = tmp_path / case.cut[0]
    text, count = re.subn(old, new, path.read_text())
    assert count
    path.write_text(text)
    refused(tmp_path, message)


def test_what_easyvolcap_may_say_and_leave_out(tmp_path: Path) -> None:
    case = CASES[0]
    case.write(tmp_path, case.rig())
    poses = tmp_path / "extri.yml"
    poses.write_text(poses.read_text().replace("R_01:", "r_01:"))
    np.testing.assert_allclose(open_rig(tmp_path).cameras[1].world_to_camera, case.rig()[1].world_to_camera, atol=1e-9)
    path, fisheye = tmp_path / "intri.yml", "rdist_01: !!opencv-matrix\n  data: [{}, 0.0]\n"
    text = path.read_text()
    path.write_text(text + fisheye.format(0.0))
    assert open_rig(tmp_path).cameras[1].distortion_model == "opencv"
    path.write_text(text + fisheye.format(0.1))
    refused(tmp_path, "'rdist_01' is a fisheye's distortion")
    path.write_text(text.replace("K_", "k_"))
    refused(tmp_path, "no camera matrix K_00 or alike")
    colours = "ccm_01: !!opencv-matrix\n  data: [1, 0, 0, 0, 1, 0, 0, 0, {}]\n"
    for blue, is_said in (1, False), (2, True):
        path.write_text(text + colours.format(blue))
        assert is_said == any("colour matrices (ccm) are not used" in words for words in open_rig(tmp_path).warnings)


def test_a_skew_that_moves_no_pixel_is_none(tmp_path: Path) -> None:
    case = CASES[1]
    case.write(tmp_path, case.rig())
    path = tmp_path / case.cut[0]
    path.write_text(path.read_text().replace("matrix = [[60.0, 0.0", "matrix = [[60.0, 5e-5"))
    assert len(open_rig(tmp_path).cameras) == 3


def test_a_camera_is_in_step_within_half_a_frame(tmp_path: Path) -> None:
    case = next(case for case in CASES if case.layout == "colmap4d")
    case.write(tmp_path, case.rig())
    path = tmp_path / case.cut[0]
    path.write_text(path.read_text().replace("\n5 40000001\n", "\n5 60000000\n"))
    assert open_rig(tmp_path).frame_count == FRAMES
    path.write_text(path.read_text().replace("\n5 60000000\n", "\n5 60000001\n"))
    refused(tmp_path, "camera cam02 is 0.0200 s out of step with cam01")


def test_a_lens_without_a_projection_is_plain(tmp_path: Path) -> None:
    case = next(case for case in CASES if case.layout == "immersive")
    case.write(tmp_path, case.rig())
    path = tmp_path / case.cut[0]
    path.write_text(
        path.read_text().replace('"projection_type": "fisheye"', '"more": 1').replace("-0.02, 0.0]", "-0.02, 3]")
    )
    camera = open_rig(tmp_path).cameras[0]
    assert (camera.distortion_model, camera.distortion) == ("opencv", (0.1, -0.02, 0.0, 0.0, 3.0))


# --- what is particular ---------------------------------------------------------------------------------------------


def test_the_example_of_the_immersive_data_set(tmp_path: Path) -> None:
    """The README's own camera, point and pixel, digit by digit."""
    view = {
        "name": "camera_0001",
        "position": [0.003311238794086777, 0.000126384684934784, 0.42421246053630285],
        "orientation": [-0.03295944563072383, 0.02964606619481096, -0.03337751007195316],
        "focal_length": 1111.3638715594666,
        "pixel_aspect_ratio": 1.0,
        "principal_point": [1284.7296468363463, 925.4651609728676],
        "height": 1920.0,
        "width": 2560.0,
        "radial_distortion": [0.0970525284520715, -0.01708587111009977, 0.0],
        "projection_type": "fisheye",
    }
    (tmp_path / "models.json").write_text(json.dumps([view]))
    write_pictures(tmp_path / "camera_0001" / "{}.png", (320, 240))
    (camera,) = open_rig(tmp_path).cameras
    point = np.array([[[0.5, 0.5, 10.0]]])
    place = cv2.Rodrigues(camera.world_to_camera[:3, :3])[0], camera.world_to_camera[:3, 3]
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    found = cv2.fisheye.projectPoints(point, *place, matrix, np.array(camera.distortion))[0].ravel()
    np.testing.assert_allclose(found * 8, (1377.85525, 1017.61440), atol=5e-6)


REAL = [
    ("balance_4cam", "original_calibration.toml", {f"cam0{i}": f"cam0{i + 1}" for i in range(4)}),
    ("mouse_cage_8cam", "original_calibration.toml", None),
    ("quartet_4cam", "original_calibration.qca.txt", None),
]


@pytest.mark.parametrize(("name", "calibration", "renamed"), REAL, ids=[row[0] for row in REAL])
def test_real_calibrations(
    tmp_path: Path, shared_data: Callable[[str], Path], name: str, calibration: str, renamed: dict[str, str] | None
) -> None:
    """The recording's rig.json, which others made of the same calibration by hand: equal to a millionth of a pixel."""
    source = shared_data(f"real/{name}")
    stated = json.loads((source / "rig.json").read_text())["cameras"]
    names = renamed or {camera["file"].removesuffix(".mp4"): camera["original_name"] for camera in stated}
    # Two of the four videos of quartet_4cam were squeezed, so that only its rig.json fits them.
    fitting = [camera for camera in stated if name != "quartet_4cam" or camera["width"] == 1088]
    for camera in fitting:
        stem = camera["file"].removesuffix(".mp4")
        (tmp_path / f"{names[stem]}.mp4").symlink_to(source / camera["file"])
    text = (source / calibration).read_text()
    if name == "quartet_4cam":
        squeezed = [camera["original_name"] for camera in stated if camera not in fitting]
        text = re.sub(rf'<camera [^>]*serial="(?:{"|".join(squeezed)})".*?</camera>', "", text, flags=re.DOTALL)
    (tmp_path / calibration).write_text(text)
    rig = open_rig(tmp_path)
    wanted = {camera.name: camera for camera in open_rig(source / "rig.json").cameras}
    by_name = {camera["original_name"]: wanted[camera["name"]] for camera in stated}
    paths = {path.stem: camera for camera, path in zip(rig.cameras, (s.path for s in rig.sources), strict=True)}
    assert len(paths) == len(fitting)
    for stem, camera in paths.items():
        expected = by_name[stem]
        assert (camera.width, camera.height) == (expected.width, expected.height)
        np.testing.assert_allclose(
            (camera.fx, camera.fy, camera.cx, camera.cy),
            (expected.fx, expected.fy, expected.cx, expected.cy),
            atol=1e-6,
        )
        np.testing.assert_allclose(camera.world_to_camera, expected.world_to_camera, atol=1e-6)
        count = min(len(camera.distortion), len(expected.distortion))
        np.testing.assert_allclose(camera.distortion[:count], expected.distortion[:count], atol=1e-12)


def test_points_of_the_first_instant(tmp_path: Path) -> None:
    """Of the points with times those of the first frame, and those without one."""
    case = next(case for case in CASES if case.layout == "colmap4d")
    case.write(tmp_path, case.rig())
    rig = open_rig(tmp_path)
    assert rig.points is not None
    np.testing.assert_array_equal(rig.points.xyz[:, 0], [0, FRAMES - 1])
    assert rig.fps == pytest.approx(25)


def test_a_camera_that_moves_is_refused(tmp_path: Path) -> None:
    for layout in "colmap4d", "frame folders":
        case = next(case for case in CASES if case.layout == layout)
        folder = tmp_path / layout.replace(" ", "_")
        folder.mkdir()
        case.write(folder, case.rig())
        path = folder / ("sparse/0" if layout == "colmap4d" else f"frame{FRAMES - 1:06d}/sparse/0") / "images.txt"
        lines = path.read_text().split("\n")
        index = max(i for i, line in enumerate(lines) if "cam02.png" in line)
        words = lines[index].split()
        words[5] = str(float(words[5]) + 0.01)
        lines[index] = " ".join(words)
        path.write_text("\n".join(lines))
        refused(folder, "camera cam02 stands somewhere else")


def test_what_is_not_followed_is_said(tmp_path: Path) -> None:
    case = CASES[0]
    write_easyvolcap(tmp_path, case.rig(), more="t_01: 0.0042\r\n")
    assert any("times (t) are not used" in text for text in open_rig(tmp_path).warnings)


@pytest.mark.parametrize("layout", ["panoptic", "actorshq"])
def test_cameras_without_frames_are_left_out(tmp_path: Path, layout: str) -> None:
    case = next(case for case in CASES if case.layout == layout)
    case.write(tmp_path, case.rig())
    (warning,) = open_rig(tmp_path).warnings
    assert re.search("camera (00_30|Cam160) left out, without frames", warning)


def test_a_video_that_may_be_of_two_cameras(tmp_path: Path) -> None:
    case = CASES[1]
    case.write(tmp_path, case.rig())
    (tmp_path / "take1_mid.mp4").rename(tmp_path / "mid_left.mp4")
    refused(tmp_path, r"may hold frames of camera 'left', too")
    (tmp_path / "take1_left.mp4").unlink()
    refused(tmp_path, "may be of camera 'left' or 'mid'")


@pytest.mark.parametrize(
    "name", ["calib-charuco-cam{}-compressed", "2019-08-02-vid01-cam{}", "Camera{}", "hand-{}-test"]
)
def test_cam_may_stand_before_a_camera_s_name(tmp_path: Path, name: str) -> None:
    """As in aniposelib's tutorial, whose cameras are called A, B and C."""
    letters = ["A", "B", "C"]
    write_aniposelib(tmp_path, cameras("opencv", letters))
    for letter in letters:
        (tmp_path / f"take1_{letter}.mp4").rename(tmp_path / f"{name.format(letter)}.mp4")
    rig = open_rig(tmp_path)
    assert [(camera.name, source.path.stem) for camera, source in zip(rig.cameras, rig.sources, strict=True)] == [
        (letter, name.format(letter)) for letter in letters
    ]


def test_a_folder_s_name_has_no_ending(tmp_path: Path) -> None:
    case = CASES[1]
    case.write(tmp_path, case.rig())
    (tmp_path / "take1_mid.mp4").unlink()
    write_pictures(tmp_path / "take1.mid" / "{}.png", (64, 48))
    assert [source.path.name for source in open_rig(tmp_path).sources][2] == "take1.mid"


def test_a_number_behind_cam_is_the_camera_s(tmp_path: Path) -> None:
    """And not a take's, which is the name of another camera."""
    numbers = ["1", "2", "10"]
    write_aniposelib(tmp_path, cameras("opencv", numbers))
    for number in numbers:
        (tmp_path / f"take1_{number}.mp4").rename(tmp_path / f"cam_{number}-take-1.mp4")
    rig = open_rig(tmp_path)
    assert [source.path.stem for source in rig.sources] == ["cam_1-take-1", "cam_2-take-1", "cam_10-take-1"]


def test_a_camera_whose_file_has_an_unknown_ending_is_not_called_missing(tmp_path: Path) -> None:
    case = CASES[1]
    case.write(tmp_path, case.rig())
    (tmp_path / "calibration.toml").rename(tmp_path / "calib_mid.toml")
    (tmp_path / "take1_mid.mp4").rename(tmp_path / "take1_mid.wmv")
    refused(tmp_path, r"take1_mid\.wmv: files ending in \.wmv are not read as frames")
    (tmp_path / "take1_mid.wmv").unlink()
    refused(tmp_path, r"no video or picture folder of camera 'mid' in")


@pytest.mark.parametrize(
    ("layout", "file"),
    [("technicolor", "*.png"), ("frame folders", "frame000002/images/cam02.png"), ("colmap4d", "frame_0002/cam02.png")],
)
def test_pictures_of_an_unknown_ending_are_not_called_missing(tmp_path: Path, layout: str, file: str) -> None:
    case = next(case for case in CASES if case.layout == layout)
    case.write(tmp_path, case.rig())
    for path in list(tmp_path.glob(file)):
        path.rename(path.with_suffix(".heic"))
    refused(tmp_path, r"\.heic (is there|are not read)|files ending in \.heic are not read")


def test_the_calibration_may_be_in_a_folder_of_its_own(tmp_path: Path) -> None:
    """As Pose2Sim's sessions have it: ``calibration/`` and ``videos/``."""
    for index, name in (1, "Calib_scene.toml"), (3, "take.qca.txt"):
        case, folder = CASES[index], tmp_path / name
        folder.mkdir()
        case.write(folder, case.rig())
        for inside in "calibration", "videos":
            (folder / inside).mkdir()
        (folder / case.cut[0]).rename(folder / "calibration" / name)
        for video in folder.glob("*.mp4"):
            video.rename(folder / "videos" / video.name)
        for given in folder, folder / "calibration" / name:
            rig = open_rig(given)
            assert (rig.path, rig.layout, len(rig.cameras)) == (folder, case.layout, 3)


def test_pickles_are_refused_with_the_way_out(tmp_path: Path) -> None:
    write_pictures(tmp_path / "00" / "{}.png", (64, 48))
    (tmp_path / "cameras.pkl").write_bytes(b"\x80\x04}\x94\x8c\x01K\x94K\x01s.")
    message = refused(tmp_path, r"cameras\.pkl: a Python pickle, .* is not opened; .* write a rig\.json")
    assert refused(tmp_path / "cameras.pkl") == message
    (tmp_path / "cameras.pkl").unlink()
    np.save(tmp_path / "annots.npy", np.array({"cams": 1}, dtype=object), allow_pickle=True)
    refused(tmp_path, r"annots\.npy: a Python pickle")
    (tmp_path / "annots.npy").rename(tmp_path / "poses_bounds.npy")
    (tmp_path / "00").rename(tmp_path / "cam00")
    refused(tmp_path, r"poses_bounds\.npy: a Python pickle")


def test_without_h5py(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = next(case for case in CASES if case.layout == "dna-rendering")
    case.write(tmp_path, case.rig())
    monkeypatch.setitem(sys.modules, "h5py", None)
    refused(tmp_path, r"_annots\.smc: is HDF5, which needs the package h5py; pip install .*\[h5\]'")


def test_pictures_inside_a_file_are_in_step(tmp_path: Path) -> None:
    case = next(case for case in CASES if case.layout == "dna-rendering")
    case.write(tmp_path, case.rig())
    with h5py.File(tmp_path / "0007_01.smc", "r+") as file:
        file.move("Camera_5mp/1/color/2", "Camera_5mp/1/color/7")
    refused(tmp_path, "only one of cameras 0 and 1 has frame '2'")
    with h5py.File(tmp_path / "0007_01.smc", "r+") as file:
        file.move("Camera_5mp/1/color/7", "Camera_5mp/1/color/10")
        file.move("Camera_5mp/0/color/2", "Camera_5mp/0/color/9")
    refused(tmp_path, "only one of cameras 0 and 1 has frame '9'")  # the first one by number, not by letter
    with h5py.File(tmp_path / "0007_01.smc", "r+") as file:
        del file["Camera_5mp/1/color"]
        file.create_group("Camera_5mp/1/color")
    refused(tmp_path, "Camera_5mp/1 holds no picture")
    with h5py.File(tmp_path / "0007_01.smc", "r+") as file:
        file.move("Camera_5mp/1", "Camera_5mp/left")
    refused(tmp_path, "Camera_5mp/'left' is no camera's number")


def test_hdf5_files_reach_for_no_other_file(tmp_path: Path) -> None:
    case = next(case for case in CASES if case.layout == "dna-rendering")
    case.write(tmp_path, case.rig())
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["K"] = np.eye(3)
    path = tmp_path / "0007_01_annots.smc"
    with h5py.File(path, "r+") as file:
        del file["Camera_Parameter/00/K"]
        file["Camera_Parameter/00/K"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "K")
    refused(tmp_path, "Camera_Parameter/00/K is missing or damaged")
    with h5py.File(path, "r+") as file:
        del file["Camera_Parameter/00/K"]
        file.create_dataset("Camera_Parameter/00/K", (1 << 40,), "f8", chunks=(1 << 20,))  # 8 TiB that take no room
    refused(tmp_path, "is larger than")


def test_matrices_are_not_believed_before_they_are_read(tmp_path: Path) -> None:
    case = CASES[0]
    case.write(tmp_path, case.rig())
    path = tmp_path / "intri.yml"
    path.write_text(path.read_text().replace("rows: 3", "rows: 2000000000", 1))
    assert len(open_rig(tmp_path).cameras) == len(case.names)  # nine numbers are a camera matrix all the same
    path.write_text(path.read_text().replace("data: [", "data: [1, ", 1))
    refused(tmp_path, "has 10 numbers, not 9")


def test_opencv_may_write_xml(tmp_path: Path) -> None:
    case = next(case for case in CASES if case.layout == "opencv")
    case.write(tmp_path, case.rig(), "calibration.xml")
    for camera, wanted in zip(open_rig(tmp_path).cameras, case.rig(), strict=True):
        np.testing.assert_allclose(pixels(camera), pixels(wanted), atol=case.digits)


def test_an_unknown_layout_lists_what_was_looked_for_and_found(tmp_path: Path) -> None:
    write_pictures(tmp_path / "cam_a" / "{}.png", (64, 48))
    (tmp_path / "cameras.xyz").touch()
    message = refused(tmp_path, "no calibration; looked for .*, but there are cameras.xyz, cam_a/: calibrate")
    for name in ("rig.json", "intri.yml", "*calib*.toml", "*.qca.txt", "models.json", "calibration.csv", "COLMAP"):
        assert name in message


def test_several_of_the_others_are_an_error(tmp_path: Path) -> None:
    case = CASES[0]
    case.write(tmp_path, case.rig())
    (tmp_path / "models.json").write_text("[]")
    refused(tmp_path, r"several calibrations \(intri\.yml, models\.json\)")


def test_the_rig_is_where_it_was_meant_to_be() -> None:
    """``camera_to_world`` is right: the first camera looks along its z axis at (0.1, 0.2, 0.3)."""
    pose = np.linalg.inv(camera_to_world(0))
    seen = pose[:3, :3] @ [0.1, 0.2, 0.3] + pose[:3, 3]
    np.testing.assert_allclose(seen[:2], 0, atol=1e-12)
    assert seen[2] > 0
