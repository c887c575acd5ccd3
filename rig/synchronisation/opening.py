"""Opens a rig in step by what its recordings, or a file, say of its cameras' starts."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from decogs.formats.rigs import Rig, in_step, open_recordings, open_rig
from decogs.formats.system.callbacks import OnProgress

from .starts import find_starts
from .sync_file import read_starts

AUTO = "auto"


def open_synchronised(
    path: str | os.PathLike[str],
    sync: str | None,
    *,
    threads: int = 0,
    on_step: OnProgress = lambda done, total: None,
) -> Rig:
    """The rig in step: as its calibration states for None, as is found in the recordings for AUTO, else by a file.

    What cannot be said is a warning of the rig. Raises RigError.
    """
    if sync is None:
        return open_rig(path)
    recordings = open_recordings(path)
    warnings: tuple[str, ...] = ()
    read: tuple[Path, ...] = ()
    if sync == AUTO:
        synchrony = find_starts(recordings, threads=threads, on_step=on_step)
        starts, warnings = synchrony.starts, synchrony.warnings
    else:
        read = (Path(sync),)
        starts = read_starts(*read, recordings)
    if not starts:
        warnings += (f"{recordings.path}: nothing says when its cameras start; they are taken to be in step",)
    rig = in_step(recordings, starts)
    return replace(rig, warnings=(*rig.warnings, *warnings), calibration=(*rig.calibration, *read))
