"""Everything that chooses: ingest, keyframe training, masks, selection, motion, densification and the closed loop.

``encode`` does what ``decogs-encode`` does, with the same options.
"""

from .corrections import CorrectionSettings
from .encoding import encode
from .presets import PRESETS, EncodeSettings
from .reports import EncodeReport, FrameReport

__all__ = ["PRESETS", "CorrectionSettings", "EncodeReport", "EncodeSettings", "FrameReport", "encode"]
