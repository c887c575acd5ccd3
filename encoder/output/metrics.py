"""A stream's figures of its own quality: METRICS packets (SPEC.md, section 3), which decoders ignore."""

from __future__ import annotations

import json
import math

from decogs.formats.stream.container import PacketKind

from .reports import FrameReport
from .stream_output import StreamOutput

_DECIMALS = 2


def write_metrics(output: StreamOutput, frame: int, report: FrameReport) -> None:
    """Appends a packet with the frame's PSNR in dB, a JSON object: ``psnr`` over the training views, as reported, and
    ``held_out_psnr`` where cameras were held out; and where the pictures were scaled, their ``scale`` and
    ``held_out_own_size_psnr``. What is no finite number is left out, an empty packet too."""
    figures = {"psnr": report.training_psnr, "held_out_psnr": report.held_out_psnr}
    figures["held_out_own_size_psnr"] = report.held_out_own_size_psnr
    finite = {
        name: round(value, _DECIMALS) for name, value in figures.items() if value is not None and math.isfinite(value)
    }
    if finite and report.scale != 1:
        finite["scale"] = report.scale
    if finite:
        output.write(PacketKind.METRICS, frame, json.dumps(finite, sort_keys=True, separators=(",", ":")).encode())
