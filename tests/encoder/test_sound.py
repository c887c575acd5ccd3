"""Sound goes with the pictures: a flash and a click at the same instant stay together on every way out of a rig."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest

from decogs.decoder import decode, decode_sound, info, open_stream
from decogs.decoder.editing import Concat, Retime, Trim, edit
from decogs.encoder import join
from decogs.encoder.input.sound import sound_source
from decogs.formats.errors import UsageError
from decogs.formats.rigs import open_rig
from encode_rig import encode_rig
from flash_and_click import (
    EDITS,
    FLASH,
    FPS,
    FRAMES,
    SEGMENTS,
    clicks_of,
    encoded,
    few,
    flash_of,
    picture,
    write_flashing_rig,
)
from videos_with_sound import write_video

MILLISECOND = 0.001


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_flashing_rig(tmp_path_factory.mktemp("flash") / "rig", sound=("cam01", "cam03"))


@pytest.fixture(scope="module")
def stream(rig: Path) -> Path:
    return encoded(rig, rig.parent / "scene.dgs")


@pytest.fixture(scope="module")
def in_segments(rig: Path) -> Path:
    return encoded(rig, rig.parent / "segments.dgs", **SEGMENTS)


def instants(stream: Path) -> tuple[list[float], list[float]]:
    """Seconds of the flashes and of the clicks in the video that `decode` writes of a stream."""
    video = stream.with_suffix(".mp4")
    decode(stream, video, view="cam00")
    return flash_of(video), clicks_of(video)


def check(stream: Path, flashes: list[float]) -> None:
    """A flash in each of these frames' seconds, and a click with each."""
    seen, heard = instants(stream)
    assert seen == pytest.approx(flashes, abs=1e-6)
    assert heard == pytest.approx(flashes, abs=MILLISECOND)


@pytest.mark.parametrize("name", ["stream", "in_segments"])
def test_a_cameras_sound_is_in_step_with_the_rigs_pictures(name: str, request: pytest.FixtureRequest) -> None:
    """cam01 begins three frames before the others, and its click is with their flash."""
    path = request.getfixturevalue(name)
    check(path, [FLASH / FPS])
    (track,) = info(path).sounds
    assert (track.track.title, track.track.channels) == ("cam01", 1)
    assert track.seconds == pytest.approx(FRAMES / FPS, abs=0.03)


@pytest.mark.parametrize("name", EDITS)
@pytest.mark.parametrize("source", ["stream", "in_segments"])
def test_edits_keep_them_together(name: str, source: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    operations, frames = EDITS[name]
    edit(request.getfixturevalue(source), tmp_path / "edited.dgs", operations)
    check(tmp_path / "edited.dgs", [frame / FPS for frame in frames])


def test_takes_one_after_the_other_keep_them_together(stream: Path, in_segments: Path, tmp_path: Path) -> None:
    edit(stream, tmp_path / "piece.dgs", [Trim(slice(9, 18))])
    edit(in_segments, tmp_path / "joined.dgs", [Trim(slice(2, 19)), Concat((tmp_path / "piece.dgs", stream))])
    check(tmp_path / "joined.dgs", [(FLASH - 2) / FPS, (17 + 3) / FPS, (17 + 9 + FLASH) / FPS])


def test_another_rate_and_backwards(stream: Path, tmp_path: Path) -> None:
    edit(stream, tmp_path / "film.dgs", [Retime(fps=20.0)])
    check(tmp_path / "film.dgs", [FLASH / 20])
    edit(stream, tmp_path / "back.dgs", [Retime(reverse=True)])
    seen, _ = instants(tmp_path / "back.dgs")
    assert seen == pytest.approx([(FRAMES - 1 - FLASH) / FPS])
    decode_sound(tmp_path / "back.dgs", tmp_path / "back.wav")
    # Backwards, a click ends where it began: with the end of the frame that shows the flash.
    loudest = np.abs(np.frombuffer((tmp_path / "back.wav").read_bytes()[44:], "<i2")[::2].astype(float))
    last = np.flatnonzero(loudest > 0.25 * loudest.max())[-1]
    assert last / 48_000 == pytest.approx((FRAMES - FLASH) / FPS, abs=MILLISECOND)


def test_what_stays_keeps_its_coded_sound(stream: Path, tmp_path: Path) -> None:
    edit(stream, tmp_path / "same.dgs", [Trim(slice(0, None))])
    assert sounds_of(tmp_path / "same.dgs") == sounds_of(stream)
    edit(stream, tmp_path / "piece.dgs", [Trim(slice(7, None))])
    assert sounds_of(tmp_path / "piece.dgs")[1:] == sounds_of(stream)[8:]


def sounds_of(path: Path) -> list[object]:
    with open_stream(path) as opened:
        return [*opened.sounds()]


def test_parts_joined_and_resumed_encodes_have_the_bytes_of_one_in_one_go(
    rig: Path, in_segments: Path, tmp_path: Path
) -> None:
    whole = in_segments.read_bytes()
    encoded(rig, tmp_path / "key.dgs", **SEGMENTS, only=slice(0, 1))
    for name, only in (("a", slice(0, 10)), ("b", slice(10, FRAMES))):
        encoded(rig, tmp_path / f"{name}.dgs", **SEGMENTS, only=only, keyframe=tmp_path / "key.dgs")
    # A part plays by itself: the first keyframe, then its own frames.
    assert clicks_of_sound(tmp_path / "b.dgs") == pytest.approx([(1 + FLASH - 10) / FPS], abs=MILLISECOND)
    join([tmp_path / "b.dgs", tmp_path / "a.dgs"], tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == whole
    for cut in (0.4, 0.7, 0.97):
        (tmp_path / "resumed.dgs.part").write_bytes(whole[: int(len(whole) * cut)])
        encoded(rig, tmp_path / "resumed.dgs", **SEGMENTS, resume=True)
        assert (tmp_path / "resumed.dgs").read_bytes() == whole
        (tmp_path / "resumed.dgs").unlink()
    (tmp_path / "resumed.dgs.part").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UsageError, match=r"was begun with sound .*this encode has null \(`audio`\)"):
        encoded(rig, tmp_path / "resumed.dgs", **SEGMENTS, resume=True, audio=None)


def clicks_of_sound(stream: Path) -> list[float]:
    wav = stream.with_suffix(".wav")
    decode_sound(stream, wav)
    return clicks_of(wav)


def test_a_pipe_has_the_sound_of_each_frame_behind_it(rig: Path, in_segments: Path, tmp_path: Path) -> None:
    pipe = io.BytesIO()
    encode_rig(rig, pipe, few(), audio="cam01", **SEGMENTS)
    assert pipe.getvalue() == in_segments.read_bytes()
    decode(io.BytesIO(pipe.getvalue()), tmp_path / "piped.mp4", view="cam00")
    assert clicks_of(tmp_path / "piped.mp4") == pytest.approx([FLASH / FPS], abs=MILLISECOND)
    decode(io.BytesIO(pipe.getvalue()), tmp_path / "late.mp4", view="cam00", frames=slice(10, None))
    assert clicks_of(tmp_path / "late.mp4") == pytest.approx([(FLASH - 10) / FPS], abs=MILLISECOND)


def test_frames_of_a_take_begin_its_sound(rig: Path, tmp_path: Path) -> None:
    encoded(rig, tmp_path / "late.dgs", frames=slice(9, 20))
    assert clicks_of_sound(tmp_path / "late.dgs") == pytest.approx([(FLASH - 9) / FPS], abs=MILLISECOND)
    encoded(rig, tmp_path / "file.dgs", frames=slice(9, 20), audio=rig / "cam03.mp4")
    assert clicks_of_sound(tmp_path / "file.dgs") == pytest.approx([(FLASH - 9) / FPS], abs=MILLISECOND)


def test_auto_is_the_clearest_camera(rig: Path, tmp_path: Path) -> None:
    """cam01 has noise beneath its click; a rig without sound gives a stream without, and says so."""
    noisy = write_flashing_rig(tmp_path / "rig", sound=("cam01", "cam03"))
    pictures = np.stack([picture(1, frame) for frame in range(FRAMES + 3)])
    noise = np.random.default_rng(0).normal(0, 0.2, 48_000).astype(np.float32)
    write_video(noisy / "cam01.mp4", pictures, noise, fps=FPS)
    encoded(noisy, tmp_path / "auto.dgs", audio="auto", frames=slice(0, 2))
    assert info(tmp_path / "auto.dgs").sounds[0].track.title == "cam03"
    silent, warnings = write_flashing_rig(tmp_path / "silent", sound=()), list[str]()
    encode_rig(silent, tmp_path / "none.dgs", few(), audio="auto", frames=slice(0, 2), on_warning=warnings.append)
    assert any("no camera has sound" in text for text in warnings)
    assert info(tmp_path / "none.dgs").sounds == ()


@pytest.mark.parametrize(("level", "clearest"), [(0.5, "cam01"), (1.2, "cam03")])
def test_auto_takes_a_loud_camera_unless_it_clips(level: float, clearest: str, tmp_path: Path) -> None:
    rig = write_flashing_rig(tmp_path / "rig", sound=("cam01", "cam03"))
    loud = np.zeros(48_000, np.float32)
    loud[10_000:30_000] = level * np.sign(np.sin(np.arange(20_000) * 0.02))
    write_video(rig / "cam01.mp4", np.stack([picture(1, frame) for frame in range(FRAMES + 3)]), loud, fps=FPS)
    source = sound_source("auto", open_rig(rig), 0, pytest.fail)
    assert source is not None
    assert source.track.title == clearest


def test_what_has_no_sound_is_named(rig: Path, tmp_path: Path) -> None:
    (tmp_path / "noise.wav").write_bytes(b"not a sound" * 100)
    for audio, message in (
        ("cam00", "`audio` cam00: this camera has no sound"),
        ("cam99", "`audio` cam99: is no file, and no camera of cam00, cam01"),
        (rig / "cam00.mp4", "has no sound; name a file that has"),
        (tmp_path / "noise.wav", "cannot be read as audio"),
    ):
        with pytest.raises(UsageError, match=message):
            encoded(rig, tmp_path / "x.dgs", audio=audio)
        assert not (tmp_path / "x.dgs").exists()
