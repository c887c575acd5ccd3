"""A subject without a background, going out: its alpha over any background is the picture over that background."""

from __future__ import annotations

from pathlib import Path

import av
import cv2
import numpy as np
import OpenEXR
import pytest

from decogs.codec.packets.corrections import CorrectedCameras, Correction
from decogs.decoder import decode, info, open_stream, render_view
from decogs.decoder.commands import decode_main, info_main
from decogs.decoder.output.exr import linear_light
from decogs.decoder.output.video import VideoSettings
from decogs.decoder.rendering.layouts import Stereo
from decogs.formats.colours.srgb import srgb_from_linear
from decogs.formats.errors import UsageError
from packets import with_header

BACKGROUNDS = ((0.9, 0.2, 0.5), (0.1, 0.7, 0.3))
LEAST_DB = 50
VIEWS = ("cam00", "cam01", "wide")


@pytest.fixture
def subject(small_stream, tmp_path: Path) -> Path:
    return with_header(small_stream.path, tmp_path / "subject.dgs", subject=True)


def over(colours: np.ndarray, alpha: np.ndarray, background: tuple[float, float, float]) -> np.ndarray:
    """Porter and Duff's over, of straight colours."""
    return alpha[..., None] * colours + (1 - alpha[..., None]) * np.array(background)


def psnr(one: np.ndarray, other: np.ndarray) -> float:
    return float(10 * np.log10(1 / np.mean((one.clip(0, 1) - other.clip(0, 1)) ** 2)))


def png(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Colours 0 to 1, and what is left of alpha."""
    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED) / 255
    assert picture.shape[2] == 4
    return picture[..., 2::-1], picture[..., 3]


def rendered(stream: Path, view: str, background: tuple[float, float, float]) -> np.ndarray:
    with open_stream(stream) as opened:
        frame = next(opened.frames())
        how = {"background": background, "corrections": frame.corrections}
        return render_view(opened.header, frame.splats, view, **how).image


@pytest.mark.parametrize("view", VIEWS)
def test_png_over_two_backgrounds_is_the_picture_over_them(subject: Path, tmp_path: Path, view: str) -> None:
    decode(subject, tmp_path / "x.png", view=view, frames=slice(0, 1))
    colours, alpha = png(tmp_path / "x.png")
    assert alpha.min() == 0
    assert alpha.max() > 0.9
    for background in BACKGROUNDS:
        assert psnr(over(colours, alpha, background), rendered(subject, view, background)) > LEAST_DB


@pytest.mark.parametrize("view", VIEWS)
def test_exr_is_the_png_in_linear_light_premultiplied(subject: Path, tmp_path: Path, view: str) -> None:
    """Programs make a straight PNG linear, then multiply; both then give the same over every background."""
    for name in ("x.png", "x.exr"):
        decode(subject, tmp_path / name, view=view, frames=slice(0, 1))
    colours, alpha = png(tmp_path / "x.png")
    with OpenEXR.File(str(tmp_path / "x.exr"), separate_channels=True) as file:
        seen = {name: channel.pixels.astype(float) for name, channel in file.channels().items()}
        header = file.header()
    assert set("RGBAZ") <= set(seen)
    assert "trained.A" not in seen
    assert "decogs:background" not in header
    premultiplied = np.stack([seen[name] for name in "RGB"], -1)
    np.testing.assert_allclose(seen["A"], alpha, atol=0.51 / 255 + 2**-11)  # rounding to 8 bit and to halves
    assert not premultiplied[seen["A"] == 0].any()
    for background in (linear_light(np.array(colour)) for colour in BACKGROUNDS):
        from_exr = srgb_from_linear((premultiplied + (1 - seen["A"][..., None]) * background).clip(0, 1))
        from_png = srgb_from_linear(over(linear_light(colours), alpha, background))
        assert psnr(from_exr, from_png) > LEAST_DB


def test_prores_over_two_backgrounds_is_the_picture_over_them(subject: Path, tmp_path: Path) -> None:
    decode(subject, tmp_path / "x.mov", view="cam00")
    with av.open(str(tmp_path / "x.mov")) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        assert stream.codec_context.name == "prores"
        assert "yuva444p" in stream.pix_fmt
    assert len(frames) == 8
    planes = {"format": "gbrapf32le", "src_colorspace": "ITU709", "src_color_range": "MPEG", "dst_color_range": "JPEG"}
    green, blue, red, alpha = (
        np.frombuffer(plane, np.float32).reshape(plane.height, -1)[:, : plane.width]
        for plane in frames[0].reformat(**planes).planes
    )
    colours = np.stack([red, green, blue], -1)
    for background in BACKGROUNDS:
        assert psnr(over(colours, alpha, background), rendered(subject, "cam00", background)) > LEAST_DB


@pytest.mark.parametrize("name", ["x.mp4", "x.y4m"])
def test_other_videos_are_over_a_colour(subject: Path, small_stream, tmp_path: Path, name: str) -> None:
    """The stream's own, as a whole scene's, or the one asked for."""
    for stream in (subject, small_stream.path):
        decode(stream, tmp_path / f"{stream.stem}_{name}", view="cam00")
        decode(stream, tmp_path / f"{stream.stem}_white_{name}", view="cam00", background=(1, 1, 1))
    for kind in ("", "white_"):
        one, other = (tmp_path / f"{stream.stem}_{kind}{name}" for stream in (subject, small_stream.path))
        assert one.read_bytes() == other.read_bytes()


def test_a_background_asked_for_leaves_no_alpha(subject: Path, small_stream, tmp_path: Path) -> None:
    for stream in (subject, small_stream.path):
        options = ["--view", "cam00", "--background", "white", "-o", f"{tmp_path / stream.stem}"]
        assert decode_main([str(stream), *options]) == 0
    for name in ("cam00_000000.png", "cam00_000007.png"):
        assert (tmp_path / "subject" / name).read_bytes() == (tmp_path / small_stream.path.stem / name).read_bytes()


def test_an_exr_of_a_subject_takes_no_background(subject: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="an EXR of a subject has no background"):
        decode(subject, tmp_path / "x.exr", view="cam00", background=(0, 0, 0))
    assert not (tmp_path / "x.exr").exists()


def test_a_followed_subject_and_a_stereo_pair_have_alpha(subject: Path, tmp_path: Path) -> None:
    with subject.open("rb") as pipe:
        decode(pipe, tmp_path / "followed", view="cam00")
    decode(subject, tmp_path / "opened", view="cam00")
    for path in (tmp_path / "opened").iterdir():
        assert path.read_bytes() == (tmp_path / "followed" / path.name).read_bytes()
    decode(subject, tmp_path / "x.png", view="cam00", frames=slice(0, 1), layout=Stereo(0.1))
    assert png(tmp_path / "x.png")[1].min() == 0


@pytest.mark.parametrize("view", VIEWS)
def test_a_cameras_colours_are_the_subjects_and_not_the_backgrounds(small_stream, tmp_path: Path, view: str) -> None:
    """What is behind shows as it was asked for, where a camera's exposure and white balance differ."""
    colours = {name: Correction(exposure=2000, red=-900, blue=700) for name in ("cam00", "wide")}
    changes = {"camera_colours": colours, "effects": ("colour_mismatch",), "corrected": CorrectedCameras()}
    subject = with_header(small_stream.path, tmp_path / "subject.dgs", subject=True, **changes)
    decode(subject, tmp_path / "x.png", view=view, frames=slice(0, 1))
    straight, alpha = png(tmp_path / "x.png")
    for background in BACKGROUNDS:
        seen = rendered(subject, view, background)
        assert psnr(over(straight, alpha, background), seen) > LEAST_DB
        # Half a level of alpha, and what a lens's cubic interpolation rings about edges; exposure would shift it by .1.
        np.testing.assert_allclose(seen[alpha == 0] - background, 0, atol=0.01)
    plain = with_header(small_stream.path, tmp_path / "plain.dgs", subject=True)
    decode(plain, tmp_path / "plain.png", view=view, frames=slice(0, 1))
    assert np.array_equal(png(tmp_path / "plain.png")[0], straight) == (view not in colours)


def test_info_says_that_it_is_a_subject(subject: Path, small_stream, capsys: pytest.CaptureFixture[str]) -> None:
    assert info(subject).to_json()["header"]["subject"] is True
    for stream in (subject, small_stream.path):
        assert info_main([str(stream)]) == 0
        assert ("subject      without a background" in capsys.readouterr().out) == (stream == subject)


def test_a_subject_in_a_codec_without_alpha(subject: Path, small_stream, tmp_path: Path) -> None:
    for stream in (subject, small_stream.path):
        decode(stream, tmp_path / f"{stream.stem}.mov", view="cam00", video=VideoSettings(codec="h264"))
    assert (tmp_path / "subject.mov").read_bytes() == (tmp_path / f"{small_stream.path.stem}.mov").read_bytes()
