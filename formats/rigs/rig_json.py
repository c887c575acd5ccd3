"""The plain ``rig.json`` layout: one file that lists every camera with its frames, intrinsics, distortion and pose.

docs/rig.md has every field. In this file the centre of the top left pixel is (0, 0) unless pixel_convention says
(0.5, 0.5).
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import cast

from ..cameras import Camera, DistortionModel
from ..errors import RigError
from ..videos.readouts import MAX_READOUT
from .calibration import calibrated_camera, rigid_pose
from .colmap import has_model, model_files, read_points
from .fields import Fields, read_json
from .rig import Rig, assemble_rig
from .sources import open_source, other_endings
from .steps import MAX_START
from .timeline import RigTime, Timeline

LAYOUT = "rig.json"
CALIBRATION = "rig.json"
_COEFFICIENTS = {"none": {0}, "opencv": {0, 4, 5, 8}, "fisheye": {4}}


def read_rig_json(folder: Path) -> Rig:
    """The rig described by ``folder``/rig.json. Raises RigError."""
    path = folder / CALIBRATION
    fields = read_json(path)
    shift = _pixel_shift(fields)
    pairs, starts, readouts = [], dict[str, float](), dict[str, float]()
    for record in fields.records("cameras"):
        file = record.path("file", folder)
        if not os.path.exists(file):
            raise RigError(
                f"{record.where}: {file} is missing{other_endings(file)}; put it back or remove the camera from "
                f"{path.name}"
            )
        pairs.append((_camera(record, shift), open_source(file)))
        if "start" in record:
            starts[pairs[-1][0].name] = record.number("start")
        if "readout" in record or "readout_from" in record:
            readouts[pairs[-1][0].name] = _readout(record)
    model = fields.path("colmap_model", folder, "sparse/0")
    if "colmap_model" in fields and not has_model(model):
        raise fields.wrong("colmap_model", f"names {model}, where no COLMAP model lies")
    rig = assemble_rig(
        folder,
        LAYOUT,
        pairs,
        [path, *model_files(model)],
        resizable=False,
        fps=fields.rate("fps") if "fps" in fields else None,
        points=read_points(model) if has_model(model) else None,
        source_text=fields.text("source", ""),
        licence=fields.text("licence", ""),
        length_unit=fields.text("length_unit", ""),
    )
    if "frame_count" in fields and fields.integer("frame_count") != rig.frame_count:
        raise fields.wrong(
            "frame_count", f"is {fields.integer('frame_count')}, but the cameras have {rig.frame_count} frames"
        )
    if any(readouts.values()) and rig.timeline.rate is None:
        raise fields.wrong("readout", "is in seconds, but no frame rate is known; state 'fps'")
    return replace(
        rig,
        starts=_on_the_rigs_clock(fields, starts, rig.timeline),
        timeline=rig.timeline.with_readouts(readouts) if rig.timeline.rate else rig.timeline,
    )


def _readout(record: Fields) -> float:
    """Seconds from the exposure of the picture's first row to that of its last, below 0 where it is read from below."""
    seconds, start = record.number("readout"), record.text("readout_from", "top")
    if not 0 <= seconds <= MAX_READOUT:
        raise record.wrong("readout", f"is {seconds:g} s, not between 0 and {MAX_READOUT:g}")
    if start not in ("top", "bottom"):
        raise record.wrong("readout_from", f"is {start!r}, neither 'top' nor 'bottom'")
    return seconds if start == "top" else -seconds


def _on_the_rigs_clock(fields: Fields, starts: dict[str, float], timeline: Timeline) -> dict[str, RigTime]:
    """The starts, whatever their unit in the file."""
    unit = fields.text("start_unit", "frames")
    if unit not in ("frames", "seconds"):
        raise fields.wrong("start_unit", f"is {unit!r}, neither 'frames' nor 'seconds'")
    if unit == "seconds" and timeline.rate is None:
        raise fields.wrong("start_unit", "is 'seconds', but no frame rate is known; state 'fps'")
    frames = {name: RigTime(start) if unit == "frames" else timeline.time_of(start) for name, start in starts.items()}
    for name, start in frames.items():
        if abs(start) > MAX_START:
            raise fields.wrong("start", f"of {name} is {start:g} frames away, which no recording is")
    return frames


def _pixel_shift(fields: Fields) -> float:
    """What to add to cx and cy to put the centre of the first pixel at (0.5, 0.5)."""
    convention = fields.text("pixel_convention", "(0,0)").replace(" ", "")
    if "(0.5,0.5)" in convention:
        return 0.0
    if "(0,0)" in convention:
        return 0.5
    raise fields.wrong("pixel_convention", "says neither (0,0) nor (0.5,0.5) for the centre of the top left pixel")


def _camera(record: Fields, shift: float) -> Camera:
    model = record.label("distortion_model", "opencv")
    distortion = record.numbers("distortion") if "distortion" in record else ()
    if model not in _COEFFICIENTS:
        raise record.wrong("distortion_model", f"is {model!r}; known are {', '.join(_COEFFICIENTS)}")
    if len(distortion) not in _COEFFICIENTS[model]:
        raise record.wrong("distortion", f"has {len(distortion)} coefficients, which {model!r} does not take")
    return calibrated_camera(
        record.label("name"),
        (record.integer("width"), record.integer("height")),
        (record.number("fx"), record.number("fy"), record.number("cx") + shift, record.number("cy") + shift),
        rigid_pose(record.matrix("world_to_camera"), f"{record.where} ({record.label('name')})"),
        cast(DistortionModel, model),
        distortion,
        record.where,
    )
