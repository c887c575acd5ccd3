"""A first take file for a rig, from what its analysis finds."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from decogs.formats.errors import RigError
from decogs.formats.rigs import open_rig
from decogs.formats.system.callbacks import OnProgress
from decogs.formats.videos.reading import VIDEO_SUFFIXES

_HARMFUL = "harmful"
_OUT_OF_STEP = 0.25
"""In frames: what an encode of cameras that are late trains with as it is."""


def new_take(rig_dir: Path, folder: Path, on_step: OnProgress) -> str:
    """The text of a take file in ``folder`` for a rig, or for a folder of videos whose cameras are not placed yet.

    ``on_step`` reports the analysis. Raises RigError for a folder that is neither.
    """
    there = _text(os.path.relpath(rig_dir, folder))
    try:
        open_rig(str(rig_dir))
    except RigError:
        videos = [entry for entry in rig_dir.glob("*") if entry.suffix.lower() in VIDEO_SUFFIXES]
        if len(videos) < 2:
            raise
        return _OF_VIDEOS.format(rig=there, camera=_text(sorted(videos)[0].stem))
    from decogs.encoder.analysis.analyse import analyse

    analysis = analyse(open_rig(str(rig_dir)), on_step=on_step, shown=True)
    document = analysis.to_json()
    found = "\n".join(f"# {line}".rstrip() for line in analysis.table())
    return _OF_RIG.format(rig=there, found=found, encode=_encode(document), camera=_text(document["cameras"][0]))


def _encode(document: Mapping[str, Any]) -> str:
    """What the analysis says of an encode."""
    harmful = [name for name, check in document["checks"].items() if check["verdict"] == _HARMFUL]
    late = any(abs(check["late"] or 0) > _OUT_OF_STEP for check in document["checks"].values())
    lines = ['preset = "standard"']
    lines += [f"exclude = [{', '.join(map(_text, harmful))}]   # harmful, says the analysis"] if harmful else []
    lines += ['sync = "auto"   # cameras began at other moments'] if late else []
    if document["stage"] is not None:
        lines.append('# masks = "MATTES"   # the performer alone: mattes, or key = "green" for a clean screen')
    return "\n".join(lines)


def _text(value: str) -> str:
    return json.dumps(value, ensure_ascii=False)


_DELIVER = """\
[edit]
operations = []                  # as decogs-edit has them, such as "clean" or "trim 0:48"

[deliver.page]                   # a folder for any web server

[deliver.poster]
view = {camera}

[deliver.video]
orbit = true

[deliver.usd]
"""

_OF_RIG = (
    """\
# What decogs-analyze found:
{found}

rig = {rig}

[encode]
{encode}

"""
    + _DELIVER
)

_OF_VIDEOS = (
    """\
rig = {rig}                      # videos whose cameras are not placed yet

[calibrate]
sync = "auto"                    # videos begin at other moments

[encode]
preset = "standard"
sync = "auto"

"""
    + _DELIVER
)
