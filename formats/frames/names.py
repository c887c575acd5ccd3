"""Names of files that are numbered by frame, as programs of the trade write them.

=====================  ================================================================
in a file's name       where it comes from
=====================  ================================================================
``####``               Nuke, Houdini's flipbooks, RV: as many digits as signs, at least
``%04d``, ``%d``       C, Nuke, ffmpeg
``$F4``, ``$F``        Houdini; a shell wants it in single quotes
=====================  ================================================================

A name without any is that of a single file; where several are written, ``_`` and six digits follow its stem.
"""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Callable
from pathlib import Path

from ..errors import UsageError

_PLACE = re.compile(r"(?P<signs>#+)|%(?:0(?P<padded>[1-9]))?d|\$F(?P<houdini>[1-9])?(?![A-Za-z])")
_DIGITS = 6


def is_numbered(path: Path) -> bool:
    """Whether the file's name has a place for the frame's number. Raises UsageError for more than one."""
    fields = len(list(_PLACE.finditer(path.name)))
    if fields > 1:
        raise UsageError(f"{path}: has {fields} places for the frame's number; give one, such as x_####{path.suffix}")
    return fields == 1


def names_of_frames(path: Path, frames: int | None) -> Callable[[int], str]:
    """The file's name for each frame's number; ``frames``: how many there will be, None when nobody knows.

    Raises UsageError for a name with several places.
    """
    if is_numbered(path):
        return lambda frame: _PLACE.sub(lambda field: f"{frame:0{_width(field)}d}", path.name)
    if frames == 1:
        return lambda _: path.name
    return lambda frame: f"{path.stem}_{frame:0{_DIGITS}d}{path.suffix}"


def numbered_files(path: Path) -> list[tuple[int, Path]]:
    """The files there are of a numbered name, and their numbers, in order; they follow on each other.

    Raises UsageError for a name without a place for the number, where there is none of them, or where one is missing.
    """
    if not is_numbered(path):
        raise UsageError(f"{path}: has no place for the frame's number; name the files like x_####{path.suffix}")
    field = _PLACE.search(path.name)
    assert field is not None
    before, after = re.escape(path.name[: field.start()]), re.escape(path.name[field.end() :])
    pattern = re.compile(f"{before}([0-9]{{{_width(field)},18}}){after}")
    try:
        names = os.listdir(path.parent)
    except OSError as error:
        raise UsageError(f"{path.parent}: {error.strerror}; give a folder with the files") from error
    files = sorted((int(match[1]), path.with_name(name)) for name in names if (match := pattern.fullmatch(name)))
    if not files:
        raise UsageError(f"{path}: there is no such file; check the name")
    for (number, name), (following, _) in itertools.pairwise(files):
        if following != number + 1:
            raise UsageError(f"{path}: after {name.name} comes number {following}; give every frame once")
    return files


def _width(field: re.Match[str]) -> int:
    if field["signs"]:
        return len(field["signs"])
    return int(field["padded"] or field["houdini"] or 1)
