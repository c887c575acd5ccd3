"""What the float32 kernel loses against its float64 twin, on a decoded frame."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rasterise import Rendering, render
from decogs.decoder.rasterise.reference import render_reference
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import through_lens, view_plan
from decogs.encoder.backends.psnr import psnr_of
from decogs.formats.files.outputs import write_whole
from decogs.formats.splats import FloatArray, Splats

from .estimates import rounded
from .machine import code_version
from .metrics import BytePicture
from .regions import held_out_pictures
from .runs import RigBench
from .variants import Variant

SCALE = 0.5
"""Of the pictures compared, times the report's: the twin lets every pixel see every Gaussian."""


@dataclass(frozen=True)
class Precision:
    """One frame of the held-out camera, rendered twice. PSNR in dB of float pictures, clipped to 0..1.

    ``single``, ``double``: the kernel's and the twin's picture against what was recorded; ``between``: the kernel's
    against the twin's. ``changed``: share of 8-bit values that differ between the two. ``*_seconds``: to render it.
    """

    code: str
    frame: int
    width: int
    height: int
    gaussians: int
    single: float
    double: float
    between: float
    changed: float
    single_seconds: float
    double_seconds: float


def measure_precision(bench: RigBench, source: Variant) -> Precision:
    """Compares the two on the last frame of the variant's stream and keeps the result."""
    index = bench.frames_of(source)[-1]
    scale = bench.options.scale * SCALE
    (recorded,) = held_out_pictures(bench.rig, bench.camera, [index], scale)
    with open_stream(bench.stream(source), strict=True) as stream:
        *_, last = stream.frames(stream.frame_count - 1)
        found = compare(stream.header, last.splats, bench.camera, scale, recorded, index)
    write_whole(_file(bench, source), (json.dumps(rounded(asdict(found)), indent=1) + "\n").encode())
    return found


def find_precision(bench: RigBench, source: Variant) -> Precision | None:
    """What an earlier report left, if the source's run is there and was made by the same code."""
    try:
        found = Precision(**json.loads(_file(bench, source).read_text("utf-8")))
    except (OSError, ValueError, TypeError):
        return None
    run = bench.find(source)
    return found if run is not None and run.code == found.code else None


def compare(
    header: StreamHeader, splats: Splats, camera: str, scale: float, recorded: BytePicture, frame: int
) -> Precision:
    """One scene through both, its lens included, on one thread; ``frame`` is the rig's index."""
    plan = view_plan(header, camera, scale=scale, undistorted=False)
    render(splats, plan.render_camera, header.background, threads=1)  # the first rendering loads the kernel
    began = time.perf_counter()
    fast = render(splats, plan.render_camera, header.background, threads=1)
    between = time.perf_counter()
    exact, alpha, depth, _ = render_reference(
        np,
        splats.means.astype(np.float64),
        splats.log_scales.astype(np.float64),
        splats.quaternions.astype(np.float64),
        splats.opacity_logits.astype(np.float64),
        splats.sh.astype(np.float64),
        plan.render_camera,
        header.background,
        splats.sh_degree,
    )
    ended = time.perf_counter()
    # float32 from here on: 1e-7 of a picture that is compared to 1e-5 at best.
    planes = (np.ascontiguousarray(exact.transpose(1, 2, 0)), alpha, depth)
    twin = Rendering(*(plane.astype(np.float32) for plane in planes))
    one, other = (np.clip(through_lens(plan, seen, header.background).image, 0, 1) for seen in (fast, twin))
    target = recorded / np.float32(255)
    height, width = target.shape[:2]
    return Precision(
        code_version(),
        frame,
        width,
        height,
        len(splats.means),
        _psnr(one, target),
        _psnr(other, target),
        _psnr(one, other),
        float((to_8bit(one) != to_8bit(other)).mean()),
        between - began,
        ended - between,
    )


def _psnr(one: FloatArray, other: FloatArray) -> float:
    return psnr_of(float(np.mean((one.astype(np.float64) - other) ** 2)))


def _file(bench: RigBench, source: Variant) -> Path:
    return bench.runs_folder / f"{bench.name}-precision-{bench.key(source)}.json"
