"""COLMAP models as they come: which frames an image belongs to, text that editors changed, lenses, models beside it."""

from __future__ import annotations

import shutil
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.formats.errors import RigError
from decogs.formats.rigs import Rig, open_rig, read_frames

NAMES = ["cam00", "cam01", "cam02"]


def check(rig: Rig, make: Any, names: list[str] = NAMES, frames: int | None = None) -> None:
    """Cameras at their places, in order, with all their frames."""
    assert [camera.name for camera in rig.cameras] == names
    for i, camera in enumerate(rig.cameras):
        np.testing.assert_allclose(camera.world_to_camera, np.linalg.inv(make.camera_to_world(i)), atol=1e-12)
    assert rig.frame_count == (make.frames if frames is None else frames)
    for index, pictures in read_frames(rig):
        for picture in pictures:
            # 4 levels: what the synthetic videos' codec does to a flat colour.
            np.testing.assert_allclose(picture.mean(axis=(0, 1)), np.array([40, 30, 20]) + 20 * index, atol=4)


# --- pairing --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("files", "images"),
    [
        ("images/rig1/{}/", "rig1/{}/0000.png"),
        ("rig1/{}/", "rig1/{}/0000.png"),
        ("Images/day2/rig1/{}/", "day2/rig1/{}/0000.png"),
        ("{}/", "rig1/{}/0000.png"),
        ("{}/images/", "{}/images/0000.png"),
        ("images/{}/", "images\\{}\\0000.png"),
        ("images/{}/", "C:\\scans\\take 1\\images\\{}\\0000.png"),
        ("images/{}/", "/home/anna/images/{}/0000.png"),
        ("images/{}/", "./{}/0000.png"),
        ("images/100% {}/", "100% {}/0000.png"),
        ("{}.mp4", "{}/000000.png"),
        ("{}.mp4", "{}_frame0001.png"),
        ("{}.mp4", "{}-0001.jpg"),
        ("{}.mp4", "{}.0001.jpg"),
        ("{}.mp4", "{}_Frame_01.jpg"),
        ("rig1/{}.mp4", "rig1/{}.png"),
        ("videos/{}.mp4", "stills/{}.png"),
        ("{}.mp4", "stills/{}/images/frame_0.png"),
    ],
)
@pytest.mark.parametrize("text", [False, True])
def test_images_find_their_frames(tmp_path: Path, make: Any, files: str, images: str, text: bool) -> None:
    for name in NAMES:
        path = tmp_path / files.format(name)
        make.video(path) if path.suffix == ".mp4" else make.pictures(path)
    make.colmap_model(tmp_path / "sparse/0", [images.format(name) for name in NAMES], text=text)
    rig = open_rig(tmp_path)
    check(rig, make, [name.format(n) for n in NAMES for name in ["100% {}" if "100%" in files else "{}"]])
    assert rig.warnings == ()


def test_long_names_take_no_time(tmp_path: Path, make: Any) -> None:
    make.colmap(tmp_path, text=False, cameras=2)
    for name in ("_" * 100_000 + "a", "a/" * 100_000 + "b", "1" * 100_000, "_ " * 50_000 + "1"):
        make.colmap_model(tmp_path / "sparse/0", ["cam00.png", name], text=False)
        with pytest.raises(RigError, match="no video, picture folder or picture of image"):
            open_rig(tmp_path)


def test_cameras_of_two_rigs_with_the_same_names(tmp_path: Path, make: Any) -> None:
    names = ["rig1/left", "rig1/right", "rig2/left", "rig2/top"]
    for name in names:
        make.pictures(tmp_path / "images" / name)
    make.colmap_model(tmp_path / "sparse/0", [f"{name}/0000.png" for name in names], text=False)
    by_place = {camera.name: camera.world_to_camera for camera in open_rig(tmp_path).cameras}
    assert set(by_place) == {"rig1_left", "right", "rig2_left", "top"}
    for i, name in enumerate(["rig1_left", "right", "rig2_left", "top"]):
        np.testing.assert_allclose(by_place[name], np.linalg.inv(make.camera_to_world(i)), atol=1e-12)


def test_pictures_of_several_cameras_in_one_folder_are_told_what_to_do(tmp_path: Path, make: Any) -> None:
    make.pictures(tmp_path / "images/phone", frames=3)
    make.colmap_model(tmp_path / "sparse/0", [f"phone/{k:04d}.png" for k in range(3)], text=False)
    with pytest.raises(RigError, match=r"phone stands somewhere else .*cameras need a folder each, or lie in images/"):
        open_rig(tmp_path)


# --- frames without a pose, poses without frames --------------------------------------------------------------------


def test_frames_of_one_camera_are_not_taken_for_several_cameras(tmp_path: Path, make: Any) -> None:
    names = ["cam00_0000", "cam00_0001", "cam01_0000", "cam01_0001"]
    for name in names:
        make.pictures(tmp_path / "made", frames=1)
        (tmp_path / "images").mkdir(exist_ok=True)
        (tmp_path / "made/0000.png").rename(tmp_path / f"images/{name}.png")
    make.colmap_model(tmp_path / "sparse/0", [f"{name}.png" for name in names], text=False, indices=[0, 0, 1, 1])
    with pytest.raises(RigError, match=r"sparse/0: cam00_0000 and cam00_0001 have one pose, .* a folder of its own"):
        open_rig(tmp_path)


def test_a_model_file_that_is_none(tmp_path: Path, make: Any) -> None:
    images = make.colmap(tmp_path, text=True) / "sparse/0/images.txt"
    images.unlink()
    images.symlink_to("/dev/null")
    with pytest.raises(RigError, match=r"images\.txt: cannot be read \(this is no regular file\)"):
        open_rig(tmp_path)


def test_folders_without_a_pose_are_said(tmp_path: Path, make: Any) -> None:
    for name in (*NAMES, "cam03", "cam04"):
        make.pictures(tmp_path / name)
    make.colmap_model(tmp_path / "sparse/0", [f"{name}/0000.png" for name in NAMES], text=True)
    rig = open_rig(tmp_path)
    check(rig, make)
    assert rig.warnings == (f"{tmp_path}/cam03 and 1 more: left out, without a pose in {tmp_path}/sparse/0",)
    make.colmap_model(tmp_path / "sparse/1", ["cam03/0000.png", "cam04/0000.png"], text=True, indices=[3, 4])
    (warning,) = open_rig(tmp_path).warnings
    assert "(perhaps in sparse/1, whose poses do not fit these)" in warning


def test_single_pictures_without_a_pose_are_said(tmp_path: Path, make: Any) -> None:
    make.pictures(tmp_path / "images", frames=4)
    make.colmap_model(tmp_path / "sparse/0", ["0000.png", "0002.png"], text=True, indices=[0, 2])
    rig = open_rig(tmp_path)
    assert [camera.name for camera in rig.cameras] == ["0000", "0002"]
    assert rig.warnings == (f"{tmp_path}/images/0001.png and 1 more: left out, without a pose in {tmp_path}/sparse/0",)


def test_smaller_pictures_masks_and_stills_are_no_cameras_left_out(tmp_path: Path, make: Any) -> None:
    make.colmap(tmp_path, text=False)
    for folder in ("images_2", "masks", "images"):
        make.pictures(tmp_path / folder, frames=3)
        for name, file in zip(NAMES, sorted((tmp_path / folder).iterdir()), strict=True):
            file.rename(file.with_stem(name))
    cv2.imwrite(str(tmp_path / "poster.png"), np.zeros((9, 16, 3), np.uint8))
    rig = open_rig(tmp_path)
    check(rig, make)
    assert rig.warnings == ()


def test_masks_in_a_cameras_folder_are_no_camera(tmp_path: Path, make: Any) -> None:
    for name in NAMES:
        make.pictures(tmp_path / name)
        make.pictures(tmp_path / name / "masks")
    make.colmap_model(tmp_path / "sparse/0", [f"{name}/0000.png" for name in NAMES], text=True)
    rig = open_rig(tmp_path)
    check(rig, make)
    assert rig.warnings == ()


def test_an_image_without_frames_is_named(tmp_path: Path, make: Any) -> None:
    for name in NAMES[1:]:
        make.pictures(tmp_path / name)
    make.colmap_model(tmp_path / "sparse/0", [f"{name}/0000.png" for name in NAMES], text=False)
    with pytest.raises(RigError, match=r"picture of image 'cam00/0000\.png' of .*; put it back, or take the image out"):
        open_rig(tmp_path)


def test_a_video_without_a_pose_points_to_the_other_model(tmp_path: Path, make: Any) -> None:
    make.colmap(tmp_path, text=False)
    make.video(tmp_path / "left.mp4")
    make.colmap_model(tmp_path / "sparse/1", ["left.png"], text=False)
    with pytest.raises(RigError, match=r"left\.mp4: no camera of this name in .*0 \(perhaps in sparse/1, whose poses"):
        open_rig(tmp_path)


@pytest.mark.parametrize("given", [".", "sparse/1", "sparse/1/cameras.bin"])
def test_a_model_in_sparse_1(tmp_path: Path, make: Any, given: str) -> None:
    make.colmap(tmp_path, text=False)
    (tmp_path / "sparse/0").rename(tmp_path / "sparse/1")
    rig = open_rig(tmp_path / given)
    check(rig, make)
    assert rig.path == tmp_path


# --- text -----------------------------------------------------------------------------------------------------------


def without_empty_lines(text: str) -> str:
    return "".join(line for line in text.splitlines(keepends=True) if line.strip())


@pytest.mark.parametrize(
    "change",
    [
        without_empty_lines,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: without_empty_lines(text).replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\n\n"),
        lambda text: text.replace("\n", "   \t\n"),
        lambda text: text.replace(" ", "\t"),
        lambda text: "\ufeff" + text,
        lambda text: "\ufeff# Image list\r\n" + text,
        lambda text: text.replace("\n", "\n# a comment\n  # and another\n"),
        lambda text: text.removesuffix("\n"),
        lambda text: text.replace("1.5 2.5 -1 3.5 4.5 1", "1.5 2.5 -1 3.5 4.5 1 " * 50_000),
        lambda text: text.replace("1.5 2.5 -1 3.5 4.5 1", "1.5 2.5 -1 3.5 4.5 1 " * 3 + "0 0 -1"),
        lambda text: without_empty_lines(text).replace("1.5 2.5 -1 3.5 4.5 1\n", ""),
    ],
)
def test_text_that_editors_and_programs_changed(tmp_path: Path, make: Any, change: Any) -> None:
    """No line of points, an empty one, or one of any length may follow an image."""
    make.colmap(tmp_path, text=True)
    for file in (tmp_path / "sparse/0").iterdir():
        file.write_bytes(change(file.read_text()).encode())
    rig = open_rig(tmp_path)
    check(rig, make)
    for file in (tmp_path / "sparse/0").iterdir():
        file.write_bytes(file.read_bytes().decode("utf-8-sig").encode("utf-16"))
    check(open_rig(tmp_path), make)
    assert rig.points is not None
    assert len(rig.points) == 2


@pytest.mark.parametrize("name", ["left  1", "17", "a 1 2", "%04d"])
@pytest.mark.parametrize("blank", [False, True])
def test_names_with_spaces_and_numbers(tmp_path: Path, make: Any, name: str, blank: bool) -> None:
    make.pictures(tmp_path / "images", frames=2)
    (tmp_path / "images/0000.png").rename(tmp_path / "images" / f"{name}.png")
    (tmp_path / "images/0001.png").rename(tmp_path / "images/0.png")
    make.colmap_model(tmp_path / "sparse/0", [f"{name}.png", "0.png"], text=True)
    if not blank:
        path = tmp_path / "sparse/0/images.txt"
        path.write_text(without_empty_lines(path.read_text()))
    assert {camera.name for camera in open_rig(tmp_path).cameras} == {name, "0"}


@pytest.mark.parametrize(
    ("line", "number"),
    [
        ("1.5 2.5 -1 3.5 4.5", 4),
        ("1.5 2.5 -1\n1.5 2.5 -1", 5),
        ("3 1.0 0.0 0.0 0.0 0.5 0.5 0.5 7", 4),
    ],
)
def test_a_line_that_is_neither_an_image_nor_points(tmp_path: Path, make: Any, line: str, number: int) -> None:
    """Among them an image that lost its name: left out, it would be a camera less without a word."""
    make.colmap(tmp_path, text=True)
    path = tmp_path / "sparse/0/images.txt"
    lines = without_empty_lines(path.read_text()).splitlines()
    path.write_text("\n".join([*lines[:3], line, *lines[3:]]))
    (tmp_path / "sparse/0/points3D.txt").unlink()
    with pytest.raises(RigError, match=rf"images\.txt: line {number} is malformed"):
        open_rig(tmp_path)


# --- lenses ---------------------------------------------------------------------------------------------------------

LENSES = {
    "SIMPLE_RADIAL_FISHEYE": (8, (60.0, 31.0, 25.0, 0.1), (60.0, 60.0, 31.0, 25.0), (0.1, 0.0, 0.0, 0.0)),
    "RADIAL_FISHEYE": (9, (60.0, 31.0, 25.0, 0.1, -0.02), (60.0, 60.0, 31.0, 25.0), (0.1, -0.02, 0.0, 0.0)),
    "SIMPLE_FISHEYE": (14, (60.0, 31.0, 25.0), (60.0, 60.0, 31.0, 25.0), (0.0,) * 4),
    "FISHEYE": (15, (60.0, 61.0, 31.0, 25.0), (60.0, 61.0, 31.0, 25.0), (0.0,) * 4),
}
"""Number in COLMAP, parameters in its order, what they are as fx, fy, cx, cy and as OpenCV's k1 to k4."""


def write_lens(model: Path, make: Any, number: int, name: str, parameters: tuple[float, ...], *, text: bool) -> None:
    if text:
        words = " ".join(map(repr, parameters))
        (model / "cameras.txt").write_text(f"7 {name} {make.width} {make.height} {words}\n")
    else:
        head = struct.pack("<QIiQQ", 1, 7, number, make.width, make.height)
        (model / "cameras.bin").write_bytes(head + struct.pack(f"<{len(parameters)}d", *parameters))


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("name", LENSES)
def test_fisheye_lenses(tmp_path: Path, make: Any, name: str, text: bool) -> None:
    make.colmap(tmp_path, text=text)
    number, parameters, intrinsics, distortion = LENSES[name]
    write_lens(tmp_path / "sparse/0", make, number, name, parameters, text=text)
    for camera in open_rig(tmp_path).cameras:
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == intrinsics
        assert (camera.distortion_model, camera.distortion) == ("fisheye", distortion)


@pytest.mark.parametrize(
    ("number", "name"),
    [
        (7, "FOV"), (10, "THIN_PRISM_FISHEYE"), (11, "RAD_TAN_THIN_PRISM_FISHEYE"), (12, "SIMPLE_DIVISION"),
        (13, "DIVISION"), (16, "EUCM"), (17, "EQUIRECTANGULAR"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("text", [False, True])
def test_other_lenses_are_refused_by_name(tmp_path: Path, make: Any, number: int, name: str, text: bool) -> None:
    make.colmap(tmp_path, text=text)
    write_lens(tmp_path / "sparse/0", make, number, name, (60.0, 61.0, 31.0, 25.0, 0.1), text=text)
    with pytest.raises(RigError, match=rf"camera 7: camera model '{name}' is not supported; undistort"):
        open_rig(tmp_path)


def test_a_lens_of_the_future_is_refused_by_number(tmp_path: Path, make: Any) -> None:
    make.colmap(tmp_path, text=False)
    write_lens(tmp_path / "sparse/0", make, 99, "", (), text=False)
    with pytest.raises(RigError, match="camera model 'number 99' is not supported"):
        open_rig(tmp_path)


def test_poses_need_neither_rigs_nor_frames_files(tmp_path: Path, make: Any) -> None:
    """COLMAP >= 3.12 writes both, and whole poses into the images all the same."""
    for name in NAMES:
        make.pictures(tmp_path / "images/rig1" / name)
    model = tmp_path / "sparse/0"
    make.colmap_model(model, [f"rig1/{name}/0000.png" for name in NAMES], text=True)
    (model / "rigs.txt").write_text("1 3 CAMERA 1 CAMERA 2 1 1 0 0 0 1 2 3 CAMERA 3 1 1 0 0 0 3 2 1\n")
    (model / "frames.txt").write_text("1 1 1 0 0 0 0 0 0 3 CAMERA 1 1 CAMERA 2 2 CAMERA 3 3\n")
    rig = open_rig(tmp_path)
    check(rig, make)
    shutil.rmtree(model)
    assert {path.name for path in rig.calibration} == {
        "cameras.txt", "images.txt", "points3D.txt", "rigs.txt", "frames.txt"
    }  # fmt: skip
