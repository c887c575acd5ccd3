"""Fisheyes of 170 degrees: other viewpoints are without the veil that far Gaussians lay over wide pictures."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.bench.measures.metrics import psnr
from decogs.decoder.cameras.lens import Undistortion
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.formats import cameras as decogs_cameras
from decogs.formats.cameras import as_pinhole
from encode_rig import encode_rig
from fisheyes.make import HELD_OUT, cameras, write_fisheyes

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_fisheyes(tmp_path_factory.mktemp("fisheyes") / "rig", cameras((120, 90), 170.0), frames=2)


def test_other_viewpoints_have_no_veil(rig: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two left-out cameras, straightened: 4.6 dB at 240x180; how far seeds differ is .1."""
    drawn_in_faces = free_views(rig, tmp_path / "faces.dgs")
    monkeypatch.setattr(decogs_cameras, "WIDEST_CORNER", np.inf)
    whole = free_views(rig, tmp_path / "whole.dgs")
    assert drawn_in_faces[0] > whole[0] + 2
    assert drawn_in_faces[1] > drawn_in_faces[0] - 0.3, "a later frame"


def free_views(rig: Path, path: Path) -> list[float]:
    """PSNR by frame of what a pinhole of the lens's focal length sees from where the left-out cameras stand."""
    encode_rig(rig, path, "live", holdout=list(HELD_OUT), threads=1)
    found = []
    with open_stream(path) as stream:
        straight = {camera.name: Undistortion(camera, as_pinhole(camera)) for camera in stream.header.cameras}
        for number, frame in enumerate(stream.frames()):
            errors = []
            for name in HELD_OUT:
                recorded = cv2.imread(str(rig / name / f"{number:04d}.png"))[..., ::-1].astype(np.float32) / 255
                seen = render_view(stream.header, frame.splats, straight[name].pinhole, threads=1).image
                errors.append((np.clip(seen, 0, 1) - straight[name].apply(recorded)) ** 2)
            found.append(psnr(np.stack(errors)) or 0.0)
    return found
