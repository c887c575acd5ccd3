"""A camera path: the cameras of a film's pictures, and which frame of the stream each of them shows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError

MAX_PICTURES = 1 << 17
"""Of a path: an hour and a quarter at 30 a second."""

FPS = 1e-6, 1e6
"""The least and the most pictures per second that a path may have."""

DEFAULT_FPS = 30.0
"""Frame rate of a stream that does not know its own."""


@dataclass(frozen=True)
class CameraPath:
    """Cameras of one size, in the order of the pictures.

    ``times``: the frame of the stream that each picture shows, from 0, with fractions; in any order, and as often as
    wanted. None: entry t is the camera of frame t, and a single entry that of every frame. ``fps``: pictures per
    second, the stream's when None. ``source`` names the path in errors.
    """

    cameras: tuple[Camera, ...]
    times: tuple[float, ...] | None = None
    fps: float | None = None
    source: str = "the camera path"


@dataclass(frozen=True)
class ToFilm:
    """What a path may need to know of the stream it films: its cameras, and its frames; both None where unknown.

    ``metres``: of a world unit, as far as the stream knows.
    """

    cameras: tuple[Camera, ...]
    fps: float | None = None
    frame_count: int | None = None
    metres: float = 1.0

    def frame_at(self, seconds: float) -> float:
        """The frame that plays at a time from the stream's beginning; the first and the last one hold."""
        frame = max(0.0, seconds * (self.fps or DEFAULT_FPS))
        return frame if self.frame_count is None else min(frame, float(self.frame_count - 1))


def check_pictures(count: int, source: str) -> None:
    """Raises UsageError for a path of more pictures than are rendered."""
    if count > MAX_PICTURES:
        raise UsageError(f"{source}: has {count} cameras; at most {MAX_PICTURES} are rendered, give a shorter path")


def shown_frames(path: CameraPath, frame_count: int) -> list[int]:
    """The frame that each picture of a path with times shows: the nearest one, the later of two equally near.

    Raises UsageError for a time that is nearer to no frame of the stream, which has ``frame_count``.
    """
    shown = [math.floor(time + 0.5) for time in path.times or ()]
    for entry, frame in enumerate(shown):
        if not 0 <= frame < frame_count:
            raise UsageError(
                f"{path.source}: camera {entry} shows frame {path.times[entry] if path.times else frame:g}, "
                f"and the stream has frames 0 to {frame_count - 1}; choose a `frame` among them"
            )
    return shown


def camera_of_frame(cameras: Sequence[Camera], frame: int) -> Camera:
    """The camera of a frame in a path without times; raises UsageError behind its end."""
    if frame >= len(cameras):
        raise UsageError(
            f"the camera path has {len(cameras)} cameras and none for frame {frame}; "
            "list one per frame of the stream, a single one for all, or give every entry its `frame`"
        )
    return cameras[frame]
