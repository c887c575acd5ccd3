"""Opening, ranges of frames, seeking, damage, and the one function that renders a view."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.scene.lattice import dequantise
from decogs.codec.scene.state import State
from decogs.decoder.cameras.lens import Redistortion
from decogs.decoder.rasterise import render
from decogs.decoder.reading.following import follow_stream
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import as_pinhole, scale_camera
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.frames.ranges import frame_range
from decogs.formats.stream import container
from decogs.formats.stream.container import PACKET_OVERHEAD, read_index, scan_index

ARRAYS = ("means", "log_scales", "quaternions", "opacity_logits", "sh", "ids")


def assert_same_state(actual: State, expected: State) -> None:
    assert (actual.frame, actual.next_id, actual.row_sum) == (expected.frame, expected.next_id, expected.row_sum)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name))


def test_every_frame_equals_the_writers_state(small_stream) -> None:
    with open_stream(small_stream.path) as stream:
        frames = list(stream.frames())
        assert stream.header.to_bytes() == small_stream.header.to_bytes()
        assert (stream.frame_count, stream.complete, stream.unfinished_bytes) == (8, True, 0)
    assert [frame.index for frame in frames] == list(range(8))
    assert [frame.kind.name.lower() for frame in frames] == list(small_stream.kinds)
    for frame, expected in zip(frames, small_stream.states, strict=True):
        assert_same_state(frame.state, expected)
        for name in ARRAYS[:5]:
            activated = getattr(dequantise(expected, small_stream.header.lattice), name)
            np.testing.assert_array_equal(getattr(frame.splats, name), activated)


@pytest.mark.parametrize(("start", "stop"), [(0, 1), (2, 4), (3, None), (4, 6), (5, 8), (7, None), (3, 3)])
def test_any_range_is_the_same_as_reading_from_the_start(small_stream, start: int, stop: int | None) -> None:
    with open_stream(small_stream.path) as stream:
        frames = list(stream.frames(start, stop))
    assert [frame.index for frame in frames] == list(range(8))[start:stop]
    for frame in frames:
        assert_same_state(frame.state, small_stream.states[frame.index])


def test_seeking_reads_from_the_last_keyframe_only(small_stream) -> None:
    """The first keyframe's payload is damaged: frames of the second segment do not notice, earlier ones do."""
    data = bytearray(small_stream.path.read_bytes())
    with small_stream.path.open("rb") as file:
        first_key = read_index(file)[0]
    data[first_key.offset + PACKET_OVERHEAD + 5] ^= 1
    small_stream.path.write_bytes(data)
    with open_stream(small_stream.path) as stream:
        assert_same_state(next(stream.frames(6)).state, small_stream.states[6])
        with pytest.raises(StreamError, match=r"^[^:]*scene\.dgs: [^:]* in packet 1 at byte \d+ \[bad-payload-crc\]"):
            list(stream.frames(3))


@contextmanager
def bytes_read() -> Iterator[list[int]]:
    """Counts what the process reads from any file meanwhile, as the kernel sees it."""

    def so_far() -> int:
        counts = dict(line.split(": ") for line in Path("/proc/self/io").read_text().splitlines())
        return int(counts["rchar"])

    own = -so_far() + so_far()  # what reading the counter costs
    counted, before = [0], so_far()
    yield counted
    counted[0] = so_far() - before - own


READ_AHEAD = 3 * 8192
"""Of Python's file objects: one for the header, one at the file's end, one for the frames."""


def test_opening_a_whole_file_reads_its_header_and_index_only(segmented_stream) -> None:
    size = segmented_stream.path.stat().st_size
    with bytes_read() as counted, open_stream(segmented_stream.path) as stream:
        assert stream.frame_count == 20
    assert 0 < counted[0] < len(segmented_stream.header.to_bytes()) + 20 * 16 + READ_AHEAD < size / 2


def test_a_range_reads_the_first_keyframe_and_its_own_segment_only(segmented_stream) -> None:
    path, size = segmented_stream.path, segmented_stream.path.stat().st_size
    with path.open("rb") as file:
        offsets = [entry.offset for entry in read_index(file)]
    first_key, until_frame_18 = offsets[1] - offsets[0], offsets[18] - offsets[15]
    with open_stream(path) as stream, bytes_read() as counted:
        frames = list(stream.frames(16, 18))
    for frame in frames:
        assert_same_state(frame.state, segmented_stream.states[frame.index])
    assert first_key + until_frame_18 <= counted[0] < first_key + until_frame_18 + READ_AHEAD < 0.8 * size
    data = bytearray(path.read_bytes())
    for between in range(offsets[1], offsets[15]):
        data[between] = 0
    path.write_bytes(data)
    with open_stream(path) as stream:
        assert_same_state(next(stream.frames(19)).state, segmented_stream.states[19])


@pytest.mark.parametrize("start", range(0, 20, 3))
def test_segments_decode_alike_from_anywhere(segmented_stream, start: int) -> None:
    with open_stream(segmented_stream.path) as stream:
        for frame in stream.frames(start):
            assert_same_state(frame.state, segmented_stream.states[frame.index])
            assert frame.refers_to_first == (frame.index in (5, 10, 15))


def test_a_segment_without_the_first_keyframe_is_an_error(segmented_stream) -> None:
    data = bytearray(segmented_stream.path.read_bytes())
    with segmented_stream.path.open("rb") as file:
        first, *_, last = scan_index(file)
    data[first.offset + PACKET_OVERHEAD + 5] ^= 1
    segmented_stream.path.write_bytes(data)
    with open_stream(segmented_stream.path) as stream, pytest.raises(StreamError, match="bad-payload-crc"):
        next(stream.frames(last.frame))


def test_readers_do_not_disturb_each_other(small_stream) -> None:
    with open_stream(small_stream.path) as stream:
        pairs = list(zip(stream.frames(), stream.frames(), strict=True))
    for one, other in pairs:
        assert_same_state(one.state, other.state)


def test_skip_frames_share_the_splats(small_stream) -> None:
    with open_stream(small_stream.path) as stream:
        frames = list(stream.frames(4))
    assert frames[2].splats is frames[1].splats
    assert frames[3].splats is frames[1].splats
    assert frames[1].splats is not frames[0].splats


def test_bytes_add_up_to_the_file(small_stream) -> None:
    with open_stream(small_stream.path) as stream:
        frames = list(stream.frames())
        total = stream.file_bytes
    for frame in frames:
        assert sum(frame.costs.values()) + PACKET_OVERHEAD == frame.packet_bytes
    with small_stream.path.open("rb") as file:
        first = read_index(file)[0].offset
    tail = total - first - sum(frame.packet_bytes for frame in frames)
    index_bytes = PACKET_OVERHEAD + 4 + 16 * 8
    assert tail == index_bytes + container._END_PACKET_SIZE


def test_changes_are_those_that_were_written(small_stream) -> None:
    with open_stream(small_stream.path) as stream:
        counted = [(f.changes.touched, f.changes.added, f.changes.removed) for f in stream.frames()]
    assert counted == list(small_stream.changes)


def test_an_unfinished_stream_gives_its_complete_frames(unfinished_stream) -> None:
    with open_stream(unfinished_stream.path) as stream:
        assert (stream.frame_count, stream.complete, stream.unfinished_bytes) == (7, False, 3)
        for frame in stream.frames():
            assert_same_state(frame.state, unfinished_stream.states[frame.index])
    with pytest.raises(
        StreamError, match=r"cut\.dgs: the stream stops 3 bytes into a packet at byte \d+ \[truncated\]"
    ):
        open_stream(unfinished_stream.path, strict=True)


def test_what_is_no_stream_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.dgs"
    for content, reason in ((b"", "truncated"), (b"hello, this is no stream", "bad-signature")):
        path.write_bytes(content)
        with pytest.raises(StreamError, match=rf"x\.dgs: .*\[{reason}\]"):
            open_stream(path)
    with pytest.raises(FileNotFoundError):
        open_stream(tmp_path / "none.dgs")


def test_limits_refuse_what_is_too_large(small_stream) -> None:
    for limits in ({"max_gaussians": 59}, {"max_memory": 15 * (4 * (11 + 12) + 8) * 59}):
        with open_stream(small_stream.path, **limits) as stream, pytest.raises(StreamError) as caught:
            next(stream.frames())
        assert caught.value.reason == "too-many-gaussians"


def test_ranges_outside_the_stream_are_refused(small_stream) -> None:
    with open_stream(small_stream.path) as stream:
        for start, stop in ((-1, 3), (3, 9), (5, 4)):
            with pytest.raises(UsageError, match="not in this stream of 8 frames"):
                list(stream.frames(start, stop))


def test_a_pinhole_view_is_the_plain_render(small_stream) -> None:
    header, splats = small_stream.header, dequantise(small_stream.states[0], small_stream.header.lattice)
    for scale in (1.0, 1.5):
        plain = render(splats, scale_camera(header.cameras[0], scale), header.background)
        seen = render_view(header, splats, "cam00", scale=scale)
        for name in ("image", "alpha", "depth"):
            np.testing.assert_array_equal(getattr(seen, name), getattr(plain, name))


@pytest.mark.parametrize("number", [1, 2])
def test_a_lens_view_has_the_cameras_size_and_its_lens(small_stream, number: int) -> None:
    header, splats = small_stream.header, dequantise(small_stream.states[0], small_stream.header.lattice)
    camera = header.cameras[number]
    seen = render_view(header, splats, camera.name)
    assert seen.image.shape == (camera.height, camera.width, 3)
    plan = Redistortion(camera)
    wide = render(splats, plan.render_camera, header.background)
    np.testing.assert_array_equal(seen.image, plan.apply(wide.image, outside=header.background))
    flat = render_view(header, splats, camera.name, undistorted=True)
    np.testing.assert_array_equal(flat.image, render(splats, as_pinhole(camera), header.background).image)
    assert np.abs(flat.image - seen.image).max() > 0.1
    assert 0 <= seen.alpha.min() <= seen.alpha.max() <= 1
    depths = seen.depth[seen.alpha > 0.2]
    # Splats lie 1.6 to 2.6 from the origin; the camera stands 0.2 behind it.
    assert 1.7 < depths.min() <= depths.max() < 2.9


def test_backgrounds_default_to_the_streams(small_stream) -> None:
    header, splats = small_stream.header, dequantise(small_stream.states[0], small_stream.header.lattice)
    for name in ("cam00", "cam01", "wide"):
        np.testing.assert_allclose(render_view(header, splats, name).image[0, 0], header.background, atol=1e-3)
        white = render_view(header, splats, name, background=(1.0, 1.0, 1.0))
        np.testing.assert_allclose(white.image[0, 0], 1.0, atol=1e-3)


def test_views_that_cannot_be(small_stream) -> None:
    header, splats = small_stream.header, dequantise(small_stream.states[0], small_stream.header.lattice)
    with pytest.raises(UsageError, match=r"no camera 'cam7' in this stream; it has cam00, cam01, wide"):
        render_view(header, splats, "cam7")
    for scale in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(UsageError, match="scale"):
            render_view(header, splats, "cam00", scale=scale)
    huge = replace(header.cameras[0], width=30_000, height=30_000)
    with pytest.raises(UsageError, match="above the limit"):
        render_view(header, splats, huge)


def test_frame_ranges_are_read_as_in_python() -> None:
    ranges = {"0:10": (0, 10), ":": (None, None), "5:": (5, None), "-3:": (-3, None), ":-1": (None, -1)}
    for text, ends in ranges.items():
        assert frame_range(text) == slice(*ends)
    for text in ("", "5", "a:b", "1:2:3", "1.5:2", "0-10", "\u0661:\u0663", "1_0:", "9" * 5000 + ":"):
        with pytest.raises(UsageError, match="no range; write A:B"):
            frame_range(text)


def test_a_closed_stream_raises_and_reads_no_other_file(small_stream, segmented_stream) -> None:
    """The number of a closed file's descriptor is the next file's."""
    with open_stream(small_stream.path, on_damage=pytest.fail) as stream:
        frames = stream.frames()
        next(frames)
    with segmented_stream.path.open("rb"), pytest.raises(UsageError, match=r"scene\.dgs: the stream is closed"):
        next(frames)
    with pytest.raises(UsageError, match="the stream is closed"):
        next(stream.frames(2, 3))
    with follow_stream(small_stream.path, idle=0.1, on_damage=pytest.fail) as growing:
        coming = growing.frames()
        next(coming)
    with segmented_stream.path.open("rb"), pytest.raises(UsageError, match=r"scene\.dgs: the stream is closed"):
        next(coming)


def test_a_pipe_cannot_be_opened_and_says_what_can_be_done(small_stream, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for nothing_to_seek in (tmp_path / "pipe", Path(os.devnull)):
        with pytest.raises(UsageError, match="is no regular file; write the stream to a file first"):
            open_stream(nothing_to_seek)


def test_a_file_that_is_written_into_while_it_is_read_is_refused(
    small_stream, segmented_stream, tmp_path: Path
) -> None:
    """Other bytes, more, fewer, or at another time: no frame of both. A new file of that name is no change of it."""
    other = segmented_stream.path.read_bytes()
    path = tmp_path / "s.dgs"
    for change in (other, small_stream.path.read_bytes() + b"more", other[:1000], None):
        path.write_bytes(small_stream.path.read_bytes())
        with open_stream(path, on_damage=lambda damage: None) as stream:
            coming = stream.frames()
            next(coming)
            if change is None:
                os.utime(path, ns=(0, 1))
            else:
                path.write_bytes(change)
            with pytest.raises(UsageError, match=r"s\.dgs: changed while it was read; try again"):
                list(coming)
    path.write_bytes(small_stream.path.read_bytes())
    with open_stream(path) as stream:
        (tmp_path / "new").write_bytes(other)
        os.replace(tmp_path / "new", path)
        assert len(list(stream.frames())) == len(small_stream.states)


def test_a_stream_that_still_grows_may_get_longer_while_it_is_read(small_stream, tmp_path: Path) -> None:
    data = small_stream.path.read_bytes()
    path = tmp_path / "s.dgs.part"
    path.write_bytes(data[:-300])
    with open_stream(path, on_damage=lambda damage: None) as stream:
        path.write_bytes(data)
        assert len(list(stream.frames())) == stream.frame_count
        path.write_bytes(data[:-400])
        with pytest.raises(UsageError, match="changed while it was read"):
            list(stream.frames())
