"""The constants of an encode: rig, settings, kernel and views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats

from ..backends import BLACK, TrainingKernel, training_kernel
from ..backends.scene_views import SceneViews
from ..input.compensation import Corrector, RenderView, corrector_of
from ..input.ingest import Ingest
from ..methods import method_of
from ..settings.encode import EncodeSettings
from ..training.method import FrameMethod
from ..training.schedule import OnLoss, StoppingRule
from .cross_fade import fade_cameras
from .segment_starts import SegmentStarts


@dataclass(frozen=True)
class Context:
    """The rig, the settings and the views in which frames are trained and drawn.

    ``views``: the training views; ``fade_views``: where two closed segments are compared. Both draw the
    scene that is asked for. ``corrector``: of the cameras whose drift is compensated, or None. ``starts``: those of
    closed segments after a cut. ``on_loss`` follows every training step.
    """

    ingest: Ingest
    settings: EncodeSettings
    kernel: TrainingKernel
    views: SceneViews
    fade_views: SceneViews
    method: FrameMethod
    corrector: Corrector | None
    starts: SegmentStarts
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
    ) -> Context:
        """Raises UsageError for a device or a method that is not there, or a camera that cannot be compensated."""
        kernel = training_kernel(device, threads, ingest.background or BLACK)

        def cameras() -> Sequence[Camera]:
            return [view.pinhole for view in ingest.views]

        return cls(
            ingest,
            settings,
            kernel,
            SceneViews(kernel, cameras, ingest.rig.timeline.late() if _follows_frame_by_frame(settings) else None),
            SceneViews(kernel, lambda: fade_cameras(cameras())),
            method_of(settings),
            corrector_of(ingest.views, settings.corrections),
            SegmentStarts(ingest, settings.segment),
            seed,
            threads,
            on_loss,
        )

    def renderer(self, scene: Splats) -> RenderView:
        """Renders the ``scene`` through a training view, by number; views are kept from frame to frame."""
        return self.fresh_renderer(scene) if self.method.dense else lambda number: self.views.of(scene)[number].rgb

    def fresh_renderer(self, scene: Splats) -> RenderView:
        """Renders the ``scene`` through a training view, by number, and keeps nothing."""
        return lambda number: self.kernel.forward(scene, self.ingest.views[number].pinhole).rgb

    def stopping(self, deadline: float | None = None) -> StoppingRule:
        """What ends a training, by the settings' target and the ``deadline``."""
        return StoppingRule(deadline, self.settings.target_psnr, self.on_loss)


def _follows_frame_by_frame(settings: EncodeSettings) -> bool:
    """Whether what a frame's training moves is a frame's motion: no catching up, no frame that is left to the next."""
    return not settings.closed and settings.time_budget is None
