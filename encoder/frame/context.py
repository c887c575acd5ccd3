"""The constants of an encode: rig, settings, kernel and views."""

from __future__ import annotations

from dataclasses import dataclass, replace

from decogs.formats.cameras import is_wide
from decogs.formats.rigs.timeline import RowTimes
from decogs.formats.splats import Splats
from decogs.rig.pictures.ingest import Ingest

from ..backends import BLACK, TrainingKernel, training_kernel
from ..backends.late_view import PictureClock
from ..backends.scene_views import SceneViews
from ..backends.wide import WideKernel
from ..input.compensation import Corrector, RenderView, corrector_of
from ..methods import method_of
from ..settings.encode import EncodeSettings
from ..training.method import FrameMethod
from ..training.schedule import OnLoss, StoppingRule


@dataclass(frozen=True)
class Context:
    """The rig, the settings, and what trains and draws frames; nothing that changes from frame to frame.

    ``corrector``: of the cameras whose drift is compensated, or None. ``on_loss`` follows every training step.
    """

    ingest: Ingest
    settings: EncodeSettings
    kernel: TrainingKernel
    method: FrameMethod
    corrector: Corrector | None
    seed: int
    threads: int
    on_loss: OnLoss | None = None

    @classmethod
    def of(
        cls,
        ingest: Ingest,
        settings: EncodeSettings,
        *,
        seed: int,
        threads: int,
        device: str = "auto",
        on_loss: OnLoss | None = None,
        kernel: TrainingKernel | None = None,
    ) -> Context:
        """Raises UsageError for a device or a method that is not there, or a camera that cannot be compensated.

        ``kernel``: None is the ``device``'s.
        """
        kernel = kernel or training_kernel(device, threads, ingest.background or BLACK)
        views = [*ingest.views, *ingest.held_out_views]
        return cls(
            ingest,
            settings,
            WideKernel(kernel) if any(is_wide(view.pinhole) for view in views) else kernel,
            method_of(settings),
            corrector_of(ingest.views, settings.corrections),
            seed,
            threads,
            on_loss,
        )

    def row_times(self) -> dict[str, RowTimes]:
        """By camera, of those whose rows are of other times than a frame's instant, as far as later frames heed it."""
        timeline, corrections = self.ingest.rig.timeline, self.settings.corrections
        if not corrections.rolling_shutter:
            timeline = replace(timeline, readouts={})
        elif timeline.rate is not None:
            # Bands of lamps tell what the rig's files do not; no camera reads longer than a frame takes.
            seen = {name: timeline.time_of(lamp.readout) for name, lamp in corrections.lamps.items()}
            possible = {name: readout for name, readout in seen.items() if abs(readout) <= 1}
            timeline = replace(timeline, readouts={**possible, **timeline.readouts})
        return timeline.row_times() if _follows_frame_by_frame(self.settings) else {}

    def new_views(self) -> SceneViews:
        """The training views, in which nothing is drawn yet."""
        times = self.row_times()
        views = self.ingest.views
        clocks = {
            view.camera.name: PictureClock(own, view.camera)
            for view in views
            if (own := times.get(view.camera.name, RowTimes())) != RowTimes()
        }
        recorded = {view.camera.name: view.recorded for view in views}
        return SceneViews(self.kernel, lambda: [view.pinhole for view in self.ingest.views], clocks, recorded)

    def renderer(self, views: SceneViews, scene: Splats) -> RenderView:
        """Renders the ``scene`` through a training view, by number; ``views``: those kept from frame to frame."""
        return self.fresh_renderer(scene) if self.method.dense else lambda number: views.of(scene)[number].rgb

    def fresh_renderer(self, scene: Splats) -> RenderView:
        """Renders the ``scene`` through a training view, by number, and keeps nothing."""
        return lambda number: self.kernel.forward(scene, self.ingest.views[number].pinhole).rgb

    def stopping(self, deadline: float | None = None) -> StoppingRule:
        """What ends a training, by the settings' target and the ``deadline``."""
        return StoppingRule(deadline, self.settings.target_psnr, self.on_loss)


def _follows_frame_by_frame(settings: EncodeSettings) -> bool:
    """Whether what a frame's training moves is a frame's motion: no catching up, no frame that is left to the next."""
    return not settings.closed and settings.time_budget is None
