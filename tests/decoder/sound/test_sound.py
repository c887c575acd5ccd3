"""Sound of a stream: to the sample from any frame on, silence where damaged, tracks together, told by decogs-info."""

from __future__ import annotations

import io
import json
import re
import struct
import wave
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.sound import (
    MAX_BLOCKS,
    MAX_PACKETS,
    MAX_TRACKS,
    RATE,
    SoundPacket,
    SoundTrack,
    frame_start,
    read_sound,
)
from decogs.codec.packets.syntax import write_key, write_skip
from decogs.decoder import decode, decode_sound, info, open_stream
from decogs.decoder.commands import decode_main, info_main
from decogs.decoder.editing import Set, edit
from decogs.decoder.reading.following import follow_stream
from decogs.decoder.sound.coding import coded
from decogs.decoder.sound.samples import decode_tracks, frames_before, mixed
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.sound.opus import OpusDecoder
from decogs.formats.stream.container import FRAME_KINDS, PROLOGUE_SIZE, Packet, PacketKind, StreamWriter, packet_bytes
from decogs.formats.stream.survey import MAX_DAMAGED_PLACES
from packets import iterate_packets
from sounding_streams import FIRST_TONE, STEP, with_sound

CLICKS = [5_000, 48_000, 100_001]


def clicking(channels: int = 2, seconds: int = 3) -> np.ndarray:
    samples = np.zeros((channels, seconds * RATE), np.float32)
    for at in CLICKS:
        samples[:, at : at + 20] = 0.8
    return samples


def together(sounds: list, tracks: list[SoundTrack], fps: float, first: int = 0) -> np.ndarray:
    return np.concatenate([mixed(voices) for voices in decode_tracks(sounds, tracks, fps, first)], axis=1)


def onsets(samples: np.ndarray, begin: int) -> list[int]:
    """Of clicks of .8, half of which is reached at their first sample; counted from the stream's start."""
    loud = np.flatnonzero(np.abs(samples[0]) > 0.4)
    return [int(at) + begin for at, before in zip(loud, [-RATE, *loud[:-1]], strict=True) if at - before > 1000]


@pytest.mark.parametrize("fps", [1.0, 24.0, 30000 / 1001, 60.0, 333.3])
@pytest.mark.parametrize("channels", [1, 2])
def test_coded_sound_is_heard_at_its_sample(fps: float, channels: int) -> None:
    frames = int(3 * fps)
    pieces = np.array_split(clicking(channels), 7, axis=1)
    sounds = list(islice(coded(pieces, channels, fps), frames))
    for first in (0, frames // 3):
        begin = frame_start(first, fps)
        read = max(0, first - frames_before(fps))
        samples = together(sounds[read:], [SoundTrack(channels)], fps, read)[:, begin - frame_start(read, fps) :]
        assert samples.shape == (2, frame_start(frames, fps) - begin)
        assert onsets(samples, begin) == [at for at in CLICKS if at >= begin]


def test_no_more_is_read_than_frames_need_and_none_is_made_up() -> None:
    """A take of ten seconds does not wait for an hour of sound; behind the end of sound there is silence."""
    taken = 0

    def endless():
        nonlocal taken
        while True:
            taken += 1000
            yield np.zeros((1, 1000), np.float32)

    list(islice(coded(endless(), 1, 25.0), 10))
    assert taken < frame_start(11, 25.0) + 1000
    sounds = list(islice(coded([clicking(1, 3)[:, :30_000]], 1, 25.0), 75))
    assert sounds[-1] == ()
    assert not together(sounds, [SoundTrack(1)], 25.0)[:, 31_500:].any()


def test_a_packet_that_is_lost_is_silence_and_what_follows_in_its_place() -> None:
    sounds = list(islice(coded([clicking()], 2, 25.0), 75))
    for lost in (10, 11, 12):
        sounds[lost] = ()
    samples = together(sounds, [SoundTrack(2)], 25.0)
    assert not samples[:, frame_start(10, 25.0) + 960 : frame_start(13, 25.0)].any()
    assert onsets(samples, 0) == CLICKS


def test_tracks_are_heard_together_up_to_full_level() -> None:
    tracks = [SoundTrack(1), SoundTrack(2)]
    one, other = (coded([clicking(track.channels)], track.channels, 25.0, track=n) for n, track in enumerate(tracks))
    samples = together([a + b for a, b in islice(zip(one, other, strict=True), 75)], tracks, 25.0)
    assert onsets(samples, 0) == CLICKS
    assert np.abs(samples).max() == 1


@pytest.fixture
def sounding(small_stream, tmp_path: Path) -> Path:
    return with_sound(
        small_stream.path, tmp_path / "sounding.dgs", [SoundTrack(2, "mix"), SoundTrack(1, "voice", (1, 2, 3))]
    )


def test_it_is_told_by_info(sounding: Path, small_stream, capsys: pytest.CaptureFixture[str]) -> None:
    facts = info(sounding, strict=True)
    assert [(sound.track.title, sound.track.channels) for sound in facts.sounds] == [("mix", 2), ("voice", 1)]
    assert sum(sound.bytes for sound in facts.sounds) < sounding.stat().st_size - small_stream.path.stat().st_size
    sizes = facts.totals["bytes_by_purpose"]
    assert sizes["sound"] == sum(sound.bytes for sound in facts.sounds)
    assert sum(sizes.values()) == facts.file_bytes
    assert info_main([str(sounding)]) == 0
    assert re.search(
        r"^sound +voice: Opus, mono, 48000 Hz, 0\.\d\d s, .*, at 1,2,3$", capsys.readouterr().out, re.MULTILINE
    )
    assert info_main([str(sounding), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["header"]["sound"][1]
    assert told | {"seconds": 0, "bytes": 0} == {
        **{"codec": "opus", "channels": 1, "title": "voice", "position": [1, 2, 3], "rate": 48000},
        **{"seconds": 0, "bytes": 0},
    }


def test_pictures_are_those_of_the_stream_without_it(sounding: Path, small_stream) -> None:
    with open_stream(sounding, strict=True) as one, open_stream(small_stream.path) as other:
        for frame, was in zip(one.frames(), other.frames(), strict=True):
            np.testing.assert_array_equal(frame.state.means, was.state.means)


def test_it_alone_is_a_wav(sounding: Path, small_stream, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    wav = tmp_path / "alone.wav"
    assert decode_main([str(sounding), "-o", str(wav), "--frames", "2:6", "-q"]) == 0
    assert re.search(r"alone\.wav: 2 tracks of 4 frames, 0\.16 s", capsys.readouterr().out)
    with wave.open(str(wav)) as file:
        assert (file.getnchannels(), file.getframerate(), file.getnframes()) == (2, 48000, 4 * 1920)
        samples = np.frombuffer(file.readframes(4 * 1920), "<i2").reshape(-1, 2)[:, 0]
    peak = np.fft.rfftfreq(len(samples), 1 / RATE)[np.abs(np.fft.rfft(samples * np.hanning(len(samples)))).argmax()]
    assert peak == pytest.approx(FIRST_TONE, abs=RATE / len(samples))
    for arguments, message in (
        ([str(small_stream.path)], "has no sound"),
        ([str(sounding), "--view", "cam00"], "there is no --view"),
        ([str(sounding), "--frames", "9:"], "nothing to decode"),
        (["-"], "a pipe cannot be seeked"),
    ):
        assert decode_main([*arguments, "-o", str(tmp_path / "no.wav")]) == 2
        assert message in capsys.readouterr().err
        assert not (tmp_path / "no.wav").exists()


def test_a_wav_of_two_loud_tracks_stops_at_full_level(small_stream, tmp_path: Path) -> None:
    """Above it, a sample would come out at the other end: a crack."""
    assert decode_sound(with_sound(small_stream.path, tmp_path / "loud.dgs", [SoundTrack(1)] * 4), tmp_path / "x.wav")
    with wave.open(str(tmp_path / "x.wav")) as written:
        samples = np.frombuffer(written.readframes(written.getnframes()), "<i2")
    assert (samples.min(), samples.max()) == (-32767, 32767)
    steps = np.abs(np.diff(samples.reshape(-1, 2).astype(int), axis=0))
    # Four tones of half of full level and up to some kHz: a sine's step, and what coding adds.
    assert steps.max() < 4 * 32767 / 2 * 2 * np.pi * (FIRST_TONE + 20 * STEP) / RATE + 2000


def test_a_film_of_another_rate_or_on_wish_has_none(sounding: Path, tmp_path: Path) -> None:
    import av

    from decogs.decoder.output.video import VideoSettings

    def has_sound(name: str) -> bool:
        with av.open(str(tmp_path / name)) as container:
            return bool(container.streams.audio)

    decode(sounding, tmp_path / "with.mp4", view="cam00")
    decode(sounding, tmp_path / "without.mp4", view="cam00", video=VideoSettings(silent=True))
    assert [has_sound(name) for name in ("with.mp4", "without.mp4")] == [True, False]
    camera = {"width": 64, "height": 48, "fov_y": 50, "position": [0, 0, -1], "look_at": [0, 0, 2], "up": [0, -1, 0]}
    (tmp_path / "path.json").write_text(json.dumps([{"frame": frame, **camera} for frame in (0, 4, 2)]))
    decode(sounding, tmp_path / "part.mp4", camera=tmp_path / "path.json", frames=slice(0, 1))
    assert has_sound("part.mp4")  # pictures that show frame after frame have it
    warnings: list[str] = []
    decode(sounding, tmp_path / "path.mp4", camera=tmp_path / "path.json", on_warning=warnings.append)
    assert not has_sound("path.mp4")
    assert any("its sound is left out" in text for text in warnings)
    warnings.clear()
    decode(sounding, tmp_path / "pictures", camera=tmp_path / "path.json", on_warning=warnings.append)
    assert not warnings


@pytest.mark.parametrize("place", [0, 4, 7])
def test_damage_in_sound_costs_no_picture(sounding: Path, tmp_path: Path, place: int) -> None:
    data = sounding.read_bytes()
    packets = [packet for packet in iterate_packets(io.BytesIO(data)) if packet.kind == PacketKind.SOUND]
    broken = bytearray(data)
    broken[packets[place].offset + 30] ^= 0x10
    (tmp_path / "broken.dgs").write_bytes(broken)
    damage: list[object] = []
    with open_stream(tmp_path / "broken.dgs", on_damage=damage.append) as stream:
        sounds = list(stream.sounds())
        assert all(frame.concealed is None for frame in stream.frames())
    assert len(damage) == 1
    assert sum(map(len, sounds)) == len(packets) - 1 - (place % 2 == 0)  # what follows in the frame goes with it
    with (
        open_stream(tmp_path / "broken.dgs", strict=True) as stream,
        pytest.raises(StreamError, match="bad-payload-crc"),
    ):
        list(stream.sounds())
    decode_sound(tmp_path / "broken.dgs", tmp_path / "broken.wav", on_warning=lambda text: None)


def test_packets_are_read_as_they_were_written_and_only_so() -> None:
    tracks = [SoundTrack(), SoundTrack(1)]
    packet = SoundPacket(1, -312, (b"abc", b"\xff" * 1276))
    payload = packet.payload()
    most = SoundPacket(0, 0, (b"\xfc",) * MAX_BLOCKS)
    assert read_sound(Packet(PacketKind.SOUND, 0, most.payload()), tracks) == most
    flooded = most.payload() + b"\1\0\xfc"
    assert read_sound(Packet(PacketKind.SOUND, 0, payload), tracks) == packet
    for bad in (
        payload[:-1],
        payload + b"\0",
        b"\2" + payload[1:],
        payload[:5],
        payload[:4],
        b"",
        payload + b"\xfd\4",
        flooded,
    ):
        with pytest.raises(StreamError, match="bad-payload"):
            read_sound(Packet(PacketKind.SOUND, 0, bad), tracks)


def test_blocks_that_nobody_hears_are_not_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Long before, long after, and in many packets of one frame: what is decoded follows from the seconds played."""
    decoded = []
    monkeypatch.setattr(OpusDecoder, "decode", lambda self, block: decoded.append(block) or np.zeros((1, 960), "f4"))
    flood = (b"\xfc",) * MAX_BLOCKS
    at_once = tuple(SoundPacket(0, -100 * number, flood) for number in range(MAX_PACKETS))
    sounds = [(SoundPacket(0, -2_000_000_000, flood),), (SoundPacket(0, 2_000_000_000, flood),), at_once]
    together(sounds, [SoundTrack(1)], 25.0)
    assert len(decoded) == -(-(63 * 100 + RATE // 25) // 960), "from where the last packet begins to the frame's end"


def test_a_frame_has_so_many_packets_of_sound(small_stream, tmp_path: Path) -> None:
    packet = SoundPacket(0, 0, (b"\xfc",))
    with (tmp_path / "s.dgs").open("wb") as file:
        for read in iterate_packets(io.BytesIO(small_stream.path.read_bytes())):
            if read.kind == PacketKind.HEADER:
                writer = StreamWriter(file, replace(small_stream.header, sound=(SoundTrack(1),)).to_bytes())
            elif read.kind in FRAME_KINDS:
                writer.write(read.kind, read.frame, read.payload)
                for _ in range(MAX_PACKETS + 5):
                    writer.write(PacketKind.SOUND, read.frame, packet.payload())
    with open_stream(tmp_path / "s.dgs") as stream:
        assert [len(sound) for sound in stream.sounds()] == [MAX_PACKETS] * stream.frame_count
    with follow_stream(tmp_path / "s.dgs", idle=0.1) as followed:
        heard = followed.heard()
        frames = followed.frames()
        next(frames)
        next(frames)
        assert len(heard._packets) == MAX_PACKETS


def test_a_stream_with_too_many_damaged_packets_of_sound_is_refused(small_stream, tmp_path: Path) -> None:
    """As one with as many damaged frames is; each of them would be kept in memory and named."""
    header = replace(small_stream.header, sound=(SoundTrack(1),)).to_bytes()
    state = small_stream.states[0]
    with (tmp_path / "s.dgs").open("wb") as file:
        writer = StreamWriter(file, header)
        writer.write(PacketKind.KEY, 0, write_key(state).payload)
        for frame in range(1, MAX_DAMAGED_PLACES // MAX_PACKETS + 2):
            writer.write(PacketKind.SKIP, frame, write_skip(state).payload)
            for _ in range(MAX_PACKETS):
                writer.write(PacketKind.SOUND, frame, b"\7")
        writer.finish()
    with pytest.raises(StreamError, match="damaged in too many places"):
        info(tmp_path / "s.dgs")


@pytest.mark.parametrize("broken", ["payload", "header", "blocks"])
def test_the_sound_that_is_lost_is_named(small_stream, tmp_path: Path, broken: str) -> None:
    """Also where frames were read first, by an edit of the header alone, and when frames are followed."""
    data = bytearray(with_sound(small_stream.path, tmp_path / "s.dgs").read_bytes())
    packet = next(p for p in iterate_packets(io.BytesIO(data)) if p.kind == PacketKind.SOUND and p.frame == 3)
    if broken == "blocks":
        bad = packet_bytes(PacketKind.SOUND, 3, b"\7" + packet.payload[1:])
        data[packet.offset : packet.offset + packet.size] = bad
    else:
        data[packet.offset + (30 if broken == "payload" else 9)] ^= 1
    (tmp_path / "s.dgs").write_bytes(data)
    said: list[str] = []
    edit(tmp_path / "s.dgs", tmp_path / "o.dgs", [Set(title="x")], on_warning=said.append)
    assert any("the sound of frame 3 is lost, and no frame" in text for text in said), said
    assert len(said) == (2 if broken == "header" else 1)
    assert any("the sound of frame 3 is lost" in str(damage) for damage in info(tmp_path / "s.dgs").damage)


@pytest.mark.parametrize(
    "entry",
    [
        *({"codec": "opus", "channels": value} for value in (0, 3, 2.0, True, None, "2")),
        *({"codec": value, "channels": 2} for value in ("aac", "", None, 5)),
        *({"codec": "opus", "channels": 2, "title": value} for value in ("x" * 65_537, None, 5)),
        *({"codec": "opus", "channels": 2, "position": value} for value in (None, [1, 2], [1, 2, "3"], [1, 2, 1e13])),
        *([], None, "opus"),
    ],
)
def test_a_list_with_an_entry_out_of_bounds_is_none(small_stream, entry: object) -> None:
    header = replace(small_stream.header, sound=(SoundTrack(1, "a"),))
    document = json.loads(header.to_bytes())
    assert StreamHeader.from_bytes(header.to_bytes()).sound == header.sound
    document["sound"].append(entry)
    assert StreamHeader.from_bytes(json.dumps(document).encode()).sound == ()


@pytest.mark.parametrize("change", [{"fps": None}, {"fps": 0.5}, {"sound": (SoundTrack(),) * (MAX_TRACKS + 1)}])
def test_a_header_that_would_lose_its_sound_is_not_written(small_stream, change: dict[str, object]) -> None:
    with pytest.raises(StreamError, match="sound is out of its bounds"):
        replace(small_stream.header, **{"sound": (SoundTrack(),), **change}).to_bytes()


def test_a_frame_of_hours_of_blocks_takes_no_memory(small_stream, tmp_path: Path) -> None:
    """A megabyte of three-byte blocks says two hours: what is not heard in its frame is not decoded."""
    import tracemalloc

    path = tmp_path / "long.dgs"
    with path.open("wb") as file:
        writer = StreamWriter(file, replace(small_stream.header, sound=(SoundTrack(),)).to_bytes())
        for packet in iterate_packets(io.BytesIO(small_stream.path.read_bytes())):
            if packet.kind in FRAME_KINDS:
                writer.write(packet.kind, packet.frame, packet.payload)
                blocks = struct.pack("<Bi", 0, 0) + b"\x03\0\xfc\xff\xfe" * 200_000
                writer.write(PacketKind.SOUND, packet.frame, blocks)
        writer.finish()
    tracemalloc.start()
    decode_sound(path, tmp_path / "x.wav")
    assert tracemalloc.get_traced_memory()[1] < 100 << 20  # the packets themselves, as objects, are 20 MB each
    tracemalloc.stop()
    assert (tmp_path / "x.wav").stat().st_size < 4 * RATE


def test_old_readers_pass_over_it(sounding: Path) -> None:
    """To a reader that does not know its kind, a SOUND packet is one of those that may be ignored."""
    for packet in iterate_packets(io.BytesIO(sounding.read_bytes())):
        if packet.kind == PacketKind.SOUND:
            assert not packet.critical
            assert packet.offset > PROLOGUE_SIZE


def test_no_sound_is_asked_of_a_stream_without(small_stream, tmp_path: Path) -> None:
    with open_stream(small_stream.path) as stream:
        assert list(stream.sounds(2, 4)) == [(), ()]
    with pytest.raises(UsageError, match="has no sound"):
        decode_sound(small_stream.path, tmp_path / "x.wav")


def test_steps_of_the_test_tone() -> None:
    """Neighbouring seconds differ by more than what a piece of half a second can tell apart."""
    assert STEP > 2 * 10
