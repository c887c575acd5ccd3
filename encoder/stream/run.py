"""A range of a rig's frames encoded into one output: begun, continued, interrupted or finished."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from decogs.formats.callbacks import OnWarning
from decogs.formats.container import Packet
from decogs.formats.errors import DecogsError

from ..frame.context import Context
from ..input.imported_keyframe import KeyframeSource
from ..input.imported_splats import SplatSource
from ..input.ingest import Ingest
from ..input.recordings import is_current
from ..output.convergence_log import ConvergenceLog
from ..output.metrics import write_metrics
from ..output.reports import EncodeReport, FrameReport, OnFrame, OnKeyframeStep
from ..output.resume import Interrupted, check_resumable
from ..output.stream_output import FileOutput, StreamOutput, open_output
from ..parallel import ahead
from ..segments.next_segment import with_following
from ..settings.encode import EncodeSettings
from .encoder import StreamEncoder


def encode_stream(
    ingest: Ingest,
    output: Path | BinaryIO | StreamOutput,
    span: range,
    settings: EncodeSettings,
    *,
    seed: int,
    threads: int,
    keyframe: KeyframeSource | SplatSource | None = None,
    device: str = "auto",
    resume: bool = False,
    metrics: bool = False,
    read_ahead: bool = True,
    on_frame: OnFrame | None = None,
    on_keyframe_step: OnKeyframeStep | None = None,
    convergence: ConvergenceLog | None = None,
    on_warning: OnWarning | None = None,
) -> EncodeReport:
    """Encodes frames ``span`` of the rig to ``output``; Ctrl-C after the keyframe ends the stream early but whole.

    ``output``: a path, an open file that takes bytes, such as a pipe, or one that was taken already, for ``resume`` if
    that is asked for. ``keyframe``: an earlier stream's, or a file's Gaussians, to begin with instead of training
    one; UsageError when it does not fit the rig. ``resume``: go on with what an earlier encode left, in ``output`` +
    ".part" or as a shorter stream; the result has the bytes of one that was not cut off, but for a time budget, with
    which no two encodes have the same. ``metrics``: each frame's PSNR goes behind it. ``read_ahead``: the next frame is
    read and undistorted on a thread of its own while this one trains, which takes memory; one thread does neither.
    ``convergence`` takes the loss of every step.
    Raises DecogsError for unusable input; complete frames then remain in ``output`` + ".part", and the message says so.
    """
    with output if isinstance(output, StreamOutput) else open_output(output, resume=resume) as target:
        left = _left(target, settings) if resume else None
        context = Context.of(
            ingest,
            settings,
            seed=seed,
            threads=threads,
            device=device,
            on_loss=None if convergence is None else convergence.step,
        )
        encoder = StreamEncoder(context, target, keyframe, convergence=convergence, on_warning=on_warning)
        encoder.check_header(span.start)
        resumed = (0 if left is None else len(left.entries)) if resume else None
        packets: Iterator[Packet] = iter(())
        origin, last = "", 0
        if left is not None:
            left.check_recordings(next(ingest.frames(span.start, span.start + 1)).recorded, span.start)
            encoder.take_over(left, span)
            done = range(span.start, span.start + len(left.entries))
            if on_warning is not None and not is_current(left.path, ingest.rig, done):
                on_warning(f"`resume`: a recording was written after {left.path}; start over if its frames are others")
            packets, origin, last = left.packets(), f"`resume`: {left.path}", len(left.entries) - 1
            if left.path != target.growing and left.ended and resumed == len(span):
                return EncodeReport(target.name, [], left.path.stat().st_size, False, resumed)
        reports: list[FrameReport] = []
        interrupted = False
        try:
            frames = ingest.frames(span.start, span.stop)
            read = ahead(frames) if read_ahead and threads > 1 else frames
            for frame, following in with_following(read, span.start, settings):
                packet = next(packets, None)
                if packet is not None:
                    # The first and the last show whether the pictures are those that it was made from.
                    report = encoder.replay(frame, packet, origin if len(reports) in (0, last) else "")
                elif not reports:
                    report = encoder.encode_key(frame, on_keyframe_step)
                else:
                    report = encoder.encode_next(frame, on_keyframe_step, following)
                reports.append(report)
                if metrics:
                    write_metrics(target, frame.index - span.start, report)
                if on_frame:
                    on_frame(report)
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
