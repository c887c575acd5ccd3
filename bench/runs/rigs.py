"""A rig of a report: the name that its results are kept by, and the cameras to measure on."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

from decogs.formats.errors import UsageError
from decogs.formats.rigs import Rig
from decogs.rig.pictures.ingest import check_held_out


def result_name(rig: Rig) -> str:
    """The name that a rig's results are kept by: its folder's, as part of file names."""
    return re.sub(r"[^\w.-]+", "_", rig.path.resolve().name) or "rig"


def check_names(rigs: Sequence[Rig]) -> None:
    """Raises UsageError when two rigs' results would be kept by one name."""
    seen: dict[str, Rig] = {}
    for rig in rigs:
        name = result_name(rig)
        if name in seen:
            raise UsageError(f"{rig.path}: {seen[name].path} has the same name; give each its own report")
        seen[name] = rig


def held_out_cameras(rig: Rig, chosen: Sequence[str]) -> tuple[str, ...]:
    """The cameras to measure on: those asked for, or the rig's own, or cam00."""
    names = [camera.name for camera in rig.cameras]
    if chosen:
        check_held_out(rig, chosen)
        return tuple(dict.fromkeys(chosen))
    for name in (_own_held_out(rig.path / "rig.json"), "cam00"):
        if name in names:
            return (str(name),)
    raise UsageError(f"{rig.path}: names no camera to hold out and has no cam00; choose one with `holdout` CAM")


def _own_held_out(calibration: Path) -> str | None:
    """``held_out_camera`` of a rig.json, which the rig reader leaves alone: it matters to measuring only."""
    try:
        value = json.loads(calibration.read_text("utf-8")).get("held_out_camera")
    except (OSError, ValueError, AttributeError):
        return None
    return value if isinstance(value, str) else None
