"""What comes beside a rig's pictures: mattes of each frame, and one picture per camera, such as a clean plate.

A matte is white where the subject covers a pixel, black where nothing does, grey in between.
"""

from .per_camera import pictures_per_camera
from .per_frame import alpha_of, matte_origin, matte_rig, own_alpha_rig, stream_matte_rig

__all__ = [
    "alpha_of",
    "matte_origin",
    "matte_rig",
    "own_alpha_rig",
    "pictures_per_camera",
    "stream_matte_rig",
]
