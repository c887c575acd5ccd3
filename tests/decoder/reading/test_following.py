"""Following a stream while it grows: each picture when its packet is complete, whatever happens to the file."""

from __future__ import annotations

import io
import os
import re
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from decogs.decoder import decode
from decogs.decoder.commands import decode_main
from decogs.decoder.reading.following import GrowingStream, follow_stream
from decogs.decoder.reading.stream import open_stream
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.files.outputs import GrowingFile
from packets import iterate_packets

PATIENCE = 20.0
"""Seconds that a test waits for what must come; a shared machine may be slow."""


def ends(data: bytes) -> list[int]:
    """Where the header ends and every later packet."""
    return [packet.offset + packet.size for packet in iterate_packets(io.BytesIO(data))]


def wait_for(what: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.01)


class Follower(threading.Thread):
    """Decodes while the test writes; ``error`` is what it ended with."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(daemon=True)
        self.arguments, self.options = arguments, {"view": "cam00", "follow": True, "idle": PATIENCE} | options
        self.error: BaseException | None = None
        self.start()

    def run(self) -> None:
        try:
            decode(*self.arguments, **self.options)
        except BaseException as error:
            self.error = error

    def end(self) -> None:
        self.join(PATIENCE)
        assert not self.is_alive()
        if self.error is not None:
            raise self.error


def same_pictures(one: Path, other: Path) -> bool:
    names = sorted(os.listdir(other))
    return sorted(os.listdir(one)) == names and all((one / n).read_bytes() == (other / n).read_bytes() for n in names)


@pytest.fixture
def whole(small_stream: Any, tmp_path: Path) -> Path:
    """The pictures of the finished stream."""
    decode(small_stream.path, tmp_path / "whole", view="cam00")
    return tmp_path / "whole"


def test_each_picture_comes_with_its_packet(small_stream: Any, whole: Path, tmp_path: Path) -> None:
    data, output = small_stream.path.read_bytes(), tmp_path / "live"
    follower = Follower(tmp_path / "new.dgs", output)
    part, written = tmp_path / "new.dgs.part", 0
    time.sleep(0.1)  # it has to wait for the file
    with part.open("wb") as file:
        for frame, end in enumerate(ends(data), start=-1):
            for stop in (end - 1, end):
                file.write(data[written:stop])
                file.flush()
                written = stop
                if stop == end - 1 and frame >= 0:
                    time.sleep(0.12)  # more than a poll: a byte is missing, nothing may appear
                    assert len(os.listdir(output) if output.exists() else []) == min(frame, 8)
            if 0 <= frame < 8:
                wait_for((output / f"cam00_{frame:06d}.png").exists)
    part.rename(tmp_path / "new.dgs")
    follower.end()
    assert same_pictures(output, whole)


def test_a_rename_meanwhile_is_not_noticed(small_stream: Any, whole: Path, tmp_path: Path) -> None:
    data = small_stream.path.read_bytes()
    cut = ends(data)[3] + 5
    part = tmp_path / "new.dgs.part"
    part.write_bytes(data[:cut])
    follower = Follower(tmp_path / "new.dgs", tmp_path / "live")
    wait_for((tmp_path / "live" / "cam00_000002.png").exists)
    part.rename(tmp_path / "new.dgs")
    with (tmp_path / "new.dgs").open("ab") as file:
        file.write(data[cut:])
    follower.end()
    assert same_pictures(tmp_path / "live", whole)


def test_an_encode_that_is_resumed_is_followed_on(small_stream: Any, whole: Path, tmp_path: Path) -> None:
    """The new encode cuts the packet off that a kill left unfinished, and writes it again."""
    data = small_stream.path.read_bytes()
    boundary = ends(data)[4]
    part = tmp_path / "new.dgs.part"
    part.write_bytes(data[:boundary])
    follower = Follower(tmp_path / "new.dgs", tmp_path / "live")
    wait_for((tmp_path / "live" / "cam00_000003.png").exists)
    with part.open("r+b") as file:
        file.seek(boundary)
        file.write(data[boundary : boundary + 9])
        file.truncate(boundary)
        file.seek(boundary)
        file.write(data[boundary:])
    follower.end()
    assert same_pictures(tmp_path / "live", whole)


def test_a_file_that_is_begun_anew_is_an_error(small_stream: Any, tmp_path: Path) -> None:
    data = small_stream.path.read_bytes()
    part = tmp_path / "new.dgs.part"
    part.write_bytes(data[: ends(data)[2]])
    follower = Follower(tmp_path / "new.dgs", tmp_path / "live")
    wait_for((tmp_path / "live" / "cam00_000001.png").exists)
    os.truncate(part, 40)
    with pytest.raises(StreamError, match=r"new\.dgs: the file was cut back meanwhile; follow it again .*truncated"):
        follower.end()


def test_a_finished_stream_is_read_to_its_end(small_stream: Any, whole: Path, tmp_path: Path) -> None:
    decode(small_stream.path, tmp_path / "live", view="cam00", follow=True)
    assert same_pictures(tmp_path / "live", whole)


def test_an_empty_part_that_a_killed_encode_left_is_not_waited_for(
    small_stream: Any, whole: Path, tmp_path: Path
) -> None:
    stream, part = tmp_path / "x.dgs", tmp_path / "x.dgs.part"
    stream.write_bytes(small_stream.path.read_bytes())
    part.touch()
    os.utime(part, (time.time() - 60, time.time() - 60))
    decode(stream, tmp_path / "live", view="cam00", follow=True, idle=5)
    assert same_pictures(tmp_path / "live", whole)
    with GrowingFile(stream, leftover="dropped") as growing:
        os.utime(part, (time.time() - 60, time.time() - 60))
        with pytest.raises(StreamError, match="before its header is complete"):
            decode(stream, tmp_path / "other", view="cam00", follow=True, idle=0.2)
        assert not growing.size


def test_what_grows_behind_a_link_is_followed(small_stream: Any, whole: Path, tmp_path: Path) -> None:
    (tmp_path / "disk").mkdir()
    (tmp_path / "disk" / "x.dgs.part").write_bytes(small_stream.path.read_bytes())
    (tmp_path / "link.dgs").symlink_to(tmp_path / "disk" / "x.dgs")
    decode(tmp_path / "link.dgs", tmp_path / "live", view="cam00", follow=True, idle=5)
    assert same_pictures(tmp_path / "live", whole)


def test_segments_are_followed(segmented_stream: Any) -> None:
    with follow_stream(segmented_stream.path) as stream:
        frames = list(stream.frames())
        assert stream.ended
    assert [frame.refers_to_first for frame in frames] == [index in (5, 10, 15) for index in range(20)]
    with open_stream(segmented_stream.path) as opened:
        for frame, same in zip(frames, opened.frames(), strict=True):
            assert frame.state.row_sum == same.state.row_sum == segmented_stream.states[frame.index].row_sum
            assert (frame.changes, frame.costs) == (same.changes, same.costs)


def test_what_stops_is_given_up_after_a_while(unfinished_stream: Any, tmp_path: Path, capsys: Any) -> None:
    arguments = [str(unfinished_stream.path), "--view", "cam00", "--follow", "--idle", "0.3"]
    assert decode_main([*arguments, "-o", str(tmp_path / "live")]) == 0
    assert len(os.listdir(tmp_path / "live")) == 7
    told = capsys.readouterr()
    assert "cut.dgs: nothing more came, and no end packet; 7 pictures were written" in told.err
    assert "7 frames of cam00" in told.out
    assert decode_main([*arguments, "-o", str(tmp_path / "live.mp4")]) == 0
    assert (tmp_path / "live.mp4").stat().st_size > 1000


def test_what_never_comes_is_an_error(small_stream: Any, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"new\.dgs: neither it nor new\.dgs\.part is there after 0\.2 s"):
        decode(tmp_path / "new.dgs", tmp_path / "live", view="cam00", follow=True, idle=0.2)
    data = small_stream.path.read_bytes()
    for size, message in ((0, "before its header is complete"), (ends(data)[0] + 3, "no such frame came")):
        (tmp_path / "new.dgs.part").write_bytes(data[:size])
        with pytest.raises((StreamError, UsageError), match=rf"new\.dgs: .*{message}"):
            decode(tmp_path / "new.dgs", tmp_path / "live", view="cam00", follow=True, idle=0.2)
    assert not (tmp_path / "live").exists()
    with pytest.raises(UsageError, match="0 s are no time to wait"):
        decode(tmp_path / "new.dgs", tmp_path / "live", view="cam00", follow=True, idle=0)


def test_a_range_ends_without_waiting_for_more(small_stream: Any, whole: Path, tmp_path: Path) -> None:
    data = small_stream.path.read_bytes()
    (tmp_path / "new.dgs.part").write_bytes(data[: ends(data)[4]])
    warnings: list[str] = []
    options: dict[str, Any] = {"view": "cam00", "follow": True, "on_warning": warnings.append}
    decode(tmp_path / "new.dgs", tmp_path / "live", frames=slice(1, 3), **options)
    assert sorted(os.listdir(tmp_path / "live")) == ["cam00_000001.png", "cam00_000002.png"]
    assert (tmp_path / "live" / "cam00_000002.png").read_bytes() == (whole / "cam00_000002.png").read_bytes()
    assert warnings == []
    for frames in (slice(-2, None), slice(-1), range(3, 3), slice(0, 4, 2)):
        with pytest.raises(UsageError, match="`frames` of a stream that still grows: give consecutive ones"):
            decode(tmp_path / "new.dgs", tmp_path / "live", frames=frames, **options)


def damaged_in_frame(frame: int, data: bytes) -> bytes:
    at = ends(data)[frame] + 30
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


DAMAGED = r"the payload's checksum is wrong in packet 3 at byte \d+ \[bad-payload-crc\]"


def test_damage_is_concealed_while_the_stream_grows(small_stream: Any, whole: Path, tmp_path: Path) -> None:
    """The search waits for the next packet, byte by byte, and the frames lost appear with it."""
    data, output = small_stream.path.read_bytes(), tmp_path / "live"
    data, at = damaged_in_frame(2, data), ends(data)
    warnings: list[str] = []
    part = tmp_path / "new.dgs.part"
    part.write_bytes(data[: at[3]])
    follower = Follower(tmp_path / "new.dgs", output, on_warning=warnings.append)
    wait_for((output / "cam00_000001.png").exists)
    time.sleep(0.12)
    assert (len(os.listdir(output)), warnings) == (2, []), "whether a frame is lost is not known yet"
    with part.open("ab", buffering=0) as file:
        for position in range(at[3], at[4]):
            file.write(data[position : position + 1])
            if position < at[3] + 24:
                time.sleep(0.06)  # more than a poll: the search stops and goes on inside the packet header
        wait_for((output / "cam00_000003.png").exists)
        assert len(warnings) == 1
        assert re.fullmatch(
            rf".*new\.dgs: {DAMAGED}; frames from 2 on show frame 1 until the next keyframe", warnings[0]
        )
        file.write(data[at[4] :])
    follower.end()
    held = (whole / "cam00_000001.png").read_bytes()
    for frame in range(8):
        name = f"cam00_{frame:06d}.png"
        assert (output / name).read_bytes() == (held if frame in (2, 3) else (whole / name).read_bytes())
    assert len(warnings) == 1


def test_a_search_ends_when_nothing_more_comes(small_stream: Any, tmp_path: Path, capsys: Any) -> None:
    data = small_stream.path.read_bytes()
    (tmp_path / "new.dgs.part").write_bytes(damaged_in_frame(2, data)[: ends(data)[3]])
    arguments = [
        str(tmp_path / "new.dgs"),
        "--view",
        "cam00",
        "--follow",
        "--idle",
        "0.3",
        "-o",
        str(tmp_path / "live"),
    ]
    assert decode_main(arguments) == 0
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2
    assert re.search(rf"{DAMAGED}; no frame is known to be lost by it", said[0])
    assert "nothing more came, and no end packet; 2 pictures were written" in said[1]


def test_a_file_that_is_cut_back_while_damage_is_searched_past_is_an_error(
    small_stream: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data, part = small_stream.path.read_bytes(), tmp_path / "new.dgs.part"
    part.write_bytes(damaged_in_frame(2, data)[: ends(data)[3]])
    all_read, check = threading.Event(), GrowingStream._check_not_cut

    def checked(stream: GrowingStream) -> None:
        check(stream)
        if stream._reader.bytes_read == ends(data)[3]:
            all_read.set()

    monkeypatch.setattr(GrowingStream, "_check_not_cut", checked)
    follower = Follower(tmp_path / "new.dgs", tmp_path / "live")
    wait_for(all_read.is_set)
    os.truncate(part, ends(data)[3] - 1)
    with pytest.raises(StreamError, match=r"new\.dgs: the file was cut back meanwhile; follow it again .*truncated"):
        follower.end()


def test_followed_strictly_damage_is_an_error_that_names_the_file(
    small_stream: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    data = small_stream.path.read_bytes()
    cut, data = data[: ends(data)[1] - 3], damaged_in_frame(2, data)
    (tmp_path / "new.dgs").write_bytes(data)
    arguments = ["--view", "cam00", "--strict", "-o", str(tmp_path / "live")]
    assert decode_main([str(tmp_path / "new.dgs"), "--follow", *arguments]) == 2
    assert re.fullmatch(rf".*new\.dgs: {DAMAGED}\n", capsys.readouterr().err)
    assert len(os.listdir(tmp_path / "live")) == 2, "what came before it has appeared"
    for damaged, said in ((data, DAMAGED), (cut, r"stops \d+ bytes into a packet .*truncated")):
        monkeypatch.setattr("sys.stdin", type("Input", (), {"buffer": io.BytesIO(damaged)}))
        assert decode_main(["-", *arguments]) == 2
        assert re.search(rf"-: .*{said}", capsys.readouterr().err)


def test_a_damaged_pipe_is_concealed(
    small_stream: Any, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    data = damaged_in_frame(3, small_stream.path.read_bytes())
    read_end, write_end = os.pipe()
    with os.fdopen(read_end, "rb") as source, os.fdopen(write_end, "wb") as sink:
        sink.write(data)
        sink.close()
        monkeypatch.setattr("sys.stdin", type("Input", (), {"buffer": source}))
        assert decode_main(["-", "--view", "cam00", "-o", str(tmp_path / "live")]) == 0
    said = capsys.readouterr().err
    assert re.search(r"-: .* in packet 4 at byte \d+ \[bad-payload-crc\]; frame 3 shows frame 2\n", said)
    assert said.count("\n") == 1
    (whole / "cam00_000003.png").write_bytes((whole / "cam00_000002.png").read_bytes())
    assert same_pictures(tmp_path / "live", whole)


def test_a_pipe_is_decoded_as_it_comes(
    small_stream: Any, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    data = small_stream.path.read_bytes()
    read_end, write_end = os.pipe()
    with os.fdopen(read_end, "rb") as source, os.fdopen(write_end, "wb") as sink:
        follower = Follower(source, tmp_path / "live")
        sink.write(data[: ends(data)[3]])
        sink.flush()
        wait_for((tmp_path / "live" / "cam00_000002.png").exists)
        sink.write(data[ends(data)[3] :])
        sink.close()
        follower.end()
    assert same_pictures(tmp_path / "live", whole)

    class Input:
        buffer = io.BytesIO(data[: ends(data)[3] + 7])

    monkeypatch.setattr("sys.stdin", Input)
    assert decode_main(["-", "--view", "cam00", "-o", str(tmp_path / "x_%02d.exr")]) == 0
    assert sorted(path.name for path in tmp_path.glob("*.exr")) == [f"x_{t:02d}.exr" for t in range(3)]
    assert "-: nothing more came, and no end packet; 3 pictures" in capsys.readouterr().err


def test_numbers_do_not_depend_on_how_many_came(small_stream: Any, tmp_path: Path) -> None:
    decode(small_stream.path, tmp_path / "x.png", view="cam00", frames=slice(2, 3), follow=True)
    assert [path.name for path in tmp_path.glob("x*")] == ["x_000002.png"]
