"""How one output is encoded, beside the settings."""

from __future__ import annotations

from dataclasses import dataclass

from decogs.formats.system.callbacks import OnWarning

from ..input.imported_keyframe import KeyframeSource
from ..input.imported_splats import SplatSource
from ..input.sound import SoundSource
from ..output.convergence_log import ConvergenceLog
from ..output.reports import OnFrame, OnKeyframeStep


@dataclass(frozen=True)
class RunOptions:
    """What a stream and a part of one are encoded with, beside the settings, and who follows it."""

    keyframe: KeyframeSource | SplatSource | None = None  # an earlier stream's, or a file's Gaussians, to begin with
    metrics: bool = False  # each frame's PSNR goes behind it
    sound: SoundSource | None = None  # goes beside the frames
    read_ahead: bool = True  # the next frame is read on a thread of its own while this one trains; takes memory
    on_frame: OnFrame | None = None
    on_keyframe_step: OnKeyframeStep | None = None
    convergence: ConvergenceLog | None = None  # takes the loss of every step
    on_warning: OnWarning | None = None
