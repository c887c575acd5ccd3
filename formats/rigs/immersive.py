"""Google's Immersive light field videos: ``models.json`` and ``camera_0001.mp4`` ...

A list of cameras with ``name``, ``position`` (the centre), ``orientation`` (Rodrigues, world-to-camera),
``focal_length``, ``pixel_aspect_ratio``, ``principal_point``, ``radial_distortion``, ``width`` and ``height``.
``projection_type`` "fisheye" is OpenCV's with k1 and k2; "perspective" has k1 k2 k3. Pixel centres are at .5, as in the
same house's camera class (google/nerfies, camera.py, get_pixel_centers). Cameras without a model are left out.
Source: augmentedperception/deepview_video_dataset, README.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..cameras import Camera, DistortionModel
from .calibration import calibrated_camera, invert_pose, vector_pose
from .fields import Fields, read_json_list
from .named_frames import frames_of_cameras
from .rig import Rig, assemble_rig
from .sources import open_source

LAYOUT = "immersive"
CALIBRATION = "models.json"


def read_immersive(calibration: Path) -> Rig:
    """The rig in the folder of a models.json. Raises RigError."""
    folder = calibration.parent
    records = {record.label("name"): record for record in read_json_list(calibration, "cameras")}
    frames = frames_of_cameras(calibration, [folder], {name: (name,) for name in records}, may_lack=True)
    pairs = [(_camera(name, records[name]), open_source(path)) for name, path in frames.of.items()]
    rig = assemble_rig(folder, LAYOUT, pairs, [calibration], resizable=True)
    return replace(rig, warnings=(*rig.warnings, *frames.warnings))


def _camera(name: str, record: Fields) -> Camera:
    where = f"{record.where} ({name})"
    turned = vector_pose(record.array("orientation", (3,)), (0.0, 0.0, 0.0), where)
    pose = invert_pose(turned)
    pose[:3, 3] = record.array("position", (3,))
    focal = record.number("focal_length")
    intrinsics = (focal, focal * record.number("pixel_aspect_ratio", 1.0), *record.array("principal_point", (2,)))
    model, distortion = _lens(record)
    size = (record.integer("width"), record.integer("height"))
    return calibrated_camera(name, size, intrinsics, invert_pose(pose), model, distortion, where)


def _lens(record: Fields) -> tuple[DistortionModel, tuple[float, ...]]:
    k1, k2, k3 = record.array("radial_distortion", (3,))
    kind = record.label("projection_type", "perspective")
    if kind == "fisheye" and not k3:
        return "fisheye", (k1, k2, 0.0, 0.0)
    if kind == "perspective":
        return "opencv", (k1, k2, 0.0, 0.0, k3)
    raise record.wrong("projection_type", f"is {kind!r}, which is read as 'fisheye' with k1 k2, or 'perspective'")
