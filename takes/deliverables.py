"""What can be delivered: each kind is a command with the options that it begins with, and the file that it makes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any


@dataclass(frozen=True)
class Kind:
    """``file``: what is made where the table does not name it, a folder if it ends with a slash; ``options`` of the
    ``command`` that the table may replace; ``reads_rig``: it is told the rig, too."""

    command: str
    file: str
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))
    reads_rig: bool = False


CAMERAS = ("view", "camera", "orbit", "spiral")
"""Members of which a picture needs one."""

KINDS = {
    "page": Kind("decogs-view", "page/"),
    "poster": Kind("decogs-decode", "poster.png", {"frames": "0:1"}),
    "video": Kind("decogs-decode", "video.mp4"),
    "pictures": Kind("decogs-decode", "pictures/"),
    "thumbnails": Kind("decogs-decode", "thumbnails/", {"scale": 0.25}),
    "exr": Kind("decogs-decode", "exr/frame_####.exr"),
    "usd": Kind("decogs-export", "scene.usdc"),
    "blender": Kind("decogs-export", "blender.usdc", {"up": "Z"}),
    "report": Kind("decogs-report", "report.html", reads_rig=True),
    "fence": Kind("decogs-report", "fence.json", reads_rig=True),
    "splats": Kind("decogs-export", "splats/frame_####.spz"),
}
"""By the name of a table in [deliver], or by its member ``kind``."""
