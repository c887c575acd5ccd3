"""Edits of a stream, without training: ``edit`` with the operations below, in the order given.

``read_recipe`` reads operations from a file, as ``decogs-edit --recipe`` does.
"""

from .editing import EditReport, edit
from .operations.audio import Audio
from .operations.base import Operation
from .operations.cameras import Cameras
from .operations.clean import Clean
from .operations.concat import Concat
from .operations.crop import Crop
from .operations.grade import Grade
from .operations.merge import Merge
from .operations.retime import Retime, Speed
from .operations.set import Set
from .operations.strip import Strip
from .operations.transform import Transform
from .operations.trim import Trim
from .recipe import read_recipe
from .regions import Box, Polygon, Region, Sphere

__all__ = [
    "Audio",
    "Box",
    "Cameras",
    "Clean",
    "Concat",
    "Crop",
    "EditReport",
    "Grade",
    "Merge",
    "Operation",
    "Polygon",
    "Region",
    "Retime",
    "Set",
    "Speed",
    "Sphere",
    "Strip",
    "Transform",
    "Trim",
    "edit",
    "read_recipe",
]
