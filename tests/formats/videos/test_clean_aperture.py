"""The clean aperture of a video: what is shown of it, and what a rig is calibrated for."""

from __future__ import annotations

import io
import struct
from dataclasses import replace
from pathlib import Path

import av
import numpy as np
import pytest

from decogs.formats.rigs import open_rig, read_frames
from decogs.formats.videos.clean_aperture import _elements
from decogs.formats.videos.reading import open_video
from rig_layouts import cameras, write_model
from textured_videos import with_matrix, write


def with_aperture(mp4: bytes, *values: int) -> bytes:
    """The file with a clean aperture: numerators and denominators of width, height, and right and down off the middle.

    Source: ISO 14496-12, section 12.1.4.
    """
    data, box = bytearray(mp4), struct.pack(">I4s4IiIiI", 40, b"clap", *values)
    parents = [data.find(kind) - 4 for kind in (b"moov", b"trak", b"mdia", b"minf", b"stbl", b"stsd", b"avc1")]
    end = parents[-1] + int(struct.unpack_from(">I", data, parents[-1])[0])
    assert data.find(b"mdat") < parents[0], "no place of pictures moves"
    for at in parents:
        struct.pack_into(">I", data, at, struct.unpack_from(">I", data, at)[0] + len(box))
    data[end:end] = box
    return bytes(data)


@pytest.mark.parametrize("turns", [0, 1])
@pytest.mark.parametrize("name", ["a.mov", "a.mp4", "a.mkv"])
def test_a_clean_aperture_is_what_is_shown(tmp_path: Path, name: str, turns: int) -> None:
    """40 x 30 pixels of 64 x 48, two right of the middle and three above it; FFmpeg's own words: "14/10/6/12"."""
    shown = write(tmp_path / "whole.mov", frames=2)
    boxed = with_aperture((tmp_path / "whole.mov").read_bytes(), 40, 1, 30, 1, 4, 2, -3, 1)
    boxed = with_matrix(boxed, 0, 1, -1, 0) if turns else boxed
    (tmp_path / "boxed.mov").write_bytes(boxed)
    if name == "a.mkv":
        _copied(tmp_path / "boxed.mov", tmp_path / name)  # by FFmpeg, which knows PixelCrop
    else:
        (tmp_path / name).write_bytes(boxed)
    source = open_video(tmp_path / name)
    for expected, picture in zip(shown, source.read(0, 2), strict=True):
        within = np.rot90(expected[6:36, 14:54], -turns)
        assert picture.shape == within.shape == (source.height, source.width, 3)
        assert np.abs(picture.astype(float) - within).mean() < 3
    whole = source.whole()
    assert sorted((whole.width, whole.height)) == [48, 64]
    assert np.abs(next(whole.read(0, 1)).astype(float) - np.rot90(shown[0], -turns)).mean() < 3


def _copied(source: Path, copy: Path) -> None:
    with av.open(str(source)) as read, av.open(str(copy), "w") as written:
        stream = written.add_stream_from_template(read.streams.video[0])
        for packet in read.demux(read.streams.video[0]):
            if packet.dts is not None:
                packet.stream = stream
                written.mux(packet)


@pytest.mark.parametrize(
    "aperture",
    [(0, 1, 0, 1, 0, 1, 0, 1), (40, 0, 30, 1, 0, 1, 0, 1), (80, 1, 60, 1, 0, 1, 0, 1), (40, 1, 30, 1, 99, 1, 0, 1)],
)
def test_a_clean_aperture_that_is_none_is_passed_over(tmp_path: Path, aperture: tuple[int, ...]) -> None:
    """Nothing, a half of nothing, more than there is, and beside the picture."""
    write(tmp_path / "a.mov", frames=1)
    (tmp_path / "a.mov").write_bytes(with_aperture((tmp_path / "a.mov").read_bytes(), *aperture))
    assert (open_video(tmp_path / "a.mov").width, open_video(tmp_path / "a.mov").height) == (64, 48)


@pytest.mark.parametrize(("calibrated", "focal"), [((40, 30), 50.0), ((64, 48), 50.0), ((20, 15), 100.0)])
def test_a_rig_is_calibrated_for_what_is_shown_or_for_the_whole(
    tmp_path: Path, calibrated: tuple[int, int], focal: float
) -> None:
    """A calibration of another size is scaled to what is shown, which is not sure, and said."""
    write(tmp_path / "whole.mov", frames=1)
    boxed = with_aperture((tmp_path / "whole.mov").read_bytes(), 40, 1, 30, 1, 0, 1, 0, 1)
    (tmp_path / "whole.mov").unlink()
    posed = []
    for camera in cameras("opencv", ["left", "right"]):
        lens = replace(camera, width=calibrated[0], height=calibrated[1], fx=50.0, fy=50.0)
        posed.append((f"{camera.name}.png", lens))
        (tmp_path / f"{camera.name}.mov").write_bytes(boxed)
    write_model(tmp_path / "sparse/0", posed)
    rig = open_rig(tmp_path)
    size = calibrated if calibrated[0] >= 40 else (40, 30)
    assert {(camera.width, camera.height, camera.fx) for camera in rig.cameras} == {(*size, focal)}
    assert [frame.shape for frame in next(read_frames(rig))[1]] == [(size[1], size[0], 3)] * 2
    assert any("clean aperture" in warning for warning in rig.warnings) == (calibrated == (20, 15))


@pytest.mark.parametrize("length", [b"\xff", b"\x01" + b"\xff" * 7], ids=["one byte", "eight bytes"])
def test_a_matroska_element_of_unknown_size_goes_to_the_end(length: bytes) -> None:
    data = b"\xa3\x82ab" + b"\x18\x53\x80\x67" + length + bytes(200)
    spans = [span for _, span in _elements(io.BytesIO(data), (0, len(data)))]
    assert spans == [(2, 4), (8 + len(length), len(data))]
