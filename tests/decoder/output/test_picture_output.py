"""What is written for a frame: names, pixels read back, and nothing under the output's name after an error."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.decoder.output.exr import Layers, linear_light
from decogs.decoder.output.pictures import open_sink, to_8bit
from decogs.decoder.rasterise import Rendering
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError


def frame_of(seed: int, width: int = 32, height: int = 24) -> Rendering:
    """A smooth coloured picture with values a little outside 0..1, alpha 0 in the first column."""
    y, x = np.mgrid[:height, :width] / 10
    planes = [0.5 + 0.6 * np.sin(x + seed + k) * np.cos(y - k) for k in range(3)]
    alpha = np.full((height, width), 0.75, np.float32)
    alpha[:, 0] = 0
    return Rendering(np.stack(planes, -1).astype(np.float32), alpha, np.full((height, width), 4.5, np.float32))


LAYERS = Layers(Camera("cam00", 32, 24, 30.0, 30.0, 16.0, 12.0, np.eye(4)), (0.0, 0.0, 0.0))


def write(output: Path | str, frames: list[int], *, fps: float | None = 25.0, view: str = "cam00") -> None:
    with open_sink(output, view=view, frames=len(frames), fps=fps) as sink:
        for frame in frames:
            sink.write(frame, frame_of(frame), LAYERS if sink.has_layers else None)


def read_png(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1]


def names_in(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))


def test_8bit_rounds_to_nearest_and_clips() -> None:
    values = np.array([-1.0, 0.0, 0.49 / 255, 0.51 / 255, 127.4 / 255, 127.6 / 255, 1.0, 7.0])
    np.testing.assert_array_equal(to_8bit(values), [0, 0, 0, 1, 127, 128, 255, 255])
    every = np.arange(256, dtype=np.float32) / np.float32(255)
    np.testing.assert_array_equal(to_8bit(every), np.arange(256))


def test_linear_light_is_the_srgb_standard() -> None:
    """IEC 61966-2-1: 0.5 codes 0.21404 of full light, 0.04045 the end of the straight part."""
    np.testing.assert_allclose(
        linear_light(np.array([0.0, 0.04045, 0.5, 1.0, -0.5])), [0.0, 0.0031308, 0.2140411, 1.0, -0.2140411], atol=2e-7
    )
    assert linear_light(np.array([1.5]))[0] > 1.5


@pytest.mark.parametrize("ending", ["", "/"])
def test_a_folder_holds_one_png_per_frame(tmp_path: Path, ending: str) -> None:
    write(f"{tmp_path}/deep/er/frames{ending}", [8, 9, 10, 100])
    folder = tmp_path / "deep/er/frames"
    assert names_in(folder) == [f"cam00_{t:06d}.png" for t in (8, 9, 10, 100)]
    for t in (8, 100):
        np.testing.assert_array_equal(read_png(folder / f"cam00_{t:06d}.png"), to_8bit(frame_of(t).image))
    assert names_in(tmp_path) == ["deep"]


def test_a_folder_keeps_what_is_in_it(tmp_path: Path) -> None:
    (tmp_path / "note.txt").write_text("mine")
    write(tmp_path, [0])
    write(tmp_path, [0, 1])
    assert names_in(tmp_path) == ["cam00_000000.png", "cam00_000001.png", "note.txt"]


def test_a_view_name_cannot_leave_the_folder(tmp_path: Path) -> None:
    write(tmp_path / "out", [3], view="../../étage 1/cam")
    assert names_in(tmp_path / "out") == ["_.._étage_1_cam_000003.png"]


@pytest.mark.parametrize("suffix", [".png", ".exr"])
def test_names_of_single_files(tmp_path: Path, suffix: str) -> None:
    write(tmp_path / f"one{suffix}", [7])
    write(tmp_path / f"some{suffix}", [7, 8])
    write(tmp_path / f"f_%04d{suffix}", [12])
    write(tmp_path / f"g_%d_x{suffix}", [12])
    write(tmp_path / f"h_####{suffix}", [3, 12])
    write(tmp_path / f"i.$F3{suffix}", [12])
    assert names_in(tmp_path) == sorted(
        f"{name}{suffix}"
        for name in ("one", "some_000007", "some_000008", "f_0012", "g_12_x", "h_0003", "h_0012", "i.012")
    )


@pytest.mark.parametrize("size", [(32, 24), (51, 33)])
def test_mp4_shows_every_frame_at_the_streams_rate(tmp_path: Path, size: tuple[int, int]) -> None:
    with open_sink(tmp_path / "x.mp4", view="cam00", frames=6, fps=29.97) as sink:
        for t in range(6):
            sink.write(t, frame_of(t, *size))
    video = cv2.VideoCapture(str(tmp_path / "x.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(30000 / 1001), "which 29.97 stands for"
    for t in range(6):
        ok, picture = video.read()
        assert ok
        width, height = size
        assert picture.shape == (height + height % 2, width + width % 2, 3)
        difference = picture[:height, :width, ::-1].astype(float) - to_8bit(frame_of(t, *size).image)
        # MPEG-4 at its finest quantiser with 4:2:0 colour: a few grey levels; the next frame differs by tens.
        assert np.abs(difference).mean() < 6
    assert not video.read()[0]
    video.release()


def test_mp4_of_a_stream_without_a_rate(tmp_path: Path) -> None:
    write(tmp_path / "x.mp4", [0, 1], fps=None)
    video = cv2.VideoCapture(str(tmp_path / "x.mp4"))
    assert video.get(cv2.CAP_PROP_FPS) == pytest.approx(30)
    video.release()


@pytest.mark.parametrize("output", ["out", "x.mp4", "x.exr", "x.png"])
@pytest.mark.parametrize("error", [UsageError, KeyboardInterrupt])
def test_an_error_leaves_nothing_behind(tmp_path: Path, output: str, error: type[BaseException]) -> None:
    def interrupted() -> None:
        with open_sink(tmp_path / output, view="cam00", frames=5, fps=25.0) as sink:
            sink.write(0, frame_of(0), LAYERS)
            raise error("stop")

    with pytest.raises(error):
        interrupted()
    assert names_in(tmp_path) == []


def test_an_error_leaves_the_earlier_video_as_it_was(tmp_path: Path) -> None:
    (tmp_path / "x.mp4").write_bytes(b"earlier")
    with pytest.raises(UsageError), open_sink(tmp_path / "x.mp4", view="v", frames=1, fps=1.0):
        raise UsageError("stop")
    assert (tmp_path / "x.mp4").read_bytes() == b"earlier"
    write(tmp_path / "x.mp4", [0])
    assert (tmp_path / "x.mp4").read_bytes() != b"earlier"


def test_a_pipe_is_an_open_file_and_no_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match="open binary file for a pipe"):
        write(Path("-"), [0])
    assert names_in(tmp_path) == []


def test_outputs_that_cannot_be(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    for output, message in (
        ("x.jpg", "not written"),
        ("x.avi", "not written"),
        ("file", "is a file"),
        ("file/x.mp4", "cannot be written"),
        ("file/folder/", "cannot be written"),
    ):
        with pytest.raises(UsageError, match=message):
            write(tmp_path / output, [0])
    assert names_in(tmp_path) == ["file"]
