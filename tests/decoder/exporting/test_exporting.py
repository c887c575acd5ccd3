"""decogs-export: what it writes shows the decoded picture, stands upright, and is named and numbered as asked."""

from __future__ import annotations

import gzip
import hashlib
import io
import re
import struct
import sys
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdValidation

from decogs.codec.header.header import StreamHeader
from decogs.decoder import export, open_stream, render_view
from decogs.decoder.cameras.moves import looked_at
from decogs.decoder.commands import export_main
from decogs.decoder.reading.stream import read_header
from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.errors import UsageError
from decogs.formats.geometry.similarity import Similarity, transformed_splats
from decogs.formats.geometry.up_direction import AXES, turn_between
from decogs.formats.splat_files import splat_formats
from decogs.formats.splats import Splats


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def frames_of(small_stream: Any) -> tuple[Any, list[Splats]]:
    with open_stream(small_stream.path) as stream:
        return stream.header, [frame.splats for frame in stream.frames()]


def turned_camera(camera: Camera, by: Similarity) -> Camera:
    """The camera in a world that was turned and scaled: it sees there what it saw here."""
    pose = camera.world_to_camera.copy()
    pose[:3, :3] = pose[:3, :3] @ by.rotation.T
    pose[:3, 3] *= by.scale
    return replace(camera, world_to_camera=pose)


def psnr(a: np.ndarray, b: np.ndarray) -> float:
    return float(-10 * np.log10(max(1e-20, np.mean((a.astype(float) - b) ** 2))))


# Half a step of every kind of value at once. Of .spz: 2^-15 of a unit, 1/32 of a logarithm of size, 1/510 of opacity,
# 1/1022 of a quaternion's component, 1/76 of the colour's coefficient; .splat has 1/256 of a quaternion's component and
# no view dependence, so that it is compared with the scene without it. glTF has float32 throughout: rounding only.
# .sog has 1/360 of a quaternion's component, and 256 values for sizes and colours.
LEAST_PSNR = {".ply": 120.0, ".glb": 110.0, ".spz": 40.0, ".splat": 40.0, ".sog": 40.0}


@pytest.mark.parametrize("up", ["none", "-Y", "Z", "auto"])
@pytest.mark.parametrize("suffix", sorted(LEAST_PSNR))
def test_a_file_that_is_read_again_shows_the_decoded_picture(
    small_stream: Any, tmp_path: Path, suffix: str, up: Any
) -> None:
    """The camera is turned along with the scene. What is not turned by a file of all bits is equal to the bit."""
    header, frames = frames_of(small_stream)
    export(small_stream.path, tmp_path / f"x_##{suffix}", up=up, frames=slice(2, 4))
    form = splat_formats()[suffix]()
    to = AXES[form.up]
    # The rig's cameras stand upright in COLMAP's axes.
    world_up = AXES["-Y"] if up == "auto" else AXES.get(up, to)
    by = Similarity(turn_between(world_up, to))
    for index in (2, 3):
        splats = form.decode((tmp_path / f"x_0{index}{suffix}").read_bytes())
        shown = frames[index]
        if suffix == ".splat":
            shown = replace(shown, sh=shown.sh[:, :1].copy())
        for camera in header.cameras[:1]:
            expected = render_view(header, shown, camera).image
            found = render_view(header, splats, turned_camera(camera, by)).image
            assert expected.max() > 0.5
            if suffix == ".ply" and by.is_identity:
                np.testing.assert_array_equal(found, expected)
            else:
                assert psnr(found, expected) > LEAST_PSNR[suffix]


def test_turned_and_scaled_splats_look_the_same_to_a_camera_that_went_along(small_stream: Any) -> None:
    """Through SH of degree 1 and the rasteriser. Tolerance: float32 positions, and opacities near a cut of 1/255."""
    header, frames = frames_of(small_stream)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    by = Similarity(turn * np.sign(np.linalg.det(turn)), 2.5)
    camera = header.cameras[0]
    expected = render_view(header, frames[0], camera).image
    found = render_view(header, transformed_splats(frames[0], by), turned_camera(camera, by)).image
    assert psnr(found, expected) > 70
    assert psnr(render_view(header, frames[0], turned_camera(camera, by)).image, expected) < 30, "or it says nothing"


def test_a_half_turn_keeps_bits_and_no_turn_keeps_the_object(small_stream: Any) -> None:
    _, frames = frames_of(small_stream)
    half = Similarity(turn_between(AXES["-Y"], AXES["Y"]))
    again = transformed_splats(transformed_splats(frames[0], half), half)
    np.testing.assert_array_equal(again.means, frames[0].means)
    np.testing.assert_array_equal(again.sh, frames[0].sh)
    np.testing.assert_array_equal(again.quaternions, -frames[0].quaternions)
    assert transformed_splats(frames[0], Similarity(np.eye(3))) is frames[0]


@pytest.mark.parametrize("suffix", [".usdc", ".usda", ".usd", ".usdz"])
def test_usd_stands_upright(small_stream: Any, tmp_path: Path, suffix: str, capsys: Any) -> None:
    """The rig's world has -Y up: in the file its cameras do not hang upside down."""
    path = tmp_path / f"s{suffix}"
    options = ["--first-frame", "1001", "--fps", "24", "--scale-to-metres", "0.5", "--frames", "1:4"]
    assert export_main([str(small_stream.path), "-o", str(path), *options]) == 0
    assert "the world's up, -Y, is Y there" in capsys.readouterr().out
    stage = Usd.Stage.Open(str(path))
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert [error.GetMessage() for error in UsdValidation.ValidationContext(validators).Validate(stage)] == []
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetFramesPerSecond()) == (1002, 1004, 24)
    assert (UsdGeom.GetStageUpAxis(stage), UsdGeom.GetStageMetersPerUnit(stage)) == ("Y", 1)
    world = stage.GetPrimAtPath("/World")
    assert Usd.ModelAPI(world).GetKind() == "component"
    camera = UsdGeom.Xformable(stage.GetPrimAtPath("/World/Cameras/cam00")).ComputeLocalToWorldTransform(1002)
    np.testing.assert_allclose(camera.TransformDir(Gf.Vec3d(0, 1, 0)), [0, 0.5, 0], atol=1e-12)
    positions = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Static")).GetPositionsAttr().Get()
    placed = UsdGeom.Xformable(world).ComputeLocalToWorldTransform(1002).Transform(Gf.Vec3d(positions[0]))
    np.testing.assert_allclose(placed, np.array(positions[0]) * [0.5, -0.5, -0.5], rtol=1e-6)
    assert names(tmp_path) == sorted([path.name, "scene.dgs"])


def test_usd_without_a_turn_has_no_transform(small_stream: Any, tmp_path: Path) -> None:
    for number, up in enumerate(("none", "Y")):
        report = export(small_stream.path, tmp_path / f"{number}.usdc", up=up)  # type: ignore[arg-type]
        stage = Usd.Stage.Open(str(tmp_path / f"{number}.usdc"))
        assert UsdGeom.Xformable(stage.GetPrimAtPath("/World")).GetOrderedXformOps() == []
        assert report.up == (None if up == "none" else "Y")


@pytest.mark.parametrize("said", [True, False])
def test_usd_says_what_it_is(small_stream: Any, tmp_path: Path, said: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    if not said:
        monkeypatch.setattr(
            "decogs.decoder.reading.stream.read_header",
            lambda *given: replace(read_header(*given), source_text="", licence=""),
        )
    export(small_stream.path, tmp_path / "other.usdc")
    stage = Usd.Stage.Open(str(tmp_path / "other.usdc"))
    model = Usd.ModelAPI(stage.GetDefaultPrim())
    assert model.GetAssetName() == "scene"
    assert model.GetAssetVersion() == hashlib.sha256(small_stream.path.read_bytes()).hexdigest()[:12]
    text = stage.GetRootLayer().documentation
    assert text.startswith("scene: free-viewpoint video as 3D Gaussians, from 3 cameras")
    assert text.endswith("CC0") == said


def test_a_usdz_is_the_same_each_time(small_stream: Any, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        export(small_stream.path, tmp_path / folder / "s.usdz")
    assert (tmp_path / "a" / "s.usdz").read_bytes() == (tmp_path / "b" / "s.usdz").read_bytes()
    with zipfile.ZipFile(tmp_path / "a" / "s.usdz") as archive:
        assert [(file.filename, file.date_time[:3]) for file in archive.infolist()] == [("s.usdc", (1980, 1, 1))]


@pytest.mark.parametrize(
    ("name", "frames", "expected"),
    [
        ("x_####.ply", "0:2", ["x_1001.ply", "x_1002.ply"]),
        ("x.$F5.spz", "6:", ["x.01007.spz", "x.01008.spz"]),
        ("deep/er/x_%d.glb", "3:4", ["x_1004.glb"]),
        ("x.splat", ":2", ["x_001001.splat", "x_001002.splat"]),
        ("x.PLY", "5:6", ["x.PLY"]),
    ],
)
def test_files_are_numbered_from_the_first_frame(
    small_stream: Any, tmp_path: Path, name: str, frames: str, expected: list[str], capsys: Any
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    arguments = ["-o", str(out / name), "--frames", frames, "--first-frame", "1001"]
    assert export_main([str(small_stream.path), *arguments]) == 0
    folder = (out / name).parent
    assert names(folder) == expected
    said = capsys.readouterr().out
    assert f"{len(expected)} frame" in said
    assert (" files, " in said) == (len(expected) > 1)


def test_a_scale_moves_and_grows(small_stream: Any, tmp_path: Path) -> None:
    _, frames = frames_of(small_stream)
    export(small_stream.path, tmp_path / "a.ply", up="none", scale_to_metres=3.0, frames=slice(0, 1))
    found = splat_formats()[".ply"]().decode((tmp_path / "a.ply").read_bytes())
    np.testing.assert_allclose(found.means, 3 * frames[0].means, rtol=1e-6)
    np.testing.assert_allclose(np.exp(found.log_scales), 3 * np.exp(frames[0].log_scales), rtol=1e-5)


def test_the_unit_that_the_rig_states_is_the_default(
    small_stream: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """Here a centimetre; what is asked for goes before it."""
    _, frames = frames_of(small_stream)
    read = StreamHeader.from_bytes
    monkeypatch.setattr(StreamHeader, "from_bytes", lambda payload: replace(read(payload), units="centimetre"))
    for options, metres in ((["--frames", ":1"], 0.01), (["--frames", ":1", "--scale-to-metres", "1"], 1)):
        assert export_main([str(small_stream.path), "-o", str(tmp_path / "a.ply"), "--up", "none", *options]) == 0
        found = splat_formats()[".ply"]().decode((tmp_path / "a.ply").read_bytes())
        np.testing.assert_allclose(found.means, metres * frames[0].means, rtol=1e-6)
        assert ("a unit is 0.01 m" in capsys.readouterr().out) == (metres != 1)


def test_the_version_of_spz(small_stream: Any, tmp_path: Path) -> None:
    for version, start in ((2, b"\x1f\x8b"), (3, b"\x1f\x8b"), (4, b"NGSP")):
        arguments = ["-o", str(tmp_path / "a.spz"), "--frames", ":1", "--spz-version", str(version)]
        assert export_main([str(small_stream.path), *arguments]) == 0
        assert (tmp_path / "a.spz").read_bytes().startswith(start)


def test_spz_4_says_how_viewers_may_circle(small_stream: Any, tmp_path: Path) -> None:
    """Adobe's extension: elevations of the cameras about what they look at, 12 degrees more to both sides, and six
    tenths of the nearest one's distance; npm's @adobe/spz 4 reads it so. Older versions have no room for it."""
    sizes = {}
    for version in (3, 4):
        arguments = ["-o", str(tmp_path / "a.spz"), "--frames", ":1", "--spz-version", str(version)]
        assert export_main([str(small_stream.path), *arguments, "--up", "Y", "--scale-to-metres", "2"]) == 0
        sizes[version] = (tmp_path / "a.spz").read_bytes()
    *_, flags, _, streams_at = struct.unpack_from("<IIIBBBBI", sizes[4])
    assert (flags & 2, streams_at) == (2, 52)
    kind, length, low, high, radius = struct.unpack_from("<IIfff", sizes[4], 32)
    assert (kind, length) == (0xADBE0002, 12)
    with open_stream(small_stream.path) as stream:
        cameras = stream.header.cameras
    away = np.array([camera_centre(camera) for camera in cameras]) - looked_at(cameras)
    distances = np.linalg.norm(away, axis=1)
    elevations = np.rad2deg(np.arcsin(away[:, 1] / distances))
    expected = max(elevations.min() - 12, -90), min(elevations.max() + 12, 90)
    np.testing.assert_allclose(np.rad2deg([low, high]), expected, atol=1e-4)
    assert radius == pytest.approx(0.6 * 2 * distances.min())
    assert gzip.decompress(sizes[3])[14] & 2 == 0


@pytest.mark.parametrize(("metres", "fault"), [("1e-3", "sizes of"), ("1", ""), ("1e5", "sizes of")])
def test_sizes_that_spz_clamps_are_said(
    small_stream: Any, tmp_path: Path, capsys: Any, metres: str, fault: str
) -> None:
    arguments = ["-o", str(tmp_path / "a.spz"), "--frames", ":1", "--scale-to-metres", metres]
    assert export_main([str(small_stream.path), *arguments]) == 0
    assert (fault in capsys.readouterr().err) if fault else not capsys.readouterr().err


class Piped(io.BytesIO):
    """A pipe that takes seven bytes at a time."""

    def write(self, data: Any) -> int:
        return super().write(bytes(data[:7]))


@pytest.mark.parametrize("kind", ["ply", ".spz", "GLB", "sog", "usdc"])
def test_a_pipe_takes_what_a_file_would(
    small_stream: Any, tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    suffix = f".{kind.lower().lstrip('.')}"
    export(small_stream.path, tmp_path / f"a{suffix}", frames=slice(2, 3))
    pipe = Piped()
    with monkeypatch.context() as streams:
        streams.setattr(sys, "stdout", io.TextIOWrapper(pipe))
        arguments = ["-o", "-", "--format", kind, "--frames", "2:3"]
        assert export_main([str(small_stream.path), *arguments]) == 0
        assert pipe.getvalue() == (tmp_path / f"a{suffix}").read_bytes()
    assert "1 frame" in capsys.readouterr().err
    assert not Path("-").exists()


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["-o", "a.obj"], "choose one of these endings"),
        (["-o", "folder"], "choose one of these endings"),
        (["-o", "folder/"], "choose one of these endings"),
        (["-o", "taken.ply"], "is a folder"),
        (["-o", "a_##.usdc"], "one USD file holds all frames"),
        (["-o", "a_##_%d.ply"], "2 places for the frame's number"),
        (["-o", "a.ply", "--format", "ply"], "leave `format` out|leave --format out"),
        (["-o", "a.ply", "--spz-version", "4"], "the output is a .ply"),
        (["-o", "a.ply", "--scale-to-metres", "0"], "--scale-to-metres 0: give the metres"),
        (
            ["-o", "a.ply", "--scale-to-metres", "1e39", "--frames", ":1"],
            "not finite; choose another --scale-to-metres",
        ),
        (["-o", "a.spz", "--scale-to-metres", "1e8", "--frames", ":1"], "a.spz: a Gaussian lies .* write .ply"),
        (["-o", "a.usdc", "--fps", "nan"], "'nan' is no rate"),
        (["-o", "a.usdc", "--first-frame", "-1"], "--first-frame -1"),
        (["-o", "a.usdc", "--up", "W"], "invalid choice: 'W'"),
        (["-o", "missing/a.usdc"], "folder does not exist"),
        (["-o", "a.ply", "--frames", "9:"], "choose other --frames"),
        (["-o", "scene.ply", "--frames", ":1"], "is read, as"),
        (["-o", "scene.%d", "--frames", ":1"], "choose one of these endings"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_what_cannot_be_is_one_line_and_no_file(
    small_stream: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any, arguments: list[str], says: str
) -> None:
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    (folder / "taken.ply").mkdir()
    (folder / "folder").mkdir()
    small_stream.path.rename("scene.ply")
    try:
        code = export_main(["scene.ply", *arguments])
    except SystemExit as ended:
        code = ended.code  # type: ignore[assignment]
    assert code == 2
    line = capsys.readouterr().err
    assert re.search(says, line)
    assert len(line.splitlines()) == 1
    assert names(folder) == ["folder", "scene.ply", "taken.ply"]


def test_several_frames_are_no_pipe(small_stream: Any, monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    for arguments, says in (
        (["--format", "ply"], "8 frames are as many .ply files; choose one of the --frames"),
        ([], "say by --format which of .usdc"),
        (["--format", "exr", "--frames", ":1"], "--format exr: exports are"),
    ):
        with monkeypatch.context() as streams:
            streams.setattr(sys, "stdout", io.TextIOWrapper(io.BytesIO()))
            assert export_main([str(small_stream.path), "-o", "-", *arguments]) == 2
        assert says in capsys.readouterr().err


def test_what_a_format_leaves_out_is_said_once_and_first(small_stream: Any, tmp_path: Path, capsys: Any) -> None:
    assert export_main([str(small_stream.path), "-o", str(tmp_path / "a_##.splat")]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 2
    assert "compensation of opacity" in lines[0]
    assert "view dependence (SH degree 1)" in lines[1]
    assert export_main([str(small_stream.path), "-o", str(tmp_path / "a_##.ply")]) == 0
    assert capsys.readouterr().err == ""


def test_an_export_that_fails_leaves_what_was_there(small_stream: Any, tmp_path: Path) -> None:
    (tmp_path / "a_00.ply").write_bytes(b"old")

    def stop(done: int, all: int) -> None:
        if done == 13:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        export(small_stream.path, tmp_path / "a_##.ply", on_frame=stop)
    assert names(tmp_path) == ["a_00.ply", "scene.dgs"]
    assert (tmp_path / "a_00.ply").read_bytes() == b"old"


def test_progress_counts_both_readings(small_stream: Any, tmp_path: Path) -> None:
    for name in ("a_##.ply", "a.usdc"):
        told: list[tuple[int, int]] = []
        export(small_stream.path, tmp_path / name, on_frame=lambda *at, told=told: told.append(at))
        assert told == [(t + 1, 16) for t in range(16)]


def test_a_wrong_up_from_python(small_stream: Any, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="`up` north"):
        export(small_stream.path, tmp_path / "a.ply", up="north")  # type: ignore[arg-type]
