"""A stream beside what was recorded: how far each camera's picture of some frames is from its view."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.decoder.limits import DEFAULT_MAX_MEMORY
from decogs.decoder.reading.frame import DecodedFrame
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.formats.colours.srgb import srgb_from_linear
from decogs.formats.errors import UsageError
from decogs.formats.rigs import Rig, read_frames
from decogs.formats.system.callbacks import OnProgress

from .holding import Holding, holding
from .witness import Witnesses

F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
_COVERED = 0.5
"""Alpha from which on a pixel counts as a subject's."""


@dataclass(frozen=True)
class Pair:
    """``recorded`` and ``shown`` (H, W, 3) of one camera and frame, and the squared ``error`` (H, W), NaN where it does
    not count."""

    camera: str
    frame: int
    recorded: U8
    shown: U8
    error: F64

    @property
    def psnr(self) -> float:
        """dB; NaN where nothing counts."""
        if np.isnan(self.error).all():
            return float("nan")
        return float(-10 * np.log10(max(float(np.nanmean(self.error)), 1e-12)))


@dataclass(frozen=True)
class Compared:
    """``psnr`` (C, F) in dB of each of ``cameras`` in each of ``frames``, NaN where no picture was recorded.

    ``held_out``: cameras that training did not see. ``subject``: errors are of the subject's own pixels alone.
    """

    cameras: tuple[str, ...]
    frames: tuple[int, ...]
    psnr: F64
    held_out: tuple[str, ...]
    subject: bool

    def ranked(self) -> list[tuple[float, str, int]]:
        """All that was recorded, the worst first: dB, camera, frame."""
        rows = [
            (float(self.psnr[i, j]), camera, frame)
            for i, camera in enumerate(self.cameras)
            for j, frame in enumerate(self.frames)
        ]
        return sorted(row for row in rows if np.isfinite(row[0]))


def compare(
    stream: Path, rig: Rig, most_frames: int, on_frame: OnProgress, threads: int = 0, *, upto: int | None = None
) -> Compared:
    """Each camera's pictures of up to ``most_frames`` frames, spread over the take, against the decoded ones.

    ``upto``: frames of the stream from there on do not count. Raises UsageError where stream and rig have no camera or
    frame in common, StreamError and RigError.
    """
    with open_stream(stream, max_memory=DEFAULT_MAX_MEMORY) as opened:
        header = opened.header
        names = _common(header, rig)
        count = opened.frame_count if upto is None else min(upto, opened.frame_count)
        frames = _chosen(header, count, rig, most_frames)
        columns = []
        for done, pairs in enumerate(_pairs(header, opened.frames(), rig, frames, names, threads), start=1):
            columns.append([pair.psnr for pair in pairs])
            on_frame(done, len(frames))
    held_out = tuple(name for name in names if name in header.held_out)
    return Compared(tuple(names), tuple(frames), np.array(columns).T, held_out, header.subject)


def pairs_of(
    stream: Path, rig: Rig, wanted: Sequence[tuple[str, int]], threads: int = 0
) -> dict[tuple[str, int], Pair]:
    """Pictures of these cameras and frames beside each other. Raises as `compare`."""
    frames = sorted({frame for _, frame in wanted})
    names = sorted({camera for camera, _ in wanted})
    with open_stream(stream, max_memory=DEFAULT_MAX_MEMORY) as opened:
        found = _pairs(opened.header, opened.frames(), rig, frames, names, threads)
        return {
            (pair.camera, pair.frame): pair for pairs in found for pair in pairs if (pair.camera, pair.frame) in wanted
        }


def holding_of(stream: Path, rig: Rig, compared: Compared, threads: int = 0) -> Holding:
    """Where the first frame holds, by the pictures of it that training saw and those that were left out."""
    with open_stream(stream, max_memory=DEFAULT_MAX_MEMORY) as opened:
        header, scene = opened.header, next(opened.frames())
    cameras = {camera.name: camera for camera in header.cameras if camera.name in compared.cameras}
    training = [name for name in cameras if name not in compared.held_out]
    first = header.first_frame
    ((_, pictures),) = read_frames(rig, first, first + 1, names=training)
    witnesses = Witnesses(header, scene.splats, dict(zip(training, pictures, strict=True)), threads=threads)
    measured = {
        name: (cameras[name], float(compared.psnr[compared.cameras.index(name), 0])) for name in compared.held_out
    }
    return holding(witnesses, [cameras[name] for name in training], measured)


def _common(header: StreamHeader, rig: Rig) -> list[str]:
    there = {camera.name: camera for camera in rig.cameras}
    names = [
        camera.name
        for camera in header.cameras
        if camera.name in there
        and (camera.width, camera.height) == (there[camera.name].width, there[camera.name].height)
    ]
    if not names:
        raise UsageError(
            f"{rig.path}: no camera of this rig is in the stream, with pictures of its size; `decogs-pack --rig` "
            "gives one its cameras"
        )
    return names


def _chosen(header: StreamHeader, count: int, rig: Rig, most: int) -> list[int]:
    """Frames of the stream, of which the rig has the pictures."""
    count = min(count, rig.frame_count - header.first_frame)
    if count < 1:
        raise UsageError(f"{rig.path}: ends before the stream begins, which is its frame {header.first_frame}")
    return sorted({round(at) for at in np.linspace(0, count - 1, min(most, count))})


def _pairs(
    header: StreamHeader,
    decoded: Iterator[DecodedFrame],
    rig: Rig,
    frames: Sequence[int],
    names: Sequence[str],
    threads: int,
) -> Iterator[list[Pair]]:
    lost: set[tuple[int, str]] = set()
    first = header.first_frame
    span = first + frames[0], first + frames[-1] + 1
    recorded = read_frames(rig, *span, names=names, on_lost=lambda frame, name, error: lost.add((frame, name)))
    for at, pictures in recorded:
        if at - first not in frames:
            continue
        scene = next(frame for frame in decoded if frame.index == at - first)
        yield [
            _pair(header, scene, name, picture, threads, is_lost=(at, name) in lost)
            for name, picture in zip(names, pictures, strict=True)
        ]


def _pair(
    header: StreamHeader, scene: DecodedFrame, name: str, picture: NDArray[np.generic], threads: int, *, is_lost: bool
) -> Pair:
    seen = render_view(header, scene.splats, name, corrections=scene.corrections, threads=threads)
    shown = np.clip(seen.image, 0, 1)
    recorded = _display(picture)
    error = ((shown - recorded) ** 2).mean(axis=2).astype(np.float64)
    if header.subject:
        error[seen.alpha < _COVERED] = np.nan
    if is_lost:
        error[:] = np.nan
    eight_bit = [np.rint(each * 255).astype(np.uint8) for each in (recorded, shown)]
    return Pair(name, scene.index, eight_bit[0], eight_bit[1], error)


def _display(picture: NDArray[np.generic]) -> NDArray[np.float32]:
    """A recorded picture as it is displayed, 0 to 1."""
    if picture.dtype == np.uint8:
        return np.asarray(picture / np.float32(255), np.float32)
    linear: NDArray[np.float32] = picture.astype(np.float32).clip(0, 1)
    return srgb_from_linear(linear)
