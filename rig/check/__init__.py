"""What to expect of a rig before it is encoded: poses, delays, light, noise, faults of single cameras."""

from typing import TYPE_CHECKING

from decogs.formats.system.lazy_names import lazy_names

if TYPE_CHECKING:
    from .rig_statistics import RigStatistics as RigStatistics
    from .rig_statistics import gather_statistics as gather_statistics

_HOMES = {"RigStatistics": "rig_statistics", "gather_statistics": "rig_statistics"}
__all__ = list(_HOMES)
__getattr__ = lazy_names(__name__, _HOMES)
