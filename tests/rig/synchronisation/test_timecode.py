"""Starts by timecode: what a second of it counts, drop-frame beside non-drop, and takes over midnight."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from decogs.formats.cameras import Camera
from decogs.formats.rigs import Rig
from decogs.formats.rigs.rig import recorded_rate
from decogs.formats.rigs.timeline import Timeline
from decogs.formats.videos.reading import VideoSource
from decogs.formats.videos.timecodes import Timecode, read_timecode, timecode_of
from decogs.rig.synchronisation.joint import StartEstimate
from decogs.rig.synchronisation.timecode import starts_by_timecode

NTSC = 60000 / 1001
DAY = 24 * 3600


def rig_of(rates: list[float], fps: float | None = None) -> Rig:
    """Cameras whose videos have these rates."""
    names = [f"c{number}" for number in range(len(rates))]
    cameras = tuple(Camera(name, 64, 48, 64, 64, 32, 24, np.eye(4)) for name in names)
    sources = tuple(VideoSource(Path(name), 64, 48, 100, rate) for name, rate in zip(names, rates, strict=True))
    return Rig(Path("rig"), "", cameras, sources, fps, 100, timeline=Timeline(recorded_rate(sources, fps)))


Stamp = tuple[str, int | None]


def starts(rig: Rig, *stamps: Stamp) -> tuple[StartEstimate, tuple[str, ...]]:
    """The starts, where each camera's file states a text and numbers in a second."""
    stated = {f"c{number}": Timecode(*stamp) for number, stamp in enumerate(stamps)}
    return starts_by_timecode(rig, lambda path: stated[path.name])


def differences(rig: Rig, *stamps: Stamp) -> list[float]:
    found = starts(rig, *stamps)[0].starts
    return [round(float(start - found[0]), 6) for start in found]


@pytest.mark.parametrize(
    ("text", "per_second", "count"),
    [
        ("00:00:10:05", 25, 255),
        ("01:00:00:00", 30, 108000),
        ("00:01:00;02", 30, 1800),  # the first number of minute 1
        ("00:10:00;00", 30, 17982),
        ("01:00:00;00", 60, 215784),
        ("00:00:00:25", 25, None),
        ("24:00:00:00", 25, None),
    ],
)
def test_timecodes_count_numbers_since_midnight(text: str, per_second: int, count: int | None) -> None:
    found = timecode_of(text)
    assert found is not None
    assert found.count(per_second) == count
    assert timecode_of("once") is None


@pytest.mark.parametrize(("text", "per_second"), [("23:59:59:24", 25), ("23:59:59;29", 30), ("23:59:59;59", 60)])
def test_a_day_has_one_number_more_than_its_last(text: str, per_second: int) -> None:
    found = timecode_of(text)
    assert found is not None
    assert found.day(per_second) == (found.count(per_second) or 0) + 1
    assert abs(found.day(30) / (30000 / 1001) - DAY) < 0.1 or ":" in text[8]


def test_the_number_in_a_file_tells_what_a_second_counts(tmp_path: Path) -> None:
    """The timecode track of a .mov at 50 frames a second counts 25: its sample is the number, the text follows it."""
    path = tmp_path / "a.mov"
    with av.open(str(path), "w") as file:
        track = file.add_stream("mpeg4", rate=50)
        track.width, track.height, track.pix_fmt = 64, 48, "yuv420p"
        file.metadata["timecode"] = "10:00:01:05"
        for _ in range(3):
            file.mux(track.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")))
        file.mux(track.encode())
    data = bytearray(path.read_bytes())
    entry = next(at for at in occurrences(data, b"tmcd") if struct.unpack(">IIB", data[at + 20 : at + 29])[2] == 50)
    struct.pack_into(">IIB", data, entry + 20, 25, 1, 25)
    (offset,) = struct.unpack_from(">I", data, data.find(b"stco", entry) + 12)
    struct.pack_into(">I", data, offset, 36001 * 25 + 5)
    path.write_bytes(data)
    found = read_timecode(path)
    assert found is not None
    assert (found.text, found.per_second) == ("10:00:01:05", 25)


def occurrences(data: bytearray, word: bytes) -> list[int]:
    return [at for at in range(len(data)) if data.startswith(word, at)]


@pytest.mark.parametrize("fps", [50.0, NTSC])
def test_two_pictures_may_share_a_number(fps: float) -> None:
    half = round(fps / 2)
    rig, stamps = rig_of([fps] * 3), [("10:00:01:05", half), ("10:00:01:20", half), ("10:00:02:00", half)]
    assert differences(rig, *stamps) == [0, 30, 2 * (half - 5)]
    assert starts(rig, *stamps)[0].errors.tolist() == [0.5] * 3, "two pictures, not one"


def test_where_nothing_tells_what_a_second_counts_it_is_not_used() -> None:
    one, two = ("10:00:01:05", None), ("10:00:01:20", None)
    found, warnings = starts(rig_of([50.0] * 2), one, two)
    assert np.isnan(found.starts).all()
    (warning,) = warnings
    assert "camera c0 and 1 more: nothing says whether the timecode 10:00:01:05 counts every frame of 50 a" in warning
    assert differences(rig_of([50.0] * 2), one, ("10:00:01:40", None)) == [0, 35], "a number above 24 is of 50"
    assert differences(rig_of([25.0] * 2), one, two) == [0, 15], "25 are counted one by one"


def test_drop_frame_beside_others_is_named_and_most_cameras_are_believed() -> None:
    rig, stamps = rig_of([NTSC] * 3), [("14:30:00;10", 60), ("14:30:00:22", 60), ("14:30:00;15", 60)]
    found, warnings = starts(rig, *stamps)
    assert differences(rig, *stamps)[::2] == [0, 5]
    assert np.isnan(found.starts[1])
    (warning,) = warnings
    assert "camera c0 and 1 more counts drop-frame timecode, camera c1 does not" in warning
    assert np.isnan(starts(rig_of([NTSC] * 2), *stamps[:2])[0].starts).all(), "one against one"


@pytest.mark.parametrize(
    ("before", "after", "fps", "per_second", "apart"),
    [
        ("23:59:59:20", "00:00:01:05", 25.0, 25, 35),
        ("23:59:59;20", "00:00:01;05", 30000 / 1001, 30, 45),
        ("23:59:59:20", "00:00:01:05", 30000 / 1001, 30, 45),
        ("23:59:59:20", "00:00:01:05", 24000 / 1001, 24, 33),
        ("23:59:59:20", "00:00:01:05", 50.0, 25, 70),
        ("23:59:59;58", "00:00:00;00", NTSC, 60, 2),
    ],
)
def test_midnight_is_passed_by_the_day_of_the_timecode(
    before: str, after: str, fps: float, per_second: int, apart: int
) -> None:
    assert differences(rig_of([fps] * 2), (before, per_second), (after, per_second)) == [0, apart]


def test_starts_are_in_frames_as_recorded_whatever_rate_is_played() -> None:
    stamps = ("10:00:00:00", 30), ("10:00:01:15", 30)
    assert differences(rig_of([30.0] * 2, fps=15.0), *stamps) == [0, 45]
    assert differences(rig_of([30.0, 30.0], fps=29.97), *stamps) == [0, 45]


@dataclass(frozen=True)
class Untimed:
    """A source that states no rate."""

    path: Path
    frame_count: int = 5
    fps: float | None = None


def test_the_rate_of_a_rig_is_the_slowest_recording_s() -> None:
    sources: Any = rig_of([60.0, NTSC / 2]).sources
    assert recorded_rate(sources, 15.0) == Fraction(30000, 1001)
    nobody: Any = [Untimed(Path("a"))]
    assert recorded_rate(nobody, 29.97) == Fraction(30000, 1001)
    assert recorded_rate(nobody, None) is None
