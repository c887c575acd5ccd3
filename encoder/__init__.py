"""Everything that chooses: ingest, keyframe training, masks, selection, motion, densification and the closed loop.

``encode`` does what ``decogs-encode`` does, with the same options.
"""

from .encoding import encode
from .output.reports import EncodeReport, FrameReport
from .settings.compensation import CorrectionSettings
from .settings.encode import EncodeSettings
from .settings.presets import PRESETS

__all__ = ["PRESETS", "CorrectionSettings", "EncodeReport", "EncodeSettings", "FrameReport", "encode"]
