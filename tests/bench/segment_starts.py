"""What shows where a closed segment starts: its first frame against the frames between two starts, per stream.

    python tests/bench/segment_starts.py RIG STREAM.dgs ...

For the stream's first held-out camera, where things move (decogs-bench's dynamic regions) and where nothing does:

- PSNR of the frame;
- flicker: mean difference, x100, of the change since the frame before from the recorded change, in 0..1; what moves as
  recorded adds nothing. Where nothing moves, the change itself (mTV x100).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

import numpy as np

from decogs.bench.measures.metrics import psnr, square_error_map, total_variation
from decogs.bench.measures.regions import find_regions, held_out_pictures
from decogs.codec.header.header import StreamHeader
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.formats.rigs import open_rig


def measure(rig_path: str, stream_path: str) -> list[dict[str, Any]]:
    """One record per frame."""
    rig, rows = open_rig(rig_path), []
    with open_stream(stream_path) as stream:
        header, camera = stream.header, stream.header.held_out[0]
        scale = header.settings["scale"]
        frames = range(header.first_frame, header.first_frame + stream.frame_count)
        regions = find_regions(rig, camera, frames, scale)
        pictures = held_out_pictures(rig, camera, frames, scale)
        before = None
        for frame, recorded in zip(stream.frames(), pictures, strict=True):
            seen = to_8bit(render_view(header, frame.splats, camera, scale=scale).image)
            row = {"frame": frame.index, "bytes": frame.packet_bytes, "starts": starts(header, frame.index)}
            row["psnr"] = psnr(square_error_map(seen, recorded), regions.dynamic)
            if before is not None:
                change, true = (
                    np.subtract(now, was, dtype=np.float64) for now, was in zip((seen, recorded), before, strict=True)
                )
                row["flicker"] = 100 * float(np.abs(change - true)[regions.dynamic].mean()) / 255
                row["static"] = 100 * (total_variation(before[0], seen, regions.static) or 0.0)
            before = (seen, recorded)
            rows.append(row)
    return rows


def starts(header: StreamHeader, frame: int) -> bool:
    segment = header.settings.get("segment", 0)
    return bool(frame and segment and frame % segment == 0)


def summary(name: str, rows: Sequence[dict[str, Any]]) -> str:
    """The means of starts, of the frames right before them, and of all others but the first."""
    at = [row for row in rows if row["starts"]]
    others = [row for row in rows[1:] if not row["starts"]]

    def means(group: Sequence[dict[str, Any]]) -> str:
        figures = [fmean(row[name] for row in group) for name in ("psnr", "flicker", "static", "bytes")]
        return "{:6.2f} dB  flicker {:.3f}  static mTV {:.4f}  {:7.0f} bytes".format(*figures)

    last = [rows[row["frame"] - 1] for row in at]
    following = [rows[row["frame"] + 1] for row in at if row["frame"] + 1 < len(rows)]
    lines = [f"{name}", f"  others          {means(others)}"]
    if at:
        lines += [f"  before a start  {means(last)}", f"  starts          {means(at)}"]
        lines += [f"  after a start   {means(following)}"]
    worst = max(row["flicker"] for row in others)
    return "\n".join([*lines, f"  largest flicker of an ordinary frame {worst:.3f}"])


def main(rig: str, *streams: str) -> None:
    for stream in streams:
        print(summary(Path(stream).name, measure(rig, stream)), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
