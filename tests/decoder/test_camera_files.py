"""Cameras of nerfstudio and USD, written from their own specifications, see what those say they see."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom

from decogs.decoder import decode, export
from decogs.decoder.camera_files import camera_file, read_camera_file
from decogs.decoder.camera_path import ToFilm
from decogs.formats.cameras import Camera, camera_centre, project
from decogs.formats.errors import UsageError
from decogs.formats.similarity import Similarity
from decogs.formats.usd import UsdWriter
from decogs.formats.usd_prims import UsdSplats

RIG = Camera("cam00", 640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(4))
FILM = ToFilm((RIG,), fps=25.0, frame_count=11)


def turn(degrees: float, axis: tuple[float, float, float]) -> np.ndarray:
    return cv2.Rodrigues(np.radians(degrees) * np.array(axis, float))[0]


def opengl(rotation: np.ndarray, position: list[float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation, position
    return matrix


def nerfstudio(folder: Path, entries: list[dict[str, Any]], **fields: Any) -> Path:
    path = folder / "camera_path.json"
    data = {"camera_type": "perspective", "render_height": 100, "render_width": 160, "camera_path": entries} | fields
    path.write_text(json.dumps(data))
    return path


def test_nerfstudio_looks_along_minus_z_with_y_up(tmp_path: Path) -> None:
    """nerfstudio's docs: "+X is right, +Y is up, and +Z is pointing back and away from the camera"."""
    entry = {"camera_to_world": np.eye(4).ravel().tolist(), "fov": 90, "aspect": 1.6}
    path = read_camera_file(nerfstudio(tmp_path, [entry], fps=24), FILM)
    (camera,) = path.cameras
    assert (camera.width, camera.height, camera.fx, camera.fy) == (160, 100, pytest.approx(50), pytest.approx(50))
    u, v, depth = project(camera, np.array([[0.5, 0.25, -1.0]]))
    assert (u[0], v[0], depth[0]) == pytest.approx((80 + 25, 50 - 12.5, 1))
    assert path.fps == 24


def test_nerfstudio_times(tmp_path: Path) -> None:
    entry = {"camera_to_world": np.eye(4).tolist(), "fov": 50}
    assert read_camera_file(nerfstudio(tmp_path, [entry] * 3, fps=50), FILM).times == (0, 0.5, 1)
    assert read_camera_file(nerfstudio(tmp_path, [entry] * 20, fps=25), FILM).times == pytest.approx(
        (*range(11), *[10.0] * 9)
    )
    assert read_camera_file(nerfstudio(tmp_path, [entry] * 12), FILM).times == (*range(11), 10)
    timed = [entry | {"render_time": time} for time in (0, 0.25, 1)]
    assert read_camera_file(nerfstudio(tmp_path, timed, fps=50), FILM).times == (0, 2.5, 10)


def test_nerfstudio_normalisation_is_undone(tmp_path: Path) -> None:
    """dataparser_transforms.json: p_path = scale (transform (p_world, 1))."""
    rotation, shift, scale = turn(50, (0.6, 0, 0.8)), np.array([0.3, -1, 2]), 0.2
    world = opengl(turn(20, (0, 1, 0)), [1.0, 2.0, 3.0])
    in_path = opengl(rotation @ world[:3, :3], scale * (rotation @ world[:3, 3] + shift))
    (tmp_path / "dataparser_transforms.json").write_text(
        json.dumps({"transform": np.column_stack([rotation, shift]).tolist(), "scale": scale})
    )
    path = nerfstudio(tmp_path, [{"camera_to_world": in_path.ravel().tolist(), "fov": 50}])
    (camera,) = read_camera_file(path, FILM).cameras
    np.testing.assert_allclose(camera_centre(camera), [1, 2, 3], atol=1e-9)
    np.testing.assert_allclose(camera.world_to_camera[:3, :3].T, world[:3, :3] @ np.diag([1, -1, -1]), atol=1e-9)


@pytest.mark.parametrize(
    ("fields", "entry", "message"),
    [
        ({"camera_type": "equirectangular"}, {}, "equirectangular.*only perspective"),
        ({"render_width": 0}, {}, "render_width is 0"),
        ({"fps": 0}, {}, "fps is 0"),
        ({"camera_path": []}, {}, "not empty"),
        ({"camera_path": [3]}, {}, "camera 0: a camera must be"),
        ({}, {"fov": 180}, "camera 0: fov is 180"),
        ({}, {"camera_to_world": [1, 2]}, "camera 0: camera_to_world must be 4 by 4"),
        ({}, {"camera_to_world": [2.0] * 16}, "camera 0: the last row"),
        ({}, {"render_time": 2}, "camera 0: render_time is 2"),
    ],
)
def test_nerfstudio_errors(tmp_path: Path, fields: dict[str, Any], entry: dict[str, Any], message: str) -> None:
    good = {"camera_to_world": np.eye(4).tolist(), "fov": 50}
    with pytest.raises(UsageError, match=rf"camera_path\.json: .*{message}"):
        read_camera_file(nerfstudio(tmp_path, [good | entry], **fields), FILM)


def usd(path: Path, *, up: str = "Y", start: float | None = None, end: float | None = None) -> Any:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    stage.SetTimeCodesPerSecond(24)
    if start is not None:
        stage.SetStartTimeCode(start)
        stage.SetEndTimeCode(end)
    return stage


def moving_camera(stage: Any, codes: list[float]) -> Any:
    """As Blender writes it: an object's transform with samples, the camera below it."""
    above = UsdGeom.Xform.Define(stage, "/root/Shot")
    camera = UsdGeom.Camera.Define(stage, "/root/Shot/Camera")
    operation = above.AddTransformOp()
    for code in codes:
        matrix = opengl(turn(5 + 3 * code, (0.6, 0.8, 0)), [0.5 + code / 10, 1.0, 4.0])
        operation.Set(Gf.Matrix4d(matrix.T.tolist()), code)
        camera.CreateFocalLengthAttr().Set(35 + code, code)
    camera.CreateHorizontalApertureAttr(36.0)
    camera.CreateVerticalApertureAttr(20.25)
    camera.CreateHorizontalApertureOffsetAttr(1.5)
    camera.CreateVerticalApertureOffsetAttr(-0.75)
    return camera


def seen_by_usd(camera: Any, code: float, point: list[float]) -> tuple[float, float]:
    """Where OpenUSD's own frustum has a point of the stage: x to the right and y up, -1 to 1."""
    frustum = camera.GetCamera(Usd.TimeCode(code)).frustum
    matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    x, y, _ = matrix.Transform(Gf.Vec3d(point))
    return x, y


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_a_moving_usd_camera_sees_what_usd_says(tmp_path: Path, up: str) -> None:
    stage = usd(tmp_path / "shot.usda", up=up)
    camera = moving_camera(stage, [0.0, 4.0])
    stage.GetRootLayer().Save()
    path = read_camera_file(tmp_path / "shot.usda", FILM)
    assert path.fps == 24
    assert path.times == pytest.approx([code * 25 / 24 for code in range(5)])
    for code, shown in enumerate(path.cameras):
        assert (shown.width, shown.height) == (640, 360)
        x, y = seen_by_usd(camera, code, [0.7, 0.9, 0.2])
        # A y-up scene is turned when a z-up program imports it: (x, y, z) there is (x, z, -y) here.
        there = [0.7, 0.9, 0.2] if up == "Y" else [0.7, 0.2, -0.9]
        u, v, depth = project(shown, np.array([there]))
        assert depth[0] > 0
        assert (2 * u[0] / 640 - 1, 1 - 2 * v[0] / 360) == pytest.approx((x, y), abs=1e-5)


def test_the_stage_says_which_codes_are_pictures(tmp_path: Path) -> None:
    stage = usd(tmp_path / "shot.usdc", start=2, end=20)
    moving_camera(stage, [0.0, 30.0])
    stage.GetRootLayer().Save()
    path = read_camera_file(tmp_path / "shot.usdc", FILM)
    assert len(path.cameras) == 19
    assert path.times is not None
    assert path.times[-1] == 10, "the last frame holds"
    stage.SetEndTimeCode(1e9)
    stage.GetRootLayer().Save()
    with pytest.raises(UsageError, match="at most 131072"):
        read_camera_file(tmp_path / "shot.usdc", FILM)


@pytest.mark.parametrize("view", ["cam00"])
def test_an_exported_camera_shows_the_views_own_pixels(small_stream, tmp_path: Path, view: str) -> None:
    export(small_stream.path, tmp_path / "scene.usdc")
    decode(small_stream.path, tmp_path / "out", view=view)
    decode(small_stream.path, tmp_path / "out", camera=f"{tmp_path}/scene.usdc:{view}")
    for t in range(8):
        own, read = (cv2.imread(f"{tmp_path}/out/{name}_{t:06d}.png").astype(int) for name in (view, "camera"))
        assert np.abs(own - read).max() <= 1  # focal length and apertures are float32 there


def test_a_turned_world_is_turned_back(tmp_path: Path) -> None:
    """An export of ours whose /World stands on its head: cameras are still where the stream has them."""
    stage = usd(tmp_path / "scene.usda")
    world = UsdGeom.Xform.Define(stage, "/World")
    UsdGeom.PointInstancer.Define(stage, "/World/Static")
    camera = UsdGeom.Camera.Define(stage, "/World/Cameras/a")
    camera.AddTranslateOp().Set((1.0, 2.0, 3.0))
    world.AddRotateXOp().Set(180)
    stage.GetRootLayer().Save()
    path = read_camera_file(tmp_path / "scene.usda", FILM)
    assert path.times is None
    np.testing.assert_allclose(camera_centre(path.cameras[0]), [1, 2, 3], atol=1e-9)
    np.testing.assert_allclose(path.cameras[0].world_to_camera[:3, :3], np.diag([1, -1, -1]), atol=1e-9)


@pytest.mark.parametrize("scale", [1.0, 0.01])
def test_a_clipping_range_is_the_near_plane_in_the_streams_units(tmp_path: Path, scale: float) -> None:
    """Clipping ranges are in the scene's units, whatever scales the camera: GfCamera's frustum."""
    rig_camera = replace(FILM.cameras[0], name="a", near=0.5)
    frames = [UsdSplats(*(np.ones(shape, np.float32) for shape in ((1, 3), (1, 4), (1, 3), (1, 3), (1,))))]
    with UsdWriter(tmp_path / "scene.usdc", fps=25.0, frames=(0, 0), root=Similarity(np.eye(3), scale)) as writer:
        writer.add_cameras([rig_camera])
        writer.add_group("Static", np.arange(1))
        writer.write_frame("Static", 0, frames[0])
    stage = Usd.Stage.Open(str(tmp_path / "scene.usdc"))
    seen = UsdGeom.Camera(stage.GetPrimAtPath("/World/Cameras/a")).GetCamera(0).frustum.nearFar
    assert seen.min == pytest.approx(max(0.5 * scale, 0.01), rel=1e-6)
    again = read_camera_file(tmp_path / "scene.usdc", FILM).cameras[0]
    assert again.near == pytest.approx(max(0.5, 0.01 / scale), rel=1e-6)


def test_usd_errors(small_stream, tmp_path: Path) -> None:
    stage = usd(tmp_path / "two.usda")
    for name in "ab":
        UsdGeom.Camera.Define(stage, f"/World/{name}")
    stage.GetRootLayer().Save()
    for given, message in (
        ("two.usda", r"has 2 cameras, /World/a, /World/b; name one"),
        ("two.usda:c", r"has no camera 'c'; it has /World/a"),
        ("none.usdc", r"none\.usdc: cannot be read"),
    ):
        with pytest.raises(UsageError, match=message):
            read_camera_file(tmp_path / given, FILM)
    (tmp_path / "broken.usda").write_text("#usda 1.0\n(((")
    with pytest.raises(UsageError, match=r"broken\.usda: is no USD file"):
        read_camera_file(tmp_path / "broken.usda", FILM)
    empty = usd(tmp_path / "empty.usda")
    empty.GetRootLayer().Save()
    with pytest.raises(UsageError, match="has no camera"):
        read_camera_file(tmp_path / "empty.usda", FILM)
    assert camera_file("a.usdc:/World/b") == (Path("a.usdc"), "/World/b")
    assert camera_file("a:b.json") == (Path("a:b.json"), None)


def test_a_usd_cameras_metres_become_the_streams_units(tmp_path: Path) -> None:
    """Of a stream in centimetres; the stage's unit is a decimetre."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "c.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 0.1)
    eye = UsdGeom.Camera.Define(stage, "/eye")
    eye.AddTranslateOp().Set((3, 0, 0))
    eye.CreateClippingRangeAttr((2, 100))
    stage.Save()
    (camera,) = read_camera_file(tmp_path / "c.usda", replace(FILM, metres=0.01)).cameras
    np.testing.assert_allclose(camera_centre(camera), [30, 0, 0], atol=1e-9)
    assert camera.near == pytest.approx(20)
