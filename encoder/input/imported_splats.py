"""Another trainer's Gaussians, a .ply or .spz, as the keyframe to begin with.

The file states its trainer's renderer: those without `comment SplatRenderMode: mip`, or .spz's flag
"antialiased", were trained without the compensation of opacity that ours has.
"""

from __future__ import annotations

import hashlib
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from decogs.codec.scene.state import DEFAULT_MAX_GAUSSIANS
from decogs.formats.errors import UsageError
from decogs.formats.files.regular_files import open_regular
from decogs.formats.splat_files import Room
from decogs.formats.splat_files.reading import READABLE, SplatFile, read_splats
from decogs.formats.stream.container import SIGNATURE


@dataclass(frozen=True)
class SplatSource:
    """A file of Gaussians and its content."""

    path: Path
    file: SplatFile

    @property
    def count(self) -> int:
        """How many Gaussians it has."""
        return len(self.file.splats)

    @property
    def document(self) -> dict[str, Any]:
        """What the stream's header says of the keyframe's origin: the file's name and what is in it."""
        content = hashlib.sha256()
        for values in vars(self.file.splats).values():
            content.update(np.ascontiguousarray(values).tobytes())
        return {"compensated": self.file.compensated, "file": self.path.name, "sha256": content.hexdigest()}


def is_splat_file(path: str | os.PathLike[str]) -> bool:
    """Whether a keyframe is a file of Gaussians, of a kind that is read or another, not a stream."""
    suffix = Path(path).suffix.lower()
    if suffix in (*READABLE, ".dgs"):
        return suffix != ".dgs"
    with suppress(OSError), open_regular(Path(path)) as file:
        return file.read(len(SIGNATURE)) != SIGNATURE
    return False


def read_splat_source(path: str | os.PathLike[str], max_memory: int | None = None) -> SplatSource:
    """The file's Gaussians; raises UsageError for what cannot be read, and for more than decoders or memory take."""
    try:
        return SplatSource(Path(path), read_splats(path, Room(DEFAULT_MAX_GAUSSIANS, max_memory)))
    except UsageError as error:
        raise UsageError(f"`keyframe` {error}") from None
