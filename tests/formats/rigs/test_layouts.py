"""Every layout gives the same rig: cameras in OpenCV convention, pixel centres at .5, frames in step."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.rigs import Rig, open_rig, read_frames

WORLD_POINT = np.array([0.3, 0.1, 0.5])
NAMES = ["cam00", "cam01", "cam02"]


def project(camera: Camera, point: np.ndarray) -> np.ndarray:
    """Pixel of a world point, by OpenCV's own projection."""
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    pose, coefficients = camera.world_to_camera, np.array(camera.distortion)
    vector, translation = cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3]
    if camera.distortion_model == "fisheye":
        return cv2.fisheye.projectPoints(point.reshape(1, 1, 3), vector, translation, matrix, coefficients)[0].ravel()
    return cv2.projectPoints(point, vector, translation, matrix, coefficients)[0].ravel()


def check_poses(rig: Rig, make: Any) -> None:
    for i, camera in enumerate(rig.cameras):
        expected = np.linalg.inv(make.camera_to_world(i))
        np.testing.assert_allclose(camera.world_to_camera, expected, atol=1e-12)  # float64 throughout
        assert (camera.width, camera.height) == (make.width, make.height)


def check_frames(rig: Rig, make: Any) -> None:
    assert rig.frame_count == make.frames
    for index, pictures in read_frames(rig):
        assert len(pictures) == len(rig.cameras)
        for picture in pictures:
            assert picture.shape == (make.height, make.width, 3)
            # 4 steps: what the synthetic videos' codec does to a flat colour.
            np.testing.assert_allclose(picture.mean(axis=(0, 1)), np.array([40, 30, 20]) + 20 * index, atol=4)


def test_n3dv(tmp_path: Path, make: Any) -> None:
    rig = open_rig(make.n3dv(tmp_path))
    assert (rig.layout, [c.name for c in rig.cameras], rig.fps) == ("n3dv", NAMES, 30.0)
    check_poses(rig, make)
    check_frames(rig, make)
    # The layout's projection as its documentation words it: along down, right and backwards.
    down, right, backwards, position, _ = make.poses_bounds_row(1)[:15].reshape(3, 5).T
    d = WORLD_POINT - position
    z = -d @ backwards
    u, v = make.width / 2 + make.focal * (d @ right) / z, make.height / 2 + make.focal * (d @ down) / z
    np.testing.assert_allclose(project(rig.cameras[1], WORLD_POINT), (u, v), atol=1e-9)


def test_n3dv_intrinsics_are_rescaled_to_the_video(tmp_path: Path, make: Any) -> None:
    rig = open_rig(make.n3dv(tmp_path, size=(2 * make.width, 2 * make.height), focal=120.0))
    for camera in rig.cameras:
        assert (camera.width, camera.height) == (make.width, make.height)
        np.testing.assert_allclose((camera.fx, camera.fy, camera.cx, camera.cy), (60, 60, 32, 24), atol=1e-12)


def test_n3dv_rescaling_of_the_published_size(tmp_path: Path, make: Any) -> None:
    # 2704 x 2028 videos are commonly halved twice; 676 x 507 has the same shape.
    make.video(tmp_path / "cam00.mp4", size=(676, 508), frames=1)
    np.save(tmp_path / "poses_bounds.npy", make.poses_bounds_row(0, size=(2704, 2028), focal=1462.0)[None])
    camera = open_rig(tmp_path).cameras[0]
    # Height 508 instead of 507 (encoders want even sizes): each axis gets its own factor.
    assert (camera.width, camera.height) == (676, 508)
    np.testing.assert_allclose((camera.fx, camera.cx), (1462 / 4, 338), atol=1e-9)
    np.testing.assert_allclose((camera.fy, camera.cy), (1462 * 508 / 2028, 254), atol=1e-9)


def test_n3dv_rows_belong_to_the_cameras_that_exist(tmp_path: Path, make: Any) -> None:
    for number in (0, 2, 13):
        make.video(tmp_path / f"cam{number:02d}.mp4")
    np.save(tmp_path / "poses_bounds.npy", np.stack([make.poses_bounds_row(i) for i in range(3)]))
    rig = open_rig(tmp_path)
    assert [camera.name for camera in rig.cameras] == ["cam00", "cam02", "cam13"]
    check_poses(rig, make)


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_n3dv_with_picture_folders(tmp_path: Path, make: Any, suffix: str) -> None:
    for i in range(3):
        make.pictures(tmp_path / f"cam{i:02d}", suffix=suffix)
    np.save(tmp_path / "poses_bounds.npy", np.stack([make.poses_bounds_row(i) for i in range(3)]))
    rig = open_rig(tmp_path)
    assert (rig.layout, rig.fps) == ("n3dv", None)
    check_poses(rig, make)
    check_frames(rig, make)


def test_meetroom_names_sort_naturally(tmp_path: Path, make: Any) -> None:
    rig = open_rig(make.n3dv(tmp_path, cameras=12, name="cam_{}"))
    assert rig.layout == "meetroom"
    assert [camera.name for camera in rig.cameras] == [f"cam_{i}" for i in range(12)]
    check_poses(rig, make)


def test_meetroom_with_a_colmap_model(tmp_path: Path, make: Any) -> None:
    names = [f"cam_{i}" for i in range(12)]
    for name in names:
        make.video(tmp_path / f"{name}.mp4")
    make.colmap_model(tmp_path / "sparse" / "0", [f"{name}.jpg" for name in names], text=False, lens="OPENCV")
    rig = open_rig(tmp_path)
    assert (rig.layout, [camera.name for camera in rig.cameras]) == ("meetroom", names)
    check_poses(rig, make)
    assert rig.points is not None


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize(
    ("lens", "intrinsics", "model", "distortion"),
    [
        ("SIMPLE_PINHOLE", (60, 60, 31, 25), "none", ()),
        ("PINHOLE", (60, 61, 31, 25), "none", ()),
        ("SIMPLE_RADIAL", (60, 60, 31, 25), "opencv", (0.1, 0, 0, 0)),
        ("RADIAL", (60, 60, 31, 25), "opencv", (0.1, -0.02, 0, 0)),
        ("OPENCV", (60, 61, 31, 25), "opencv", (0.1, -0.02, 0.003, -0.004)),
        ("OPENCV_FISHEYE", (60, 61, 31, 25), "fisheye", (0.1, -0.02, 0.003, -0.004)),
        ("FULL_OPENCV", (60, 61, 31, 25), "opencv", (0.1, -0.02, 0.003, -0.004, 0.005, 0.006, 0.007, 0.008)),
    ],
)
def test_colmap_models(
    tmp_path: Path, make: Any, text: bool, lens: str, intrinsics: Any, model: str, distortion: Any
) -> None:
    rig = open_rig(make.colmap(tmp_path, text=text, lens=lens))
    assert (rig.layout, [camera.name for camera in rig.cameras]) == ("colmap", NAMES)
    check_poses(rig, make)
    for camera in rig.cameras:
        assert (camera.fx, camera.fy, camera.cx, camera.cy) == intrinsics
        assert (camera.distortion_model, camera.distortion) == (model, distortion)
    assert rig.points is not None
    np.testing.assert_array_equal(rig.points.xyz, np.array([xyz for xyz, _ in make.points], np.float32))
    np.testing.assert_array_equal(rig.points.rgb, [rgb for _, rgb in make.points])


@pytest.mark.parametrize("text", [False, True])
def test_colmap_with_picture_folders(tmp_path: Path, make: Any, text: bool) -> None:
    for i in range(3):
        make.pictures(tmp_path / "images" / f"cam{i:02d}")
    make.colmap_model(tmp_path / "sparse", [f"{name}/0000.png" for name in NAMES], text=text)
    rig = open_rig(tmp_path)
    assert [camera.name for camera in rig.cameras] == NAMES
    check_poses(rig, make)
    check_frames(rig, make)


def test_colmap_videos_go_before_the_stills_of_the_model(tmp_path: Path, make: Any) -> None:
    make.colmap(tmp_path, text=False)
    for name in NAMES:
        make.pictures(tmp_path / "stills", frames=1)
        (tmp_path / "images").mkdir(exist_ok=True)
        (tmp_path / "stills" / "0000.png").rename(tmp_path / "images" / f"{name}.png")
    rig = open_rig(tmp_path)
    assert [source.path.suffix for source in rig.sources] == [".mp4"] * 3
    for name in NAMES:
        (tmp_path / f"{name}.mp4").unlink()
    stills = open_rig(tmp_path)
    assert (stills.frame_count, stills.fps) == (1, None)
    assert [source.path.suffix for source in stills.sources] == [".png"] * 3


def test_colmap_several_images_of_one_fixed_camera(tmp_path: Path, make: Any) -> None:
    for name in NAMES:
        make.pictures(tmp_path / name)
    images = [f"{name}/{k:04d}.png" for name in NAMES for k in (0, 1)]
    make.colmap_model(tmp_path / "sparse" / "0", images, text=True, indices=[0, 0, 1, 1, 2, 2])
    check_poses(open_rig(tmp_path), make)


def test_rigs_and_frames_files_of_new_colmap_are_ignored(tmp_path: Path, make: Any) -> None:
    make.colmap(tmp_path, text=False)
    for name in ("rigs.bin", "frames.bin"):
        (tmp_path / "sparse" / "0" / name).write_bytes(b"\xff" * 9)
    check_poses(open_rig(tmp_path), make)


def test_nerfstudio_videos(tmp_path: Path, make: Any) -> None:
    rig = open_rig(make.nerfstudio(tmp_path))
    assert (rig.layout, [camera.name for camera in rig.cameras]) == ("nerfstudio", NAMES)
    check_poses(rig, make)
    check_frames(rig, make)
    camera = rig.cameras[0]
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (60, 61, 31, 25)
    assert (camera.distortion_model, camera.distortion) == ("opencv", (0.1, -0.02, 0.003, -0.004, 0.0))


def test_nerfstudio_picture_per_entry_and_time(tmp_path: Path, make: Any) -> None:
    paths, indices, times = [], [], []
    for i, name in enumerate(NAMES):
        make.pictures(tmp_path / name / "images")
        for k in (3, 0, 4, 2, 1):  # any order
            paths.append(f"./{name}/images/{k:04d}")  # no suffix, as in Blender's files
            indices.append(i)
            times.append(k / 4)
    values = make.transforms_values(paths, indices=indices)
    for frame, time in zip(values["frames"], times, strict=True):
        frame["time"] = time
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    rig = open_rig(tmp_path)
    assert [camera.name for camera in rig.cameras] == NAMES
    check_poses(rig, make)
    check_frames(rig, make)


def test_nerfstudio_one_picture_per_camera_and_field_of_view(tmp_path: Path, make: Any) -> None:
    for i, name in enumerate(NAMES):
        make.pictures(tmp_path / "images", frames=i + 1)
        (tmp_path / "images" / "0000.png").rename(tmp_path / "images" / f"{name}.png")
    values = make.transforms_values([f"images/{name}.png" for name in NAMES])
    shared = {"camera_angle_x": 2 * np.arctan(0.5)}  # focal length = width
    (tmp_path / "transforms.json").write_text(json.dumps({**shared, "frames": values["frames"]}))
    rig = open_rig(tmp_path)
    assert ([camera.name for camera in rig.cameras], rig.frame_count) == (NAMES, 1)
    check_poses(rig, make)
    camera = rig.cameras[2]
    np.testing.assert_allclose((camera.fx, camera.fy, camera.cx, camera.cy), (64, 64, 32, 24), atol=1e-12)


def test_nerfstudio_fisheye_and_own_intrinsics(tmp_path: Path, make: Any) -> None:
    values = make.transforms_values([f"{name}.mp4" for name in NAMES])
    values["frames"][1] |= {"camera_model": "OPENCV_FISHEYE", "fl_x": 50, "k3": 0.25, "k4": 0.125, "p1": 0, "p2": 0}
    rig = open_rig(make.nerfstudio(tmp_path, values))
    assert [camera.fx for camera in rig.cameras] == [60, 50, 60]
    assert rig.cameras[1].distortion_model == "fisheye"
    assert rig.cameras[1].distortion == (0.1, -0.02, 0.25, 0.125)


@pytest.mark.parametrize(("model", "kept"), [("OPENCV", "none"), ("OPENCV_FISHEYE", "fisheye")])
def test_coefficients_of_zero_make_a_pinhole_but_an_equidistant_fisheye(
    tmp_path: Path, make: Any, model: str, kept: str
) -> None:
    values = make.transforms_values([f"{name}.mp4" for name in NAMES])
    values["frames"][1] |= {"camera_model": model} | dict.fromkeys(("k1", "k2", "k3", "k4", "p1", "p2"), 0)
    camera = open_rig(make.nerfstudio(tmp_path, values)).cameras[1]
    assert (camera.distortion_model, camera.distortion) == (kept, (0, 0, 0, 0) if kept == "fisheye" else ())


def test_rig_json_and_its_pixel_convention(tmp_path: Path, make: Any) -> None:
    rig = open_rig(make.rig_json(tmp_path))
    assert (rig.layout, [camera.name for camera in rig.cameras]) == ("rig.json", NAMES)
    assert (rig.fps, rig.source_text, rig.licence, rig.points) == (30, "synthetic", "none", None)
    assert rig.length_unit == ""
    check_poses(rig, make)
    check_frames(rig, make)
    # 30.5, 24.5 in the file: there the first pixel's centre is (0, 0), here it is (0.5, 0.5).
    assert [(camera.cx, camera.cy) for camera in rig.cameras] == [(31, 25)] * 3
    values = make.rig_json_values() | {"pixel_convention": "the centre of the top-left pixel is (0.5, 0.5)"}
    values["length_unit"] = "cm"
    (tmp_path / "rig.json").write_text(json.dumps(values))
    assert open_rig(tmp_path).cameras[0].cx == 30.5


def test_all_layouts_project_alike(tmp_path: Path, make: Any) -> None:
    rigs = [
        open_rig(make.colmap(tmp_path / "colmap", text=False, lens="OPENCV")),
        open_rig(make.nerfstudio(tmp_path / "nerfstudio")),
        open_rig(make.rig_json(tmp_path / "rig_json")),
    ]
    pixels = [[project(camera, WORLD_POINT) for camera in rig.cameras] for rig in rigs]
    np.testing.assert_allclose(pixels[1], pixels[0], atol=1e-9)  # float64, some ten operations
    np.testing.assert_allclose(pixels[2], pixels[0], atol=1e-9)


def test_points_of_a_colmap_model_beside_rig_json(tmp_path: Path, make: Any) -> None:
    make.rig_json(tmp_path)
    make.colmap_model(tmp_path / "sparse" / "0", [f"{name}.png" for name in NAMES], text=True)
    rig = open_rig(tmp_path)
    assert rig.layout == "rig.json"
    assert rig.points is not None
    np.testing.assert_array_equal(rig.points.rgb, [rgb for _, rgb in make.points])


def test_camera_with_a_pose_of_few_digits_is_made_rigid(tmp_path: Path, make: Any) -> None:
    values = make.rig_json_values()
    for record in values["cameras"]:
        record["world_to_camera"] = np.round(record["world_to_camera"], 4).tolist()
    rig = open_rig(make.rig_json(tmp_path, values))
    rotation = rig.cameras[0].world_to_camera[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)


def test_the_calibration_named_is_the_one_used(tmp_path: Path, make: Any) -> None:
    make.n3dv(tmp_path)
    make.colmap(tmp_path, text=False)
    make.nerfstudio(tmp_path)
    assert open_rig(tmp_path / "poses_bounds.npy").layout == "n3dv"
    assert open_rig(tmp_path / "transforms.json").layout == "nerfstudio"
    assert open_rig(tmp_path / "sparse" / "0").layout == "colmap"
    assert open_rig(tmp_path / "sparse" / "0" / "cameras.bin").layout == "colmap"


_OPENED: list[str] | None = None


def _note_opened(event: str, arguments: tuple[Any, ...]) -> None:
    if _OPENED is not None and event in ("open", "os.listdir", "os.scandir"):
        _OPENED.append(str(arguments[0]))


sys.addaudithook(_note_opened)


@pytest.mark.parametrize("layout", ["n3dv", "colmap", "nerfstudio", "rig_json"])
def test_ground_truth_beside_the_frames_is_never_read(tmp_path: Path, make: Any, layout: str) -> None:
    global _OPENED
    options = {"text": True} if layout == "colmap" else {}
    getattr(make, layout)(tmp_path, **options)
    clean = open_rig(tmp_path)
    (tmp_path / "scene.json").write_text("{broken")
    (tmp_path / "truth").mkdir()
    for name in ("cam00.mp4", "cam00.png", "cameras.bin", "poses_bounds.npy"):
        (tmp_path / "truth" / name).write_bytes(b"broken")
    _OPENED = []
    try:
        rig = open_rig(tmp_path)
        count = sum(1 for _ in read_frames(rig))
        opened = list(_OPENED)
    finally:
        _OPENED = None
    assert count == make.frames
    assert opened
    # Looking whether a folder holds pictures lists its names; nothing in it is opened.
    assert [path for path in opened if "scene.json" in path or "/truth/" in path] == []
    assert [camera.name for camera in rig.cameras] == [camera.name for camera in clean.cameras]
    assert rig.points is None or len(rig.points) == len(make.points)


def test_the_sample_rig_is_n3dv() -> None:
    rig = open_rig(Path(__file__).parents[2] / "demo" / "workbench")
    assert (rig.layout, len(rig.cameras), rig.frame_count, rig.fps) == ("n3dv", 13, 9, 30.0)
    # cam00's row: position and focal length as in the file's columns.
    row = np.load(rig.path / "poses_bounds.npy")[0, :15].reshape(3, 5)
    np.testing.assert_allclose(camera_centre(rig.cameras[0]), row[:, 3], atol=1e-9)
    assert (rig.cameras[0].fx, rig.cameras[0].cx, rig.cameras[0].cy) == (row[2, 4], 176, 132)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "tolerance"),
    # rig.json and the COLMAP model state the same cameras twice, half a pixel apart by convention.
    [("real/panoptic_basketball", 1e-6), ("real/mouse_cage_8cam", 1e-6), ("real_static/n3dv_flame_steak_frame0", 1e-6)],
)
def test_rig_json_and_colmap_agree_on_real_rigs(
    shared_data: Callable[[str], Path], scene: str, tolerance: float
) -> None:
    folder = shared_data(scene)
    by_json, by_colmap = open_rig(folder), open_rig(folder / "sparse" / "0")
    assert (by_json.layout, by_colmap.layout) == ("rig.json", "colmap")
    assert [camera.name for camera in by_json.cameras] == [camera.name for camera in by_colmap.cameras]
    for one, other in zip(by_json.cameras, by_colmap.cameras, strict=True):
        np.testing.assert_allclose(
            (one.fx, one.fy, one.cx, one.cy), (other.fx, other.fy, other.cx, other.cy), atol=tolerance
        )
        np.testing.assert_allclose(one.world_to_camera, other.world_to_camera, rtol=1e-6, atol=tolerance)
    assert by_json.points is not None
    assert by_colmap.points is not None
    np.testing.assert_array_equal(by_json.points.xyz, by_colmap.points.xyz)
