"""A range of a rig's frames encoded into one output: begun, continued, interrupted or finished."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

from decogs.formats.errors import DecogsError
from decogs.rig.pictures.recording_digests import is_current

from ..frame.context import Context
from ..output.metrics import write_metrics
from ..output.reports import EncodeReport, FrameReport
from ..output.resume import Interrupted, check_resumable
from ..output.sound import SoundWriter
from ..output.stream_output import FileOutput, StreamOutput, open_output
from ..settings.encode import EncodeSettings
from .encoder import Earlier, StreamEncoder
from .options import RunOptions


def encode_stream(
    context: Context,
    output: Path | BinaryIO | StreamOutput,
    span: range,
    options: RunOptions | None = None,
    *,
    resume: bool = False,
) -> EncodeReport:
    """Encodes frames ``span`` of the rig to ``output``; Ctrl-C after the keyframe ends the stream early but whole.

    ``output``: a path, an open file that takes bytes, such as a pipe, or one that was taken already, for ``resume`` if
    that is asked for. ``resume``: go on with what an earlier encode left, in ``output`` + ".part" or as a shorter
    stream; the result has the bytes of one that was not cut off, but for a time budget, with which no two encodes have
    the same.
    Raises DecogsError for unusable input, UsageError for a keyframe that does not fit the rig; complete frames then
    remain in ``output`` + ".part", and the message says so.
    """
    options, settings, ingest = options or RunOptions(), context.settings, context.ingest
    with output if isinstance(output, StreamOutput) else open_output(output, resume=resume) as target:
        left = _left(target, settings) if resume else None
        encoder = StreamEncoder(context, target, options)
        encoder.check_header(span.start)
        resumed = (0 if left is None else len(left.entries)) if resume else None
        earlier = Earlier()
        if left is not None:
            left.check_metrics(options.metrics)
            left.check_recordings(next(ingest.frames(span.start, span.start + 1)).recorded, span.start)
            encoder.take_over(left, span)
            done = range(span.start, span.start + len(left.entries))
            if options.on_warning is not None and not is_current(left.path, ingest.rig, done):
                options.on_warning(
                    f"`resume`: a recording was written after {left.path}; start over if its frames are others"
                )
            earlier = Earlier(left.packets(), f"`resume`: {left.path}", (0, len(left.entries) - 1))
            if left.path != target.growing and left.ended and resumed == len(span):
                return EncodeReport(target.name, [], left.path.stat().st_size, False, resumed)
        reports: list[FrameReport] = []
        sound, interrupted = SoundWriter(options.sound, target), False
        try:
            frames = ingest.frames(span.start, span.stop)
            for report in encoder.encode(frames, span.start, earlier):
                reports.append(report)
                if len(reports) >= (resumed or 0):  # what was behind the last frame that was left is cut off
                    sound.write(report.frame - span.start)
                    if options.metrics:
                        write_metrics(target, report.frame - span.start, report)
                if options.on_frame:
                    options.on_frame(report)
            target.open()
        except KeyboardInterrupt:
            if not reports or not target.is_open:
                raise
            interrupted = True
        except DecogsError as error:
            if reports and target.is_open and target.growing is not None:
                before = "the frame before it is" if len(reports) == 1 else f"the {len(reports)} frames before it are"
                error.args = (f"{error}; {before} in {target.growing}",)
            raise
        finally:
            target.close(len(reports))
        return EncodeReport(
            target.name, reports, target.publish(), interrupted, resumed, settings.frame_budget, settings.time_budget
        )


def _left(output: StreamOutput, settings: EncodeSettings) -> Interrupted | None:
    check_resumable(settings)
    return output.take_left() if isinstance(output, FileOutput) else None
