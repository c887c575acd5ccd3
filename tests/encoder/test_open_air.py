"""Under the open sky, nothing hangs before the sky where no camera was, and a resumed encode has the same bytes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.decoder.reading.stream import open_stream
from decogs.formats.cameras import project
from decogs.formats.splats import sigmoid
from encode_rig import encode_rig
from outdoors.make import cameras, write_meadow
from packets import iterate_packets

LEFT_OUT = "cam06"


@pytest.fixture(scope="module")
def meadow(tmp_path_factory: pytest.TempPathFactory) -> Path:
    views = cameras((96, 72), 110)[::2]
    return write_meadow("clear", tmp_path_factory.mktemp("meadow") / "clear", views, frames=2)


@pytest.fixture(scope="module")
def stream(meadow: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    output = tmp_path_factory.mktemp("meadow") / "clear.dgs"
    encode_rig(meadow, output, "live", holdout=[LEFT_OUT], effects="motion")
    return output


def test_nothing_hangs_before_the_sky_of_a_left_out_camera(meadow: Path, stream: Path) -> None:
    is_sky = np.isinf(np.load(meadow / f"truth/depth/{LEFT_OUT}.npy")).astype(np.uint8)
    well_inside = cv2.erode(is_sky, np.ones((7, 7), np.uint8)) > 0
    with open_stream(stream, strict=True) as decoded:
        camera = next(each for each in decoded.header.cameras if each.name == LEFT_OUT)
        for frame in decoded.frames():
            u, v, depth = project(camera, frame.splats.means)
            inside = (depth > 0) & (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
            rows = np.flatnonzero(inside & (sigmoid(frame.splats.opacity_logits) > 0.1))
            before = rows[well_inside[v[rows].astype(int), u[rows].astype(int)]]
            near = np.count_nonzero(depth[before] < 60)
            # Between two neighbours' skies is space that neither of them shows to be free.
            assert near < 0.1 * len(before)
            assert len(before) > 50


def test_a_resumed_encode_has_the_same_sky(meadow: Path, stream: Path, tmp_path: Path) -> None:
    with stream.open("rb") as file:
        ends = [packet.offset + packet.size for packet in iterate_packets(file)]
    output = tmp_path / "again.dgs"
    (tmp_path / "again.dgs.part").write_bytes(stream.read_bytes()[: ends[1]])  # header and keyframe
    report = encode_rig(meadow, output, "live", holdout=[LEFT_OUT], effects="motion", resume=True)
    assert report.resumed == 1
    assert output.read_bytes() == stream.read_bytes()
