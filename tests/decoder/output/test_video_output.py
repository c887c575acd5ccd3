"""Videos as players read them: pixels against the PNGs, tags, sound in step, raw video byte by byte, the fallback."""

from __future__ import annotations

import io
import os
import struct
import subprocess
import sys
import wave
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from decogs.decoder import decode
from decogs.decoder.commands import decode_main
from decogs.decoder.output.pictures import open_sink, to_8bit
from decogs.decoder.output.raw_video import RawVideo
from decogs.decoder.output.video import Movie, VideoSettings, halved
from decogs.decoder.rasterise import Rendering
from decogs.formats.errors import UsageError

FRAMES = 8


def pngs(stream: Path, folder: Path, view: str = "cam00") -> list[np.ndarray]:
    decode(stream, folder, view=view)
    return [cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[..., ::-1] for path in sorted(folder.iterdir())]


def frames_of(video: Path) -> list[np.ndarray]:
    """RGB by the tags of the file: BT.709, limited range.

    PyAV before 18 takes BT.601 after all, unless something differs between source and destination: the range does.
    """
    with av.open(str(video)) as container:
        stream = container.streams.video[0]
        frames = list(container.decode(stream))
        assert {(frame.colorspace, frame.color_range) for frame in frames} == {(1, 1)}
        return [
            frame.reformat(
                format="rgb24", src_colorspace="ITU709", src_color_range="MPEG", dst_color_range="JPEG"
            ).to_ndarray()
            for frame in frames
        ]


def psnr(one: list[np.ndarray], other: list[np.ndarray]) -> float:
    assert len(one) == len(other)
    error = np.mean([(a.astype(float) - b[: a.shape[0], : a.shape[1]]) ** 2 for a, b in zip(one, other, strict=True)])
    return float(10 * np.log10(255**2 / error))


@pytest.mark.parametrize(
    ("name", "settings", "codec", "pixels", "least"),
    [
        # 4:2:0 of 64x48 pixels of small colourful blobs, samples repeated: what it can; 4:4:4 has 45 dB.
        ("x.mp4", VideoSettings(), "h264", "yuv420p", 30),
        ("x.mp4", VideoSettings(chroma="444"), "h264", "yuv444p", 45),
        ("x.mp4", VideoSettings(codec="hevc", chroma="444"), "hevc", "yuv444p10le", 45),
        ("x.mov", VideoSettings(), "prores", "yuv444p12le", 45),
        ("x.mov", VideoSettings(codec="h264", chroma="444", crf=0), "h264", "yuv444p", 45),
    ],
    ids=["h264", "h264-444", "hevc-444", "prores", "mov-h264"],
)
def test_a_video_shows_the_pngs(
    small_stream, tmp_path: Path, name: str, settings: VideoSettings, codec: str, pixels: str, least: float
) -> None:
    decode(small_stream.path, tmp_path / name, view="cam00", video=settings)
    with av.open(str(tmp_path / name)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == codec
        assert stream.codec_context.pix_fmt in (pixels, pixels.replace("12", "10"))
        assert stream.average_rate == 25
        assert stream.frames == FRAMES
    assert psnr(pngs(small_stream.path, tmp_path / "png"), frames_of(tmp_path / name)) >= least


def interpolated(samples: np.ndarray) -> np.ndarray:
    """Chroma at full size, by what lies in the middle of four pixels: 3/4 of the nearest sample, 1/4 of the next."""
    for _ in range(2):
        padded = np.pad(samples, ((1, 1), (0, 0)), mode="edge")
        rows = np.stack([0.75 * samples + 0.25 * padded[:-2], 0.75 * samples + 0.25 * padded[2:]], axis=1)
        samples = rows.reshape(-1, samples.shape[1]).T
    return samples


def as_a_browser_shows(path: Path) -> list[np.ndarray]:
    """Chroma interpolated, and BT.709's formulas in limited range: Chromium on a GPU shows the same within .01 dB."""
    shown = []
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            planes = [
                np.frombuffer(p, np.uint8).reshape(p.height, -1)[:, : p.width].astype(float) for p in frame.planes
            ]
            y = (planes[0] - 16) * 255 / 219
            blue, red = ((interpolated(plane) - 128) * 255 / 224 for plane in planes[1:])
            r, b = y + 1.5748 * red, y + 1.8556 * blue
            g = (y - 0.2126 * r - 0.0722 * b) / 0.7152
            shown.append(np.clip(np.rint(np.stack([r, g, b], axis=-1)), 0, 255))
    return shown


def test_chroma_is_what_players_that_interpolate_want() -> None:
    """The pseudoinverse of interpolating, in the middle of a picture; at its rim six terms count the rim."""
    columns = np.array([interpolated(row.reshape(1, -1))[0] for row in np.eye(40)]).T
    samples = np.random.default_rng(0).uniform(-100, 100, (80, 80)).astype(np.float32)
    best = np.linalg.pinv(columns) @ samples @ np.linalg.pinv(columns).T
    np.testing.assert_allclose(
        halved(samples)[8:-8, 8:-8], best[8:-8, 8:-8], atol=1, err_msg="cut off at 3^-6, of 200, along both axes"
    )
    even = np.full((6, 4), 77, np.float32)
    np.testing.assert_allclose(halved(even), 77, rtol=1e-6)


def test_h264_has_45_db_where_chroma_is_interpolated(small_stream, tmp_path: Path) -> None:
    """The default, as browsers show it. With means of four pixels it would be 40.6."""
    decode(small_stream.path, tmp_path / "x.mp4", view="cam00")
    assert psnr(pngs(small_stream.path, tmp_path / "png"), as_a_browser_shows(tmp_path / "x.mp4")) > 45


def test_luma_is_right_whatever_becomes_of_colours(tmp_path: Path) -> None:
    originals = list(np.random.default_rng(1).integers(60, 190, (3, 48, 64, 3)).astype(np.uint8))
    movie = Movie(tmp_path / "x.mp4", 25, VideoSettings(crf=1))
    for picture in originals:
        movie.write(picture)
    movie.finish()
    with av.open(str(tmp_path / "x.mp4")) as container:
        for frame, original in zip(container.decode(video=0), originals, strict=True):
            luma = np.frombuffer(frame.planes[0], np.uint8).reshape(48, -1)[:, :64]
            expected = 16 + 219 / 255 * (original @ np.array([0.2126, 0.7152, 0.0722]))
            assert np.sqrt(np.mean((luma - expected) ** 2)) < 1


def test_the_same_bytes_every_time(small_stream, tmp_path: Path) -> None:
    for name in ("a.mp4", "b.mp4"):
        decode(small_stream.path, tmp_path / name, view="cam00", threads=1 + (name == "b.mp4"))
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()


def test_the_same_bytes_whatever_memory_held_before(tmp_path: Path) -> None:
    """glibc fills what it gives out; x264's mbtree reads what nobody has set."""
    program = f"""
from pathlib import Path
import cv2
import numpy as np
from decogs.decoder.output.video import Movie, VideoSettings
random = np.random.default_rng(0)
movie = Movie(Path({str(tmp_path)!r}) / "x.mp4", 25, VideoSettings())
for _ in range(8):
    noise = random.normal(120, 40, (48, 64, 3)).clip(0, 255).astype(np.uint8)
    movie.write(cv2.GaussianBlur(noise, (0, 0), 2))
movie.finish()
"""
    made = set()
    for fill in ("0", "1", "85"):
        subprocess.run([sys.executable, "-c", program], check=True, env=os.environ | {"MALLOC_PERTURB_": fill})
        made.add((tmp_path / "x.mp4").read_bytes())
    assert len(made) == 1


def test_what_browsers_need_comes_first(small_stream, tmp_path: Path) -> None:
    """ISO/IEC 14496-12: boxes of a length and a name; moov before mdat plays before all is there."""
    decode(small_stream.path, tmp_path / "x.mp4", view="cam00")
    data, at, boxes = (tmp_path / "x.mp4").read_bytes(), 0, []
    while at < len(data):
        boxes.append(data[at + 4 : at + 8])
        at += int.from_bytes(data[at : at + 4], "big")
    assert boxes.index(b"moov") < boxes.index(b"mdat")
    assert b"avc1" in data


def test_crf_costs_quality_and_saves_bytes(small_stream, tmp_path: Path) -> None:
    for crf in ("4", "30"):
        arguments = [str(small_stream.path), "--view", "cam00", "--crf", crf, "-o", str(tmp_path / f"{crf}.mp4")]
        assert decode_main(arguments) == 0
    assert (tmp_path / "30.mp4").stat().st_size < 0.7 * (tmp_path / "4.mp4").stat().st_size


def write_tone(path: Path, seconds: float, rate: int = 44_100) -> None:
    """Silence for a quarter of a second, then 1 kHz."""
    t = np.arange(round(seconds * rate)) / rate
    tone = np.where(t >= 0.25, 0.5 * np.sin(2 * np.pi * 1000 * t), 0)
    with wave.open(str(path), "wb") as file:
        file.setnchannels(1)
        file.setsampwidth(2)
        file.setframerate(rate)
        file.writeframes((tone * 32767).astype("<i2").tobytes())


@pytest.mark.parametrize(("first", "silence"), [(0, 0.25), (2, 0.17), (7, 0.0)])
def test_sound_is_in_step_and_as_long_as_the_pictures(small_stream, tmp_path: Path, first: int, silence: float) -> None:
    """25 frames per second: frame 2 is .08 s into the sound."""
    write_tone(tmp_path / "tone.wav", 3)
    settings = VideoSettings(audio=tmp_path / "tone.wav")
    decode(small_stream.path, tmp_path / "x.mp4", view="cam00", frames=slice(first, None), video=settings)
    with av.open(str(tmp_path / "x.mp4")) as container:
        sound = container.streams.audio[0]
        assert (sound.codec_context.name, sound.rate) == ("aac", 48_000)
        parts = [(float(frame.pts * frame.time_base), frame.to_ndarray()[0]) for frame in container.decode(sound)]
    samples = np.concatenate([part for _, part in parts])[round(max(0, -parts[0][0]) * 48_000) :]
    seconds = (FRAMES - first) / 25
    assert abs(len(samples) / 48_000 - seconds) < 2 * 1024 / 48_000  # AAC comes in blocks of 1024
    heard = np.abs(samples) > 0.2
    if silence < seconds:
        assert abs(heard.argmax() / 48_000 - silence) < 0.025
    else:
        assert not heard.any()


def test_sound_whose_title_is_in_another_encoding_is_taken(small_stream, tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        container.metadata["title"] = "TITLE"
        stream = container.add_stream("aac", rate=48_000, layout="stereo")
        silence = av.AudioFrame.from_ndarray(np.zeros((2, 1024), np.float32), format="fltp", layout="stereo")
        silence.sample_rate = 48_000
        container.mux(stream.encode(silence))
        container.mux(stream.encode(None))
    data = (tmp_path / "a.mp4").read_bytes()
    assert b"TITLE" in data
    (tmp_path / "a.mp4").write_bytes(data.replace(b"TITLE", b"caf\xe9\xff"))
    settings = VideoSettings(audio=tmp_path / "a.mp4")
    decode(small_stream.path, tmp_path / "x.mp4", view="cam00", frames=slice(0, 1), video=settings)


def test_sound_that_is_none(small_stream, tmp_path: Path) -> None:
    (tmp_path / "noise.wav").write_bytes(b"not a sound" * 100)
    (tmp_path / "film.y4m").write_bytes(b"YUV4MPEG2 W2 H2 F25:1 C444\nFRAME\n" + bytes(12))
    (tmp_path / "list.wav").write_text("ffconcat version 1.0\nfile noise.wav\n")
    decode(small_stream.path, tmp_path / "silent.mp4", view="cam00", frames=slice(0, 1))
    for name, message in (
        ("noise.wav", "cannot be read as audio"),
        ("none.wav", "cannot be read"),
        ("film.y4m", "cannot be read as audio"),
        ("list.wav", "cannot be read as audio"),
        ("silent.mp4", "has no sound"),
    ):
        with pytest.raises(UsageError, match=rf"{name}: .*{message}"):
            decode(small_stream.path, tmp_path / "x.mp4", view="cam00", video=VideoSettings(audio=tmp_path / name))
    assert not (tmp_path / "x.mp4").exists()
    with pytest.raises(UsageError, match="is read, as `audio`"):
        decode(small_stream.path, tmp_path / "film.y4m", view="cam00", video=VideoSettings(audio=tmp_path / "film.y4m"))


@pytest.mark.parametrize(
    ("name", "settings", "message"),
    [
        ("x", VideoSettings(crf=10), "are for videos"),
        ("x.exr", VideoSettings(audio=Path("a.wav")), "are for videos"),
        ("x.y4m", VideoSettings(codec="h264"), "are for videos"),
        ("x.mp4", VideoSettings(codec="prores"), "holds h264 or hevc"),
        ("x.mov", VideoSettings(crf=10), "ProRes has none"),
        ("x.mp4", VideoSettings(crf=52), "0 .best. to 51"),
        ("x.mov", VideoSettings(chroma="420"), "ProRes is written as 4444"),
    ],
)
def test_settings_that_no_file_has(
    small_stream, tmp_path: Path, name: str, settings: VideoSettings, message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        decode(small_stream.path, tmp_path / name, view="cam00", video=settings)
    assert not (tmp_path / name).exists()


def read_y4m(data: bytes) -> tuple[bytes, list[np.ndarray]]:
    """A plain reader of yuv4mpeg(5) in 4:4:4, colours by BT.601: the header line and RGB pictures."""
    line, rest = data.split(b"\n", 1)
    fields = {field[:1]: field[1:] for field in line.split(b" ")[1:]}
    width, height = int(fields[b"W"]), int(fields[b"H"])
    pictures = []
    while rest:
        assert rest.startswith(b"FRAME\n")
        planes = np.frombuffer(rest[6 : 6 + 3 * width * height], np.uint8).reshape(3, height, width).astype(float)
        y, cb, cr = (planes[0] - 16) / 219, (planes[1] - 128) / 224, (planes[2] - 128) / 224
        rgb = np.stack([y + 1.402 * cr, y - 0.344136 * cb - 0.714136 * cr, y + 1.772 * cb], -1)
        pictures.append(np.rint(np.clip(rgb, 0, 1) * 255))
        rest = rest[6 + 3 * width * height :]
    return line, pictures


def test_y4m_and_rgb_are_the_pngs(small_stream, tmp_path: Path) -> None:
    expected = pngs(small_stream.path, tmp_path / "png")
    for name in ("x.y4m", "x.rgb"):
        decode(small_stream.path, tmp_path / name, view="cam00")
    assert (tmp_path / "x.rgb").read_bytes() == b"".join(picture.tobytes() for picture in expected)
    line, pictures = read_y4m((tmp_path / "x.y4m").read_bytes())
    assert line == b"YUV4MPEG2 W64 H48 F25:1 Ip A1:1 C444"
    # Rounding Y to 1/219 and Cb, Cr to 1/224: at most .5 * 255 * (1 / 219 + 1.772 / 224) levels, and .5 of RGB's own.
    assert np.abs(np.array(pictures) - np.array(expected)).max() <= 2
    assert psnr(expected, pictures) > 48
    piped = io.BytesIO()
    decode(small_stream.path, piped, view="cam00")
    assert piped.getvalue() == (tmp_path / "x.y4m").read_bytes()


def test_a_pipe_gets_the_video_and_nothing_else(
    small_stream, tmp_path: Path, capsysbinary: pytest.CaptureFixture[bytes]
) -> None:
    decode(small_stream.path, tmp_path / "x.y4m", view="cam00")
    assert decode_main([str(small_stream.path), "--view", "cam00", "-o", "-"]) == 0
    printed = capsysbinary.readouterr()
    assert printed.out == (tmp_path / "x.y4m").read_bytes()
    assert b"8 frames of cam00" in printed.err


def test_ffmpeg_reads_the_y4m(small_stream, tmp_path: Path) -> None:
    decode(small_stream.path, tmp_path / "x.y4m", view="cam00")
    with av.open(str(tmp_path / "x.y4m")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.pix_fmt, stream.average_rate) == ("yuv444p", 25)
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
    assert psnr(pngs(small_stream.path, tmp_path / "png"), frames) > 45


def test_ntsc_rates_are_exact() -> None:
    file = io.BytesIO()
    RawVideo(file, 30000 / 1001, y4m=True).write(np.zeros((1, 1, 3), np.uint8))
    assert file.getvalue() == b"YUV4MPEG2 W1 H1 F30000:1001 Ip A1:1 C444\nFRAME\n" + bytes([16, 128, 128])


def test_an_odd_picture_is_not_cut(tmp_path: Path) -> None:
    image = np.random.default_rng(1).uniform(0, 1, (33, 51, 3)).astype(np.float32)
    picture = Rendering(image, image[..., 0], image[..., 0])
    with open_sink(tmp_path / "x.mp4", view="v", frames=2, fps=24, video=VideoSettings(chroma="444", crf=0)) as sink:
        sink.write(0, picture)
        sink.write(1, picture)
    with av.open(str(tmp_path / "x.mp4")) as container:
        assert container.streams.video[0].average_rate == Fraction(24)
    frames = frames_of(tmp_path / "x.mp4")
    assert frames[0].shape == (34, 52, 3)
    assert psnr([to_8bit(image)], frames[:1]) > 40


@pytest.mark.parametrize(("fps", "stated"), [(1e-6, "1:1000000"), (0.001, "1:1000"), (1e6, "1000000:1")])
def test_a_rate_of_y4m_is_never_nothing(fps: float, stated: str) -> None:
    """yuv4mpeg(5): both numbers of a rate are positive; a stream may state any."""
    file = io.BytesIO()
    RawVideo(file, fps, y4m=True).write(np.zeros((1, 1, 3), np.uint8))
    assert f" F{stated} ".encode() in file.getvalue()


def test_sound_that_is_no_numbers_is_one_line(small_stream, tmp_path: Path) -> None:
    """A WAV of IEEE floats (format 3), all NaN: FFmpeg reads it, and AAC has no code for it."""
    samples = np.full(48_000, np.nan, "<f4").tobytes()
    form = struct.pack("<HHIIHH", 3, 1, 48_000, 4 * 48_000, 4, 32)
    chunks = b"WAVEfmt " + struct.pack("<I", len(form)) + form + b"data" + struct.pack("<I", len(samples)) + samples
    (tmp_path / "nan.wav").write_bytes(b"RIFF" + struct.pack("<I", len(chunks)) + chunks)
    with pytest.raises(UsageError, match=r"nan\.wav: cannot be read as audio"):
        decode(small_stream.path, tmp_path / "x.mp4", view="cam00", video=VideoSettings(audio=tmp_path / "nan.wav"))
    assert not (tmp_path / "x.mp4").exists()


def test_audio_is_a_file_and_no_address_of_ffmpegs(
    small_stream, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_tone(tmp_path / "tone.wav", 1)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=r"concat:tone\.wav: cannot be read as audio .No such file"):
        decode(small_stream.path, "x.mp4", view="cam00", video=VideoSettings(audio=Path("concat:tone.wav")))
    (tmp_path / "concat:tone.wav").write_bytes((tmp_path / "tone.wav").read_bytes())
    decode(small_stream.path, "x.mp4", view="cam00", video=VideoSettings(audio=Path("concat:tone.wav")))
