"""Videos without poses brought in step, by timecode and sound or by a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from decogs.formats.cameras import Camera
from decogs.formats.rigs import Rig, in_step
from decogs.formats.rigs.rig import recorded_rate
from decogs.formats.rigs.timeline import Timeline

from ..synchronisation.opening import AUTO
from ..synchronisation.starts import find_starts_without_poses
from ..synchronisation.sync_file import read_starts
from .footage import Footage


def brought_in_step(
    videos: Path, footage: Sequence[Footage], sync: str, threads: int
) -> tuple[tuple[Footage, ...], tuple[str, ...]]:
    """The footage from the same instant on, with its starts, and what the user should know.

    ``sync``: AUTO, or the path of a sync.json. Raises RigError as `decogs.formats.rigs.steps`.
    """
    rig = _without_poses(videos, footage)
    warnings: tuple[str, ...] = ()
    if sync == AUTO:
        synchrony = find_starts_without_poses(rig, threads=threads)
        starts, warnings = synchrony.starts, synchrony.warnings
    else:
        starts = read_starts(Path(sync), rig)
    if not starts:
        reason = "neither timecode nor sound says when its cameras start" if sync == AUTO else f"{sync} states no start"
        return tuple(footage), (*warnings, f"{videos}: {reason}; they are taken to be in step")
    together = in_step(rig, starts)
    cut = [
        replace(one, source=source, start=starts.get(one.name))
        for one, source in zip(footage, together.sources, strict=True)
    ]
    return tuple(cut), (*together.warnings, *warnings)


def _without_poses(videos: Path, footage: Sequence[Footage]) -> Rig:
    """The videos as a rig whose cameras all stand in one place: their poses are what is sought."""
    cameras = [
        Camera(name=one.name, width=w, height=h, fx=w, fy=w, cx=w / 2, cy=h / 2, world_to_camera=np.eye(4))
        for one in footage
        for w, h in [one.size]
    ]
    sources = tuple(one.source for one in footage)
    count, timeline = min(source.frame_count for source in sources), Timeline(recorded_rate(sources, None))
    return Rig(videos, "videos", tuple(cameras), sources, None, count, timeline=timeline)
