"""One part of a take: the first keyframe, trained or taken from an earlier part, then the part's own frames."""

from __future__ import annotations

from itertools import islice

from decogs.formats.callbacks import OnWarning
from decogs.formats.container import FRAME_KINDS, PacketKind, PacketReader
from decogs.formats.errors import StreamError, UsageError

from ..frame.context import Context
from ..input.imported_keyframe import KeyframeSource
from ..input.imported_splats import SplatSource
from ..input.ingest import Ingest, RigFrame
from ..input.recordings import is_current
from ..output.convergence_log import ConvergenceLog
from ..output.metrics import write_metrics
from ..output.reports import EncodeReport, FrameReport, OnFrame, OnKeyframeStep
from ..output.stream_output import StreamOutput
from ..parallel import ahead
from ..segments.next_segment import with_following
from ..settings.encode import EncodeSettings
from ..stream.encoder import StreamEncoder
from .base import Base
from .manifest import Part, frames_read, inputs_of, made_with, recorded, with_part
from .output import PartOutput


def encode_part(
    ingest: Ingest,
    output: StreamOutput,
    frames: range,
    take: range,
    settings: EncodeSettings,
    *,
    seed: int,
    threads: int,
    base: Base | None,
    keyframe: KeyframeSource | SplatSource | None = None,
    device: str = "auto",
    metrics: bool = False,
    read_ahead: bool = True,
    on_frame: OnFrame | None = None,
    on_keyframe_step: OnKeyframeStep | None = None,
    convergence: ConvergenceLog | None = None,
    on_warning: OnWarning | None = None,
) -> EncodeReport:
    """Encodes ``frames`` of the rig's ``take`` to ``output``, whole or not at all.

    Only these frames, the first one, and the next segment's first one are read. ``base``: an earlier part with the
    first keyframe; without, it is made here, from ``keyframe`` if that is given, and the part must begin with it.
    ``metrics``: each frame's PSNR goes behind it. ``read_ahead``: as in `encode_stream`. An output that is this part
    already, and not older than the recordings of its frames, stays as it is.
    Raises DecogsError for unusable input, UsageError for a base of another encode.
    """
    if base is None and frames.start > take.start:
        raise UsageError(
            f"`only` {frames.start}:{frames.stop}: parts after the first start from its keyframe; make one with `only` "
            f"{take.start}:{take.start + 1}, and give it as `keyframe`"
        )
    first = next(ingest.frames(take.start, take.start + 1))
    rig = ingest.rig
    read = frames_read(frames, take, settings)
    part = Part(frames, take, inputs_of(rig, first), recorded(rig, read), made_with(device), metrics)
    if base is not None:
        base.check(part)
    with output:
        out = PartOutput(output, part)
        context = Context.of(
            ingest,
            settings,
            seed=seed,
            threads=threads,
            device=device,
            on_loss=None if convergence is None else convergence.step,
        )
        source = keyframe if base is None else base.source
        encoder = StreamEncoder(context, out, source, convergence=convergence, on_warning=on_warning)
        encoder.check_header(take.start)
        if base is not None:
            encoder.take_over(base.keyframe, take)
            there = _size_if_there(output, with_part(base.keyframe.header_payload, part), part)
            if there is not None and is_current(output.name, rig, read):
                return EncodeReport(output.name, [], there, False, len(frames), part=frames)
        reports: list[FrameReport] = []
        whole = False

        def done(report: FrameReport) -> None:
            reports.append(report)
            if metrics and report.frame in frames:
                write_metrics(out, report.frame - take.start, report)
            if on_frame is not None:
                on_frame(report)

        try:
            done(encoder.encode_key(first, on_keyframe_step) if base is None else _taken(encoder, first, base, out))
            own = range(max(frames.start, take.start + 1), frames.stop)
            later = ingest.frames(own.start, read.stop)
            later = ahead(later) if read_ahead and threads > 1 else later
            for frame, following in islice(with_following(later, take.start, settings), len(own)):
                done(encoder.encode_next(frame, following=following))
            whole = True
        finally:
            out.close(part.packets if whole else 0)
        return EncodeReport(
            output.name, reports, out.publish(), False, None, settings.frame_budget, settings.time_budget, frames
        )


def _taken(encoder: StreamEncoder, first: RigFrame, base: Base, out: PartOutput) -> FrameReport:
    """The first keyframe of the base, its packet as it is."""
    packet = base.packet
    out.begin(base.keyframe.header_payload)
    out.write(packet.kind, 0, packet.payload)
    return encoder.replay(first, packet, f"`keyframe` {base.keyframe.path}")


def _size_if_there(output: StreamOutput, header: bytes, part: Part) -> int | None:
    """Bytes of the output if it is this part already, whole; None otherwise."""
    if output.growing is None or not output.name.is_file():
        return None
    try:
        with output.name.open("rb") as file:
            reader, found = PacketReader(file), 0
            while (packet := reader.next()) is not None:
                if packet.kind == PacketKind.HEADER and packet.payload != header:
                    return None
                found += packet.kind in FRAME_KINDS
    except (OSError, StreamError):
        return None
    return output.name.stat().st_size if reader.ended and found == part.packets else None
