"""Rivals over the frames of a stream: kept on disk in their way, read again, measured as streams are; one JSON each."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime, timezone
from pathlib import Path

from decogs.decoder.reading.stream import Stream, open_stream
from decogs.formats.files.outputs import write_whole
from decogs.formats.splats import Splats

from ..estimates import mean, rounded
from ..machine import code_version
from ..measures.quality import FrameOfViews, FrameQuality, cpu_seconds
from ..questions.variants import Variant
from ..rivals.sequences import Frames, Rival, SceneFrame, Sizes
from .documents import digest, document, read_document
from .rig_bench import RigBench
from .run import Run

FORMAT = 2
"""Of the JSON files, and of what the rivals write: raise it when either changes."""
DECOGS = "decogs"
"""The family of the encoder's own streams."""
LINE = 2e6
"""Bits a second: a slow line, at which PD-4DGS (arXiv 2605.11427) states the wait for the first picture."""


@dataclass(frozen=True, kw_only=True)
class RivalFrame(FrameOfViews):
    """How one frame looks when it is read again; ``frame`` is the rig's index."""

    frame: int


@dataclass(frozen=True)
class RivalRun:
    """One rival over the frames of one stream; plain values, as they lie in the JSON file.

    ``key``: digest of what decides it. ``source``: the stream's variant and key; ``code`` is what made that.
    ``coder``: the rival's settings. ``wait_bytes``: as in Sizes. ``write_cpu_seconds``: processor seconds to write
    all frames; ``read_cpu_seconds``: to read one, the mean, rendering left out; ``first_cpu_seconds``: to read and
    render the first, None in a file from before it was measured.
    """

    rig: str
    rival: str
    family: str
    description: str
    about: str
    key: str
    code: str
    date: str
    source: list[str]
    coder: str
    first_bytes: int
    total_bytes: int
    wait_bytes: int
    write_cpu_seconds: float
    read_cpu_seconds: float
    frames: list[RivalFrame]
    first_cpu_seconds: float | None = None


@dataclass(frozen=True)
class RatePoint:
    """A row of the comparison and a point of the plot. PSNR in dB, means over all frames; bytes on disk.

    ``first_bytes``: all that comes with the first frame; ``first_seconds``: what `LINE` takes to bring what has to be
    there before that shows; ``usable_seconds``: that and the processor time to read and render it, until one core shows
    the first frame in full, None where it was not measured; ``later_bytes``: the rest over the later frames. ``mtv``:
    flicker, as mTV x100. ``read_ms``: processor milliseconds from bytes to a frame's Gaussians.
    """

    label: str
    family: str
    psnr: float | None
    psnr_dynamic: float | None
    psnr_static: float | None
    psnr_subject: float | None
    mtv: float | None
    first_bytes: int
    first_seconds: float
    usable_seconds: float | None
    later_bytes: float
    frame_bytes: float
    read_ms: float | None


def point_of(run: Run, label: str) -> RatePoint:
    """A stream as a point; what lies around its packets counts with the first frame."""
    first = run.stream_bytes - sum(frame.bytes for frame in run.frames[1:])
    return _point(label, DECOGS, run, Sizes(first, run.stream_bytes))


def point_of_rival(run: RivalRun) -> RatePoint:
    """Rate and distortion of another way to keep the same frames."""
    sizes = Sizes(run.first_bytes, run.total_bytes, run.wait_bytes)
    return _point(run.description, run.family, run, sizes)


def rival_file(bench: RigBench, source: Variant, rival: Rival) -> Path:
    """Where the rival's JSON lies."""
    return bench.runs_folder / f"{bench.name}-rival-{rival.name}-{_key(bench, source, rival)}.json"


def find_rival(bench: RigBench, source: Variant, rival: Rival) -> RivalRun | None:
    """What an earlier report left of this rival, if the source's run is there and was made by the same code."""
    run, stream = read_rival(rival_file(bench, source, rival)), bench.find(source)
    return run if run is not None and stream is not None and run.code == stream.code else None


def run_rival(
    bench: RigBench, source: Variant, rival: Rival, stream_file: Path, on_frame: Callable[[], None] | None = None
) -> RivalRun:
    """Has the rival keep the stream's frames, measures what comes back, and keeps the result."""
    with open_stream(stream_file, strict=True) as stream, tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        began = cpu_seconds()
        sizes = rival.coder.write(_frames_of(stream), folder)
        written = cpu_seconds() - began
        scenes = _counted(rival.coder.read(folder), on_frame)
        frames = bench.frames_of(source)
        quality = bench.measured(stream.header, scenes, frames)
    run = RivalRun(
        rig=bench.name,
        rival=rival.name,
        family=rival.family,
        description=rival.description,
        about=rival.about,
        key=_key(bench, source, rival),
        code=code_version(),
        date=datetime.now(timezone.utc).isoformat(timespec="seconds"),
        source=[source.name, bench.key(source)],
        coder=repr(rival.coder),
        first_bytes=sizes.first,
        total_bytes=sizes.total,
        wait_bytes=sizes.wait,
        write_cpu_seconds=rounded(written),
        read_cpu_seconds=rounded(quality.read_cpu_seconds),
        first_cpu_seconds=rounded(quality.first_cpu_seconds),
        frames=[
            RivalFrame(**rounded(asdict(looks)), frame=index)
            for index, looks in zip(frames, quality.frames, strict=True)
        ],
    )
    write_whole(rival_file(bench, source, rival), document(run).encode())
    return run


def read_rival(path: Path) -> RivalRun | None:
    """A rival's run from its JSON file; None when the file is not there or damaged or of another format."""
    return read_document(path, RivalRun, RivalFrame)


def _frames_of(stream: Stream) -> Frames:
    return lambda: (SceneFrame(frame.state.ids, frame.splats) for frame in stream.frames())


def _counted(scenes: Iterator[Splats], on_frame: Callable[[], None] | None) -> Iterator[Splats]:
    for splats in scenes:
        yield splats
        if on_frame is not None:
            on_frame()


def _key(bench: RigBench, source: Variant, rival: Rival) -> str:
    return digest({"format": FORMAT, "source": bench.key(source), "coder": repr(rival.coder)})


def _point(label: str, family: str, run: Run | RivalRun, sizes: Sizes) -> RatePoint:
    frames: Sequence[FrameQuality] = run.frames
    variation = mean(frame.variation for frame in frames)
    on_the_line = 8 * max(sizes.first, sizes.wait) / LINE
    return RatePoint(
        label,
        family,
        mean(frame.psnr for frame in frames),
        mean(frame.psnr_dynamic for frame in frames),
        mean(frame.psnr_static for frame in frames),
        mean(frame.psnr_subject for frame in frames),
        None if variation is None else 100 * variation,
        sizes.first,
        on_the_line,
        None if run.first_cpu_seconds is None else on_the_line + run.first_cpu_seconds,
        (sizes.total - sizes.first) / (len(frames) - 1),
        sizes.total / len(frames),
        None if run.read_cpu_seconds is None else 1e3 * run.read_cpu_seconds,
    )
