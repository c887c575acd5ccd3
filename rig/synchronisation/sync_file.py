"""``sync.json``: the starts of a rig's cameras."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path

from decogs.formats.errors import RigError
from decogs.formats.frames.rates import exact_rate
from decogs.formats.rigs import Rig
from decogs.formats.rigs.fields import Fields, read_json
from decogs.formats.rigs.steps import MAX_START
from decogs.formats.rigs.timeline import RigTime

from .starts import Synchrony

NAME = "sync.json"


def sync_document(synchrony: Synchrony) -> str:
    """The file's text."""
    cameras = [
        {"name": each.name, "offset": each.offset, "confidence": each.confidence, "method": each.method}
        for each in synchrony.cameras
    ]
    return json.dumps({"fps": synchrony.fps, "cameras": cameras}, indent=1) + "\n"


def read_starts(path: Path, rig: Rig) -> dict[str, RigTime]:
    """The starts that a file states of a rig's cameras, in frames of the rate that it states. Raises RigError."""
    fields = read_json(path)
    has_rate = "fps" in fields and rig.timeline.rate is not None
    second = exact_rate(fields.rate("fps")) if has_rate else None
    names, starts = {camera.name for camera in rig.cameras}, dict[str, RigTime]()
    seen = set[str]()
    for record in fields.records("cameras"):
        name = record.label("name")
        if name not in names:
            raise RigError(f"{record.where}: {rig.path} has no camera {name!r}; correct the file, or name another")
        if name in seen:
            raise record.wrong("name", f"is {name!r} for the second time")
        seen.add(name)
        if "offset" in record:
            offset = Fraction(_offset(record))
            starts[name] = RigTime(float(offset)) if second is None else rig.timeline.time_of(offset / second)
    return starts


def _offset(record: Fields) -> float:
    offset = record.number("offset")
    if abs(offset) > MAX_START:
        raise record.wrong("offset", f"is {offset:g} frames, which no recording is away")
    return offset
