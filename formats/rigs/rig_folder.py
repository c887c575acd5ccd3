"""Writes a rig as a folder of its own: ``rig.json``, and links to the frames where they lie."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..cameras import Camera
from ..errors import UsageError
from ..files.outputs import check_folder_name
from . import rig_json
from .rig import Rig
from .sources import FrameSource, PictureSource, pictures_in

_MODEL = "colmap"
"""The link to the COLMAP model that has the rig's points."""


def check_new_folder(folder: Path) -> None:
    """Raises UsageError unless there is nothing that a rig written to ``folder`` would lie among."""
    if os.path.lexists(folder) and not (folder.is_dir() and not any(folder.iterdir())):
        raise UsageError(f"`output` {folder}: is already there; name a new folder")
    check_folder_name(folder)


def write_rig_folder(rig: Rig, folder: Path, starts: Mapping[str, float]) -> None:
    """Fills ``folder``, which is there and empty, with a rig.json of whole recordings and links to them.

    ``starts``: by camera, in frames; cameras without one get none. Raises OSError.
    """
    cameras = [
        _camera(camera, _link(camera.name, source, folder), starts)
        for camera, source in zip(rig.cameras, rig.sources, strict=True)
    ]
    document: dict[str, Any] = {"pixel_convention": "(0.5,0.5)", "cameras": cameras}
    facts = {"fps": rig.fps, "length_unit": rig.length_unit, "source": rig.source_text, "licence": rig.licence}
    document |= {key: value for key, value in facts.items() if value}
    models = [file.parent for file in rig.calibration if file.stem == "cameras" and rig.points is not None]
    if models:
        os.symlink(models[0].resolve(), folder / _MODEL, target_is_directory=True)
        document["colmap_model"] = _MODEL
    (folder / rig_json.CALIBRATION).write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def _camera(camera: Camera, file: str, starts: Mapping[str, float]) -> dict[str, Any]:
    start = {} if camera.name not in starts else {"start": starts[camera.name]}
    return {
        "name": camera.name,
        "file": file,
        "width": camera.width,
        "height": camera.height,
        **{key: float(getattr(camera, key)) for key in ("fx", "fy", "cx", "cy")},
        "distortion_model": camera.distortion_model,
        "distortion": [float(value) for value in camera.distortion],
        "world_to_camera": camera.world_to_camera.tolist(),
        **start,
    }


def _link(name: str, source: FrameSource, folder: Path) -> str:
    """Makes the link to a camera's frames; returns its name."""
    if not isinstance(source, PictureSource) or source.path.is_file():
        link = f"{name}{source.path.suffix}"
        os.symlink(source.path.resolve(), folder / link)
    elif pictures_in(source.path) == source.files:
        link = name
        os.symlink(source.path.resolve(), folder / link, target_is_directory=True)
    else:
        link = name
        (folder / link).mkdir()
        for index, file in enumerate(source.files):
            os.symlink(file.resolve(), folder / link / f"{index:06d}{file.suffix}")
    return link
