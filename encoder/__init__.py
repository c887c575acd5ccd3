"""Everything that chooses: ingest, keyframe training, masks, selection, motion, densification and the closed loop.

``encode`` does what ``decogs-encode`` does, with the same options.
"""

from .corrections import CorrectionSettings
from .encoding import encode
from .loop import EncodeReport, FrameReport
from .presets import PRESETS, EncodeSettings

__all__ = ["PRESETS", "CorrectionSettings", "EncodeReport", "EncodeSettings", "FrameReport", "encode"]
