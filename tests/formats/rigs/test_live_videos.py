"""Cameras that write videos which grow, or send them: what is read of them, frame by frame, and what goes wrong."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import pytest

from decogs.formats.cameras import Camera
from decogs.formats.errors import RecordingEnded, RigError
from decogs.formats.rigs import connections as connections_module
from decogs.formats.rigs import dropped_in, open_live, read_frames
from decogs.formats.rigs.feeds import DAMAGED, LACKING, OVERRUN
from decogs.formats.rigs.sender_times import SharedClock, StampsOfFile, StampsOfSender
from decogs.formats.rigs.video_feed import VideoFeed
from decogs.formats.videos.reading import open_video
from rtsp_camera import RtspCamera, coded

WIDTH, HEIGHT, FPS, MOMENTS = 64, 48, 20, 200
DIGITS, STEP = 20, 10
"""Values of a digit, and levels of grey from one to the next: coding changes less."""


def picture(moment: int) -> np.ndarray:
    """What all cameras see at a moment: its two digits, on the left and on the right."""
    seen = np.empty((HEIGHT, WIDTH, 3), np.uint8)
    seen[:, : WIDTH // 2], seen[:, WIDTH // 2 :] = (20 + STEP * digit for digit in divmod(moment, DIGITS))
    return seen


def moment_of(seen: np.ndarray) -> int:
    left, right = (round((float(np.median(half)) - 20) / STEP) for half in np.split(seen, 2, axis=1))
    return DIGITS * left + right


def write_sources(folder: Path, cameras: dict[str, str], **values: float) -> Path:
    """A calibration of these cameras, and the file of where they record."""
    names = {name: {"name": name, "file": f"still/{name}.png", "width": WIDTH, "height": HEIGHT} for name in cameras}
    more = {"fx": 60.0, "fy": 60.0, "cx": 32.0, "cy": 24.0, "distortion_model": "none"}
    poses = {name: np.eye(4) + np.eye(4, k=3) * locate for locate, name in enumerate(names)}
    (folder / "still").mkdir()
    for name in names:
        cv2.imwrite(str(folder / "still" / f"{name}.png"), picture(0))
    rig = {"cameras": [names[name] | more | {"world_to_camera": poses[name].tolist()} for name in names]}
    (folder / "rig.json").write_text(json.dumps(rig))
    terms = {"fps": FPS, "late": 5, "end": 10} | values
    lines = ['calibration = "."', *(f"{key} = {value}" for key, value in terms.items()), "[cameras]"]
    (folder / "sources.toml").write_text("\n".join([*lines, *(f'{name} = "{at}"' for name, at in cameras.items())]))
    return folder / "sources.toml"


@dataclass
class Read:
    """The moments that each camera showed, frame by frame, and why pictures lack."""

    moments: list[list[int]] = field(default_factory=list)
    dropped: dict[int, dict[str, str]] = field(default_factory=dict)


def read(sources: Path, count: int | None = None, pause: Callable[[int], None] = lambda index: None) -> Read:
    rig, found = open_live(sources), Read()
    for index, pictures in read_frames(rig, stop=count):
        found.moments.append([moment_of(each) for each in pictures])
        if dropped := dropped_in(rig, index):
            found.dropped[index] = dropped
        pause(index)
    return found


class Recorded:
    """The bytes of a video as a camera writes them: ``upto[k]`` of them when it has written k pictures."""

    def __init__(
        self,
        container: str,
        count: int,
        lacks: tuple[int, ...] = (),
        tune: str = "zerolatency",
        x264: str = "",
        **options: str,
    ) -> None:
        self.data, self.upto = bytearray(), [0]
        with av.open(self, "w", format=container, options=options) as video:
            stream: Any = video.add_stream("libx264", rate=FPS)
            stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
            stream.codec_context.gop_size = 5
            stream.codec_context.options = {"tune": tune, "qp": "4", "sc_threshold": "0", "x264-params": x264}
            for moment in range(count):
                frame = av.VideoFrame.from_ndarray(picture(moment), format="rgb24")
                frame.pts = moment
                if moment not in lacks:
                    video.mux(stream.encode(frame))
                self.upto.append(len(self.data))
            video.mux(stream.encode(None))
        self.upto[-1] = len(self.data)

    def write(self, data: bytes) -> int:
        self.data += data
        return len(data)


FRAGMENTED = {"movflags": "frag_every_frame+empty_moov+default_base_moof"}
CONTAINERS = {"mp4": ("mp4", FRAGMENTED), "mkv": ("matroska", {"cluster_time_limit": "50"}), "ts": ("mpegts", {})}


@contextmanager
def growing(files: dict[Path, Recorded], pace: float = 0.01) -> Iterator[None]:
    """Each file gets what its camera writes, picture by picture, and in two halves."""

    def record() -> None:
        for k in range(1, max(len(each.upto) for each in files.values())):
            for path, each in files.items():
                begin, end = each.upto[k - 1 : k + 1] if k < len(each.upto) else (0, 0)
                with path.open("ab") as file:
                    file.write(each.data[begin : (begin + end) // 2])
                    file.flush()
                    file.write(each.data[(begin + end) // 2 : end])
            time.sleep(pace)

    thread = threading.Thread(target=record)
    thread.start()
    try:
        yield
    finally:
        thread.join()


@pytest.mark.parametrize("suffix", CONTAINERS)
def test_a_video_is_read_while_it_is_written(tmp_path: Path, suffix: str) -> None:
    """Every picture as the finished video has it, up to the last one, which a decoder may hold back."""
    container, options = CONTAINERS[suffix]
    names = {name: f"{name}.{suffix}" for name in ("cam00", "cam01")}
    sources = write_sources(tmp_path, names, end=1.5)
    with growing({tmp_path / file: Recorded(container, 12, **options) for file in names.values()}):
        seen = [pictures for _, pictures in read_frames(open_live(sources))]
    whole = list(open_video(tmp_path / f"cam00.{suffix}").read(0, 12))
    assert len(seen) == 12
    for pictures, expected in zip(seen, whole, strict=True):
        assert all((each == expected).all() for each in pictures)


def test_who_gets_to_the_end_later_gets_the_last_pictures_too(tmp_path: Path) -> None:
    """MPEG-TS holds back the last two until the file is over, which one camera learns before the other."""
    names = {name: f"{name}.ts" for name in ("cam00", "cam01")}
    rig = open_live(write_sources(tmp_path, names, end=1.5, late=2))
    recorded = Recorded("mpegts", 12)
    for file in names.values():
        (tmp_path / file).write_bytes(recorded.data)
    later, first = (source.read(0, 13) for source in rig.sources)
    assert [moment_of(next(later)) for _ in range(10)] == [moment_of(next(first)) for _ in range(10)]
    with ThreadPoolExecutor() as threads:
        rest = threads.submit(lambda: [moment_of(each) for each in ended(first)])
        time.sleep(0.2)
        assert [moment_of(each) for each in ended(later)] == rest.result() == [10, 11]
    assert not dropped_in(rig, 10)
    assert not dropped_in(rig, 11)


def ended(pictures: Iterator[np.ndarray]) -> Iterator[np.ndarray]:
    """Up to the end of the recording."""
    with suppress(RecordingEnded):
        yield from pictures


def test_what_the_decoder_holds_back_is_given_out_at_the_end(tmp_path: Path) -> None:
    """Pictures that others are predicted from come before these: x264's own ways, with B frames."""
    names = {name: f"{name}.mkv" for name in ("cam00", "cam01")}
    sources = write_sources(tmp_path, names, end=1.5)
    for file in names.values():
        (tmp_path / file).write_bytes(Recorded("matroska", 12, tune="animation").data)
    assert read(sources).moments == [[moment] * 2 for moment in range(12)]


def test_a_video_beside_a_folder(tmp_path: Path) -> None:
    sources = write_sources(tmp_path, {"cam00": "cam00.mkv", "cam01": "shots/{:03d}.png"}, end=1.5, late=1.5)
    (tmp_path / "shots").mkdir()
    for moment in range(10):
        cv2.imwrite(str(tmp_path / "shots" / f"{moment:03d}.png"), picture(moment))
    with growing({tmp_path / "cam00.mkv": Recorded("matroska", 10, cluster_time_limit="50")}):
        found = read(sources)
    assert found.moments == [[moment, moment] for moment in range(10)]
    assert not found.dropped


def test_what_a_growing_video_lacks_and_a_camera_that_stops(tmp_path: Path) -> None:
    names = {name: f"{name}.mp4" for name in ("cam00", "cam01")}
    sources = write_sources(tmp_path, names, end=2, late=1)
    whole = Recorded("mp4", 20, **FRAGMENTED)
    lacking = Recorded("mp4", 15, lacks=(7,), **FRAGMENTED)
    with growing({tmp_path / "cam00.mp4": whole, tmp_path / "cam01.mp4": lacking}):
        found = read(sources)
    expected = [[moment, moment if moment < 15 and moment != 7 else 6 if moment == 7 else 14] for moment in range(20)]
    assert found.moments == expected
    assert found.dropped == {frame: {"cam01": LACKING} for frame in (7, *range(15, 20))}


def test_a_damaged_packet_costs_the_frames_up_to_a_keyframe(tmp_path: Path) -> None:
    names = {name: f"{name}.mp4" for name in ("cam00", "cam01")}
    sources = write_sources(tmp_path, names, end=2)
    for name in names:
        video = Recorded("mp4", 20, **FRAGMENTED)
        if name == "cam01":
            end = video.upto[8]
            payload = slice(video.data.rindex(b"mdat", 0, end) + 9, end)
            video.data[payload] = bytes(byte ^ 0x5A for byte in video.data[payload])
        (tmp_path / f"{name}.mp4").write_bytes(video.data)
    found = read(sources)
    damaged = sorted(found.dropped)
    assert {tuple(why.items()) for why in found.dropped.values()} == {(("cam01", DAMAGED),)}
    assert damaged == list(range(damaged[0], 10))  # a keyframe comes every five frames
    assert 5 < damaged[0] < 8
    assert [two for _, two in found.moments] == [
        damaged[0] - 1 if moment in damaged else moment for moment in range(20)
    ]


def test_a_clock_that_runs_apart_is_followed_by_whole_frames() -> None:
    """A camera that takes 1 in 1000 too few pictures: told by its clock at once, by arrival after ten seconds."""
    for reports in (True, False):
        stamps, apart = StampsOfSender(FPS, reports=reports), []
        for number in range(FPS * 100):
            taken = 1e9 + number / FPS * 1.001
            arrived = taken + 0.01 * (number % 7)
            placed = stamps.locate(number / FPS, taken if reports else None, arrived)
            if placed is not None:
                apart.append(placed.frame(1e9, FPS) - (taken - 1e9) * FPS)
        assert max(map(abs, apart)) < 1.3
        assert apart[-1] - (1999 - 1999 * 1.001) > 0.5  # without it, two frames at the end


def test_a_sender_that_begins_anew_is_placed_anew() -> None:
    stamps = StampsOfSender(FPS, reports=False)
    before = [stamps.locate(5000 + t / FPS, None, 1e9 + t / FPS) for t in range(FPS * 3)]
    after = [stamps.locate(t / FPS, None, 1e9 + 10 + t / FPS) for t in range(FPS * 3)]
    assert before[0] is None
    assert after[0] is None
    for last, at in ((before[-1], 0), (after[-1], 10)):
        assert last is not None
        assert last.at == pytest.approx(1e9 + at + 3 - 1 / FPS, abs=1e-3)


def test_frame_0_is_where_the_last_camera_begins() -> None:
    clock = SharedClock()
    for name in "one", "two":
        clock.expect(name)
    clock.begin("one", 10.0)
    assert clock.zero is None
    clock.begin("two", 12.0)
    clock.begin("one", 99.0)
    assert clock.zero == 12.0


def test_every_second_frame(tmp_path: Path) -> None:
    sources = write_sources(tmp_path, {"cam00": "cam00.mp4"}, end=1.5)
    with growing({tmp_path / "cam00.mp4": Recorded("mp4", 11, **FRAGMENTED)}):
        rig = open_live(sources, seconds_per_frame=1.9 / FPS)
        seen = [moment_of(pictures[0]) for _, pictures in read_frames(rig)]
    assert seen == [0, 2, 4, 6, 8, 10]
    assert rig.fps == FPS / 2
    assert any(
        f"one of 2 frames is encoded, so that the stream has {FPS / 2:g} a second" in said for said in rig.warnings
    )
    sources.write_text("every = 3\n" + sources.read_text())
    assert open_live(sources, seconds_per_frame=100).fps == FPS / 3


def test_no_video_that_can_be_followed(tmp_path: Path) -> None:
    sources = write_sources(tmp_path, {"cam00": "cam00.mp4"}, end=0.3)
    with pytest.raises(
        RigError, match=r"cam00\.mp4.*: did not appear in 0\.3 s; start the camera, and write fragmented"
    ):
        read(sources)
    (tmp_path / "cam00.mp4").write_bytes(b"no video" * 1000)
    with pytest.raises(RigError, match=r"cam00\.mp4 \(.+\): did not appear in 0\.3 s"):
        read(sources)


def test_a_video_of_another_size(tmp_path: Path) -> None:
    sources = write_sources(tmp_path, {"cam00": "cam00.ts"})
    text = (tmp_path / "rig.json").read_text().replace(f'"height": {HEIGHT}', '"height": 40')
    cv2.imwrite(str(tmp_path / "still" / "cam00.png"), picture(0)[:40])
    (tmp_path / "rig.json").write_text(text)
    (tmp_path / "cam00.ts").write_bytes(Recorded("mpegts", 5).data)
    with pytest.raises(RigError, match=r"cam00\.ts: 64 x 48 pixels, but camera cam00 is calibrated for 64 x 40"):
        read(sources)


@contextmanager
def cameras(folder: Path, *given: dict[str, Any], **values: float) -> Iterator[tuple[Path, list[RtspCamera]]]:
    """Cameras on the network from now on, and the file of sources that names them."""
    frames, begin = coded([picture(moment) for moment in range(MOMENTS)], FPS), time.time() + 0.2
    with ExitStack() as stack:
        made = [stack.enter_context(RtspCamera(frames, FPS, begin, **each)) for each in given]
        yield write_sources(folder, {f"cam{k:02d}": each.url for k, each in enumerate(made)}, **values), made


def test_pictures_are_matched_by_their_senders_clock(tmp_path: Path) -> None:
    """One camera's pictures come six frames later, and show the same moments all the same."""
    with cameras(tmp_path, {}, {"latency": 0.3}) as (sources, _):
        found = read(sources, 30)
    assert [one - two for one, two in found.moments] == [0] * 30
    assert np.diff([moments[0] for moments in found.moments]).tolist() == [1] * 29
    assert not found.dropped


@pytest.mark.parametrize("clock", [None, 3000.0])
def test_without_a_clock_they_are_matched_by_arrival(
    tmp_path: Path, clock: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A clock that is an hour off is none; the six frames of latency are then what remains."""
    monkeypatch.setattr("decogs.formats.rigs.sender_times._UNTIL_REPORT", 0.5)
    monkeypatch.setattr("decogs.formats.rigs.sender_times._SETTLING", 0.5)
    with cameras(tmp_path, {"clock": clock}, {"latency": 0.3, "clock": clock}) as (sources, _):
        found = read(sources, 20)
    assert {one - two for one, two in found.moments} <= {5, 6, 7}
    assert len({one - two for one, two in found.moments}) == 1


def test_a_camera_that_loses_pictures_breaks_off_and_comes_back(tmp_path: Path) -> None:
    with cameras(tmp_path, {}, {"lost": {25, 26}, "cut": {40}}, late=0.1) as (sources, (_, second)):
        found = read(sources, 60)
    begin = found.moments[0][0]
    lost = {frame + begin for frame in found.dropped}
    assert {25, 26} <= lost
    assert 40 in lost
    assert second.connections == 2
    assert max(lost) < begin + 59  # it came back
    for frame, (one, two) in enumerate(found.moments):
        assert one == begin + frame
        assert two == one or frame in found.dropped
    assert set(found.dropped[25 - begin].values()) == {LACKING}


def test_the_queue_of_a_sender_is_bounded(tmp_path: Path) -> None:
    """The encoder stops for two seconds: what a queue of half a second does not hold is dropped, and no more."""
    with cameras(tmp_path, {}, {}, queue=0.5, late=0.1) as (sources, _):
        found = read(sources, 55, lambda index: time.sleep(2) if index == 5 else None)
    begin = found.moments[0][0]
    thrown = [frame for frame, why in found.dropped.items() if OVERRUN in why.values()]
    assert len(thrown) > 20
    assert found.moments[-1] == [begin + 54] * 2
    for frame, moments in enumerate(found.moments):
        lacks = found.dropped.get(frame, {})
        assert all(moment == begin + frame or f"cam{k:02d}" in lacks for k, moment in enumerate(moments))


class PausingSender:
    """A camera that sends a video's first ten packets, and the others once it is told to `go_on` (`Connection`)."""

    origin, advice, sends = "sender", "", True

    def __init__(self, path: Path) -> None:
        self.path = path
        self.paused, self.go_on, self.ended = threading.Event(), threading.Event(), threading.Event()

    @contextmanager
    def opened(self, is_over: Callable[[], bool]) -> Iterator[tuple[Any, Any]]:
        if self.ended.is_set():
            raise RigError("it ended")
        with av.open(self.path) as video:
            yield SimpleNamespace(demux=lambda stream: self.packets(video, stream)), video.streams.video[0]
        self.ended.set()

    def packets(self, video: Any, stream: Any) -> Iterator[Any]:
        for number, packet in enumerate(video.demux(stream)):
            if number == 10:
                self.paused.set()
                self.go_on.wait(10)
            yield packet

    def stamps(self) -> StampsOfFile:
        return StampsOfFile()


def test_after_pictures_were_thrown_away_those_from_a_keyframe_on_are_seen(tmp_path: Path) -> None:
    """In a video whose B frames before a keyframe need pictures of before that, too, which are gone."""
    (tmp_path / "a.mkv").write_bytes(Recorded("matroska", 40, tune="animation", x264="open-gop=1").data)
    sender = PausingSender(tmp_path / "a.mkv")
    camera = Camera("cam00", WIDTH, HEIGHT, 60.0, 60.0, 32.0, 24.0, np.eye(4))
    feed = VideoFeed(camera, sender, SharedClock(), FPS, most=10)
    try:
        assert sender.paused.wait(10)
        seen = [feed.take(frame) for frame in range(10)]
        sender.go_on.set()
        assert sender.ended.wait(10)
        seen += [feed.take(frame) for frame in range(10, 40)]
    finally:
        feed.close()
    moments = [None if each is None else moment_of(each) for each in seen]
    assert moments[:4] == [0, 1, 2, 3]
    assert moments[10:38] == [None] * 20 + list(range(30, 38))


def test_mpegts_over_tcp(tmp_path: Path) -> None:
    """Which has no clock: a camera that listens, as an encoder or a converter of SRT does."""
    video, server = Recorded("mpegts", 80), socket.create_server(("127.0.0.1", 0))

    def send() -> None:
        connection, _ = server.accept()
        with server, connection, suppress(OSError):
            for begin, end in pairwise(video.upto):
                connection.sendall(video.data[begin:end])
                time.sleep(1 / FPS)

    threading.Thread(target=send, daemon=True).start()
    found = read(write_sources(tmp_path, {"cam00": f"tcp://127.0.0.1:{server.getsockname()[1]}"}), 10)
    begin = found.moments[0][0]
    assert found.moments == [[begin + frame] for frame in range(10)]


def test_mpegts_over_udp(tmp_path: Path) -> None:
    video, port = Recorded("mpegts", 120), free_port()

    def send() -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for begin, end in pairwise(video.upto):
                for at in range(begin, end, 1316):  # seven packets of the transport stream, as is usual
                    sender.sendto(video.data[at : min(at + 1316, end)], ("127.0.0.1", port))
                time.sleep(1 / FPS)

    threading.Thread(target=send, daemon=True).start()
    found = read(write_sources(tmp_path, {"cam00": f"udp://127.0.0.1:{port}"}), 10)
    begin = found.moments[0][0]
    assert found.moments == [[begin + frame] for frame in range(10)]


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])


def test_nobody_at_the_address(tmp_path: Path) -> None:
    sources = write_sources(tmp_path, {"cam00": f"rtsp://user:secret@127.0.0.1:{free_port()}/live"}, end=0.5)
    with pytest.raises(
        RigError, match=r"rtsp://127\.0\.0\.1:[0-9]+/live \(Connection refused\): did not appear"
    ) as caught:
        read(sources)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    ("address", "problem"),
    [
        ("gopher://127.0.0.1/", "gopher:// is not read; give an address of rtsp"),
        ("file:///etc/passwd", "file:// is not read"),
        ("rtsp://", "the address has no host, or no port; write it as rtsp://HOST:PORT"),
        ("rtsp://[::1/live", "the address has no host"),
        ("udp://127.0.0.1", "the address has no host, or no port; write it as udp://HOST:PORT"),
        ("tcp://127.0.0.1:99999", "the address has no host, or no port"),
        ("cam00.jpg", "is no video, no address, and has not one place"),
    ],
)
def test_addresses_that_are_not_read(tmp_path: Path, address: str, problem: str) -> None:
    with pytest.raises(RigError, match=problem):
        open_live(write_sources(tmp_path, {"cam00": address}))


def test_srt_is_refused_where_ffmpeg_has_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sources = write_sources(tmp_path, {"cam00": "srt://127.0.0.1:9000"})
    monkeypatch.setattr(connections_module, "_has_srt", lambda: False)
    with pytest.raises(RigError, match="built without SRT; pass the camera on by udp"):
        open_live(sources)
    monkeypatch.setattr(connections_module, "_has_srt", lambda: True)
    assert open_live(sources).cameras[0].name == "cam00"
