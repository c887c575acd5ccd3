"""Measures a frame against its pictures and reports it."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean

from decogs.decoder.rendering.views import render_view
from decogs.formats.splats import FloatArray
from decogs.formats.stream.container import PacketKind
from decogs.formats.system.callbacks import OnWarning
from decogs.rig.pictures.ingest import display_referred

from ..backends.psnr import mean_picture_psnr, mean_psnr, mean_shown_psnr, psnr_of, square_error
from ..change.masks import usable_views
from ..frame.context import Context
from ..frame.encode_frame import Encoded
from ..input.compensation.colour import remove_colours
from ..output.footage import matches, warning_of
from ..output.reports import FrameReport
from ..stopwatch import Stopwatch

_STAGE = "measure"


class FrameReporter:
    """Reports the frames of a stream."""

    def __init__(self, context: Context, on_warning: OnWarning | None) -> None:
        self._context, self._on_warning = context, on_warning
        self._first_errors: dict[str, float] = {}

    def report(self, encoded: Encoded, watch: Stopwatch) -> FrameReport:
        """The report of an encoded frame, with PSNRs against its pictures."""
        cpu_seconds = watch.cpu_seconds()
        context, frame = self._context, encoded.pictures
        with watch.stage(_STAGE):
            training = self._training_psnr(encoded)
            held_out = self._held_out_psnr(encoded)
            own_size = self._own_size_psnr(encoded)
        views, packet = context.ingest.views, encoded.written.packet
        return FrameReport(
            frame.index,
            PacketKind(packet.kind).name.lower(),
            packet.size,
            len(encoded.scene.splats),
            encoded.selected,
            training,
            held_out,
            watch.seconds,
            encoded.written.costs,
            cpu_seconds,
            effects=list(encoded.effects),
            left_out={
                view.camera.name: mask.lost for view, mask in zip(views, encoded.masks, strict=False) if mask.lost
            },
            dropped=dict(frame.lost),
            rejected=encoded.rejected,
            uncorrected=list(encoded.uncorrected),
            full_frame_change=encoded.full_frame_change,
            cut=encoded.cut,
            scale=context.ingest.scale,
            held_out_own_size_psnr=own_size,
            recorded=dict(frame.recorded),
        )

    def check_footage(self, encoded: Encoded, origin: str, watch: Stopwatch) -> None:
        """Warns where the scene of an earlier encode, named by ``origin``, does not match the rig's pictures.

        A later frame's pictures are expected to fit nearly as well as the first ones that were compared.
        """
        with watch.stage(_STAGE):
            used = self._used(encoded)
            views, pictures = self._context.ingest.views, encoded.pictures.training
            compared = [views[i] for i in used], [pictures[i] for i in used], self._rendered(encoded, used)
            errors = matches(*compared, threads=self._context.threads)
            self._first_errors = self._first_errors or {match.camera: match.error for match in errors}
            cameras = [m.camera for m in errors if m.is_of_other_footage(self._first_errors.get(m.camera, m.error))]
            if cameras and self._on_warning is not None:
                self._on_warning(warning_of(origin, encoded.pictures.index, cameras))

    def _used(self, encoded: Encoded) -> Sequence[int]:
        """The views whose pictures show the frame; if there are none, all that have one; else those that stand in."""
        views, masks = self._context.ingest.views, encoded.masks
        lost = encoded.pictures.lost_views(views)
        return usable_views(masks) or [view for view in range(len(views)) if view not in lost] or range(len(views))

    def _training_psnr(self, encoded: Encoded) -> float:
        used, views = self._used(encoded), self._context.ingest.views
        chosen, pictures = [views[i] for i in used], [encoded.pictures.training[i] for i in used]
        if not self._context.method.dense:
            fixed = encoded.memory.views.of(encoded.scene.splats)
            return mean_shown_psnr([fixed[i] for i in used], chosen, pictures, threads=self._context.threads)
        return mean_picture_psnr(chosen, self._rendered(encoded, used), pictures, threads=self._context.threads)

    def _held_out_psnr(self, encoded: Encoded) -> float | None:
        """PSNR of the held-out views with a picture; of a subject alone, of those with a matte; None without one."""
        ingest, frame = self._context.ingest, encoded.pictures
        alphas = frame.held_out_alpha or [None] * len(frame.held_out)
        every = zip(ingest.held_out_views, frame.held_out, alphas, strict=True)
        compared = [
            (view, picture)
            for view, picture, alpha in every
            if (ingest.background is None or alpha is not None) and view.camera.name not in frame.lost
        ]
        if not compared:
            return None
        views, pictures = map(list, zip(*compared, strict=True))
        colours = [encoded.scene.header.colours_of(view.camera.name) for view in views]
        own = [
            picture if its is None else remove_colours(picture, its, view.pinhole)
            for view, picture, its in zip(views, pictures, colours, strict=True)
        ]
        return mean_psnr(self._context.kernel, encoded.scene.splats, views, own)

    def _own_size_psnr(self, encoded: Encoded) -> float | None:
        """PSNR of the decoded views of held-out cameras with a picture, at their own size; None without a scale."""
        frame, scene, threads = encoded.pictures, encoded.scene, self._context.threads
        names = [view.camera.name for view in self._context.ingest.held_out_views] if frame.own_size else []
        values = [
            psnr_of(
                square_error(render_view(scene.header, scene.splats, name, threads=threads, corrections={}).image, own)
            )
            for name, own in zip(names, map(display_referred, frame.own_size), strict=True)
            if name not in frame.lost
        ]
        return fmean(values) if values else None

    def _rendered(self, encoded: Encoded, used: Sequence[int]) -> list[FloatArray]:
        """The scene rendered through these views, (3, H, W) each."""
        render = self._context.renderer(encoded.memory.views, encoded.scene.splats)
        return [render(i) for i in used]
