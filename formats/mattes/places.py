"""Where a folder keeps what belongs to a camera: under its name, or under its number alone, as EasyVolcap has it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path

from ..errors import RigError
from ..pictures import PICTURE_SUFFIXES
from ..rigs.sources import list_folder
from ..videos import VIDEO_SUFFIXES


def places_of_cameras(folder: Path, names: Collection[str]) -> dict[str, Path]:
    """The entry of each camera that has one: ``cam00/``, ``cam00.png``, ``cam00.mp4``, or ``00/`` and so on.

    Raises RigError if the folder is none, or has two for one camera.
    """
    if not folder.is_dir():
        raise RigError(f"{folder}: there is no such folder; check the path")
    numbers = {name: _number(name) for name in names}
    counts = Counter(numbers.values())
    cameras = {number: name for name, number in numbers.items() if number is not None and counts[number] == 1}
    found: dict[str, Path] = {}
    for entry, stem in _entries(folder):
        name = stem if stem in names else cameras.get(int(stem)) if stem.isdecimal() else None
        if name is None:
            continue
        if name in found:
            raise RigError(f"{entry}: {found[name].name} is of camera {name}, too; keep one of the two")
        found[name] = entry
    return found


def _entries(folder: Path) -> Iterator[tuple[Path, str]]:
    for entry in list_folder(folder):
        if entry.is_dir():
            yield entry, entry.name
        elif entry.suffix.lower() in PICTURE_SUFFIXES | VIDEO_SUFFIXES:
            yield entry, entry.stem


def _number(name: str) -> int | None:
    """The last number in a camera's name."""
    digits = re.findall(r"[0-9]+", name)
    return int(digits[-1]) if digits else None
