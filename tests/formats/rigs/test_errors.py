"""Rigs that cannot be read: one line, naming the file, what is wrong and what to do; nothing on the terminal."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from decogs.formats.errors import RigError
from decogs.formats.rigs import Rig, open_rig, read_frames


@pytest.fixture
def refused(capfd: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Opens (and, if that works, reads) a rig that must fail with a one-line RigError matching the pattern."""

    def check(path: Path, pattern: str) -> str:
        capfd.readouterr()
        with pytest.raises(RigError, match=pattern) as caught:
            for _ in read_frames(open_rig(path)):
                pass
        message = str(caught.value)
        assert "\n" not in message
        assert ";" in message  # the part that says what to do
        assert capfd.readouterr() == ("", "")
        return message

    return check


Refused = Callable[[Path, str], str]


# --- which layout ---------------------------------------------------------------------------------------------------


def test_no_folder(tmp_path: Path, refused: Refused) -> None:
    refused(tmp_path / "nowhere", "nowhere: there is no such folder")


def test_no_calibration(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.video(tmp_path / "cam00.mp4")
    known = r"no calibration; looked for rig\.json, transforms\.json, poses_bounds\.npy, .* and a COLMAP model in .*"
    refused(
        tmp_path, known + r"but there are cam00\.mp4: calibrate the cameras, with decogs-calibrate .* -o RIG_DIR or"
    )
    for i in range(9):
        make.pictures(tmp_path / f"cam{i + 1:02d}", frames=1)
    (tmp_path / "sparse_").mkdir()
    (tmp_path / "poses\n.npy").touch()
    refused(tmp_path, known + r"but there are 'poses\\n\.npy', sparse_/, .* and 4 more: calibrate")
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", known + "but it is empty: calibrate")


def test_several_calibrations(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    make.colmap(tmp_path, text=True)
    refused(tmp_path, r"several calibrations \(poses_bounds\.npy, sparse/0\); give the path .*poses_bounds\.npy")
    make.rig_json(tmp_path)
    refused(tmp_path, r"several calibrations \(rig\.json, poses_bounds\.npy\)")


def test_a_file_that_is_no_calibration(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    refused(tmp_path / "cam00.mp4", "not a calibration that can be read")


def test_both_name_styles(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    make.video(tmp_path / "cam_0.mp4")
    refused(tmp_path, "frames named both camNN and cam_N")


def test_calibration_without_frames(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    for i in range(3):
        (tmp_path / f"cam{i:02d}.mp4").unlink()
    refused(tmp_path, "no video or picture folder named cam00")


# --- cameras against each other -------------------------------------------------------------------------------------


def test_missing_video(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    (tmp_path / "cam01.mp4").unlink()
    refused(tmp_path, r"poses_bounds\.npy: 3 poses, but 2 cameras .*no number 1\); put the missing camera back")


def test_shorter_video(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    make.video(tmp_path / "cam01.mp4", frames=4)
    refused(tmp_path, r"cam01\.mp4: 4 frames, but cam00\.mp4 has 5; cut all cameras")


def test_missing_picture(tmp_path: Path, make: Any, refused: Refused) -> None:
    for i in range(3):
        make.pictures(tmp_path / f"cam{i:02d}", frames=6)
    np.save(tmp_path / "poses_bounds.npy", np.stack([make.poses_bounds_row(i) for i in range(3)]))
    (tmp_path / "cam02" / "0003.png").unlink()
    refused(tmp_path, r"cam02/0003\.png: cannot be read \(No such file or directory\); put the picture back")
    for camera, frame in (("cam00", 5), ("cam01", 5)):
        (tmp_path / camera / f"{frame:04d}.png").unlink()
    refused(tmp_path, "cam02: no picture of frame 3, which cam00 has")


def test_unreadable_video(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    (tmp_path / "cam02.mp4").write_bytes(b"\0" * 5000)
    refused(tmp_path, r"cam02\.mp4: the file is no video that can be read, or is damaged; re-encode")


def test_variable_rate(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    path = tmp_path / "cam02.mp4"
    path.write_bytes(make.with_frame_durations(path.read_bytes(), [512, 512, 1536, 512, 512]))
    refused(tmp_path, r"cam02\.mp4: variable frame rate .*frame 2 lasts 100\.0 ms.*-fps_mode cfr")


def test_other_rate(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    make.video(tmp_path / "cam02.mp4", fps=25)
    refused(tmp_path, r"cam02\.mp4: 25\.000 frames per second, but cam00\.mp4 has 30\.000; bring all videos")


def test_cropped_video(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    make.video(tmp_path / "cam01.mp4", size=(64, 40))
    refused(tmp_path, r"cam01\.mp4: 64 x 40 pixels, but camera cam01 is calibrated for 64 x 48; resize .*without crop")


def test_one_video_at_another_scale(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    make.video(tmp_path / "cam01.mp4", size=(128, 96))
    refused(tmp_path, r"cam01\.mp4: 128 x 96 pixels is 2\.00 times its calibrated size, but cam00\.mp4 is 1\.00 times")


def test_rig_json_states_the_size_of_its_files(tmp_path: Path, make: Any, refused: Refused) -> None:
    values = make.rig_json_values()
    for record in values["cameras"]:
        record |= {"width": 128, "height": 96}
    make.rig_json(tmp_path, values)
    refused(tmp_path, r"cam00\.mp4: 64 x 48 pixels, but camera cam00 is calibrated for 128 x 96; correct")


def test_video_and_folder_of_one_camera(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    make.pictures(tmp_path / "cam01")
    refused(tmp_path, r"both cam01 and cam01\.mp4 hold frames of one camera; move one away")


def test_pictures_of_several_kinds(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.pictures(tmp_path / "cam00")
    make.pictures(tmp_path / "cam00", suffix=".jpg")
    np.save(tmp_path / "poses_bounds.npy", make.poses_bounds_row(0)[None])
    refused(tmp_path, r"cam00: holds pictures of several kinds \(\.jpg, \.png\); keep one")


def test_nan_in_an_exr_frame(tmp_path: Path, make: Any, refused: Refused) -> None:
    (tmp_path / "cam00").mkdir()
    for k in range(3):
        pixels = np.ones((make.height, make.width, 3), np.float16)
        pixels[7, 9, 2] = np.nan if k == 2 else 1
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGB": pixels}).write(str(tmp_path / "cam00" / f"{k:04d}.exr"))
    np.save(tmp_path / "poses_bounds.npy", make.poses_bounds_row(0)[None])
    refused(tmp_path, r"cam00/0002\.exr: 1 pixel\(s\) are NaN or infinite, the first at column 9, row 7; clamp")


# --- poses_bounds.npy -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        (lambda row: row.__setitem__(3, np.nan), r"row 1 \(cam01\): the pose holds NaN"),
        (lambda row: row.__setitem__([0, 5, 10], 0.0), r"row 1 \(cam01\): the pose is singular"),
        (lambda row: row.__setitem__([0, 5, 10], row[[1, 6, 11]]), r"row 1 \(cam01\): the pose is singular"),
        (lambda row: row.__setitem__([0, 5, 10], row[[0, 5, 10]] * 1.1), r"cam01\): the pose is not a rigid motion"),
        (lambda row: row.__setitem__([0, 5, 10], -row[[0, 5, 10]]), r"cam01\): the pose is mirrored"),
        (lambda row: row.__setitem__(0, 1e200), r"cam01\): the pose is not a rigid motion"),
        (lambda row: row.__setitem__(14, 0.0), r"cam01\): focal lengths 0, 0"),
        (lambda row: row.__setitem__(4, -5.0), r"cam01\): 64 x -5 pixels"),
        (lambda row: row.__setitem__(14, np.inf), r"cam01\): the pose holds NaN or infinite"),
    ],
)
def test_unusable_pose(
    tmp_path: Path, make: Any, refused: Refused, change: Callable[[np.ndarray], None], pattern: str
) -> None:
    make.n3dv(tmp_path)
    rows = np.load(tmp_path / "poses_bounds.npy")
    change(rows[1])
    np.save(tmp_path / "poses_bounds.npy", rows)
    refused(tmp_path, r"poses_bounds\.npy, .*" + pattern)


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x93NUMPY",
        b"garbage" * 20,
        b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999, 17), }".ljust(118),
        b"\x93NUMPY\x01\x00v\x00" + b"{((((".ljust(118),
    ],
)
def test_damaged_or_hostile_npy(tmp_path: Path, make: Any, refused: Refused, content: bytes) -> None:
    make.n3dv(tmp_path)
    (tmp_path / "poses_bounds.npy").write_bytes(content)
    refused(tmp_path, r"poses_bounds\.npy: not a readable NumPy file, or truncated")


def test_npy_of_another_shape(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.n3dv(tmp_path)
    np.save(tmp_path / "poses_bounds.npy", np.zeros((3, 15)))
    refused(tmp_path, r"poses_bounds\.npy: shape \(3, 15\) .*expected \(cameras, 17\)")


# --- COLMAP ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_every_truncation_of_a_binary_model(tmp_path: Path, make: Any, name: str) -> None:
    make.colmap(tmp_path, text=False)
    path = tmp_path / "sparse" / "0" / name
    data = path.read_bytes()
    for length in range(len(data)):
        path.write_bytes(data[:length])
        with pytest.raises(RigError, match=rf"{name}: truncated or damaged at byte \d+; export"):
            open_rig(tmp_path)


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_counts_are_checked_before_anything_is_read(tmp_path: Path, make: Any, refused: Refused, name: str) -> None:
    make.colmap(tmp_path, text=False)
    path = tmp_path / "sparse" / "0" / name
    path.write_bytes(struct.pack("<Q", 2**62) + path.read_bytes()[8:])
    refused(tmp_path, rf"{name}: truncated or damaged at byte 8")


@pytest.mark.parametrize("text", [False, True])
def test_unsupported_lens(tmp_path: Path, make: Any, refused: Refused, text: bool) -> None:
    make.colmap(tmp_path, text=text, lens="FOV")
    refused(tmp_path, r"camera 7: camera model 'FOV' is not supported; undistort")


@pytest.mark.parametrize("name", ["cameras.txt", "images.txt", "points3D.txt"])
def test_malformed_text_model(tmp_path: Path, make: Any, refused: Refused, name: str) -> None:
    make.colmap(tmp_path, text=True)
    path = tmp_path / "sparse" / "0" / name
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], lines[1].replace(" ", " x", 2), *lines[2:]]))
    refused(tmp_path, rf"{name}: line 2 is malformed; export")


@pytest.mark.parametrize(("words", "pattern"), [("0 0 0 0", "singular"), ("nan 0 0 1", "singular")])
def test_singular_colmap_pose(tmp_path: Path, make: Any, refused: Refused, words: str, pattern: str) -> None:
    make.colmap(tmp_path, text=True)
    path = tmp_path / "sparse" / "0" / "images.txt"
    lines = path.read_text().splitlines()
    lines[1] = " ".join(["1", words, *lines[1].split()[5:]])
    path.write_text("\n".join(lines))
    refused(tmp_path, rf"image 'cam00\.png': the pose is {pattern}")


def test_image_without_its_lens(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.colmap(tmp_path, text=True)
    path = tmp_path / "sparse" / "0" / "cameras.txt"
    path.write_text(path.read_text().replace("\n7 ", "\n8 "))
    refused(tmp_path, r"image 'cam00\.png': its camera 7 is not in the model")


def test_model_without_images(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.colmap(tmp_path, text=True)
    (tmp_path / "sparse" / "0" / "images.txt").write_text("# nothing\n")
    refused(tmp_path, "the model holds no images")


def test_model_without_its_images_file(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.colmap(tmp_path, text=True)
    (tmp_path / "sparse" / "0" / "images.txt").unlink()
    refused(tmp_path, r"images\.txt: cannot be read \(No such file")


def test_names_that_do_not_match(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.colmap(tmp_path, text=False)
    (tmp_path / "cam01.mp4").rename(tmp_path / "left.mp4")
    refused(
        tmp_path, r"of image 'cam01\.png' of .*, but left\.mp4, which the model does not know; give .* the same names"
    )
    make.video(tmp_path / "cam01.mp4")
    refused(tmp_path, r"left\.mp4: no camera of this name in .*; calibrate it too or move it away")


def test_moving_camera(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.pictures(tmp_path / "phone")
    make.colmap_model(tmp_path / "sparse" / "0", [f"phone/{k:04d}.png" for k in range(5)], text=False)
    refused(tmp_path, "camera phone stands somewhere else in another image; cameras must be fixed")


# --- JSON -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("layout", ["rig.json", "transforms.json"])
@pytest.mark.parametrize(
    ("content", "pattern"),
    [
        (b"", "malformed JSON in line 1"),
        (b'{"cameras": [\n{,', "malformed JSON in line 2"),
        (b"[1, 2]", "holds no object"),
        (b"\xff\xfe{}", "malformed JSON"),
        (b"[" * 100_000, "malformed JSON"),
        (b'{"cameras": [], "frames": []}', "is not a list of objects"),
        (b'{"cameras": [3], "frames": [3]}', "is not a list of objects"),
        (b'{"cameras": {}, "frames": "x"}', "is not a list"),
        (b"{}", "is missing"),
    ],
)
def test_malformed_json(tmp_path: Path, refused: Refused, layout: str, content: bytes, pattern: str) -> None:
    (tmp_path / layout).write_bytes(content)
    refused(tmp_path, rf"{layout}.*{pattern}")


MISSING = object()


@pytest.mark.parametrize(
    ("key", "value", "pattern"),
    [
        ("name", MISSING, "'name' is missing"),
        ("name", "a/b", "'a/b' is no usable camera name"),
        ("name", "cam01", "two cameras are called 'cam01'"),
        ("file", "gone.mp4", r"gone\.mp4 is missing; put it back"),
        ("file", "a\nb", "'file' holds control characters"),
        ("name", "a\nb", "'name' holds control characters"),
        ("file", "x" * 5000, "is missing; put it back"),
        ("file", 3, "'file' is not a text"),
        ("width", "64", "'width' is not a number"),
        ("width", 64.5, "'width' is 64.5, not a whole number"),
        ("height", -48, "64 x -48 pixels is no usable size"),
        ("fx", float("nan"), "'fx' is NaN or infinite"),
        ("fx", 10**400, "'fx' is too large a number"),
        ("fx", True, "'fx' is not a number"),
        ("fy", -3, "focal lengths 60, -3 are not usable"),
        ("cx", 1e9, "principal point 1e[+]09, 25 is far off the picture"),
        ("distortion", [0.1, 0.2], "has 2 coefficients, which 'opencv' does not take"),
        ("distortion", [0.1, None, 0, 0], "'distortion' is not a number"),
        ("distortion_model", "kannala", "is 'kannala'; known are none, opencv, fisheye"),
        ("world_to_camera", [[1, 0, 0, 0]] * 4, r"\(cam00\): the pose is singular"),
        ("world_to_camera", [[float("inf"), 0, 0, 0]] * 4, r"\(cam00\): the pose holds NaN or infinite"),
        ("world_to_camera", [[1, 2], [3]], "is no 3 x 4 or 4 x 4 matrix"),
        ("world_to_camera", "eye", "'world_to_camera' is not a list"),
    ],
)
def test_wrong_field_in_rig_json(
    tmp_path: Path, make: Any, refused: Refused, key: str, value: object, pattern: str
) -> None:
    values = make.rig_json_values()
    if value is MISSING:
        del values["cameras"][0][key]
    else:
        values["cameras"][0][key] = value
    make.rig_json(tmp_path, values)
    refused(tmp_path, pattern)


@pytest.mark.parametrize(
    ("key", "value", "pattern"),
    [
        ("fps", -1, "'fps' is -1, not a frame rate"),
        ("frame_count", 7, "'frame_count' is 7, but the cameras have 5 frames"),
        ("pixel_convention", "corner", "'pixel_convention' says neither"),
    ],
)
def test_wrong_field_of_the_whole_rig(
    tmp_path: Path, make: Any, refused: Refused, key: str, value: object, pattern: str
) -> None:
    make.rig_json(tmp_path, make.rig_json_values() | {key: value})
    refused(tmp_path, r"rig\.json: " + pattern)


@pytest.mark.parametrize(
    ("change", "pattern"),
    [
        ({"camera_model": "EQUIRECTANGULAR"}, "'camera_model' is 'EQUIRECTANGULAR', which is not supported; undistort"),
        ({"k4": 0.1}, "'k4' is a fourth radial coefficient"),
        ({"fl_x": None}, "'fl_x' is missing"),
        ({"fl_x": None, "camera_angle_x": 4.0}, "'camera_angle_x' is 4, not a field of view"),
        ({"w": 640, "h": 400}, r"cam00\.mp4: 64 x 48 pixels, but camera cam00 is calibrated for 640 x 400"),
    ],
)
def test_wrong_field_in_transforms_json(
    tmp_path: Path, make: Any, refused: Refused, change: dict[str, object], pattern: str
) -> None:
    values = make.transforms_values([f"cam{i:02d}.mp4" for i in range(3)]) | change
    message = refused(make.nerfstudio(tmp_path, values), pattern)
    assert "transforms.json" in message or "cam00.mp4" in message


def test_missing_file_and_singular_pose_in_transforms_json(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.nerfstudio(tmp_path)
    (tmp_path / "cam01.mp4").unlink()
    refused(tmp_path, r"frames\[1\]: .*cam01\.mp4 is missing; put it back or remove its entry")
    values = make.transforms_values([f"cam{i:02d}.mp4" for i in range(3)])
    values["frames"][2]["transform_matrix"] = np.zeros((4, 4)).tolist()
    make.nerfstudio(tmp_path, values)
    refused(tmp_path, r"transforms\.json, frames\[2\] \(cam02\): the pose is singular")


def test_moving_camera_in_transforms_json(tmp_path: Path, make: Any, refused: Refused) -> None:
    make.pictures(tmp_path / "images")
    values = make.transforms_values([f"images/{k:04d}.png" for k in range(5)])
    for k, frame in enumerate(values["frames"]):
        frame["time"] = k / 4
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    refused(tmp_path, "every entry has its own pose and time, as of a moving camera")


def opened_or_refused(path: Path) -> tuple[Rig | None, str]:
    """The rig, its poses finite, or else the message it was refused with; any other exception fails the test."""
    try:
        rig = open_rig(path)
    except RigError as error:
        return None, str(error)
    assert all(np.isfinite(camera.world_to_camera).all() for camera in rig.cameras)
    return rig, ""


JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data(), layout=st.sampled_from(["rig.json", "transforms.json"]))
def test_any_value_in_any_field_raises_nothing_else(tmp_path: Path, make: Any, data: Any, layout: str) -> None:
    names = [f"cam{i:02d}.png" for i in range(2)]
    if not (tmp_path / names[0]).exists():
        make.pictures(tmp_path / "stills", frames=2)
        for k, name in enumerate(names):
            (tmp_path / "stills" / f"{k:04d}.png").rename(tmp_path / name)
    values = make.rig_json_values(2) if layout == "rig.json" else make.transforms_values(names)
    for name, record in zip(names, values.get("cameras", []), strict=False):
        record["file"] = name
    values |= {"frame_count": 1} if layout == "rig.json" else {}
    target = data.draw(st.sampled_from([values, *values.get("cameras", []), *values.get("frames", [])]))
    target[data.draw(st.sampled_from(sorted(target)))] = data.draw(JSON)
    for other in ("rig.json", "transforms.json"):
        (tmp_path / other).unlink(missing_ok=True)
    (tmp_path / layout).write_text(json.dumps(values))
    rig, message = opened_or_refused(tmp_path)
    assert "\n" not in message
    assert rig is None or rig.frame_count == 1


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_byte_of_a_colmap_model_raises_nothing_else(tmp_path: Path, make: Any, data: Any) -> None:
    folder = tmp_path / "rig"
    model = folder / "sparse" / "0"
    text = data.draw(st.booleans())
    if not folder.exists():
        make.colmap(folder, text=True, cameras=2)
    for file in model.iterdir():
        file.unlink()
    make.colmap_model(model, ["cam00.png", "cam01.png"], text=text)
    path = data.draw(st.sampled_from(sorted(model.iterdir())))
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(content)
    rig, message = opened_or_refused(folder)
    assert "\n" not in message
    assert rig is None or rig.frame_count == make.frames
