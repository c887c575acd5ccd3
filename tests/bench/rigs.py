"""The rows of report/rigs.md: every rig, with several cameras left out of one encode.

    python tests/bench/rigs.py DATA [NAME ...]

DATA holds the folders ``rigs``, ``real`` and ``real_static``; NAMEs choose among the rows. PSNR is that of 8-bit
pictures of the cameras left out, the mean over frames and cameras; where things move: decogs-bench's dynamic regions.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean

import numpy as np

from decogs.bench.measures.metrics import psnr, square_error_map
from decogs.bench.measures.regions import find_regions, held_out_pictures
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder import EncodeJob, encode
from decogs.formats.rigs import open_rig

FEWEST_MOVING = 0.005
"""Share of the pixels below which what moves is not measured."""


@dataclass(frozen=True)
class Row:
    """A rig below DATA, the cameras left out, and the frames [``first``, ``stop``) at ``scale``."""

    rig: str
    left_out: tuple[str, ...]
    first: int
    stop: int
    scale: float = 1.0


THREE = ("cam00", "cam03", "cam09")
ROWS = (
    Row("rigs/workbench", THREE, 0, 12),
    Row("rigs/popup", THREE, 8, 20),
    Row("rigs/candle", THREE, 6, 18),
    Row("rigs/still", THREE, 0, 8),
    Row("rigs/workbench_dim", THREE, 6, 18),
    Row("rigs/workbench_drift", THREE[:2], 0, 12),
    Row("rigs/stage", ("cam00", "cam04", "cam08"), 0, 12),
    Row("rigs/hdr", ("cam00",), 0, 6),
    Row("real/panoptic_basketball", ("cam00", "cam10", "cam20"), 0, 12),
    Row("real/mouse_cage_8cam", ("cam00", "cam04"), 0, 4, 0.5),
    Row("real/desk_charuco_4cam", ("cam01",), 0, 8, 0.5),
    Row("real/balance_4cam", ("cam00",), 0, 8, 0.5),
    Row("real_static/assembly_table_8cam", ("cam03",), 0, 1, 0.5),
)


def measure(data: Path, row: Row) -> str:
    """The row's cells: whole picture, worst camera, where things move, its last frame, bytes, seconds."""
    rig, frames = open_rig(data / row.rig), range(row.first, row.stop)
    began = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.dgs"
        report = encode(
            EncodeJob(rig, path, frames=slice(row.first, row.stop), holdout=row.left_out, scale=row.scale, threads=1)
        )
        seconds = time.process_time() - began
        with open_stream(path) as stream:
            header, scenes = stream.header, [frame.splats for frame in stream.frames()]
    whole, moving = [], []
    for camera in row.left_out:
        dynamic = find_regions(rig, camera, frames, row.scale).dynamic
        pictures = held_out_pictures(rig, camera, frames, row.scale)
        errors = [
            square_error_map(to_8bit(render_view(header, scene, camera, scale=row.scale).image), picture)
            for scene, picture in zip(scenes, pictures, strict=True)
        ]
        everywhere = np.ones_like(dynamic)
        whole.append([psnr(error, everywhere) or 0.0 for error in errors])
        if dynamic.mean() > FEWEST_MOVING and len(frames) > 1:
            moving.append([psnr(error, dynamic) or 0.0 for error in errors])
    later = report.frames[1:]
    cells = [f"{np.mean(whole):.2f}", f"{min(map(fmean, whole)):.2f}"]
    cells += [f"{np.mean(moving):.2f}", f"{np.mean(moving, axis=0)[-1]:.2f}"] if moving else ["-", "-"]
    cells += (
        [f"{fmean(f.bytes for f in later) / 1e3:.1f}", f"{fmean(f.cpu_seconds for f in later):.2f}"]
        if later
        else ["-", "-"]
    )
    cells += [f"{seconds:.0f}", f"keyframe {report.frames[0].bytes / 1e3:.0f} kB"]
    effects = sorted({effect for frame in report.frames for effect in frame.effects})
    return f"| {rig.path.name} | {', '.join(row.left_out)} | " + " | ".join(cells) + f" | {', '.join(effects)} |"


def main(data: str, names: Sequence[str]) -> None:
    """Prints a line a rig, as soon as it is measured."""
    for row in ROWS:
        if not names or Path(row.rig).name in names:
            print(measure(Path(data), row), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
