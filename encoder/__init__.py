"""Everything that chooses: ingest, keyframe training, masks, selection, motion, densification and the closed loop.

``encode`` does what ``decogs-encode`` does; what the command's options write as text are values here.
"""

from .analysis import EffectChoice
from .encoding import encode
from .input.mattes import MatteChoice
from .job import EncodeJob
from .output.observer import EncodeObserver
from .output.progress import TerminalProgress
from .output.reports import EncodeReport, FrameReport
from .packing import PackReport, pack
from .parts.joining import JoinReport, join
from .settings.effects import CorrectionSettings
from .settings.encode import EncodeSettings
from .settings.presets import PRESETS
from .switches import Switches
from .targets import Targets

__all__ = [
    "PRESETS",
    "CorrectionSettings",
    "EffectChoice",
    "EncodeJob",
    "EncodeObserver",
    "EncodeReport",
    "EncodeSettings",
    "FrameReport",
    "JoinReport",
    "MatteChoice",
    "PackReport",
    "Switches",
    "Targets",
    "TerminalProgress",
    "encode",
    "join",
    "pack",
]
