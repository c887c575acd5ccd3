"""An EXR as a compositing program reads it: over, coverage, depth, dynamic part, motion vectors and camera matrices."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from decogs.codec.packets.corrections import Correction
from decogs.decoder import decode, open_stream, render_view
from decogs.decoder.output.exr import NOTHING_SEEN, Layers, coverage, linear_light, save_exr, without_background
from decogs.decoder.rasterise import Rendering
from decogs.decoder.rendering.compositing import _pixels
from decogs.decoder.rendering.views import recorded_colour
from decogs.formats.cameras import Camera, project
from decogs.formats.errors import UsageError

POSE = np.array([[0.8, 0, -0.6, 0.1], [0, 1, 0, -0.2], [0.6, 0, 0.8, 0.3], [0, 0, 0, 1.0]])
CAMERA = Camera("c", 8, 6, 7.0, 9.0, 4.5, 2.5, POSE)


def channels_of(path: Path) -> dict[str, np.ndarray]:
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: np.array(channel.pixels) for name, channel in file.channels().items()}


def attribute(path: Path, name: str, size: int) -> bytes:
    """The bytes of a header attribute, found as "OpenEXR File Layout" has it: name, type, int size, value."""
    data = path.read_bytes()
    at = data.index(name.encode() + b"\0") + len(name) + 1
    at = data.index(b"\0", at) + 1
    assert struct.unpack_from("<i", data, at)[0] == size
    return data[at + 4 : at + 4 + size]


def some_rendering() -> Rendering:
    random = np.random.default_rng(2)
    alpha = random.uniform(0.01, 1, (6, 8)).astype(np.float32)
    alpha[0, 0] = 0
    colour = random.uniform(0, 1, (6, 8, 3)).astype(np.float32) * alpha[..., None]
    image = colour + (1 - alpha[..., None]) * np.array([0.2, 0.5, 0.9], np.float32)
    return Rendering(image, alpha, np.where(alpha > 0, np.float32(4.5), np.float32(0)))


@pytest.mark.parametrize("background", [(0.0, 0.0, 0.0), None])
def test_light_above_half_precision_is_the_brightest_that_it_holds(
    tmp_path: Path, background: tuple[float, float, float] | None
) -> None:
    rendering = some_rendering()
    rendering.image[1, 2], rendering.alpha[1, 2] = 500, 1  # 2.6 million in linear light
    save_exr(tmp_path / "x.exr", rendering, Layers(CAMERA, background), fps=24)
    assert channels_of(tmp_path / "x.exr")["R"][1, 2] == 65504


def test_over_the_streams_background_is_the_picture(tmp_path: Path) -> None:
    """``over`` as Porter and Duff 1984 have it, in linear light, from the file's own numbers."""
    rendering, background = some_rendering(), (0.2, 0.5, 0.9)
    save_exr(tmp_path / "x.exr", rendering, Layers(CAMERA, background), fps=24)
    seen = channels_of(tmp_path / "x.exr")
    assert {name: str(plane.dtype) for name, plane in seen.items()} == {
        "R": "float16", "G": "float16", "B": "float16", "A": "float16", "Z": "float32", "trained.A": "float16",
    }  # fmt: skip
    rgb, alpha = np.stack([seen[name] for name in "RGB"], -1).astype(float), seen["A"].astype(float)[..., None]
    over = rgb + (1 - alpha) * linear_light(np.array(background, np.float32))
    np.testing.assert_allclose(over, linear_light(rendering.image), atol=2**-10)  # two half-precision terms
    np.testing.assert_array_equal(rgb[0, 0], 0)
    np.testing.assert_array_equal(seen["Z"] == np.float32(NOTHING_SEEN), rendering.alpha == 0)
    np.testing.assert_array_equal(seen["Z"][rendering.alpha > 0], 4.5)
    np.testing.assert_allclose(seen["trained.A"], rendering.alpha, atol=2**-12)


def test_over_black_is_the_colour_itself() -> None:
    image = some_rendering().image
    np.testing.assert_array_equal(without_background(image, np.zeros((6, 8)), (0, 0, 0)), linear_light(image))


def test_coverage_is_whole_where_paint_is_dark() -> None:
    np.testing.assert_allclose(coverage(np.array([0, 0.05, 0.1, 0.2, 0.5, 1], np.float32)), [0, 0.25, 0.5, 1, 1, 1])


def test_an_empty_pixel_stays_empty_through_a_camera_that_drifts() -> None:
    correction = Correction(exposure=40)
    background = recorded_colour((0.2, 0.5, 0.9), correction)
    assert background != (0.2, 0.5, 0.9)
    image = np.full((1, 1, 3), background, np.float32)
    np.testing.assert_allclose(without_background(image, np.zeros((1, 1), np.float32), background), 0, atol=1e-7)


def test_matrices_project_as_the_camera_does(tmp_path: Path) -> None:
    """Read as Nuke's camera scripts do: 16 floats, row vectors, translation last; NDC -1..1 with y upwards."""
    save_exr(tmp_path / "x.exr", some_rendering(), Layers(CAMERA, (0, 0, 0)), fps=30000 / 1001)
    to_camera, to_ndc = (
        np.frombuffer(attribute(tmp_path / "x.exr", name, 64), "<f4").reshape(4, 4)
        for name in ("worldToCamera", "worldToNDC")
    )
    points = np.random.default_rng(3).uniform([-1, -1, 2], [1, 1, 4], (20, 3))
    u, v, depth = project(CAMERA, points)
    rows = np.concatenate([points, np.ones((20, 1))], axis=1)
    x, y, z, w = (rows @ to_ndc).T
    np.testing.assert_allclose(x / w, 2 * u / 8 - 1, atol=1e-5)
    np.testing.assert_allclose(y / w, 1 - 2 * v / 6, atol=1e-5)
    assert ((z / w > 0) & (z / w < 1)).all()
    in_camera = rows @ to_camera
    np.testing.assert_allclose(in_camera[:, 2], depth, atol=1e-5)
    np.testing.assert_allclose(in_camera[:, 1] * 9 / depth, 2.5 - v, atol=1e-4)
    assert struct.unpack("<iI", attribute(tmp_path / "x.exr", "framesPerSecond", 8)) == (30000, 1001)


def test_what_is_behind_a_camera_lies_nowhere_in_its_picture() -> None:
    pixels = _pixels(CAMERA, np.array([[0.1, 0.2, 2.0], [0.1, 0.2, -2.0]], np.float32))
    assert np.isfinite(pixels).all(axis=1).tolist() == [True, False]


@pytest.mark.parametrize("view", ["cam00", "cam01", "wide"])
def test_what_changes_and_where_it_goes(small_stream, tmp_path: Path, view: str) -> None:
    """Frame 1 moves rows 5 to 14 by 300 lattice steps along x, y and z; everything else of the segment stands still."""
    decode(small_stream.path, tmp_path / "f_%d.exr", view=view, frames=slice(0, 3))
    zero, one, two = (channels_of(tmp_path / f"f_{t}.exr") for t in range(3))
    assert "backward.u" not in zero
    assert "forward.u" in two, "frame 3 was not asked for, but is known"
    for name in ("forward.u", "forward.v"):
        assert not one[name].any(), "frame 2 skips"
    moved = np.hypot(zero["forward.u"], zero["forward.v"]) > 0.1
    assert 0 < moved.mean() < 0.9
    assert np.abs(np.hypot(one["backward.u"], one["backward.v"])).max() > 0.1
    with open_stream(small_stream.path) as stream:
        first, second = stream.frames(0, 2)
        camera = next(c for c in stream.header.cameras if c.name == view)
        only = slice(9, 10)
        alone = replace(
            first.splats,
            **{name: value[only] for name, value in vars(first.splats).items()},
        )
        seen = render_view(stream.header, alone, view)
        assert seen.alpha.max() > 0.2
        before, after = (project(camera, frame.splats.means[only]) for frame in (first, second))
    if camera.distortion_model == "none":
        # A pixel that hardly shows anything but this Gaussian moves as it does.
        u, v = (float(after[k][0] - before[k][0]) for k in range(2))
        y, x = np.unravel_index(seen.alpha.argmax(), seen.alpha.shape)
        got = np.array([zero["forward.u"][y, x], zero["forward.v"][y, x]])
        assert got @ [u, -v] > 0
        assert np.hypot(*got) <= np.hypot(u, v) * 1.5


def test_a_lone_gaussian_moves_by_its_pixels(tmp_path: Path) -> None:
    """One Gaussian, two positions, two cameras: the vectors are the difference of its projections."""
    from decogs.codec.header.header import StreamHeader
    from decogs.codec.packets.deltas import apply_delta, difference
    from decogs.codec.packets.keyframes import keyframe_state
    from decogs.codec.packets.syntax import write_delta, write_key
    from decogs.codec.scene.lattice import default_lattice, quantise
    from decogs.codec.scene.state import take_rows
    from decogs.decoder.cameras.path import CameraPath
    from decogs.formats.splats import Splats
    from decogs.formats.stream.container import PacketKind, StreamWriter

    scene = Splats(
        np.array([[0, 0, 2]], np.float32), np.full((1, 3), -2, np.float32), np.array([[1, 0, 0, 0]], np.float32),
        np.array([3], np.float32), np.zeros((1, 1, 3), np.float32),
    )  # fmt: skip
    lattice = default_lattice(2.0)
    cameras = [
        Camera("a", 64, 48, 60.0, 60.0, 32.0, 24.0, np.eye(4)),
        replace(CAMERA, width=64, height=48, fx=50, fy=50, cx=30, cy=20),
    ]
    cameras[1] = replace(cameras[1], world_to_camera=np.eye(4) + np.array([[0] * 4, [0, 0, 0, 0.1], [0] * 4, [0] * 4]))
    state, _ = keyframe_state(quantise(scene, lattice))
    with (tmp_path / "s.dgs").open("wb") as file:
        writer = StreamWriter(file, StreamHeader(tuple(cameras), lattice, sh_degree=0).to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state).payload)
        there = take_rows(state, np.array([0]))
        there = replace(there, means=there.means + np.array([[500, -300, 100]], np.int32))
        delta = difference(state, np.array([0]), there)
        writer.write(PacketKind.DELTA, 1, write_delta(state, delta).payload)
        apply_delta(state, delta)
        writer.finish()
    path = CameraPath(tuple(cameras), (0.0, 1.0))
    decode(tmp_path / "s.dgs", tmp_path / "x_%d.exr", camera=path)
    with open_stream(tmp_path / "s.dgs") as stream:
        places = [project(camera, frame.splats.means) for camera, frame in zip(cameras, stream.frames(), strict=True)]
    moved = np.array([places[1][0] - places[0][0], places[0][1] - places[1][1]])[:, 0]
    assert np.hypot(*moved) > 2
    zero, one = (channels_of(tmp_path / f"x_{t}.exr") for t in range(2))
    for seen, name, expected in ((zero, "forward", moved), (one, "backward", -moved)):
        shows = seen["trained.A"] > 0.05
        assert shows.any()
        for k, axis in enumerate("uv"):
            np.testing.assert_allclose(seen[f"{name}.{axis}"][shows], expected[k], atol=1e-3)  # float32 colours
            assert not seen[f"{name}.{axis}"][seen["trained.A"] == 0].any()
        np.testing.assert_allclose(seen["dynamic.A"][shows], seen["A"][shows], atol=1e-3)
    decode(tmp_path / "s.dgs", tmp_path / "one.exr", camera=path, frames=slice(1, 2))
    np.testing.assert_array_equal(channels_of(tmp_path / "one.exr")["backward.u"], one["backward.u"])


def test_damage_elsewhere_costs_the_dynamic_part_only(small_stream, tmp_path: Path) -> None:
    """Strictly read, frames 0 and 1 are whole; what ever changes is not known when frame 5 is not."""
    data = bytearray(small_stream.path.read_bytes())
    at = -1
    for _ in range(7):  # the header's packet, then those of frames 0 to 5
        at = data.index(b"DGSP", at + 1)
    data[at + 40] ^= 255
    small_stream.path.write_bytes(data)
    said: list[str] = []
    decode(small_stream.path, tmp_path / "f_%d.exr", view="cam00", frames=slice(2), strict=True, on_warning=said.append)
    assert len(said) == 1
    assert said[0].startswith("dynamic.A is left out")
    assert "dynamic.A" not in channels_of(tmp_path / "f_1.exr")


def test_a_followed_stream_has_no_dynamic_part(small_stream, tmp_path: Path) -> None:
    decode(small_stream.path, tmp_path / "f_%d.exr", view="cam00", follow=True, idle=0.1)
    seen = channels_of(tmp_path / "f_7.exr")
    assert "dynamic.A" not in seen
    assert "backward.u" in seen
    assert "forward.u" not in seen


def test_a_file_that_cannot_be_written_is_named_as_the_user_knows_it(tmp_path: Path) -> None:
    """It is written in a hidden folder, which is gone afterwards."""
    with pytest.raises(UsageError, match=r"^x\.exr: the EXR cannot be written \(") as raised:
        save_exr(tmp_path / ".decogs-hidden" / "x.exr", some_rendering(), Layers(CAMERA, (0, 0, 0)), fps=24)
    assert "hidden" not in str(raised.value)
