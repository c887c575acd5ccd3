"""Which recordings a stream is of, so that none is resumed with other footage.

The header's settings have a digest of each training camera's first picture as it is decoded. Videos that are packed
anew, moved or renamed stay the same recordings; scale, lenses and held-out cameras play no part. A decoder of videos
whose pictures differ by a level makes them other pictures, and the encode's bytes others.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from decogs.codec.header.header import StreamHeader
from decogs.formats.pictures.reading import Picture
from decogs.formats.rigs import Rig, files_with

_RECORDED_SETTING, _PICTURES_SETTING = "recorded", "pictures"
_DIGEST_DIGITS = 8


def digest_of(picture: Picture) -> str:
    """A picture's digest, hexadecimal; equal for equal pictures, and by accident for one of 2^32 others."""
    content = hashlib.sha256(f"{picture.dtype} {picture.shape}".encode())
    content.update(np.ascontiguousarray(picture).data)
    return content.hexdigest()[:_DIGEST_DIGITS]


def setting_of(recorded: Mapping[str, str], cameras: Sequence[str]) -> dict[str, Any]:
    """The header's setting for the first pictures: digests in the order of ``cameras``; none without digests."""
    return (
        {_RECORDED_SETTING: {_PICTURES_SETTING: [recorded[name] for name in cameras if name in recorded]}}
        if recorded
        else {}
    )


def recorded_in(header: StreamHeader) -> dict[str, str]:
    """The digests of the first frame's pictures by camera; none for a stream without."""
    group = header.settings.get(_RECORDED_SETTING)
    texts = group.get(_PICTURES_SETTING) if isinstance(group, Mapping) else None
    if not isinstance(texts, list) or not all(isinstance(text, str) for text in texts):
        return {}
    names = [camera.name for camera in header.cameras if camera.name not in header.held_out]
    return dict(zip(names, texts, strict=True)) if len(names) == len(texts) else {}


def difference(header: StreamHeader, recorded: Mapping[str, str]) -> str:
    """Whose first pictures differ from the stream's, in words; empty if none do, or the stream has no digests."""
    names = [name for name, was in recorded_in(header).items() if was != recorded.get(name, was)]
    more = f" and {len(names) - 1} more cameras" if len(names) > 1 else ""
    return f"other pictures: frame {header.first_frame} of {names[0]}{more} differs" if names else ""


def is_current(path: Path, rig: Rig, frames: range) -> bool:
    """Whether no recording of these frames was written after the file ``path``, as make decides it."""
    made = path.stat().st_mtime_ns
    return all(file.stat().st_mtime_ns <= made for file in files_with(rig, frames))
