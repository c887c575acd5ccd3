"""Measures a frame against its pictures and reports it."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import fmean

from decogs.codec.header import StreamHeader
from decogs.decoder.views import render_view
from decogs.formats.callbacks import OnWarning
from decogs.formats.container import Packet, PacketKind
from decogs.formats.splats import FloatArray, Splats

from ..backends import IncrementalViews, TrainingKernel
from ..change.detection import Change
from ..change.masks import FrameMask, showing
from ..input.ingest import Ingest, RigFrame, display_referred
from ..psnr import mean_picture_psnr, mean_psnr, psnr_of, square_error
from ..stopwatch import Stopwatch
from .footage import matches, warning_of
from .reports import FrameReport

_STAGE = "measure"


class FrameReporter:
    """Reports the frames of a stream. ``views`` show its scene; where there are none, it is rendered."""

    def __init__(
        self,
        ingest: Ingest,
        kernel: TrainingKernel,
        views: IncrementalViews,
        on_warning: OnWarning | None,
        *,
        threads: int,
    ) -> None:
        self._ingest, self._kernel, self._views, self._threads = ingest, kernel, views, threads
        self._on_warning = on_warning
        self._first_errors: dict[str, float] = {}

    def report(
        self,
        frame: RigFrame,
        header: StreamHeader,
        scene: Splats,
        packet: Packet,
        costs: dict[str, int],
        change: Change,
        watch: Stopwatch,
    ) -> FrameReport:
        """The report of a frame whose ``scene`` stands, with PSNRs against its pictures."""
        cpu_seconds = watch.cpu_seconds()
        with watch.stage(_STAGE):
            training = self._training_psnr(frame, scene, showing(change.masks))
            held_out = mean_psnr(self._kernel, scene, self._ingest.held_out_views, frame.held_out)
            own_size = self._own_size_psnr(frame, header, scene)
        views = self._ingest.views
        return FrameReport(
            frame.index,
            PacketKind(packet.kind).name.lower(),
            packet.size,
            len(scene),
            change.share,
            training,
            held_out if frame.held_out else None,
            watch.seconds,
            costs,
            cpu_seconds,
            left_out={
                view.camera.name: mask.lost for view, mask in zip(views, change.masks, strict=False) if mask.lost
            },
            overlooked=change.overlooked,
            cut=change.cut,
            scale=self._ingest.scale,
            held_out_own_size_psnr=own_size,
        )

    def check_footage(
        self, frame: RigFrame, scene: Splats, origin: str, masks: Sequence[FrameMask], watch: Stopwatch
    ) -> None:
        """Warns where the scene of an earlier encode, named by ``origin``, is not what the rig's pictures show.

        A later frame's pictures are expected to fit nearly as well as the first ones that were compared.
        """
        with watch.stage(_STAGE):
            used = showing(masks) or range(len(self._ingest.views))
            views, pictures = [self._ingest.views[i] for i in used], [frame.training[i] for i in used]
            found = matches(views, pictures, self._shown(scene, used), threads=self._threads)
            self._first_errors = self._first_errors or {match.camera: match.error for match in found}
            cameras = [m.camera for m in found if m.is_of_other_footage(self._first_errors.get(m.camera, m.error))]
            if cameras and self._on_warning is not None:
                self._on_warning(warning_of(origin, frame.index, cameras))

    def _training_psnr(self, frame: RigFrame, scene: Splats, seen: Sequence[int]) -> float:
        """Of the views in ``seen``, of all if there are none."""
        used = seen or range(len(self._ingest.views))
        views, pictures = [self._ingest.views[i] for i in used], [frame.training[i] for i in used]
        return mean_picture_psnr(views, self._shown(scene, used), pictures, threads=self._threads)

    def _own_size_psnr(self, frame: RigFrame, header: StreamHeader, scene: Splats) -> float | None:
        """Of what a decoder shows of the held-out cameras, against what they recorded; None without a scale."""
        if not frame.own_size:
            return None
        views = [view.camera.name for view in self._ingest.held_out_views]
        return fmean(
            psnr_of(square_error(render_view(header, scene, name, threads=self._threads).image, picture))
            for name, picture in zip(views, map(display_referred, frame.own_size), strict=True)
        )

    def _shown(self, scene: Splats, used: Sequence[int]) -> list[FloatArray]:
        """What these views show of the scene, (3, H, W) each."""
        if self._views.views:
            return [self._views.views[i].rgb for i in used]
        return [self._kernel.forward(scene, self._ingest.views[i].pinhole).rgb for i in used]
