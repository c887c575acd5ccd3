"""A calibration as files: rig.json, which every command reads, calibration.json and a page."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from decogs.formats.cameras import Camera
from decogs.formats.errors import RigError
from decogs.formats.files.outputs import Output, check_folder_name, check_outputs
from decogs.formats.rigs.fields import read_json

from .placed import Calibration, Placed

CALIBRATION, _RIG = "calibration.json", "rig.json"
PAGE = "report.html"


def check_folder(folder: Path, intrinsics: str | None, *, lenses_only: bool) -> None:
    """Raises RigError where files lie that an earlier calibration of this kind did not write.

    Raises UsageError where it did, and its lenses are the ones that are to be read.
    """
    check_folder_name(folder)
    files = [folder / name for name in (_RIG, CALIBRATION, PAGE)]
    existing = [file for file in files if file.exists()]
    if existing and not _is_own(folder, lenses_only):
        raise RigError(f"{existing[0]}: is not of an earlier decogs-calibrate like this one; name another folder")
    if intrinsics is not None:
        read = Path(intrinsics)
        check_outputs(
            [Output("output", file) for file in files],
            [(file, "the lenses are read from it") for file in (read, read / _RIG, read / CALIBRATION)],
        )


def _is_own(folder: Path, lenses_only: bool) -> bool:
    """Whether a folder holds what `write_lenses`, or else `write_rig`, wrote."""
    file = folder / CALIBRATION
    if not file.exists() or (folder / _RIG).exists() == lenses_only:
        return False
    document = read_json(file)
    cameras = document.records("cameras") if "cameras" in document else []
    has_errors = bool(cameras) and all("reprojection_error" in camera for camera in cameras)
    return has_errors and ("way" in document) != lenses_only


def write_rig(calibration: Calibration, folder: Path, staging: Path, page: str) -> None:
    """Writes rig.json, with paths relative to ``folder``, calibration.json and the page into ``staging``."""
    document = {
        "pixel_convention": "(0,0)",
        "cameras": [_camera(one.camera) | _pose_fields(one) for one in calibration.placed],
        "not_connected": list(calibration.not_connected),
        "way": calibration.way,
    }
    _write(staging, {_RIG: _text(_rig(calibration, folder)), CALIBRATION: _text(document), PAGE: page})


def write_lenses(cameras: Mapping[str, tuple[Camera, float]], staging: Path) -> None:
    """Writes calibration.json with lenses alone, and the error of each, px, into ``staging``."""
    records = [_camera(camera) | {"reprojection_error": error} for camera, error in cameras.values()]
    _write(staging, {CALIBRATION: _text({"pixel_convention": "(0,0)", "cameras": records})})


def _write(staging: Path, texts: Mapping[str, str]) -> None:
    for name, text in texts.items():
        (staging / name).write_text(text, encoding="utf-8")


def _text(document: Mapping[str, Any]) -> str:
    return json.dumps(document, indent=1) + "\n"


def _rig(calibration: Calibration, folder: Path) -> dict[str, Any]:
    cameras = [
        {
            "name": one.camera.name,
            "file": os.path.relpath(one.footage.source.path.resolve(), folder.resolve()),
            "width": one.camera.width,
            "height": one.camera.height,
            "fx": one.camera.fx,
            "fy": one.camera.fy,
            "cx": one.camera.cx - 0.5,
            "cy": one.camera.cy - 0.5,
            "distortion_model": one.camera.distortion_model,
            "distortion": list(one.camera.distortion),
            "world_to_camera": one.camera.world_to_camera.tolist(),
        }
        | ({} if one.footage.start is None else {"start": one.footage.start})
        for one in calibration.placed
    ]
    unit = {"length_unit": calibration.length_unit} if calibration.length_unit else {}
    return {"pixel_convention": "(0,0)", **unit, "cameras": cameras}


def _camera(camera: Camera) -> dict[str, Any]:
    return {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "focal": [camera.fx, camera.fy],
        "centre": [camera.cx - 0.5, camera.cy - 0.5],
        "distortion_model": camera.distortion_model,
        "distortion": list(camera.distortion),
    }


def _pose_fields(one: Placed) -> dict[str, Any]:
    pose = one.camera.world_to_camera
    return {
        "pose": {"rotation": pose[:3, :3].tolist(), "translation": pose[:3, 3].tolist()},
        "reprojection_error": one.error,
    }
