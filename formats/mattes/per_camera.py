"""One picture per camera: clean plates, and masks of what its pictures do not teach."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from ..errors import RigError
from ..pictures.reading import PICTURE_KINDS, PICTURE_SUFFIXES
from ..rigs.sources import pictures_in, refuse_unknown_kinds
from .camera_paths import paths_of_cameras


def pictures_per_camera(folder: Path, names: Collection[str], needed: Collection[str] = ()) -> dict[str, Path]:
    """The picture of each camera that has one: ``cam00.png``, or the only one in ``cam00/``. Raises RigError."""
    return {name: _only_picture(path) for name, path in paths_of_cameras(folder, names, needed).items()}


def _only_picture(path: Path) -> Path:
    if not path.is_dir():
        if path.suffix.lower() not in PICTURE_SUFFIXES:
            raise RigError(f"{path}: is no picture; give one per camera, as {PICTURE_KINDS}")
        return path
    pictures = pictures_in(path)
    if not pictures:
        refuse_unknown_kinds([path])
    if len(pictures) != 1:
        raise RigError(f"{path}: holds {len(pictures)} pictures; give one that holds for all frames of the camera")
    return pictures[0]
