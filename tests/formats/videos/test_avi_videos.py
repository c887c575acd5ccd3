"""AVI, and other files without times of presentation: frames in the order in which they are shown."""

from __future__ import annotations

import re
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from decogs.formats.colours.ycbcr import to_rgb
from decogs.formats.videos.reading import open_video
from textured_videos import long_video, texture, write


@pytest.mark.parametrize(("name", "reordered"), [("a.avi", True), ("a.mxf", True), ("raw.mp4", True), ("a.mp4", False)])
def test_frames_are_in_order_where_only_their_coding_has_times(tmp_path: Path, name: str, reordered: bool) -> None:
    """AVI has no times of presentation, MXF few, and copying a stream without a container cannot restore them."""
    if name != "raw.mp4":
        source = long_video(tmp_path / name, g="50", bf="3", preset="faster")
    else:
        long_video(tmp_path / "b.mp4", g="50", bf="3", preset="faster")
        with av.open(str(tmp_path / "b.mp4")) as whole, av.open(str(tmp_path / name), "w") as copy:
            target = copy.add_stream_from_template(whole.streams.video[0])
            for packet in (packet for packet in whole.demux(video=0) if packet.size):
                packet.pts, packet.stream = packet.dts, target
                copy.mux(packet)
        source = open_video(tmp_path / name)
    assert (source.times is None) == reordered
    frames = list(source.read(0, source.frame_count))
    with av.open(str(tmp_path / name)) as container:
        shown = [to_rgb(frame, source.siting) for frame in container.decode(video=0)]
    assert all((ours == theirs).all() for ours, theirs in zip(frames, shown, strict=True))
    np.testing.assert_array_equal(list(source.read(120, 123)), frames[120:123])


@pytest.mark.parametrize("b_frames", [0, 1, 2, 3])
def test_the_packed_bitstream_of_xvid_is_read_as_it_is_shown(tmp_path: Path, b_frames: int) -> None:
    """A chunk with a picture and the first one that is shown before it, and an empty chunk in place of that one."""
    coded = mpeg4_packets(14, b_frames)
    expected = shown_by(coded)
    for name, chunks in (("packed.avi", packed(coded)), ("plain.avi", coded)):
        write_chunks(tmp_path / name, chunks)
        source = open_video(tmp_path / name)
        assert source.frame_count == len(expected) == 14
        for start in (0, 5):
            for picture, frame in zip(source.read(start, 14), expected[start:], strict=True):
                np.testing.assert_array_equal(picture, to_rgb(frame, source.siting))


def test_frames_that_a_recorder_dropped_repeat_the_one_before(tmp_path: Path) -> None:
    """AVI has an empty chunk for each; a take stays in step."""
    coded = mpeg4_packets(14, 0)
    expected = [to_rgb(frame, (True, False)) for frame in shown_by(coded[:4] + coded[6:9] + coded[10:])]
    write_chunks(tmp_path / "a.avi", [b"" if place in (4, 5, 9) else chunk for place, chunk in enumerate(coded)])
    source = open_video(tmp_path / "a.avi")
    order = [0, 1, 2, 3, 3, 3, 4, 5, 6, 6, 7, 8, 9, 10]
    for start in (0, 4, 5, 6, 10):
        for picture, place in zip(source.read(start, 14), order[start:], strict=True):
            np.testing.assert_array_equal(picture, expected[place])


def mpeg4_packets(frames: int, b_frames: int) -> list[bytes]:
    coder = av.CodecContext.create("mpeg4", "w")
    coder.width, coder.height, coder.pix_fmt, coder.time_base, coder.framerate = 64, 48, "yuv420p", Fraction(1, 25), 25
    coder.max_b_frames, coder.gop_size, coder.bit_rate = b_frames, 7, 4_000_000
    packets = []
    for t in range(frames):
        frame = av.VideoFrame.from_ndarray(np.roll(texture((64, 48)), 3 * t, axis=1), format="rgb24")
        frame = frame.reformat(format="yuv420p")
        frame.pts, frame.time_base = t, Fraction(1, 25)
        packets += coder.encode(frame)
    return [bytes(packet) for packet in [*packets, *coder.encode()]]


def shown_by(packets: list[bytes]) -> list[av.VideoFrame]:
    coder = av.CodecContext.create("mpeg4", "r")
    return [frame for packet in [*map(av.Packet, packets), None] for frame in coder.decode(packet)]


def packed(packets: list[bytes]) -> list[bytes]:
    """As XviD and DivX pack them. Source: ISO 14496-2, section 6.2.5 (vop_coding_type, vop_coded)."""

    def is_b(packet: bytes) -> bool:
        return packet[packet.index(b"\0\0\1\xb6") + 4] >> 6 == 2

    not_coded = b"\0\0\1\xb6\x50\x5f"
    chunks: list[bytes] = []
    for place, packet in enumerate(packets):
        marked = re.sub(b"\0\0\1\xb2[^\0]*", lambda _: b"\0\0\1\xb2DivX503b1393p", packet)
        if not is_b(packet):
            chunks.append(marked)
        elif not is_b(packets[place - 1]):
            chunks[-1] += marked
        else:
            chunks.append(marked)
        if is_b(packet) and (place + 1 == len(packets) or not is_b(packets[place + 1])):
            chunks.append(not_coded)
    return chunks


def write_chunks(path: Path, chunks: list[bytes]) -> None:
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt, stream.time_base = 64, 48, "yuv420p", Fraction(1, 25)
        stream.codec_context.codec_tag = "XVID"
        for place, chunk in enumerate(chunks):
            packet = av.Packet(chunk)
            packet.pts = packet.dts = place
            packet.time_base, packet.stream, packet.duration = Fraction(1, 25), stream, 1
            packet.is_keyframe = b"\0\0\1\xb0" in chunk
            container.mux(packet)


def test_after_damage_a_video_without_times_is_read_from_the_next_keyframe_on(tmp_path: Path) -> None:
    write(tmp_path / "a.avi", frames=12, options={"g": "4", "bf": "2", "sc_threshold": "0"})
    source = open_video(tmp_path / "a.avi")
    assert source.times is None
    assert [source.readable_after(index) for index in (0, 1, 4, 8)] == [4, 4, 8, 12]
