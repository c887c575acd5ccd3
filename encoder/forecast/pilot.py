"""A pilot: a short encode of a rig, with a camera left out, whose figures say what a longer one will have."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import camera_centre
from decogs.formats.errors import UsageError
from decogs.formats.rigs import Rig, open_rig
from decogs.rig.check.rig_statistics import RigStatistics, typical_noise

from ..encoding import encode
from ..job.job import EncodeJob
from ..output.observer import EncodeObserver
from ..output.reports import FrameReport

F64 = NDArray[np.float64]

LATER_FRAMES = 3
_LEAST_CAMERAS = 4
"""Of a rig from which one is left out."""
_PRESET = "live"
"""The fastest one."""
_CHANGE, _NOISE_MULTIPLE = 10.0, 4.0
"""Levels from which a pixel has changed: at least these, and so many times the camera's noise."""


@dataclass(frozen=True)
class Pilot:
    """Bytes and processor seconds of the first frame and, on average, of the later ones.

    ``frames``: of the rig, that were encoded. ``points_cpu``: of the first frame, seconds of the search for its first
    points, which presets do not change. ``training_cpu``: of a later one, of its training; presets change nothing else
    by much. ``psnr``: dB of the camera ``left_out``, None where a rig has too few; ``training_psnr``: of the others.
    """

    frames: range
    key_bytes: float
    key_cpu: float
    points_cpu: float
    frame_bytes: float
    frame_cpu: float
    training_cpu: float
    training_psnr: float
    left_out: str | None = None
    psnr: float | None = None


def run_pilot(job: EncodeJob, stats: RigStatistics, observer: EncodeObserver) -> Pilot:
    """Encodes a few frames of the job's rig as little as tells anything. Raises what `encode` raises.

    ``stats``: of the rig's frames that the job asks for, which say where as much changes as on average.
    """
    rig = job.rig if isinstance(job.rig, Rig) else open_rig(job.rig)
    frames, holdout = _typical_frames(stats), tuple(job.holdout) or _left_out(rig, job.exclude)
    with tempfile.TemporaryDirectory() as folder:
        report = encode(
            EncodeJob(
                rig,
                Path(folder) / "pilot.dgs",
                _PRESET,
                frames=frames,
                scale=job.scale,
                holdout=holdout,
                exclude=job.exclude,
                mattes=job.mattes,
                effects="auto",
                threads=job.threads,
                device=job.device,
                max_memory=job.max_memory,
            ),
            progress=observer,
        )
    return pilot_of(report.frames, " ".join(holdout) or None)


def pilot_of(reports: Sequence[FrameReport], left_out: str | None) -> Pilot:
    """The figures of a pilot's frames. Raises UsageError for a first frame alone."""
    key, later = reports[0], reports[1:]
    if not later:
        raise UsageError("a forecast needs two frames at least")
    known = [report.held_out_psnr for report in reports if report.held_out_psnr is not None]
    return Pilot(
        range(key.frame, later[-1].frame + 1),
        key.bytes,
        key.cpu_seconds,
        _cpu_of(key, "first_points"),
        float(np.mean([report.bytes for report in later])),
        float(np.mean([report.cpu_seconds for report in later])),
        float(np.mean([_cpu_of(report, "training") for report in later])),
        float(np.mean([report.training_psnr for report in reports])),
        left_out,
        float(np.mean(known)) if known else None,
    )


def _cpu_of(report: FrameReport, stage: str) -> float:
    """Processor seconds of a stage of a frame, by its share of the wall clock."""
    measured = report.seconds.get("measure", 0.0)
    return report.cpu_seconds * report.seconds.get(stage, 0.0) / max(1e-9, sum(report.seconds.values()) - measured)


def _typical_frames(stats: RigStatistics) -> range:
    """Frames in which about as much changes as in all that were analysed."""
    last = stats.frames[-1] + 1
    changes = change_shares(stats)
    window = max(1, min(len(changes), round(LATER_FRAMES / stats.step)))
    means = np.convolve(changes, np.full(window, 1 / window), "valid")
    start = stats.frames[int(np.argmin(np.abs(means - changes.mean())))] if len(changes) else stats.frames[0]
    start = max(stats.frames[0], min(start, last - LATER_FRAMES - 1))
    return range(start, min(last, start + LATER_FRAMES + 1))


def change_shares(stats: RigStatistics) -> F64:
    """The share of all cameras' pixels that change from each analysed frame to the next (F - 1,)."""
    shares = []
    for pictures, noise in zip(stats.pictures, typical_noise(stats.noise), strict=True):
        least = max(_CHANGE, _NOISE_MULTIPLE * float(noise))
        moved = [np.abs(now.astype(np.int16) - before).max(axis=2) >= least for before, now in pairwise(pictures)]
        shares.append([float(each.mean()) for each in moved])
    return np.asarray(np.mean(shares, axis=0), np.float64)


def _left_out(rig: Rig, exclude: Sequence[str]) -> tuple[str, ...]:
    """A camera whose nearest neighbour is as far as is usual on this rig; none where there are few."""
    cameras = [camera for camera in rig.cameras if camera.name not in exclude]
    if len(cameras) <= _LEAST_CAMERAS:
        return ()
    places = np.array([camera_centre(camera) for camera in cameras])
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2) + np.diag(np.full(len(cameras), np.inf))
    nearest = gaps.min(axis=1)
    return (cameras[int(np.argsort(nearest, kind="stable")[len(cameras) // 2])].name,)
