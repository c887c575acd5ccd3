"""Decoded frames against what held-out cameras recorded: quality by region, flicker, and the time to render."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from statistics import fmean, median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rendering.views import render_view
from decogs.formats.splats import Splats

from .flip import flip
from .metrics import BytePicture, Mask, aligned, psnr, square_error_map
from .perceptual import NOT_INSTALLED, Distance
from .regions import Regions
from .shot import Metric, Shot
from .stlpips import st_lpips


def metric(
    value: Callable[[Shot], float | None],
    heading: str,
    meaning: str,
    digits: int = 2,
    *,
    later: bool = False,
    **more: Any,
) -> Any:
    """A field of FrameQuality: a `Metric`, which has ``more``. ``later``: files from before it can be read."""
    kept = {"metric": Metric(value, heading, meaning, digits, **more)}
    return field(default=None, kw_only=True, metadata=kept) if later else field(metadata=kept)


@dataclass(frozen=True)
class FrameQuality:
    """One frame of a held-out camera, or the means over several: a field for each metric, None where it has no value.

    PSNR in dB, variations in 0..1.
    """

    psnr: float | None = metric(lambda shot: shot.psnr(), "PSNR", "dB over the whole picture")
    psnr_dynamic: float | None = metric(
        lambda shot: shot.psnr(shot.regions.dynamic), "dynamic", "PSNR in dB over the dynamic region"
    )
    psnr_static: float | None = metric(
        lambda shot: shot.psnr(shot.regions.static), "static", "PSNR in dB over the static region"
    )
    ssim: float | None = metric(lambda shot: shot.ssim(), "SSIM", "over the whole picture", 4)
    ssim_dynamic: float | None = metric(
        lambda shot: shot.ssim(shot.regions.dynamic), "SSIM dynamic", "SSIM map over the dynamic region", 4
    )
    ssim_static: float | None = metric(
        lambda shot: shot.ssim(shot.regions.static), "SSIM static", "SSIM map over the static region", 4
    )
    lpips: float | None = metric(
        lambda shot: None if shot.distance is None else shot.distance(shot.seen, shot.recorded),
        "LPIPS",
        "over the whole picture",
        4,
        nothing=NOT_INSTALLED,
    )
    variation: float | None = metric(
        lambda shot: shot.change(shot.regions.static),
        "mTV ×100",
        "flicker: change of static pixels from frame to frame",
        4,
        units=100,
        column="mtv",
    )
    flip: float | None = metric(
        lambda shot: flip(shot.seen, shot.recorded),
        "FLIP",
        "over the whole picture, 0 is best",
        4,
        nothing=NOT_INSTALLED,
        later=True,
    )
    st_lpips: float | None = metric(
        lambda shot: st_lpips(shot.seen, shot.recorded),
        "ST-LPIPS",
        "over the whole picture, 0 is best; hardly moved by a shift of a pixel",
        4,
        nothing=NOT_INSTALLED,
        later=True,
    )
    psnr_change: float | None = metric(
        lambda shot: shot.psnr_of_change(shot.regions.dynamic),
        "change",
        "PSNR in dB of the change from frame to frame over the dynamic region: what flickers or lags there",
        later=True,
    )
    psnr_aligned: float | None = metric(
        lambda shot: psnr(square_error_map(aligned(shot.seen, shot.recorded), shot.recorded)),
        "PSNR, aligned",
        "the same with each channel's colours aligned first",
        later=True,
    )
    psnr_subject: float | None = metric(
        lambda shot: None if shot.matte is None else shot.psnr(shot.matte),
        "subject",
        "PSNR in dB inside the rig's true mattes",
        later=True,
    )
    variation_undisturbed: float | None = metric(
        lambda shot: shot.change(shot.regions.undisturbed),
        "mTV ×100, undisturbed",
        "flicker of static pixels outside every dilated difference mask of the held-out camera",
        4,
        units=100,
        column="mtv_undisturbed",
        later=True,
    )


@dataclass(frozen=True)
class FrameOfViews(FrameQuality):
    """One frame, the means over held-out cameras; ``psnr_of_views``: PSNR over the whole picture of each of them, in
    their order, dB; None in a file from before it was kept."""

    psnr_of_views: list[float] | None = field(default=None, kw_only=True)


METRICS: Mapping[str, Metric] = {f.name: f.metadata["metric"] for f in fields(FrameQuality)}
"""By the field of FrameQuality that keeps it."""


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
    ``first_cpu_seconds``: of reading and rendering the first. ``errors``: of each view, the mean square error of every
    pixel over frames and channels, (H, W), of pictures in 0..1.
    """

    frames: list[FrameOfViews]
    render_seconds: float
    read_seconds: float
    decode_cpu_seconds: float
    read_cpu_seconds: float
    first_cpu_seconds: float
    column: NDArray[np.uint8]
    errors: list[NDArray[np.float64]]


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
    frames: list[FrameOfViews] = []
    errors = [np.zeros((), np.float64)] * len(views)
    rendering: list[float] = []
    reading: list[float] = []
    reading_cpu: list[float] = []
    decoding: list[float] = []
    columns: list[NDArray[np.uint8]] = []
    before: list[tuple[BytePicture, BytePicture] | tuple[None, None]] = [(None, None)] * len(views)
    for targets in zip(*(zip(view.recorded, view.mattes, strict=True) for view in views), strict=True):
        began, began_cpu = time.perf_counter(), cpu_seconds()
        splats = next(scenes)
        reading.append(time.perf_counter() - began)
        reading_cpu.append(cpu_seconds() - began_cpu)
        if not rendering:  # the first rendering loads the kernel
            render_view(header, splats, views[0].camera, scale=scale, threads=threads, corrections={})
        of_views: list[FrameQuality] = []
        for number, (view, (target, matte)) in enumerate(zip(views, targets, strict=True)):
            began, began_cpu = time.perf_counter(), cpu_seconds()
            seen_by = render_view(header, splats, view.camera, scale=scale, threads=threads, corrections={})
            seconds, spent = time.perf_counter() - began, cpu_seconds() - began_cpu
            seen = to_8bit(seen_by.image)
            shown, recorded = before[number]
            shot = Shot(seen, target, shown, view.regions, matte, distance, recorded)
            of_views.append(_quality(shot))
            errors[number] = errors[number] + shot.errors.mean(axis=2)
            before[number] = seen, target
            if number == 0:
                rendering.append(seconds)
                decoding.append(reading_cpu[-1] + spent)
                columns.append(seen[:, column])
        frames.append(_mean(of_views))
    return StreamQuality(
        frames,
        render_seconds=median(rendering),
        read_seconds=median(reading),
        decode_cpu_seconds=median(decoding),
        read_cpu_seconds=fmean(reading_cpu),
        first_cpu_seconds=decoding[0],
        column=np.stack(columns, axis=1),
        errors=[total / len(frames) for total in errors],
    )


def cpu_seconds() -> float:
    """Processor seconds so far, those of other programs that were run included."""
    times = os.times()
    return time.process_time() + times.children_user + times.children_system


def _quality(shot: Shot) -> FrameQuality:
    return FrameQuality(**{name: measure.value(shot) for name, measure in METRICS.items()})


def _mean(of_views: Sequence[FrameQuality]) -> FrameOfViews:
    """The means over cameras, of those that have a value."""
    values = {name: [v for each in of_views if (v := getattr(each, name)) is not None] for name in METRICS}
    means = {name: fmean(present) if present else None for name, present in values.items()}
    return FrameOfViews(**means, psnr_of_views=values["psnr"])
