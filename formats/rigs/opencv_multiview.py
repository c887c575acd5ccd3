"""What OpenCV's multi-view calibration writes by FileStorage: YAML or XML with ``Ks``, ``rvecs`` and ``Ts``.

Its sample stacks the cameras: ``cam_ids`` ("left,right"), ``image_sizes`` (width, height), ``Ks``, ``distortions``,
``is_fisheye``, and ``rvecs`` and ``Ts`` from the first camera's axes to each one's: world-to-camera in OpenCV axes, the
centre of the first pixel at (0, 0). Source: opencv/opencv, samples/python/multiview_calibration.py (saveToFile).
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera
from .calibration import opencv_camera, vector_pose
from .file_storage import FileStorage
from .named_frames import frames_of_cameras, usual_folders
from .rig import Rig, assemble_rig
from .sources import open_source

LAYOUT = "opencv"
CALIBRATIONS = ("*[Cc]alib*.yml", "*[Cc]alib*.yaml", "*[Cc]alib*.xml")


def read_opencv_multiview(calibration: Path) -> Rig:
    """The rig in the folder of such a file. Raises RigError."""
    file = FileStorage(calibration)
    names = [name.strip() for name in file.text("cam_ids").split(",")]
    frames = frames_of_cameras(calibration, usual_folders(calibration.parent), {name: (name,) for name in names})
    cameras = dict(zip(names, _cameras(file, names), strict=True))
    pairs = [(cameras[name], open_source(path)) for name, path in frames.of.items()]
    rig = assemble_rig(calibration.parent, LAYOUT, pairs, [calibration], resizable=True)
    return replace(rig, warnings=(*rig.warnings, *frames.warnings))


def _cameras(file: FileStorage, names: list[str]) -> list[Camera]:
    count = len(names)

    def rows(key: str, *sizes: int) -> NDArray[np.float64]:
        return file.matrix(key, *(count * size for size in sizes)).reshape(count, -1)

    sizes, matrices, lenses = rows("image_sizes", 2), rows("Ks", 9), rows("distortions", 4, 5, 8, 12, 14)
    turns, shifts = rows("rvecs", 3), rows("Ts", 3)
    is_fisheye = rows("is_fisheye", 1)[:, 0] if "is_fisheye" in file else np.zeros(count)
    return [
        opencv_camera(
            name,
            (int(sizes[i, 0]), int(sizes[i, 1])),
            matrices[i],
            lenses[i],
            vector_pose(turns[i], shifts[i], f"{file.path}, camera {name}"),
            f"{file.path}, camera {name}",
            is_fisheye=bool(is_fisheye[i]),
        )
        for i, name in enumerate(names)
    ]
