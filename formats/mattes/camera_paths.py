"""Where a folder keeps what belongs to a camera: under its name, or under its number alone, as EasyVolcap has it."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Collection
from pathlib import Path

from ..errors import RigError
from ..files.unicode_forms import composed
from ..pictures.reading import PICTURE_SUFFIXES
from ..rigs.sources import list_folder, refuse_unknown_kinds
from ..videos.reading import VIDEO_SUFFIXES


def paths_of_cameras(folder: Path, names: Collection[str], needed: Collection[str] = ()) -> dict[str, Path]:
    """The entry of each camera that has one: ``cam00/``, ``cam00.png``, ``cam00.mp4``, or ``00/`` and so on.

    Raises RigError if the folder is none, has two for one camera, or has for one that is ``needed`` a file of a kind
    that is not read.
    """
    if not folder.is_dir():
        raise RigError(f"{folder}: there is no such folder; check the path")
    forms = {composed(name): name for name in names}
    numbers = {name: _number(name) for name in names}
    counts = Counter(numbers.values())
    cameras = {number: name for name, number in numbers.items() if number is not None and counts[number] == 1}
    paths: dict[str, Path] = {}
    unread: list[tuple[str, Path]] = []
    for entry in list_folder(folder):
        stem = composed(entry.name if entry.is_dir() else entry.stem)
        name = forms[stem] if stem in forms else cameras.get(int(stem)) if stem.isdecimal() else None
        if name is None:
            continue
        if not entry.is_dir() and entry.suffix.lower() not in PICTURE_SUFFIXES | VIDEO_SUFFIXES:
            unread.append((name, entry))
            continue
        if name in paths:
            raise RigError(f"{entry}: {paths[name].name} is of camera {name}, too; keep one of the two")
        paths[name] = entry
    refuse_unknown_kinds(entry for name, entry in unread if name in needed and name not in paths)
    return paths


def _number(name: str) -> int | None:
    """The last number in a camera's name."""
    digits = re.findall(r"[0-9]+", name)
    return int(digits[-1]) if digits else None
