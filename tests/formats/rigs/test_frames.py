"""Reading a rig's frames in step: lazily, in sequence, only the cameras that were asked for."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from decogs.formats.errors import RigError, UsageError
from decogs.formats.pictures.reading import Picture
from decogs.formats.rigs import FrameSource, Rig, open_rig, read_frames, read_repeating
from decogs.formats.rigs.sources import open_source


@dataclass
class CountingSource:
    """A source that notes what was decoded."""

    inner: FrameSource
    decoded: list[int] = field(default_factory=list)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.inner, name)

    def read(self, start: int, stop: int, step: int = 1) -> Iterator[Picture]:
        for index, picture in zip(range(start, stop, step), self.inner.read(start, stop, step), strict=False):
            self.decoded.append(index)
            yield picture


def counting(rig: Rig) -> tuple[Rig, list[CountingSource]]:
    sources = [CountingSource(source) for source in rig.sources]
    return replace(rig, sources=tuple(sources)), sources


def test_no_frame_is_decoded_before_it_is_asked_for(tmp_path: Path, make: Any) -> None:
    rig, sources = counting(open_rig(make.n3dv(tmp_path)))
    frames = read_frames(rig)
    assert [source.decoded for source in sources] == [[], [], []]
    for taken in (1, 2, 3):
        index, pictures = next(frames)
        assert (index, len(pictures)) == (taken - 1, 3)
        assert [source.decoded for source in sources] == [list(range(taken))] * 3


def test_closing_joins_no_thread(tmp_path: Path, make: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The garbage collector closes what was left half way, also where a join would wait for its own lock."""
    frames = read_frames(open_rig(make.n3dv(tmp_path)))
    next(frames)

    def joined(*_: object) -> None:
        raise AssertionError("joins a thread")

    monkeypatch.setattr(threading.Thread, "join", joined)
    frames.close()  # type: ignore[attr-defined]


def test_range_is_half_open(tmp_path: Path, make: Any) -> None:
    rig, sources = counting(open_rig(make.n3dv(tmp_path)))
    whole = [pictures for _, pictures in read_frames(rig)]
    for source in sources:
        source.decoded.clear()
    part = list(read_frames(rig, 2, 4))
    assert [index for index, _ in part] == [2, 3]
    for index, pictures in part:
        np.testing.assert_array_equal(pictures, whole[index])
    assert [source.decoded for source in sources] == [[2, 3]] * 3
    assert list(read_frames(rig, 5)) == []
    assert [index for index, _ in read_frames(rig, 3)] == [3, 4]


def test_every_other_frame(tmp_path: Path, make: Any) -> None:
    rig, sources = counting(open_rig(make.n3dv(tmp_path)))
    whole = [pictures for _, pictures in read_frames(rig)]
    for source in sources:
        source.decoded.clear()
    some = list(read_frames(rig, 1, 5, step=2))
    assert [index for index, _ in some] == [1, 3]
    np.testing.assert_array_equal([pictures for _, pictures in some], [whole[1], whole[3]])
    assert [source.decoded for source in sources] == [[1, 3]] * 3


def test_other_cameras_are_never_opened(tmp_path: Path, make: Any) -> None:
    rig = open_rig(make.n3dv(tmp_path))
    whole = [pictures for _, pictures in read_frames(rig)]
    (tmp_path / "cam00.mp4").unlink()
    part = [pictures for _, pictures in read_frames(rig, names=["cam02", "cam01"])]
    np.testing.assert_array_equal(part, [[pictures[2], pictures[1]] for pictures in whole])
    with pytest.raises(RigError, match=r"cam00\.mp4"):
        list(read_frames(rig))


def test_a_reader_given_up_early_closes_its_files(tmp_path: Path, make: Any) -> None:
    @dataclass
    class ClosingSource(CountingSource):
        closed: bool = False

        def read(self, start: int, stop: int, step: int = 1) -> Iterator[Picture]:
            try:
                yield from super().read(start, stop, step)
            finally:
                self.closed = True

    rig = open_rig(make.n3dv(tmp_path))
    sources = [ClosingSource(source) for source in rig.sources]
    frames = read_frames(replace(rig, sources=tuple(sources)))
    next(frames)
    assert not any(source.closed for source in sources)
    frames.close()  # type: ignore[attr-defined]
    assert all(source.closed for source in sources)


@pytest.mark.parametrize(("start", "stop"), [(-1, 3), (0, 6), (4, 3), (6, None)])
def test_ranges_the_rig_does_not_have(tmp_path: Path, make: Any, start: int, stop: int | None) -> None:
    rig = open_rig(make.n3dv(tmp_path))
    with pytest.raises(UsageError, match="not within the 5 frames"):
        read_frames(rig, start, stop)


def test_unknown_camera(tmp_path: Path, make: Any) -> None:
    rig = open_rig(make.n3dv(tmp_path))
    with pytest.raises(UsageError, match="no camera 'cam9'; there are cam00, cam01, cam02"):
        read_frames(rig, names=["cam00", "cam9"])


def test_a_video_that_shrinks_after_opening_is_named(tmp_path: Path, make: Any) -> None:
    rig = open_rig(make.n3dv(tmp_path))
    make.video(tmp_path / "cam01.mp4", frames=3)
    seen = []
    with pytest.raises(RigError, match=r"cam01\.mp4: the video ends or is damaged at frame 3"):
        seen.extend(index for index, _ in read_frames(rig))
    assert seen == [0, 1, 2]


def test_a_recording_alone_goes_on_after_a_damaged_picture(tmp_path: Path, make: Any) -> None:
    """As cameras are synchronised by motion: there each is read by itself. Its first picture must be there."""
    make.pictures(tmp_path / "cam00", frames=6)
    source = open_source(tmp_path / "cam00")
    whole = list(source.read(0, 6))
    for damaged in (1, 2, 4):
        (tmp_path / "cam00" / f"{damaged:04d}.png").write_bytes(b"no picture")
    for frames, expected in ((range(6), (0, 0, 0, 3, 3, 5)), (range(0, 6, 2), (0, 0, 0)), (range(3, 6), (3, 3, 5))):
        for picture, place in zip(read_repeating(source, frames), expected, strict=True):
            np.testing.assert_array_equal(picture, whole[place])
    with pytest.raises(RigError, match=r"cam00/0001\.png"):
        next(read_repeating(source, range(1, 6)))


def test_a_picture_of_another_size_or_with_nan_is_named(tmp_path: Path, make: Any) -> None:
    for i in range(2):
        make.pictures(tmp_path / f"cam{i:02d}")
    np.save(tmp_path / "poses_bounds.npy", np.stack([make.poses_bounds_row(i) for i in range(2)]))
    rig = open_rig(tmp_path)
    make.pictures(tmp_path / "other", size=(32, 24))
    (tmp_path / "other" / "0003.png").replace(tmp_path / "cam01" / "0003.png")
    with pytest.raises(RigError, match=r"cam01/0003\.png: 32 x 24 pixels, but .* 64 x 48"):
        list(read_frames(rig))


def test_memory_does_not_grow_with_the_frames(tmp_path: Path, make: Any) -> None:
    import tracemalloc

    for i in range(2):
        make.video(tmp_path / f"cam{i:02d}.mp4", frames=60)
    np.save(tmp_path / "poses_bounds.npy", np.stack([make.poses_bounds_row(i) for i in range(2)]))
    rig = open_rig(tmp_path)
    one_frame = 2 * make.width * make.height * 3
    tracemalloc.start()
    try:
        for _ in read_frames(rig):
            pass
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # The frame handed out, the one being made (in BGR and in RGB), and the threads' small objects; 60 would be 1.1 MB.
    assert peak < 8 * one_frame + 200_000 < 60 * one_frame


def test_exr_frames_keep_their_values(tmp_path: Path, make: Any) -> None:
    """Scene-linear light far beyond 1, in a rig of folders of pictures."""
    random, written = np.random.default_rng(1), {}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    for camera in range(2):
        (tmp_path / f"cam{camera:02d}").mkdir()
        for frame in range(3):
            pixels = random.exponential(60, (make.height, make.width, 3)).astype(np.float16)
            OpenEXR.File(header, {"RGB": pixels}).write(str(tmp_path / f"cam{camera:02d}" / f"{frame:04d}.exr"))
            written[camera, frame] = pixels.astype(np.float32)
    np.save(tmp_path / "poses_bounds.npy", np.stack([make.poses_bounds_row(i) for i in range(2)]))
    rig = open_rig(tmp_path)
    assert (rig.layout, len(rig.cameras), rig.frame_count, rig.fps) == ("n3dv", 2, 3, None)
    for frame, pictures in read_frames(rig):
        for camera, picture in enumerate(pictures):
            assert picture.dtype == np.float32
            np.testing.assert_array_equal(picture, written[camera, frame])
    assert max(map(np.max, written.values())) > 467
