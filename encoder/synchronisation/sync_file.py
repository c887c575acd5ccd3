"""``sync.json``: the starts of a rig's cameras."""

from __future__ import annotations

import json
import math
from pathlib import Path

from decogs.formats.errors import RigError
from decogs.formats.rigs import Rig
from decogs.formats.rigs.fields import Fields, read_json
from decogs.formats.rigs.steps import MAX_START, common_rate

from .starts import Synchrony

NAME = "sync.json"


def sync_document(found: Synchrony) -> str:
    """The file's text."""
    cameras = [
        {"name": each.name, "offset": each.offset, "confidence": each.confidence, "method": each.method}
        for each in found.cameras
    ]
    return json.dumps({"fps": found.fps, "cameras": cameras}, indent=1) + "\n"


def read_starts(path: Path, rig: Rig) -> dict[str, float]:
    """The starts that a file states of a rig's cameras, in frames of the rig's rate. Raises RigError."""
    fields = read_json(path)
    rate = common_rate(rig)
    scale = 1.0
    if "fps" in fields and rate is not None:
        fps = fields.number("fps")
        if not (math.isfinite(fps) and fps > 0):
            raise fields.wrong("fps", f"is {fps:g}, not a frame rate")
        scale = rate / fps
    names, starts = {camera.name for camera in rig.cameras}, dict[str, float]()
    seen = set[str]()
    for record in fields.records("cameras"):
        name = record.label("name")
        if name not in names:
            raise RigError(f"{record.where}: {rig.path} has no camera {name!r}; correct the file, or name another")
        if name in seen:
            raise record.wrong("name", f"is {name!r} for the second time")
        seen.add(name)
        if "offset" in record:
            starts[name] = _offset(record) * scale
    return starts


def _offset(record: Fields) -> float:
    offset = record.number("offset")
    if abs(offset) > MAX_START:
        raise record.wrong("offset", f"is {offset:g} frames, which no recording is away")
    return offset
