"""When each camera of a rig started to record, so that frames of one instant are read together.

`starts.find_starts` asks the timecode, then the sound, then what moves; `opening.open_synchronised` applies what it
finds. ``DESIGN.md`` has measurements and rejected variants.
"""

from typing import TYPE_CHECKING

from decogs.formats.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from .opening import AUTO as AUTO
    from .opening import open_synchronised as open_synchronised
    from .starts import CameraStart as CameraStart
    from .starts import Synchrony as Synchrony
    from .starts import find_starts as find_starts

_HOMES = {
    "AUTO": "opening",
    "open_synchronised": "opening",
    "CameraStart": "starts",
    "Synchrony": "starts",
    "find_starts": "starts",
}
__all__ = list(_HOMES)
__getattr__ = lazy_names(__name__, _HOMES)
