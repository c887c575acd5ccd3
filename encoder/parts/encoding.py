"""One part of a take: the first keyframe, trained or taken from an earlier part, then the part's own frames."""

from __future__ import annotations

from dataclasses import replace
from itertools import chain, islice

from decogs.formats.errors import StreamError, UsageError
from decogs.formats.stream.container import FRAME_KINDS, PacketKind, PacketReader
from decogs.rig.pictures.recording_digests import is_current

from ..frame.context import Context
from ..output.metrics import write_metrics
from ..output.reports import EncodeReport, FrameReport
from ..output.sound import SoundWriter
from ..output.stream_output import StreamOutput
from ..stream.encoder import Earlier, StreamEncoder
from ..stream.options import RunOptions
from .base import Base
from .manifest import Part, frames_read, inputs_of, made_with, recorded, with_part
from .output import PartOutput


def encode_part(
    context: Context,
    output: StreamOutput,
    frames: range,
    take: range,
    options: RunOptions,
    base: Base | None,
    *,
    device: str = "auto",
) -> EncodeReport:
    """Encodes ``frames`` of the rig's ``take`` to ``output``, whole or not at all.

    Only these frames, the first one, and the next segment's first one are read. ``base``: an earlier part with the
    first keyframe; without, it is made here, and the part must begin with it. An output that is this part already, and
    not older than the recordings of its frames, stays as it is.
    Raises DecogsError for unusable input, UsageError for a base of another encode.
    """
    if base is None and frames.start > take.start:
        raise UsageError(
            f"`only` {frames.start}:{frames.stop}: parts after the first start from its keyframe; make one with `only` "
            f"{take.start}:{take.start + 1}, and give it as `keyframe`"
        )
    ingest, settings = context.ingest, context.settings
    first = next(ingest.frames(take.start, take.start + 1))
    read = frames_read(frames, take, settings)
    inputs, sources = inputs_of(ingest.rig, first), recorded(ingest.rig, read)
    part = Part(frames, take, inputs, sources, made_with(device), options.metrics)
    if base is not None:
        base.check(part)
        options = replace(options, keyframe=base.source)
    with output:
        out = PartOutput(output, part)
        encoder, earlier = StreamEncoder(context, out, options), Earlier()
        encoder.check_header(take.start)
        if base is not None:
            encoder.take_over(base.keyframe, take)
            size = _size_if_whole(output, with_part(base.keyframe.header_payload, part), part)
            if size is not None and is_current(output.name, ingest.rig, read):
                return EncodeReport(output.name, [], size, False, len(frames), part=frames)
            earlier = Earlier([base.packet], f"`keyframe` {base.keyframe.path}")
        reports: list[FrameReport] = []
        own = range(max(frames.start, take.start + 1), frames.stop)
        sound, whole = SoundWriter(options.sound, out), False
        try:
            if base is not None:
                out.begin(base.keyframe.header_payload)
                out.write(base.packet.kind, 0, base.packet.payload)
            given = chain([first], ingest.frames(own.start, read.stop, first=take.start))
            for report in islice(encoder.encode(given, take.start, earlier), 1 + len(own)):
                reports.append(report)
                if report.frame in frames:
                    sound.write(report.frame - take.start)
                if options.metrics and report.frame in frames:
                    write_metrics(out, report.frame - take.start, report)
                if options.on_frame is not None:
                    options.on_frame(report)
            whole = True
        finally:
            out.close(part.packets if whole else 0)
        return EncodeReport(
            output.name, reports, out.publish(), False, None, settings.frame_budget, settings.time_budget, frames
        )


def _size_if_whole(output: StreamOutput, header: bytes, part: Part) -> int | None:
    """Bytes of the output if it is this part already, whole; None otherwise."""
    if output.growing is None or not output.name.is_file():
        return None
    try:
        with output.name.open("rb") as file:
            reader, frame_packets = PacketReader(file), 0
            while (packet := reader.next()) is not None:
                if packet.kind == PacketKind.HEADER and packet.payload != header:
                    return None
                frame_packets += packet.kind in FRAME_KINDS
    except (OSError, StreamError):
        return None
    return output.name.stat().st_size if reader.ended and frame_packets == part.packets else None
