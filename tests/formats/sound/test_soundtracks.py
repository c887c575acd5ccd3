"""Samples of files: any rate and channels become 48 kHz at their own time, gaps silence, what is no sound an error."""

from __future__ import annotations

import os
import wave
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from decogs.formats.errors import UsageError
from decogs.formats.sound.opus import BLOCK, OpusDecoder, OpusEncoder
from decogs.formats.sound.tracks import FULL_RATE, RATE, read_samples, read_sound, sound_channels
from videos_with_sound import write_video


def write_click(path: Path, rate: int, channels: int = 1, seconds: float = 2.0, at: float = 0.5) -> None:
    samples = np.zeros((int(seconds * rate), channels))
    begin = int(at * rate)
    samples[begin : begin + rate // 100] = 0.8
    with wave.open(str(path), "wb") as file:
        file.setparams((channels, 2, rate, len(samples), "NONE", ""))
        file.writeframes((samples * 32767).astype("<i2").tobytes())


def heard(path: Path, channels: int = 1, **options: object) -> np.ndarray:
    return np.concatenate(list(read_samples(path, channels, **options)), axis=1)


def onset(samples: np.ndarray) -> float:
    return int(np.argmax(np.abs(samples[0]) > 0.4)) / FULL_RATE


@pytest.mark.parametrize("rate", [8_000, 22_050, 44_100, 48_000, 96_000])
@pytest.mark.parametrize(("channels", "kept"), [(1, 1), (2, 2), (6, 2)])
def test_a_click_stays_at_its_time(tmp_path: Path, rate: int, channels: int, kept: int) -> None:
    write_click(tmp_path / "a.wav", rate, channels)
    assert sound_channels(tmp_path / "a.wav") == kept
    samples = heard(tmp_path / "a.wav", kept)
    # Half of the rise of what a filter for the lower of the two rates has left of the edge.
    assert onset(samples) == pytest.approx(0.5, abs=1 / min(rate, FULL_RATE))
    assert samples.shape == (kept, pytest.approx(2 * FULL_RATE, abs=64))
    assert max(piece.shape[1] for piece in read_samples(tmp_path / "a.wav", kept)) <= FULL_RATE


@pytest.mark.parametrize("begin", [0.0, 0.123, 0.4999, -0.25])
def test_it_begins_where_it_is_asked(tmp_path: Path, begin: float) -> None:
    write_click(tmp_path / "a.wav", 44_100)
    assert onset(heard(tmp_path / "a.wav", begin=begin)) == pytest.approx(0.5 - begin, abs=1 / 44_100)


def test_a_video_is_heard_from_a_picture_on(tmp_path: Path) -> None:
    pictures = np.full((30, 32, 32, 3), 90, np.uint8)
    sound = np.zeros(48_000, np.float32)
    sound[24_000:24_480] = 0.8
    write_video(tmp_path / "a.mp4", pictures, sound, fps=30)
    with av.open(str(tmp_path / "a.mp4")) as container:
        times = [frame.pts for frame in container.decode(video=0)]
    for picture in (0, 7):
        samples = heard(tmp_path / "a.mp4", picture=times[picture])
        assert onset(samples) == pytest.approx(0.5 - picture / 30, abs=0.001)


def write_microphones(path: Path, clicks: list[float], languages: tuple[str, ...] = ()) -> None:
    """Two seconds of video whose mono tracks have a click each, at these times; 0 is none."""
    with av.open(str(path), "w") as file:
        video = file.add_stream("mpeg4", rate=30)
        video.width, video.height, video.pix_fmt = 32, 32, "yuv420p"
        tracks = [file.add_stream("pcm_s16le", rate=48_000, layout="mono") for _ in clicks]
        for track, language in zip(tracks, languages, strict=False):
            track.metadata["language"] = language
        for number in range(60):
            picture = av.VideoFrame.from_ndarray(np.full((32, 32, 3), 90, np.uint8), format="rgb24")
            picture.pts = number
            file.mux(video.encode(picture))
        for track, at in zip(tracks, clicks, strict=True):
            samples = np.zeros((1, 96_000), np.int16)
            samples[:, int(at * 48_000) : int(at * 48_000) + 480 * bool(at)] = 26_000
            for begin in range(0, 96_000, 960):
                frame = av.AudioFrame.from_ndarray(samples[:, begin : begin + 960], format="s16", layout="mono")
                frame.sample_rate, frame.pts, frame.time_base = 48_000, begin, Fraction(1, 48_000)
                file.mux(track.encode(frame))
        file.mux(video.encode(None))


@pytest.mark.parametrize("clicks", [[0.5, 1.2], [0, 1.2], [0.5, 1.2, 0.9, 0]])
def test_every_microphone_is_heard_left_and_right_in_turn(tmp_path: Path, clicks: list[float]) -> None:
    """Cameras record a mono track for each; with two, each at its level on its side."""
    write_microphones(tmp_path / "a.mov", clicks)
    assert sound_channels(tmp_path / "a.mov") == 2
    level = 26_000 / 32_768 * 2 / len(clicks)
    stereo, mono = heard(tmp_path / "a.mov", 2, picture=0), heard(tmp_path / "a.mov", 1)
    assert stereo.shape == (2, 96_000)
    for number, at in enumerate(clicks):
        side = stereo[number % 2]
        assert side[int(at * 48_000)] == pytest.approx(level if at else 0, abs=1e-3)
        assert mono[0, int(at * 48_000)] == pytest.approx(level / 2 if at else 0, abs=1e-3)
    sound = read_sound(tmp_path / "a.mov", 10)
    for at in filter(None, clicks):
        assert sound.samples[int((at - sound.delay) * RATE) + 40] == pytest.approx(level / 2, abs=0.01)


def test_a_track_that_begins_hours_later_takes_no_memory(tmp_path: Path) -> None:
    """Time stamps are a stranger's: sound is compared within the seconds that were asked for."""
    with av.open(str(tmp_path / "a.mkv"), "w") as file:
        video = file.add_stream("mpeg4", rate=30)
        video.width, video.height, video.pix_fmt = 32, 32, "yuv420p"
        tracks = [file.add_stream("pcm_s16le", rate=48_000, layout="mono") for _ in range(2)]
        picture = av.VideoFrame.from_ndarray(np.full((32, 32, 3), 90, np.uint8), format="rgb24")
        picture.pts = 0
        file.mux(video.encode(picture))
        file.mux(video.encode(None))
        for track, second in zip(tracks, (0, 10**6), strict=True):
            frame = av.AudioFrame.from_ndarray(np.full((1, 960), 9_000, np.int16), format="s16", layout="mono")
            frame.sample_rate, frame.pts, frame.time_base = 48_000, second * 48_000, Fraction(1, 48_000)
            file.mux(track.encode(frame))
    sound = read_sound(tmp_path / "a.mkv", 10)
    assert sound.samples.max() == pytest.approx(9_000 / 32_768, rel=0.1)
    assert len(sound.samples) < RATE


def test_another_language_is_no_microphone(tmp_path: Path) -> None:
    write_microphones(tmp_path / "a.mkv", [0.5, 1.2], ("eng", "fra"))
    assert sound_channels(tmp_path / "a.mkv") == 1
    assert not heard(tmp_path / "a.mkv")[0, int(1.1 * 48_000) :].any()


@pytest.mark.parametrize(
    ("ending", "codec"),
    [("ac3", "ac3"), ("eac3", "eac3"), ("wma", "wmav2"), ("au", "pcm_s16be"), ("wv", "wavpack"), ("tta", "tta")],
)
def test_files_of_other_programs_are_heard(tmp_path: Path, ending: str, codec: str) -> None:
    samples = np.zeros((1, 96_256), np.float32)
    samples[:, 24_000:24_480] = 0.8 * np.sin(np.arange(480))
    with av.open(str(tmp_path / f"a.{ending}"), "w", format="asf" if ending == "wma" else None) as file:
        track = file.add_stream(codec, rate=48_000, layout="mono")
        track.bit_rate = 128_000
        given = {"pcm_s16be": "s16", "tta": "s16"}.get(codec, "fltp")
        data = (samples * 32_767).astype(np.int16) if given == "s16" else samples
        resampler = av.AudioResampler(format=given, layout="mono", rate=48_000, frame_size=track.frame_size or 1024)
        frame = av.AudioFrame.from_ndarray(data, format=given, layout="mono")
        frame.sample_rate, frame.pts, frame.time_base = 48_000, 0, Fraction(1, 48_000)
        for part in resampler.resample(frame):
            file.mux(track.encode(part))
        file.mux(track.encode(None))
    found = heard(tmp_path / f"a.{ending}")[0]
    assert int(np.argmax(np.abs(found) > 0.3)) == pytest.approx(24_000, abs=2100), "a codec's own delay"


def test_what_is_no_file_or_changes_is_refused(tmp_path: Path) -> None:
    """A named pipe nobody writes into would be waited for."""
    os.mkfifo(tmp_path / "pipe.wav")
    for path in (tmp_path / "pipe.wav", tmp_path, Path(os.devnull)):
        with pytest.raises(UsageError, match="cannot be read as audio"):
            sound_channels(path)
    write_click(tmp_path / "a.wav", 48_000)
    coming = read_samples(tmp_path / "a.wav", 1)
    next(coming)
    write_click(tmp_path / "a.wav", 48_000, seconds=3)
    with pytest.raises(UsageError, match=r"a\.wav: changed while it was read"):
        next(coming)


def test_a_file_without_a_sample_has_no_sound(tmp_path: Path) -> None:
    write_click(tmp_path / "a.wav", 48_000, seconds=0)
    assert sound_channels(tmp_path / "a.wav") is None


def test_a_gap_is_silence_and_what_follows_stays_in_its_place(tmp_path: Path) -> None:
    """Blocks of a tone, of which some are missing, in a container that says when each begins."""
    with av.open(str(tmp_path / "a.mkv"), "w") as file:
        track = file.add_stream("pcm_s16le", rate=48_000, layout="mono")
        for number in range(100):
            if 20 <= number < 45:
                continue
            block = (np.full((1, 480), 12_000 if number == 70 else 2_000)).astype(np.int16)
            frame = av.AudioFrame.from_ndarray(block, format="s16", layout="mono")
            frame.sample_rate, frame.pts, frame.time_base = 48_000, number * 480, Fraction(1, 48_000)
            file.mux(track.encode(frame))
        file.mux(track.encode(None))
    samples = heard(tmp_path / "a.mkv")
    assert not samples[0, 20 * 480 + 96 : 45 * 480 - 96].any()
    assert int(np.argmax(samples[0] > 0.3)) == pytest.approx(70 * 480, abs=72)  # Matroska's milliseconds
    assert samples.shape[1] == pytest.approx(48_000, abs=72)


def test_what_is_no_sound_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "noise.wav").write_bytes(b"not a sound" * 100)
    write_video(tmp_path / "silent.mp4", np.full((3, 32, 32, 3), 90, np.uint8))
    assert sound_channels(tmp_path / "silent.mp4") is None
    with pytest.raises(UsageError, match=r"silent\.mp4: has no sound"):
        heard(tmp_path / "silent.mp4")
    for name in ("noise.wav", "missing.wav"):
        with pytest.raises(UsageError, match=rf"{name}: cannot be read as audio"):
            sound_channels(tmp_path / name)


@pytest.mark.parametrize("channels", [1, 2])
def test_opus_gives_a_click_back_at_its_sample(channels: int) -> None:
    samples = np.zeros((channels, 10 * BLOCK), np.float32)
    samples[:, 3000:3020] = 0.8
    encoder, decoder = OpusEncoder(channels), OpusDecoder(channels)
    blocks = [
        block for start in range(0, 10 * BLOCK, BLOCK) for block in encoder.code(samples[:, start : start + BLOCK])
    ]
    blocks += encoder.finish()
    decoded = np.concatenate([decoder.decode(block) for block in blocks], axis=1)
    assert int(np.argmax(np.abs(decoded[0]) > 0.4)) - encoder.delay == 3000


def test_bytes_that_are_no_block_are_silence() -> None:
    rng, decoder = np.random.default_rng(0), OpusDecoder(2)
    for size in [1, 2, 3, 100, 1276] * 40:
        decoded = decoder.decode(rng.bytes(size))
        assert decoded.shape == (2, BLOCK)
        assert np.isfinite(decoded).all()
        assert np.abs(decoded).max() <= 1
