"""The operations of ``decogs-edit``, a file each.

A new one is a file with a subclass of ``Operation``, and a line here.
"""

from __future__ import annotations

from .audio import Audio
from .base import Operation
from .cameras import Cameras
from .clean import Clean
from .concat import Concat
from .crop import Crop
from .grade import Grade
from .layer import MakeLayers
from .merge import Merge
from .profile import KeepProfile
from .retime import Retime
from .set import Set
from .strip import Strip
from .transform import Transform
from .trim import Trim

_ALL: tuple[type[Operation], ...] = (
    Trim,
    Concat,
    Retime,
    Crop,
    Clean,
    Grade,
    Transform,
    Merge,
    Cameras,
    Set,
    Audio,
    Strip,
    MakeLayers,
    KeepProfile,
)

OPERATIONS = {operation.name: operation for operation in _ALL}
"""By name, in the order in which they are listed."""
