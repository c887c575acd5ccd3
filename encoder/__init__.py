"""Everything that chooses: ingest, keyframe training, masks, selection, motion, densification and the closed loop.

``encode`` does what ``decogs-encode`` does; what the command's options write as text are values here.
"""

from typing import TYPE_CHECKING

from decogs.formats.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from .analysis import EffectChoice as EffectChoice
    from .encoding import encode as encode
    from .input.mattes import MatteChoice as MatteChoice
    from .job import EncodeJob as EncodeJob
    from .output.observer import EncodeObserver as EncodeObserver
    from .output.progress import TerminalProgress as TerminalProgress
    from .output.reports import EncodeReport as EncodeReport
    from .output.reports import FrameReport as FrameReport
    from .packing import PackReport as PackReport
    from .packing import pack as pack
    from .parts.joining import JoinReport as JoinReport
    from .parts.joining import join as join
    from .settings.effects import CorrectionSettings as CorrectionSettings
    from .settings.encode import EncodeSettings as EncodeSettings
    from .settings.presets import PRESETS as PRESETS
    from .switches import Switches as Switches
    from .targets import Targets as Targets

_HOMES = {
    "EffectChoice": "analysis",
    "encode": "encoding",
    "MatteChoice": "input.mattes",
    "EncodeJob": "job",
    "EncodeObserver": "output.observer",
    "TerminalProgress": "output.progress",
    "EncodeReport": "output.reports",
    "FrameReport": "output.reports",
    "PackReport": "packing",
    "pack": "packing",
    "JoinReport": "parts.joining",
    "join": "parts.joining",
    "CorrectionSettings": "settings.effects",
    "EncodeSettings": "settings.encode",
    "PRESETS": "settings.presets",
    "Switches": "switches",
    "Targets": "targets",
}
__all__ = list(_HOMES)
__getattr__ = lazy_names(__name__, _HOMES)
