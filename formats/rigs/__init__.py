"""Opens a rig of synchronised, calibrated, fixed cameras in any known layout, and reads its frames in step."""

from typing import TYPE_CHECKING

from ..system.lazy_names import lazy_names

if TYPE_CHECKING:
    from .live import dropped_in as dropped_in
    from .live import is_live as is_live
    from .live import open_live as open_live
    from .live import stop_waiting as stop_waiting
    from .opening import OnLost as OnLost
    from .opening import files_of as files_of
    from .opening import files_with as files_with
    from .opening import open_recordings as open_recordings
    from .opening import open_rig as open_rig
    from .opening import read_frames as read_frames
    from .opening import read_repeating as read_repeating
    from .rig import Points as Points
    from .rig import Rig as Rig
    from .rig import without_cameras as without_cameras
    from .sources import FrameSource as FrameSource
    from .steps import in_step as in_step

_HOMES = {
    "in_step": "steps",
    "dropped_in": "live",
    "is_live": "live",
    "open_live": "live",
    "stop_waiting": "live",
    "OnLost": "opening",
    "files_of": "opening",
    "files_with": "opening",
    "open_recordings": "opening",
    "open_rig": "opening",
    "read_frames": "opening",
    "read_repeating": "opening",
    "Points": "rig",
    "Rig": "rig",
    "without_cameras": "rig",
    "FrameSource": "sources",
}
__all__ = list(_HOMES)
__getattr__ = lazy_names(__name__, _HOMES)
