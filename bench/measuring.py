"""Decoded frames against what held-out cameras recorded: quality by region, flicker, and the time to render."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields
from statistics import fmean, median

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rendering.views import render_view
from decogs.encoder.backends.psnr import psnr_of
from decogs.formats.splats import Splats

from .metrics import BytePicture, Mask, aligned, mean_over, psnr, square_error_map, ssim_map, total_variation
from .perceptual import Distance
from .regions import Regions


@dataclass(frozen=True)
class FrameQuality:
    """One frame of a held-out camera, or the means over several. PSNR in dB; None for a region without pixels.

    ``psnr_subject``: inside the rig's true matte. ``variation``: mean change of the static pixels since the frame
    before, 0..1; None in the first.
    ``variation_undisturbed``: the same of those outside every difference mask. ``psnr_aligned``: of the whole picture
    once its colours are brought to the recording's.
    """

    psnr: float
    psnr_dynamic: float | None
    psnr_static: float | None
    ssim: float
    ssim_dynamic: float | None
    ssim_static: float | None
    lpips: float | None
    variation: float | None
    psnr_aligned: float | None = field(default=None, kw_only=True)
    psnr_subject: float | None = field(default=None, kw_only=True)
    variation_undisturbed: float | None = field(default=None, kw_only=True)


@dataclass(frozen=True)
class HeldOut:
    """A camera that training never saw: what it recorded, a picture for each frame measured, its regions and mattes."""

    camera: str
    recorded: Iterable[BytePicture]
    regions: Regions
    mattes: Iterable[Mask | None]


@dataclass(frozen=True)
class StreamQuality:
    """All frames, the median seconds to render one and to read one, and one column of every frame, (H, T, 3).

    ``decode_cpu_seconds``: the median of reading and rendering one, in processor seconds, all cores added.
    ``read_cpu_seconds``: of reading one, the mean, since some formats read all frames with the first.
    """

    frames: list[FrameQuality]
    render_seconds: float
    read_seconds: float
    decode_cpu_seconds: float
    read_cpu_seconds: float
    column: NDArray[np.uint8]


def measure_scenes(
    header: StreamHeader,
    scenes: Iterator[Splats],
    views: Sequence[HeldOut],
    *,
    scale: float,
    threads: int,
    column: int,
    distance: Distance | None = None,
) -> StreamQuality:
    """Compares the ``views`` of every frame, as any viewer would show them, with what was recorded.

    ``header`` has the cameras; ``scenes``, a frame each, are read as they are needed. Every frame is rendered, also one
    in which nothing changed. ``column``: which one of the first camera to keep; rendering is timed on that camera.
    """
    frames: list[FrameQuality] = []
    rendering: list[float] = []
    reading: list[float] = []
    reading_cpu: list[float] = []
    decoding: list[float] = []
    columns: list[NDArray[np.uint8]] = []
    before: list[BytePicture | None] = [None] * len(views)
    for targets in zip(*(zip(view.recorded, view.mattes, strict=True) for view in views), strict=True):
        began, began_cpu = time.perf_counter(), cpu_seconds()
        splats = next(scenes)
        reading.append(time.perf_counter() - began)
        reading_cpu.append(cpu_seconds() - began_cpu)
        if not rendering:  # the first rendering loads the kernel
            render_view(header, splats, views[0].camera, scale=scale, threads=threads)
        found: list[FrameQuality] = []
        for number, (view, (target, matte)) in enumerate(zip(views, targets, strict=True)):
            began, began_cpu = time.perf_counter(), cpu_seconds()
            image = render_view(header, splats, view.camera, scale=scale, threads=threads).image
            seconds, spent = time.perf_counter() - began, cpu_seconds() - began_cpu
            seen = to_8bit(image)
            found.append(_quality(before[number], seen, target, view.regions, matte, distance))
            before[number] = seen
            if number == 0:
                rendering.append(seconds)
                decoding.append(reading_cpu[-1] + spent)
                columns.append(seen[:, column])
        frames.append(_mean(found))
    return StreamQuality(
        frames,
        render_seconds=median(rendering),
        read_seconds=median(reading),
        decode_cpu_seconds=median(decoding),
        read_cpu_seconds=fmean(reading_cpu),
        column=np.stack(columns, axis=1),
    )


def cpu_seconds() -> float:
    """Processor seconds so far, those of other programs that were run included."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _mean(found: Sequence[FrameQuality]) -> FrameQuality:
    """The means over cameras, of those that have a value."""
    values = {f.name: [v for each in found if (v := getattr(each, f.name)) is not None] for f in fields(FrameQuality)}
    return FrameQuality(**{name: fmean(known) if known else None for name, known in values.items()})  # type: ignore[arg-type]


def _quality(
    before: BytePicture | None,
    seen: BytePicture,
    recorded: BytePicture,
    regions: Regions,
    matte: Mask | None,
    distance: Distance | None,
) -> FrameQuality:
    errors, likeness = square_error_map(seen, recorded), ssim_map(seen, recorded)
    return FrameQuality(
        psnr_of(float(errors.mean())),
        psnr(errors, regions.dynamic),
        psnr(errors, regions.static),
        float(likeness.mean()),
        mean_over(likeness, regions.dynamic),
        mean_over(likeness, regions.static),
        None if distance is None else distance(seen, recorded),
        None if before is None else total_variation(before, seen, regions.static),
        psnr_aligned=psnr_of(float(square_error_map(aligned(seen, recorded), recorded).mean())),
        psnr_subject=None if matte is None else psnr(errors, matte),
        variation_undisturbed=None if before is None else total_variation(before, seen, regions.undisturbed),
    )
