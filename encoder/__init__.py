"""Everything that chooses: ingest, keyframe training, masks, selection, motion, densification and the closed loop.

``encode`` does what ``decogs-encode`` does; what the command's options write as text are values here.
"""

from typing import TYPE_CHECKING

from decogs.formats.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from decogs.rig.mattes import MatteChoice as MatteChoice

    from .analysis import EffectChoice as EffectChoice
    from .encoding import encode as encode
    from .job.job import EncodeJob as EncodeJob
    from .job.switches import Switches as Switches
    from .job.targets import Targets as Targets
    from .output.observer import EncodeObserver as EncodeObserver
    from .output.progress import TerminalProgress as TerminalProgress
    from .output.reports import EncodeReport as EncodeReport
    from .output.reports import FrameReport as FrameReport
    from .packing.packing import PackReport as PackReport
    from .packing.packing import pack as pack
    from .parts.joining import JoinReport as JoinReport
    from .parts.joining import join as join
    from .settings.effects import CorrectionSettings as CorrectionSettings
    from .settings.encode import EncodeSettings as EncodeSettings
    from .settings.presets import PRESETS as PRESETS

_HOMES = {
    "EffectChoice": "analysis",
    "encode": "encoding",
    "MatteChoice": ".rig.mattes",
    "EncodeJob": "job.job",
    "EncodeObserver": "output.observer",
    "TerminalProgress": "output.progress",
    "EncodeReport": "output.reports",
    "FrameReport": "output.reports",
    "PackReport": "packing.packing",
    "pack": "packing.packing",
    "JoinReport": "parts.joining",
    "join": "parts.joining",
    "CorrectionSettings": "settings.effects",
    "EncodeSettings": "settings.encode",
    "PRESETS": "settings.presets",
    "Switches": "job.switches",
    "Targets": "job.targets",
}
__all__ = list(_HOMES)
__getattr__ = lazy_names(__name__, _HOMES)
