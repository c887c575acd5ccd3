"""When each camera of a rig started to record, so that frames of one instant are read together.

`starts.find_starts` asks the timecode, then the sound, then what moves; `opening.open_synchronised` applies what it
finds. ``DESIGN.md`` has measurements and rejected variants.
"""

from .opening import AUTO, open_synchronised
from .starts import CameraStart, Synchrony, find_starts

__all__ = ["AUTO", "CameraStart", "Synchrony", "find_starts", "open_synchronised"]
