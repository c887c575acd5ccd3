"""Cameras of nerfstudio and USD, written from their own specifications, see what those say they see."""

from __future__ import annotations

import json
import os
import resource
import struct
import time
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdUtils

from decogs.decoder import decode, export
from decogs.decoder.cameras.files import camera_file, read_camera_file
from decogs.decoder.cameras.path import ToFilm, check_pictures
from decogs.formats.cameras import Camera, camera_centre, project
from decogs.formats.errors import UsageError
from decogs.formats.files.trial import try_apart
from decogs.formats.geometry.similarity import Similarity
from decogs.formats.usd.prims import UsdSplats
from decogs.formats.usd.writing import UsdWriter

RIG = Camera("cam00", 640, 480, 500.0, 500.0, 320.0, 240.0, np.eye(4))
FILM = ToFilm((RIG,), fps=25.0, frame_count=11)


@pytest.fixture(autouse=True)
def read_here_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Not in another process first, which takes half a second: what is refused is the same."""
    monkeypatch.setattr("decogs.decoder.cameras.usd.try_apart", lambda *_, **__: None)


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
        ({"fps": 1e-323}, {}, "fps is 9.88131e-324"),
        ({}, {"fov": 1e-323}, "camera 0: fov is 9.88131e-324"),
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
    UsdGeom.SetStageMetersPerUnit(stage, 1)
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


HOSTILE = Path("strangers.usda")


def text_camera(folder: Path, fields: str = "", *, head: str = "", more: str = "", path: Path = HOSTILE) -> Path:
    """A camera 3 units before the origin as text, whose fields can be said anew."""
    given = {line.split("=")[0].split()[-1].partition(".")[0] for line in fields.splitlines() if "=" in line}
    usual = {
        "focalLength": "float focalLength = 24",
        "horizontalAperture": "float horizontalAperture = 36",
        "verticalAperture": "float verticalAperture = 24",
        "xformOp:transform": "matrix4d xformOp:transform = ((1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,3,1))",
        "xformOpOrder": 'uniform token[] xformOpOrder = ["xformOp:transform"]',
    }
    lines = [line for name, line in usual.items() if name not in given]
    text = "\n".join(["#usda 1.0", head, 'def Camera "c" {', *lines, fields, "}", more])
    (folder / path).write_text(text)
    return folder / path


@pytest.mark.parametrize(
    ("fields", "says"),
    [
        ('string focalLength = "x"', "no finite number"),
        ("float[] focalLength = [1, 2]", "no finite number"),
        ("float verticalAperture = nan", "no finite number"),
        ("double focalLength = 1e300", "no finite number"),
        ("float focalLength = 0", "must be above 0"),
        ("double focalLength = 1e-320", "its focal length is not within"),
        ("float2 horizontalApertureOffset = (1, 2)", "no finite number"),
        ('token focalLength.timeSamples = {0: "a", 1: "b"}', "no finite number"),
        ("matrix4d xformOp:transform = ((1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,1e300,1))", r"numbers above 1e\+12"),
        ("matrix4d xformOp:transform = ((1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,nan,1))", "no inverse"),
        ("matrix4d xformOp:transform = ((1,0,0,0), (0,1,0,0), (0,0,1,0), (0,0,3,0))", "is not affine"),
        ('string xformOp:transform = "x"', "cannot make out its transform"),
        ('uniform token[] xformOpOrder = ["xformOp:transform", "xformOp:nope"]', "cannot make out its transform"),
        ('string xformOpOrder = "x"', "no list of tokens"),
        ("float focalLength.spline = {\nbezier,\n1: 5; post held,\n5: 9; post held,\n}", "splines"),
        ("float focalLength.timeSamples = {0.2: 24, 0.7: 25}", "no whole time code"),
    ],
)
def test_a_strangers_usd_values_are_refused_in_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], fields: str, says: str
) -> None:
    with pytest.raises(UsageError, match=rf"strangers\.usda:/c: .*{says}") as caught:
        read_camera_file(text_camera(tmp_path, fields), FILM)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", ""), "OpenUSD's and numpy's warnings"


@pytest.mark.parametrize(
    ("head", "more", "arc"),
    [
        ("(subLayers = [@./pipe.usda@])", "", "sublayers"),
        ("", 'def "r" (references = @./pipe.usda@</a>) {\n}', "references"),
        ("", 'def "r" (payload = @./pipe.usda@</a>) {\n}', "a payload"),
        ("", 'over "o" {\ndef "r" (references = @./pipe.usda@</a>) {\n}\n}', "references"),
        ("", 'def "r" (inherits = </c>) {\n}', "inherits"),
        ("", 'def "r" (specializes = </r/a>) {\n}', "specializes"),
        ("", 'def "r" (variantSets = "v") {\nvariantSet "v" = {\n"a" {\n}\n}\n}', "variants"),
        ("", 'def "r" (clips = {\ndictionary default = {\n}\n}) {\n}', "value clips"),
    ],
)
def test_a_usd_file_that_refers_to_others_is_refused(tmp_path: Path, head: str, more: str, arc: str) -> None:
    os.mkfifo(tmp_path / "pipe.usda")
    with pytest.raises(UsageError, match=rf"strangers\.usda.*: has {arc}, and .*flatten"):
        read_camera_file(text_camera(tmp_path, head=head, more=more), FILM)


def test_nested_references_are_not_composed(tmp_path: Path) -> None:
    """8 levels of 10: composed they are 10^8 prims."""
    levels = ['def "L0" {\n}']
    for level in range(1, 9):
        kids = "".join(f'def "k{k}" (references = </L{level - 1}>) {{\n}}\n' for k in range(10))
        levels.append(f'def "L{level}" {{\n{kids}}}')
    began = time.monotonic()
    with pytest.raises(UsageError, match="has references"):
        read_camera_file(text_camera(tmp_path, more="\n".join(levels)), FILM)
    assert time.monotonic() - began < 5


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ('def "a" {\n' * 20_000 + "}\n" * 20_000, "nested too deep"),
        ('def "a" {\n' * 400 + "}\n" * 400, "more than 256 prims inside each other"),
        ('def "a" {\nint[] x = [' + "1," * 200_000 + "1]\n}", "may take 24 MiB to read.*`max_memory`"),
    ],
    ids=["brackets", "prims", "list"],
)
def test_usd_text_is_bounded_before_it_is_parsed(tmp_path: Path, more: str, says: str) -> None:
    path = text_camera(tmp_path, more=more)
    with pytest.raises(UsageError, match=rf"strangers\.usda: .*{says}"):
        read_camera_file(path, FILM, 20 << 20)


@pytest.mark.parametrize("packed", [False, True])
def test_usd_binary_is_bounded_before_it_is_opened(tmp_path: Path, packed: bool) -> None:
    stage = usd(tmp_path / "many.usdc")
    UsdGeom.Camera.Define(stage, "/c")
    layer = stage.GetRootLayer()
    with Sdf.ChangeBlock():
        for k in range(5000):
            Sdf.CreatePrimInLayer(layer, f"/a{k}")
    layer.Save()
    path = tmp_path / "many.usdc"
    if packed:
        path = tmp_path / "many.usdz"
        assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "many.usdc"), str(path))
    with pytest.raises(UsageError, match=r"many\.usd[cz]: may take \d+ MiB to read.*`max_memory`"):
        read_camera_file(path, FILM, 3 << 20)
    assert len(read_camera_file(path, FILM, 32 << 20).cameras) == 1


def test_a_count_that_fills_memory_ends_another_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OpenUSD believes it: of 3 kB, it took 6 GB and ten seconds."""
    monkeypatch.setattr("decogs.decoder.cameras.usd.try_apart", try_apart)
    path = tmp_path / "shot.usdc"
    usd(path).Save()
    data = bytearray(path.read_bytes())
    (contents,) = struct.unpack_from("<q", data, 16)
    (sections,) = struct.unpack_from("<Q", data, contents)
    begins = dict(struct.unpack_from("<16sq8x", data, contents + 8 + 32 * number) for number in range(sections))
    data[begins[b"STRINGS".ljust(16, b"\0")] + 3] = 128
    path.write_bytes(data)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(UsageError, match=r"shot\.usdc: is (no USD file that OpenUSD can read|damaged)"):
        read_camera_file(path, FILM, 256 << 20)
    kilobytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert kilobytes < 100 << 10
    assert resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss < 2 << 20


@pytest.mark.parametrize(
    "content", [b"", b"PK\3\4", b"PXR-USDC", b"PXR-USDC" + b"\xff" * 99, b"#usda 1.0\n(((", b"x" * 99]
)
@pytest.mark.parametrize("ending", ["usda", "usdc", "usdz", "usd"])
def test_what_is_no_usd_file_is_one_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], content: bytes, ending: str
) -> None:
    path = tmp_path / f"x.{ending}"
    path.write_bytes(content)
    with pytest.raises(UsageError, match=rf"x\.{ending}: ") as caught:
        read_camera_file(path, FILM)
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_a_usd_camera_without_metres_is_in_centimetres(tmp_path: Path) -> None:
    """OpenUSD's fallback for metersPerUnit is .01."""
    (camera,) = read_camera_file(text_camera(tmp_path), FILM).cameras
    np.testing.assert_allclose(camera_centre(camera), [0, 0, 0.03], atol=1e-12)


def test_a_nerfstudio_path_does_not_wait_for_a_pipe_beside_it(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "dataparser_transforms.json")
    path = nerfstudio(tmp_path, [{"camera_to_world": np.eye(4).tolist(), "fov": 50}])
    with pytest.raises(UsageError, match=r"dataparser_transforms\.json: is no file"):
        read_camera_file(path, FILM)


def test_more_camera_json_than_the_memory_holds_is_not_parsed(tmp_path: Path) -> None:
    path = tmp_path / "pose.json"
    path.write_text("[" + "{}," * (1 << 20) + "{}]")
    tracemalloc.start()
    with pytest.raises(UsageError, match=r"pose\.json: has more than 349525 bytes; .*`max_memory`"):
        read_camera_file(path, FILM, 16 << 20)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 1 << 20


@pytest.mark.parametrize("entry", ["{}", "[]", '{"":0}', '{"width":{}}', "0.1", '"ab"', '"\U0001f600"'])
def test_camera_json_that_is_parsed_stays_within_the_memory(tmp_path: Path, entry: str) -> None:
    limit = 16 << 20
    path = tmp_path / "pose.json"
    count = limit // 48 // (len(entry.encode()) + 1) - 1
    path.write_text("[" + ",".join([entry] * count) + "]", encoding="utf-8")
    tracemalloc.start()
    with pytest.raises(UsageError, match=r"camera 0: |at most 131072"):
        read_camera_file(path, FILM, limit)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < limit


def test_a_path_of_the_shortest_entries_stays_within_the_memory(tmp_path: Path) -> None:
    limit = 4 << 20
    entry = '{"width":9,"height":9,"fx":9,"position":[0,0,0],"look_at":[0,0,1],"up":[0,1,0]}'
    (tmp_path / "pose.json").write_text("[" + ",".join([entry] * (limit // 48 // len(entry) - 99)) + "]")
    tracemalloc.start()
    cameras = read_camera_file(tmp_path / "pose.json", FILM, limit).cameras
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert len(cameras) > 900
    assert peak < limit


def test_more_cameras_than_are_rendered_are_refused(tmp_path: Path) -> None:
    (tmp_path / "pose.json").write_text("[" + "0," * (1 << 17) + "0]")
    with pytest.raises(UsageError, match=r"pose\.json: has 131073 cameras; at most 131072"):
        read_camera_file(tmp_path / "pose.json", FILM)
    check_pictures(1 << 17, "pose.json")


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
