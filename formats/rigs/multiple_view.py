"""4DGaussians' own multi-view layout: a COLMAP model in ``sparse_`` and ``cam01/frame_00001.jpg`` ...

The model's ``image1.jpg`` is a picture of ``cam01``; all else is as in other COLMAP models.
Source: hustvl/4DGaussians, scene/multipleview_dataset.py and README ("multipleviews scenes").
"""

from __future__ import annotations

import re
from pathlib import Path

from .colmap import read_colmap_rig
from .rig import Rig

LAYOUT = "multipleview"
_IMAGE = re.compile(r"(?:.*/)?image([0-9]+)(\.[^./]*)?")


def read_multiple_view(folder: Path, model: Path) -> Rig:
    """The rig in ``folder``, calibrated by the ``model`` in its sparse_. Raises RigError."""
    return read_colmap_rig(folder, model, LAYOUT, _camera_image)


def _camera_image(name: str) -> str:
    match = _IMAGE.fullmatch(name)
    return f"cam{int(match[1]):02d}{match[2] or ''}" if match else name
