"""The sensor's readout that GoPros write into a track of telemetry, and rigs that have it from there."""

from __future__ import annotations

import json
import struct
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from decogs.formats.rigs import open_rig
from decogs.formats.videos.reading import open_video


def key(name: bytes, kind: bytes, data: bytes, size: int = 1) -> bytes:
    """One key of GPMF with its data, padded to four bytes; of kind 0: with other keys."""
    return struct.pack(">4scBH", name, kind, size, len(data) // size) + data + bytes(-len(data) % 4)


def telemetry(milliseconds: float, kind: bytes = b"f") -> bytes:
    number = struct.pack(">d" if kind == b"d" else ">f", milliseconds)
    stream = key(b"STNM", b"c", b"Sensor read out") + key(b"SROT", kind, number, len(number))
    return key(b"DEVC", b"\0", key(b"DVNM", b"c", b"Hero7 Black") + key(b"STRM", b"\0", stream))


def write(path: Path, payload: bytes, *, rotation: bytes | None = None) -> Path:
    """A video of 8 frames whose second track has a payload. PyAV writes no telemetry: a track of sound is renamed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with av.open(str(path), "w") as container:
        video: Any = container.add_stream("mpeg4", rate=30)
        video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        other: Any = container.add_stream("aac", rate=48000)
        container.start_encoding()
        for index in range(8):
            picture = np.full((48, 64, 3), 20 * index, np.uint8)
            container.mux(video.encode(av.VideoFrame.from_ndarray(picture)))
        container.mux(video.encode())
        packet = av.Packet(payload)
        packet.stream, packet.pts, packet.dts, packet.time_base = other, 0, 0, Fraction(1, 30)
        container.mux(packet)
    data = path.read_bytes().replace(b"mp4a", b"gpmd").replace(b"soun", b"meta")
    if rotation is not None:
        upright = struct.pack(">9i", 1 << 16, 0, 0, 0, 1 << 16, 0, 0, 0, 1 << 30)
        at = data.index(upright, data.index(b"tkhd"))
        data = data[:at] + rotation + data[at + len(rotation) :]
    path.write_bytes(data)
    return path


def matrix(a: int, b: int, c: int, d: int) -> bytes:
    return struct.pack(">9i", a << 16, b << 16, 0, c << 16, d << 16, 0, 0, 0, 1 << 30)


def test_a_gopro_tells_its_readout(tmp_path: Path) -> None:
    assert open_video(write(tmp_path / "cam.mp4", telemetry(15.25))).readout == 0.01525
    assert open_video(write(tmp_path / "plain.mp4", b"something else")).readout == 0.0


@pytest.mark.parametrize(
    ("turn", "sign"), [(matrix(-1, 0, 0, -1), -1), (matrix(0, 1, -1, 0), 0), (matrix(-1, 0, 0, 1), 1)]
)
def test_a_camera_that_hangs_upside_down_is_read_from_below(tmp_path: Path, turn: bytes, sign: int) -> None:
    """A quarter turn: rows of the sensor are columns of the picture, which have no times of their own."""
    video = open_video(write(tmp_path / "cam.mp4", telemetry(10.0), rotation=turn))
    assert video.turn != (1, 0, 0, 1)
    assert video.readout == sign * 0.01


@pytest.mark.parametrize("milliseconds", [0.0, -4.0, 201.0, float("nan"), float("inf")])
def test_values_that_no_sensor_has_are_none(tmp_path: Path, milliseconds: float) -> None:
    assert open_video(write(tmp_path / "cam.mp4", telemetry(milliseconds))).readout == 0.0


def test_telemetry_that_is_damaged_tells_nothing(tmp_path: Path) -> None:
    """Cut anywhere, of another type, or with lengths beyond its end."""
    whole = telemetry(15.25)
    begins = whole.index(b"SROT")
    damaged = [whole[:cut] for cut in range(5, begins + 12, 7)]
    damaged += [telemetry(15.25, kind=b"d"), whole.replace(b"STNM", b"STNM")[: begins + 8]]
    damaged += [whole[:12] + b"\xff\xff\xff\xff" + whole[16:]]
    for index, payload in enumerate(damaged):
        assert open_video(write(tmp_path / f"{index}.mp4", payload)).readout == 0.0


def test_rigs_of_such_videos_have_row_times_unless_the_calibration_says_others(tmp_path: Path, make: Any) -> None:
    for index in range(3):
        write(tmp_path / f"cam{index:02d}.mp4", telemetry(10.0))
    values = make.transforms_values([f"cam{index:02d}.mp4" for index in range(3)])
    values |= {"w": 64, "h": 48}
    values["frames"][1]["rolling_shutter_time"] = 0.02
    values["frames"][2]["rolling_shutter_time"] = 0.0
    (tmp_path / "transforms.json").write_text(json.dumps(values))
    rig = open_rig(tmp_path)
    assert rig.timeline.readouts == pytest.approx({"cam00": 0.3, "cam01": 0.6})
