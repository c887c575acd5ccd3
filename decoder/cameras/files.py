"""Files of cameras, and who reads them: a pose file, a nerfstudio camera path, a USD camera.

``FILE.usdc:NAME`` names a camera of a USD file that has several.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..limits import DEFAULT_MAX_MEMORY
from .fields import parsed_json
from .nerfstudio import is_nerfstudio_path, nerfstudio_path
from .path import CameraPath, ToFilm
from .pose_file import pose_file_path
from .usd import usd_camera_path

JSON_READERS: tuple[tuple[Callable[[Any], bool], Callable[[Any, Path, ToFilm], CameraPath]], ...] = (
    (is_nerfstudio_path, nerfstudio_path),
    (lambda data: True, lambda data, path, film: pose_file_path(data, path)),
)
"""What knows its file by the content, and reads it; the first that does is taken."""

_USD = re.compile(r"(?P<file>.*\.usd[acz]?)(?::(?P<name>.+))?", re.IGNORECASE | re.DOTALL)


def camera_file(given: str | os.PathLike[str]) -> tuple[Path, str | None]:
    """The file, and the camera in it that is named behind a colon, if one is."""
    usd = _USD.fullmatch(os.fspath(given))
    return (Path(given), None) if usd is None else (Path(usd["file"]), usd["name"])


def read_camera_file(given: str | os.PathLike[str], film: ToFilm, max_memory: int = DEFAULT_MAX_MEMORY) -> CameraPath:
    """The cameras of a file; raises UsageError, naming the file and the place in it, for what is missing or wrong.

    Also for a file that might take more than ``max_memory`` bytes.
    """
    path, name = camera_file(given)
    if _USD.fullmatch(str(path)):
        return usd_camera_path(path, name, film, max_memory)
    data = parsed_json(path, max_memory)
    return next(read for knows, read in JSON_READERS if knows(data))(data, path, film)
