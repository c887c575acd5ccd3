"""PSNR with a scale: what is printed says its size, and that of the cameras' own size is what one decodes."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.decoder import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder import EncodeReport, FrameReport
from decogs.encoder.output.progress import frame_line
from decogs.encoder.stream.summary import _held_out
from decogs.formats.stream.container import PacketKind, PacketReader
from encode_rig import encode_rig

HELD_OUT = ["cam02", "cam03"]


def against_the_recording(stream: Path, rig: Path, scale: float = 1.0) -> list[float]:
    """Mean PSNR of the held-out cameras' decoded views by frame, at ``scale`` of their own size."""
    found = []
    with open_stream(stream) as opened:
        for frame in opened.frames():
            each = []
            for name in HELD_OUT:
                picture = cv2.imread(str(rig / name / f"{frame.index:04d}.png"))[..., ::-1]
                shown = render_view(opened.header, frame.splats, name, scale=scale).image
                picture = cv2.resize(picture, shown.shape[1::-1], interpolation=cv2.INTER_AREA)
                square = (np.clip(shown, 0, 1).astype(np.float64) - picture / 255) ** 2
                each.append(-10 * np.log10(square.mean()))
            found.append(float(np.mean(each)))
    return found


@pytest.mark.parametrize("kind", ["moving_rig", "lens_rig"])
@pytest.mark.parametrize("scale", [0.5, 1.5])
def test_the_figure_at_own_size_is_that_of_what_is_decoded(
    encode: Any, kind: str, scale: float, request: pytest.FixtureRequest
) -> None:
    rig = request.getfixturevalue(kind)
    encoded = encode(rig, scale=scale, holdout=HELD_OUT)
    frames = encoded.report.frames
    decoded = against_the_recording(encoded.path, rig)
    # Both are means of the same float32 pictures' errors, added up in another order.
    assert [frame.held_out_own_size_psnr for frame in frames] == pytest.approx(decoded, rel=1e-6)
    assert [frame.scale for frame in frames] == [scale] * len(frames)
    if kind == "moving_rig" and scale == 0.5:
        small = against_the_recording(encoded.path, rig, scale)
        # Of the same pinhole pictures; one kernel is for training.
        assert [frame.held_out_psnr for frame in frames] == pytest.approx(small, abs=0.01)
        assert all(abs(here - own) > 0.1 for here, own in zip(small, decoded, strict=True)), "they are not the same"


def test_without_a_scale_there_is_one_size(moving: Any) -> None:
    for frame in moving.report.frames:
        assert (frame.scale, frame.held_out_own_size_psnr) == (1.0, None)


def test_report_log_and_metrics_say_the_size(moving_rig: Path, tiny_settings: Any, tmp_path: Path) -> None:
    output, log = tmp_path / "x.dgs", tmp_path / "log.jsonl"
    report = encode_rig(
        moving_rig, output, tiny_settings, frames=slice(0, 2), scale=0.5, holdout=HELD_OUT, threads=1, metrics=True,
        log=log,
    )  # fmt: skip
    assert report.held_out_sizes == dict.fromkeys(HELD_OUT, ((32, 24), (64, 48)))
    start, *frames, _ = (json.loads(line) for line in log.read_text().splitlines())
    assert start["scale"] == 0.5
    assert start["held_out_sizes"] == {name: [[32, 24], [64, 48]] for name in HELD_OUT}
    assert [frame["held_out_own_size_psnr"] for frame in frames] == [f.held_out_own_size_psnr for f in report.frames]
    with output.open("rb") as file:
        reader, told = PacketReader(file), []
        while (packet := reader.next()) is not None:
            if packet.kind == PacketKind.METRICS:
                told.append(json.loads(packet.payload))
    assert [set(each) for each in told] == [{"psnr", "held_out_psnr", "held_out_own_size_psnr", "scale"}] * 2
    assert [each["scale"] for each in told] == [0.5, 0.5]
    assert [each["held_out_own_size_psnr"] for each in told] == pytest.approx(
        [frame.held_out_own_size_psnr for frame in report.frames], abs=0.005
    )


def test_what_is_printed_says_the_size(frame_report: FrameReport) -> None:
    scaled = replace(frame_report, scale=0.5, held_out_own_size_psnr=26.96)
    assert "held out  30.25 dB at scale 0.5, 26.96 dB at the cameras' own size  sel" in frame_line(scaled)
    assert "train  31.50 dB at scale 0.5  selected" in frame_line(
        replace(scaled, held_out_psnr=None, held_out_own_size_psnr=None)
    )
    sizes = {"cam00": ((32, 24), (64, 48)), "cam01": ((32, 24), (64, 48)), "cam02": ((50, 24), (100, 48))}
    report = EncodeReport(Path("x.dgs"), [scaled], 1, False, held_out_sizes=sizes)
    assert _held_out(report) == [
        "held-out PSNR  first 30.25  mean 30.25  last 30.25 dB at 32x24, 50x24 (scaled)",
        "held-out PSNR  first 26.96  mean 26.96  last 26.96 dB at 64x48, 100x48 (own size)",
    ]
    assert _held_out(replace(report, frames=[frame_report])) == [
        "held-out PSNR  first 30.25  mean 30.25  last 30.25 dB"
    ]
