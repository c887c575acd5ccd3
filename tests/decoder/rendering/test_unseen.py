"""Pictures without what no camera of the rig has seen."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_key
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.decoder import decode
from decogs.decoder.commands import decode_main
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.splats import Splats
from decogs.formats.stream.container import PacketKind, StreamWriter

GREY, RED = 0.0, (1.2, -1.7, -1.7)


def camera(name: str, x: float) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = -x
    return Camera(name, 120, 80, 80.0, 80.0, 60.0, 40.0, pose)


def plane(x: tuple[float, float], z: float, colour: object) -> Splats:
    """A dense sheet of opaque Gaussians that faces the cameras."""
    xs, ys = np.meshgrid(np.arange(*x, 0.06), np.arange(-2.4, 2.4, 0.06))
    means = np.stack([xs.ravel(), ys.ravel(), np.full(xs.size, z)], axis=1)
    count = len(means)
    return Splats(
        means.astype(np.float32),
        np.tile(np.log(np.float32([0.05, 0.05, 0.004])), (count, 1)),
        np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        np.full(count, 5.0, np.float32),
        np.full((count, 1, 3), colour, np.float32),
    )


def stream_of(path: Path, cameras: tuple[Camera, ...], held_out: tuple[str, ...] = ()) -> Path:
    """A grey wall behind a red board, which hides its middle from a camera before it."""
    parts = plane((-6, 6), 4.0, GREY), plane((-0.5, 0.5), 2.0, RED)
    splats = Splats(*(np.concatenate(arrays) for arrays in zip(*(vars(part).values() for part in parts), strict=True)))
    lattice = default_lattice(5.0)
    header = StreamHeader(cameras=cameras, lattice=lattice, fps=30.0, held_out=held_out)
    state, _ = keyframe_state(quantise(splats, lattice))
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state).payload)
        writer.finish()
    return path


def taken(stream: Path, view: Camera | str, **options: object) -> np.ndarray:
    out = stream.with_name("out.png")
    which = {"view": view} if isinstance(view, str) else {"camera": view}
    decode(stream, out, **which, **options)  # type: ignore[arg-type]
    return np.asarray(Image.open(out)).astype(int)


def test_what_nobody_saw_is_transparent_and_the_rest_is_as_it_was(tmp_path: Path) -> None:
    stream = stream_of(tmp_path / "a.dgs", (camera("middle", 0.0),))
    view = camera("free", 2.0)
    drawn, left = taken(stream, view), taken(stream, view, unseen="transparent")
    assert drawn.shape[2] == 3
    alpha = left[..., 3]
    # The wall reaches from x -3 to 3 in the middle camera's picture, of which the board hides -1 to 1.
    x = 2.0 + (np.arange(120) + 0.5 - 60) / 80 * 4
    row = alpha[40]
    board = np.abs(2.0 + (np.arange(120) + 0.5 - 60) / 80 * 2) < 0.45
    assert (row[board] > 250).all()
    for seen, expected in (((np.abs(x) > 1.2) & (np.abs(x) < 2.8) & ~board, 255), ((x > 3.2) & ~board, 0)):
        assert seen.sum() > 5
        assert (np.abs(row[seen] - expected) < 5).all()
    hidden = (np.abs(x) < 0.8) & ~board
    assert hidden.sum() > 5
    assert (row[hidden] < 5).all()
    solid = alpha == 255
    assert np.abs(left[..., :3] - drawn)[solid].max() <= 1


def test_a_camera_sees_what_it_recorded_unless_it_was_left_out(tmp_path: Path) -> None:
    cameras = camera("middle", 0.0), camera("aside", 2.0)
    stream = stream_of(tmp_path / "a.dgs", cameras)
    assert (taken(stream, "aside", unseen="transparent")[4:-4, 4:-4, 3] > 250).mean() > 0.97
    stream = stream_of(tmp_path / "b.dgs", cameras, ("aside",))
    assert (taken(stream, "aside", unseen="transparent")[..., 3] > 250).mean() < 0.7


def test_over_a_background_and_through_a_lens(tmp_path: Path) -> None:
    bent = replace(camera("bent", 2.0), distortion_model="opencv", distortion=(-0.2, 0.0, 0.0, 0.0, 0.0))
    stream = stream_of(tmp_path / "a.dgs", (camera("middle", 0.0),))
    picture = taken(stream, bent, unseen="transparent", background=(0.0, 0.0, 1.0))
    assert picture.shape[2] == 3
    blue = (picture[..., 2] > 240) & (picture[..., 0] < 15)
    assert blue[:, 100:].mean() > 0.9
    assert 0.3 < blue.mean() < 0.7


def test_a_lens_saw_what_it_recorded(tmp_path: Path) -> None:
    """Which is more than a pinhole of its size: a view from its place has all of it, and not what lies beyond."""
    bent = replace(camera("bent", 0.0), distortion_model="opencv", distortion=(-0.12, 0.0, 0.0, 0.0, 0.0))
    stream = stream_of(tmp_path / "a.dgs", (bent,))
    assert (taken(stream, "bent", unseen="transparent")[2:-2, 2:-2, 3] > 250).mean() > 0.99
    wide = replace(camera("free", 0.0), fx=40.0, fy=40.0)
    alpha = taken(stream, wide, unseen="transparent")[40, :, 3]
    straight = stream_of(tmp_path / "b.dgs", (camera("straight", 0.0),))
    narrower = taken(straight, wide, unseen="transparent")[40, :, 3]
    # 60 columns of the pinhole's; the lens bends .75 from .83.
    assert (narrower > 250).sum() == pytest.approx(60, abs=1)
    assert (alpha > 250).sum() == pytest.approx(66, abs=2)


def test_layouts_show_all(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stream = stream_of(tmp_path / "a.dgs", (camera("middle", 0.0),))
    words = [str(stream), "--view", "middle", "-o", str(tmp_path / "o.png"), "--unseen", "transparent"]
    assert decode_main([*words, "--equirectangular"]) == 2
    assert "--unseen: stereo and 360 degree pictures show all" in capsys.readouterr().err
    assert not list(tmp_path.glob("o*"))
    with pytest.raises(UsageError, match="`unseen`"):
        decode(stream, tmp_path / "o.png", view="middle", unseen="smeared")  # type: ignore[arg-type]
