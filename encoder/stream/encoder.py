"""The frames of one encode, one after the other, into an open stream; those that an earlier encode wrote come first."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import CorrectedCameras, Corrections
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.digest import digest
from decogs.codec.scene.lattice import Lattice, default_lattice
from decogs.formats.errors import RigError, StreamError
from decogs.formats.splats import sh_degree_of
from decogs.formats.stream.container import Packet
from decogs.rig.parallel import Ahead
from decogs.rig.pictures.ingest import RigFrame
from decogs.rig.pictures.recording_digests import difference, recorded_in

from ..coding.stream_header import stream_header
from ..frame.context import Context
from ..frame.encode_frame import Encoded, Task, begin_scene, earlier_first_frame, encode_frame, train_keyframe
from ..frame.first_look import Upcoming
from ..frame.next_segment import NextSegment, train_next_segment, with_following
from ..input.imported_keyframe import KeyframeSource
from ..input.imported_splats import SplatSource
from ..keyframe.first_frame import FirstFrame
from ..keyframe.import_splats import import_splats
from ..output.reports import FrameReport
from ..output.resume import Interrupted
from ..output.stream_output import StreamOutput
from ..stopwatch import Stopwatch
from .frame_report import FrameReporter
from .options import RunOptions


@dataclass(frozen=True)
class Earlier:
    """The ``packets`` that an earlier encode made of the first frames.

    ``origin``: their source, for a warning. ``compared``: places of the frames that are compared with the pictures.
    """

    packets: Iterable[Packet] = ()
    origin: str = ""
    compared: tuple[int, ...] = (0,)


class StreamEncoder:
    """Encodes frames one after the other into an open stream."""

    def __init__(self, context: Context, output: StreamOutput, options: RunOptions) -> None:
        self._context, self._output = context, output
        self._options, self._keyframe = options, options.keyframe
        self._header: StreamHeader | None = None
        self._last: Encoded | None = None
        self._next: NextSegment | None = None
        self._reporter = FrameReporter(context, options.on_warning)
        self._upcoming: Upcoming | None = None

    def check_header(self, first: int) -> None:
        """Raises RigError, before anything is trained, for a rig that no stream's header can hold."""
        try:
            self._new_header(first, default_lattice(1.0), self._context.settings.keyframe.sh_degree).to_bytes()
        except StreamError as error:
            problem = str(error).partition(" in packet ")[0].removeprefix("header: ")
            path = self._context.ingest.rig.path
            raise RigError(f"{path}: a stream cannot hold this rig ({problem}); change its calibration") from None

    def encode(self, frames: Iterable[RigFrame], first: int, earlier: Earlier) -> Iterator[FrameReport]:
        """Encodes ``frames`` of a take that begins with the rig's frame ``first``; ``earlier`` ones are replayed."""
        written = iter(earlier.packets)
        read: Iterable[RigFrame] = frames
        if self._options.read_ahead and self._context.threads > 1:
            read = coming = Ahead(frames)
            self._upcoming = coming.peek if self._context.kernel.leaves_processor_idle else None
        for index, (frame, following) in enumerate(with_following(read, first, self._context.settings)):
            packet = next(written, None)
            if packet is not None:
                yield self._replay(frame, packet, earlier.origin if index in earlier.compared else "")
            elif self._last is None:
                yield self._encode_key(frame)
            else:
                yield self._encode_next(frame, self._last, following)

    def _encode_key(self, frame: RigFrame) -> FrameReport:
        """Trains or takes over the first frame and writes header and keyframe; the output begins only then."""
        task = Task(frame, on_step=self._options.on_keyframe_step, watch=self._begin(frame))
        first = self._first_frame(task)
        degree = sh_degree_of(first.state.coefficients)
        header = self._new_header(frame.index, first.lattice, degree, colours=first.colours, recorded=frame.recorded)
        encoded = begin_scene(self._context, header, first, replace(task, write=partial(self._write_first, header)))
        if isinstance(self._keyframe, KeyframeSource):
            self._check_keyframe(self._keyframe, encoded, frame, task.watch)
        return self._report(encoded, task.watch)

    def _encode_next(self, frame: RigFrame, last: Encoded, following: Sequence[RigFrame]) -> FrameReport:
        """Encodes a frame after the ``last``; ``following``: those up to the start of the segment it is faded into."""
        watch = self._begin(frame)
        segment = self._next_segment([frame, *following], last, watch)
        coded = segment.first if segment is not None and segment.start == frame.index else None
        packet = None if coded is None else coded.written.packet
        on_step = self._options.on_keyframe_step
        task = Task(frame, packet, segment, on_step, watch, self._write, self._upcoming)
        encoded = encode_frame(self._context, last.scene, last.memory, task)
        if coded is not None:
            encoded = replace(encoded, rejected=coded.rejected)
        return self._report(encoded, watch)

    def take_over(self, left: Interrupted, span: range) -> None:
        """Goes on from what an earlier encode left of frames ``span``: its header, near planes and cameras' colours.

        Raises UsageError unless it is the beginning of this encode.
        """
        ingest, header = self._context.ingest, left.header
        if isinstance(self._keyframe, SplatSource):
            # Rotation and lattice were found from pictures; the digest in the header identifies the file.
            self._keyframe = _keyframe_made(self._keyframe, left)
        source = self._keyframe
        if source is not None:
            source.check(ingest, span.start)
            header = source.header
        near = header.near_planes
        ingest.set_near_planes({camera.name: near.get(camera.name, 0.0) for camera in ingest.rig.cameras})
        self._header = self._new_header(
            span.start,
            header.lattice,
            header.sh_degree,
            colours=header.camera_colours,
            recorded=recorded_in(left.header),
        )
        left.check(self._header, len(span))
        if source is not None:
            key = reconstruct(None, next(left.packets()), self._header)
            left.check_keyframe(same=digest(key) == digest(source.state))

    def _replay(self, frame: RigFrame, packet: Packet, origin: str = "") -> FrameReport:
        """Does all that encoding the frame did but for the training: the result is in the packet.

        ``origin``: where the packet comes from, for a frame that is compared with its pictures; "" for none.
        """
        assert self._header is not None
        task = Task(frame, packet)
        if self._last is None:
            key = reconstruct(None, packet, self._header)
            first = earlier_first_frame(self._context, key, self._header, frame)
            self._last = begin_scene(self._context, self._header, first, task)
        else:
            self._last = encode_frame(self._context, self._last.scene, self._last.memory, task)
        if origin:
            self._reporter.check_footage(self._last, origin, task.watch)
        report = self._reporter.report(self._last, task.watch)
        return replace(report, replayed=True, effects=[], full_frame_change=False)

    def _next_segment(self, frames: Sequence[RigFrame], last: Encoded, watch: Stopwatch) -> NextSegment | None:
        """The segment that begins with the last of ``frames``, if it was trained for their fade into it."""
        start = frames[-1].index
        is_trained = self._next is not None and self._next.start == start
        if len(frames) > 1 and not is_trained and not self._context.method.dense:
            with watch.stage("next segment"):
                self._next = train_next_segment(self._context, last.scene, last.memory, frames)
        return self._next if self._next is not None and self._next.start == start else None

    def _write_first(self, header: StreamHeader, packet: Packet) -> None:
        """Begins the output with its header, and appends the first packet."""
        self._output.begin(header.to_bytes())
        self._write(packet)

    def _write(self, packet: Packet) -> None:
        self._output.write(packet.kind, packet.frame, packet.payload)

    def _report(self, encoded: Encoded, watch: Stopwatch) -> FrameReport:
        """Goes on from the frame, and reports it."""
        self._last = encoded
        return self._reporter.report(encoded, watch)

    def _first_frame(self, task: Task) -> FirstFrame:
        """Trained from the pictures, or taken from the keyframe that was given."""
        context, source = self._context, self._keyframe
        if isinstance(source, SplatSource):
            with task.watch.stage("import"):
                imported = import_splats(context.kernel, context.ingest, task.recorded, context.settings, source)
            source = self._keyframe = imported.source
            for text in imported.warnings:
                self._warn(text)
        if source is None:
            return train_keyframe(context, task.recorded, task)
        source.check(context.ingest, task.recorded.index)
        context.ingest.set_near_planes(source.header.near_planes)
        with task.watch.stage("import"):
            return earlier_first_frame(context, source.state, source.header, task.recorded)

    def _check_keyframe(self, source: KeyframeSource, encoded: Encoded, frame: RigFrame, watch: Stopwatch) -> None:
        """Warns where an earlier stream's keyframe is of other footage."""
        if not recorded_in(source.header):
            self._reporter.check_footage(encoded, f"`keyframe` {source.path}", watch)
        elif problem := difference(source.header, frame.recorded):
            self._warn(f"`keyframe` {source.path}: it was made from {problem}; is it of other footage?")

    def _new_header(
        self,
        first: int,
        lattice: Lattice,
        sh_degree: int,
        *,
        colours: Corrections | None = None,
        recorded: Mapping[str, str] | None = None,
    ) -> StreamHeader:
        """The header of a stream that begins with the rig's frame ``first``."""
        context, source = self._context, self._keyframe
        return stream_header(
            context.ingest,
            context.settings,
            first=first,
            lattice=lattice,
            sh_degree=sh_degree,
            seed=context.seed,
            corrected=CorrectedCameras() if context.corrector is None else context.corrector.cameras,
            colours=colours or {},
            inherited=source.settings if isinstance(source, KeyframeSource) else None,
            recorded=recorded or {},
            sound=() if self._options.sound is None else (self._options.sound.track,),
        )

    def _begin(self, frame: RigFrame) -> Stopwatch:
        if self._options.convergence is not None:
            self._options.convergence.begin(frame.index)
        return Stopwatch()

    def _warn(self, text: str) -> None:
        if self._options.on_warning is not None:
            self._options.on_warning(text)


def _keyframe_made(source: SplatSource, left: Interrupted) -> KeyframeSource:
    """The keyframe that an earlier encode made of a file's Gaussians; the header has that file's digest."""
    made = reconstruct(None, next(left.packets()), left.header)
    settings = {**left.header.settings, "keyframe": source.document}
    return KeyframeSource(source.path, replace(left.header, settings=settings), made)
