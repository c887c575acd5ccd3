"""Sound through edits: it goes with its frames, tracks of several takes play together, and a file's can be added."""

from __future__ import annotations

import wave
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.packets.sound import BLOCK, RATE, SoundPacket, SoundTrack, frame_start
from decogs.decoder import decode_sound, open_stream
from decogs.decoder.editing import (
    Audio,
    Cameras,
    Concat,
    Crop,
    Grade,
    Merge,
    Retime,
    Set,
    Speed,
    Sphere,
    Strip,
    Transform,
    Trim,
    edit,
)
from decogs.decoder.editing.commands import edit_main
from decogs.decoder.editing.operations.retime import _MOST_FRAMES
from decogs.decoder.editing.sound import from_frame
from decogs.decoder.editing.take import Take
from decogs.decoder.sound.packets import FrameSound
from decogs.decoder.sound.samples import mixed_sound
from decogs.formats.errors import UsageError
from edited_streams import bodies, header_of
from sounding_streams import tones, with_sound

FPS = 25.0


@pytest.fixture
def sounding(segmented_stream, tmp_path: Path) -> Path:
    return with_sound(segmented_stream.path, tmp_path / "sounding.dgs", [SoundTrack(2, "mix"), SoundTrack(1, "voice")])


def sounds_of(path: Path) -> list:
    with open_stream(path, strict=True) as stream:
        return list(stream.sounds())


def write_wav(path: Path, samples: np.ndarray) -> None:
    """One channel of 16 bits."""
    with wave.open(str(path), "wb") as file:
        file.setparams((1, 2, RATE, len(samples), "NONE", ""))
        file.writeframes((samples * 32767).astype("<i2").tobytes())


def heard(path: Path) -> np.ndarray:
    with open_stream(path, strict=True) as stream:
        return np.concatenate(list(mixed_sound(stream, range(stream.frame_count))), axis=1)


@pytest.mark.parametrize(
    "operation",
    [
        Crop(Sphere((0, 0, 2), 1.0)),
        Grade(exposure=0.5),
        Set(title="a"),
        Transform(scale=2.0),
        Cameras(drop=("cam01",)),
        Strip(("provenance",)),
        Retime(speeds=(Speed(0, None, 1.0, 1.0),)),
    ],
    ids=lambda operation: operation.name,
)
def test_what_does_not_touch_time_keeps_every_packet(sounding: Path, tmp_path: Path, operation) -> None:
    edit(sounding, tmp_path / "out.dgs", [operation])
    assert sounds_of(tmp_path / "out.dgs") == sounds_of(sounding)
    titled = not isinstance(operation, Strip)
    tracks = tuple(replace(track, title=track.title * titled) for track in header_of(sounding).sound)
    assert header_of(tmp_path / "out.dgs").sound == tracks


def test_strip_leaves_it_out(sounding: Path, segmented_stream, tmp_path: Path) -> None:
    edit(sounding, tmp_path / "out.dgs", [Strip(("sound",))])
    assert (tmp_path / "out.dgs").read_bytes() == segmented_stream.path.read_bytes()


@pytest.mark.parametrize("start", [1, 2, 5, 13])
def test_a_trim_sounds_as_the_take_does_there(sounding: Path, tmp_path: Path, start: int) -> None:
    """200 ms before it make the decoder right: ten blocks, each of which halves what it does not know."""
    edit(sounding, tmp_path / "out.dgs", [Trim(slice(start, 18))])
    was = heard(sounding)[:, frame_start(start, FPS) : frame_start(18, FPS)]
    now = heard(tmp_path / "out.dgs")
    assert np.abs(now - was).max() < 2e-3
    assert sounds_of(tmp_path / "out.dgs")[1:] == sounds_of(sounding)[start + 1 : 18]


def test_what_lies_behind_a_gap_after_the_first_frame_takes_nothing_from_it(segmented_stream, tmp_path: Path) -> None:
    """A track that stops in the frame with which the new take begins, and goes on in the next one after a silence."""
    played = {5: SoundPacket(0, 0, (b"last",)), 6: SoundPacket(0, BLOCK // 2, (b"next",))}

    def hear(start: int, stop: int) -> Iterator[FrameSound]:
        return (((played[frame],) if frame in played else ()) for frame in range(start, stop))

    take = Take(header_of(segmented_stream.path), 10, lambda start, stop: iter(()), hear)
    assert list(from_frame(take, 5)(0, 2)) == [(played[5],), (played[6],)]


def test_a_seam_is_heard_to_the_sample(sounding: Path, tmp_path: Path) -> None:
    edit(sounding, tmp_path / "tail.dgs", [Trim(slice(12, None))])
    edit(sounding, tmp_path / "out.dgs", [Trim(slice(0, 7)), Concat((tmp_path / "tail.dgs",))])
    whole, at = heard(sounding), frame_start(7, FPS)
    now = heard(tmp_path / "out.dgs")
    np.testing.assert_array_equal(now[:, :at], whole[:, :at])
    assert np.abs(now[:, at:] - whole[:, frame_start(12, FPS) :]).max() < 2e-3


def test_tracks_of_a_longer_list_go_on_and_silence_stands_for_those_that_are_none(
    sounding: Path, segmented_stream, tmp_path: Path
) -> None:
    edit(segmented_stream.path, tmp_path / "out.dgs", [Concat((sounding, segmented_stream.path))])
    tracks = header_of(tmp_path / "out.dgs").sound
    assert tracks == header_of(sounding).sound
    now, count = heard(tmp_path / "out.dgs"), frame_start(20, FPS)
    assert not now[:, :count].any()
    assert not now[:, 2 * count + 960 :].any()  # a block that has begun is heard to its end
    np.testing.assert_array_equal(now[:, count : 2 * count], heard(sounding))


def test_merged_takes_sound_together_from_where_they_are(sounding: Path, tmp_path: Path) -> None:
    placed = [Audio(track=1, position=(1.0, 2.0, 3.0)), Transform(shift=(5.0, 0.0, 0.0), scale=2.0)]
    edit(sounding, tmp_path / "moved.dgs", placed)
    assert header_of(tmp_path / "moved.dgs").sound[1].position == (1, 2, 3)
    edit(sounding, tmp_path / "out.dgs", [Merge(tmp_path / "moved.dgs")])
    tracks = header_of(tmp_path / "out.dgs").sound
    assert [track.title for track in tracks] == ["mix", "voice"] * 2
    assert tracks[3].position == pytest.approx((7, 4, 6))
    np.testing.assert_allclose(heard(tmp_path / "out.dgs"), np.clip(2 * heard(sounding), -1, 1), atol=1e-6)
    with pytest.raises(UsageError, match="sound is out of its bounds"):
        edit(sounding, None, [Merge(sounding)] * 8)


def test_a_position_is_said_in_the_world_that_is_shown(sounding: Path, tmp_path: Path) -> None:
    turned = [Transform(turns=(("Z", 90.0),), shift=(0.0, 0.0, 4.0)), Audio(position=(0.0, 3.0, 4.0), title="hall")]
    edit(sounding, tmp_path / "out.dgs", turned)
    mix, voice = header_of(tmp_path / "out.dgs").sound
    assert (mix.position, voice.title) == (None, "hall")
    assert voice.position == pytest.approx((3, 0, 0))
    edit(tmp_path / "out.dgs", tmp_path / "none.dgs", [Audio(nowhere=True)])
    assert header_of(tmp_path / "none.dgs").sound[1] == SoundTrack(1, "hall")


def test_a_file_is_added_from_where_it_is_asked(segmented_stream, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).uniform(-0.5, 0.5, 2 * RATE).astype(np.float32)
    write_wav(tmp_path / "mix.wav", noise)
    for begin in (0.0, 0.25, -0.1):
        edit(segmented_stream.path, tmp_path / "out.dgs", [Audio(tmp_path / "mix.wav", begin=begin)])
        (track,) = header_of(tmp_path / "out.dgs").sound
        assert track == SoundTrack(1, "mix.wav")
        lags = np.correlate(heard(tmp_path / "out.dgs")[0], noise[16_000:20_000], "valid")
        assert lags.argmax() == 16_000 - round(begin * RATE)
        assert bodies(tmp_path / "out.dgs") == bodies(segmented_stream.path)


@pytest.mark.parametrize("speed", [0.5, 2.0, 3.0])
def test_speed_is_pitch(sounding: Path, tmp_path: Path, speed: float) -> None:
    edit(sounding, tmp_path / "out.dgs", [Retime(speeds=(Speed(0, None, speed, speed),))])
    now = heard(tmp_path / "out.dgs")[0, 1000:-2000]
    spectrum = np.abs(np.fft.rfft(now * np.hanning(len(now))))
    assert np.fft.rfftfreq(len(now), 1 / RATE)[spectrum.argmax()] == pytest.approx(400 * speed, abs=RATE / len(now))


def test_backwards_twice_is_as_before(sounding: Path, tmp_path: Path) -> None:
    """But for being coded three times instead of once: 64 kbit/s of a plain tone, 35 dB and better."""
    edit(sounding, tmp_path / "out.dgs", [Retime(reverse=True), Retime(reverse=True)])
    was, now = heard(sounding)[0, 2000:-2000], heard(tmp_path / "out.dgs")[0, 2000:-2000]
    assert 10 * np.log10((was**2).mean() / ((now - was) ** 2).mean()) > 35


def test_what_is_too_fast_to_be_heard_is_silent(sounding: Path, tmp_path: Path) -> None:
    edit(sounding, tmp_path / "out.dgs", [Retime(speeds=(Speed(0, None, 20.0, 20.0),))])
    assert not heard(tmp_path / "out.dgs").any()
    assert _MOST_FRAMES == 1 << 20


def test_a_hold_is_silent(sounding: Path, tmp_path: Path) -> None:
    edit(sounding, tmp_path / "out.dgs", [Retime(holds=((4, 10),))])
    now = heard(tmp_path / "out.dgs")
    # The coder spreads its neighbours by up to a block.
    assert np.abs(now[:, frame_start(5, FPS) + 960 : frame_start(15, FPS) - 960]).max() < 0.01
    assert np.abs(now[:, frame_start(16, FPS) :]).max() > 0.3


def test_a_frame_a_second_is_just_enough_for_sound(sounding: Path, segmented_stream, tmp_path: Path, capsys) -> None:
    decode_sound(sounding, tmp_path / "mix.wav")
    slow, slower = tmp_path / "slow.dgs", tmp_path / "slower.dgs"
    assert edit_main([str(segmented_stream.path), "-o", str(slow), "retime", "--fps", "1"]) == 0
    assert edit_main([str(segmented_stream.path), "-o", str(slower), "retime", "--fps", "0.99"]) == 0
    capsys.readouterr()
    assert edit_main([str(slow), "-o", str(tmp_path / "out.dgs"), "audio", str(tmp_path / "mix.wav")]) == 0
    assert edit_main([str(slower), "-o", str(tmp_path / "no.dgs"), "audio", str(tmp_path / "mix.wav")]) == 2
    assert "needs a frame rate of at least 1 " in capsys.readouterr().err


def test_what_cannot_be_is_one_line(sounding: Path, segmented_stream, tmp_path: Path, capsys) -> None:
    (tmp_path / "noise.wav").write_bytes(b"not a sound" * 100)
    plain = str(segmented_stream.path)
    decode_sound(sounding, tmp_path / "mix.wav")
    with wave.open(str(tmp_path / "none.wav"), "wb") as file:
        file.setparams((1, 2, RATE, 0, "NONE", ""))
    for arguments, message in (
        ([str(sounding), "audio"], "nothing is to be done"),
        ([plain, "audio", "--title", "a"], "there is no track 0; the stream has 0"),
        ([str(sounding), "audio", "--track", "2", "--title", "a"], "there is no track 2; the stream has 2"),
        ([plain, "audio", str(tmp_path / "noise.wav")], "cannot be read as audio"),
        ([plain, "audio", str(tmp_path / "missing.wav")], "cannot be read as audio"),
        ([str(sounding), "retime", "--fps", "0.5"], "lacks a frame rate of at least 1"),
        ([str(sounding), "audio", "--position", "1,2"], "'1,2'"),
        ([plain, "audio", str(tmp_path / "mix.wav"), "--begin", "1e300"], "1e+300 is not possible"),
        (
            [plain, "audio", str(tmp_path / "mix.wav"), "--begin", "60"],
            "nothing of it is heard when it begins at second 60",
        ),
        (
            [plain, "audio", str(tmp_path / "mix.wav"), "--begin", "-60"],
            "nothing of it is heard when it begins at second -60",
        ),
        ([plain, "audio", str(tmp_path / "none.wav")], "has no sound"),
    ):
        assert edit_main([arguments[0], "-o", str(tmp_path / "out.dgs"), *arguments[1:]]) == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "out.dgs").exists()


def test_sound_that_is_read_is_never_written_over(segmented_stream, sounding: Path, tmp_path: Path) -> None:
    decode_sound(sounding, tmp_path / "mix.wav")
    before = (tmp_path / "mix.wav").read_bytes()
    with pytest.raises(UsageError, match="never replaces what it reads"):
        edit(segmented_stream.path, tmp_path / "mix.wav", [Audio(tmp_path / "mix.wav")])
    assert (tmp_path / "mix.wav").read_bytes() == before


def test_the_tone_of_the_first_second_is_the_first() -> None:
    """The clip is shorter than a second: what is compared above is one tone."""
    assert frame_start(20, FPS) < RATE
    assert tones(1, 1).shape == (1, RATE)
