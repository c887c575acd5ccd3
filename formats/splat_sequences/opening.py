"""Opens a file of a whole sequence by the ending of its name."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

from ..errors import UsageError
from ..splat_files import Room
from . import SplatSequence
from .fourdgs import FourDGSFile
from .splat4d import Splat4dFile

_READERS: Mapping[str, Callable[[Path, Room, float | None], SplatSequence]] = {
    ".4dgs": FourDGSFile,
    ".splat4d": Splat4dFile,
}
SEQUENCES: tuple[str, ...] = tuple(_READERS)
"""The endings of files that are read, each with its dot."""


def open_sequence(path: str | os.PathLike[str], room: Room, fps: float | None = None) -> SplatSequence:
    """The sequence of a .4dgs or .splat4d file.

    ``room``: what each frame, with the file, may take. ``fps``: at how many frames per second a .4dgs is sampled, and
    what a .splat4d is played at; None is the file's own. Raises UsageError for a file that cannot be read, for one that
    has no rate of its own, and where the package that reads it is not installed.
    """
    path = Path(path)
    try:
        if not path.is_file():
            raise UsageError(f"{path}: is no file; give a {' or '.join(SEQUENCES)}")
        size = path.stat().st_size
    except OSError as error:
        raise UsageError(f"{path}: {error.strerror}; give a file that can be read") from error
    if room.memory is not None and size > room.memory:
        raise UsageError(f"{path}: has {size} bytes; allow more memory than {room.memory} (`max_memory`)")
    return _READERS[path.suffix.lower()](path, room, fps)
