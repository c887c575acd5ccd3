"""A folder for each frame: ``frame000000/images/cam00.png`` and a COLMAP model, ``frame000000/sparse/0``.

So 3DGStream and its followers have them; SpacetimeGaussians has ``colmap_0/images/cam00.png``. The first folder's model
calibrates; the last one's, if there is one, shows that no camera moved. Pixel centres and axes are COLMAP's.
Source: SJoJoK/3DGStream, test/flame_steak_suite; oppo-us-research/SpacetimeGaussians, script/pre_n3d.py.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath

from ..cameras import Camera
from ..errors import RigError
from ..files.unicode_forms import composed
from .colmap import cameras_of, find_model, model_files, read_images, read_lenses, read_points, same_pose
from .named_frames import usual_folders
from .rig import Rig, assemble_rig
from .sources import FrameSource, list_folder, open_listed, pictures_in, refuse_unknown_kinds

LAYOUT = "frame folders"
_NAME = re.compile(r"(?:frame|colmap)_?([0-9]+)")


def frame_folders(folder: Path) -> list[Path]:
    """The folders of frames, in order; none where the first has no COLMAP model."""
    named = [(entry, _NAME.fullmatch(entry.name)) for entry in list_folder(folder)]
    numbered = sorted((int(name[1]), entry) for entry, name in named if name is not None and entry.is_dir())
    folders = [entry for _, entry in numbered]
    return folders if folders and find_model(folders[0]) is not None else []


def read_frame_folders(folder: Path) -> Rig:
    """The rig whose frames are the folders in ``folder``. Raises RigError."""
    folders = frame_folders(folder)
    cameras = _cameras(folders[0])
    _check_still(cameras, folders[-1])
    pictures = [_pictures(frame) for frame in folders]
    pairs = [(camera, _source(name, folders, pictures)) for name, camera in cameras.items()]
    model = _model(folders[0])
    return assemble_rig(folder, LAYOUT, pairs, model_files(model), resizable=True, points=read_points(model))


def _model(folder: Path) -> Path:
    model = find_model(folder)
    if model is None:
        raise RigError(f"{folder}: no COLMAP model in sparse/0; put it back")
    return model


def _cameras(folder: Path) -> dict[str, Camera]:
    model = _model(folder)
    images = read_images(model)
    return cameras_of(model, read_lenses(model), images, {one.name: PurePosixPath(one.name).stem for one in images})


def _check_still(cameras: dict[str, Camera], folder: Path) -> None:
    """Poses of the last folder's model, where it has one, are the first one's."""
    if find_model(folder) is None:
        return
    last = _cameras(folder)
    for name, camera in cameras.items():
        if name not in last:
            raise RigError(f"{folder}: its model has no camera {name}, which the first folder's has; calibrate once")
        if not same_pose(camera, last[name]):
            raise RigError(
                f"{folder}: camera {name} stands somewhere else than in the first frame; a rig needs fixed cameras, "
                "calibrated once for all frames"
            )


def _pictures(folder: Path) -> dict[str, Path]:
    """The pictures of one frame by camera."""
    itself, *inside = usual_folders(folder)
    per_folder = (pictures_in(searched) for searched in (*inside, itself))
    return {composed(path.stem): path for path in next(filter(None, per_folder), ())}


def _source(name: str, folders: list[Path], pictures: list[dict[str, Path]]) -> FrameSource:
    lacking = next((frame for frame, by_camera in zip(folders, pictures, strict=True) if name not in by_camera), None)
    if lacking is not None:
        beside = (entry for searched in usual_folders(lacking) for entry in list_folder(searched))
        refuse_unknown_kinds(entry for entry in beside if composed(entry.stem) == name)
        raise RigError(f"{lacking}: no picture of camera {name}; give all frames the same cameras")
    files = [by_camera[name] for by_camera in pictures]
    return open_listed(files[0], files)
