"""Which layout a rig has.

Which layout a folder has is decided by the calibration in it; exactly one of these may be there:

==================== ==========================================================================
``rig.json``         rig.json; a COLMAP model beside it only gives its points
``transforms.json``  nerfstudio
``poses_bounds.npy`` MeetRoom if the cameras are named ``cam_N``, N3DV if ``camNN``
COLMAP model         in ``sparse/0`` (or the next number that has one), ``sparse`` or the folder itself:
                     MeetRoom if the cameras are named ``cam_N``, colmap4d if its images have times, else COLMAP;
                     in ``sparse_``: 4DGaussians
==================== ==========================================================================

Where none of these is there, exactly one of those in ``OTHERS`` may be, which data sets and other programs have. Where
several are, the path of the calibration itself (``rig/poses_bounds.npy``, ``rig/sparse/0``) says which to use.
No other file, such as ground truth lying beside the frames, is opened.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import partial
from pathlib import Path, PurePosixPath

from ..errors import RigError
from . import (
    actors_hq,
    camera_tables,
    colmap,
    colmap4d,
    dna_rendering,
    easyvolcap,
    frame_folders,
    immersive,
    meetroom,
    multiple_view,
    n3dv,
    nerfstudio,
    opencv_multiview,
    panoptic,
    qualisys,
    rig_json,
    technicolor,
)
from .pickles import refuse_pickles
from .rig import Rig
from .sources import holds_frames, list_folder, natural_key

Reader = Callable[[], Rig]
"""Reads a rig whose calibration is known."""

_NAMED = 8
"""Entries of a folder that a message names."""


@dataclass(frozen=True)
class _Layout:
    """A calibration and its reader: the names of its files in a rig's folder, and others that count if given."""

    read: Callable[[Path], Rig]
    patterns: tuple[str, ...]
    if_given: tuple[str, ...] = ()

    def files_in(self, folder: Path) -> list[Path]:
        """The calibrations of this kind in a folder, in natural order."""
        files = {file for pattern in self.patterns for file in folder.glob(pattern) if file.is_file()}
        return sorted((file for file in files if file.name[0] != "."), key=lambda file: natural_key(str(file)))


_FIRST = (
    _Layout(lambda path: rig_json.read_rig_json(path.parent), (rig_json.CALIBRATION,)),
    _Layout(lambda path: nerfstudio.read_nerfstudio(path.parent), (nerfstudio.CALIBRATION,)),
    _Layout(lambda path: _read_poses_bounds(path.parent), (n3dv.CALIBRATION,)),
)
OTHERS = (
    _Layout(easyvolcap.read_easyvolcap, (easyvolcap.CALIBRATION,), ("extri.yml",)),
    _Layout(lambda path: nerfstudio.read_splits(path.parent), (nerfstudio.SPLITS_CALIBRATION,)),
    _Layout(camera_tables.read_camera_tables, camera_tables.CALIBRATIONS, ("*.toml",)),
    _Layout(qualisys.read_qualisys, qualisys.CALIBRATIONS),
    _Layout(immersive.read_immersive, (immersive.CALIBRATION,)),
    _Layout(technicolor.read_technicolor, (technicolor.CALIBRATION,)),
    _Layout(panoptic.read_panoptic, panoptic.CALIBRATIONS),
    _Layout(actors_hq.read_actors_hq, (actors_hq.CALIBRATION,)),
    _Layout(dna_rendering.read_dna_rendering, dna_rendering.CALIBRATIONS),
    _Layout(opencv_multiview.read_opencv_multiview, opencv_multiview.CALIBRATIONS, ("*.yml", "*.yaml", "*.xml")),
)


def reader_at(path: Path) -> Reader:
    """Reads the rig in a folder, or whose calibration file or COLMAP model folder this is. Raises RigError."""
    readers = _calibrations_at(path)
    if not readers:
        refuse_pickles(list_folder(path))
        raise RigError(
            f"{path}: no calibration; looked for {_looked_for()}, but {_contents(path)}: calibrate the cameras, "
            f"with decogs-calibrate {path} -o RIG_DIR or with COLMAP"
        )
    if len(readers) > 1:
        names = list(readers)
        raise RigError(
            f"{path}: several calibrations ({', '.join(names)}); give the path of the one to use, "
            f"e.g. {path / names[0]}, or move the others away"
        )
    (read,) = readers.values()
    return read


def calibration_files(folder: Path) -> Iterator[Path]:
    """The files of every calibration of a known kind in a folder, whichever of them is read."""
    for layout in (*_FIRST, *OTHERS):
        yield from layout.files_in(folder)
    model = colmap.find_model(folder)
    if model is not None:
        yield from colmap.model_files(model)


def _calibrations_at(path: Path) -> dict[str, Reader]:
    """Readers that fit, by what they were recognised by."""
    if path.is_file():
        return _calibration_file(path)
    if not path.is_dir():
        raise RigError(f"{path}: neither a folder nor a calibration file; give the rig's folder")
    readers = _readers_of(_FIRST, path)
    model = colmap.find_model(path)
    if model is not None and rig_json.CALIBRATION not in readers:
        readers[str(model.relative_to(path))] = partial(_read_colmap, colmap.rig_folder_of(model), model)
    if not readers:
        readers = _readers_of(OTHERS, path)
        if frame_folders.frame_folders(path):
            readers["a folder for each frame"] = partial(frame_folders.read_frame_folders, path)
    return readers


def _readers_of(layouts: Sequence[_Layout], folder: Path) -> dict[str, Reader]:
    files = ((layout, file) for layout in layouts for file in layout.files_in(folder))
    return {str(file.relative_to(folder)): partial(layout.read, file) for layout, file in files}


def _looked_for() -> str:
    patterns = (pattern.replace("[Cc]", "c") for layout in (*_FIRST, *OTHERS) for pattern in layout.patterns)
    names = [pattern for pattern in patterns if "/" not in pattern]
    model = "a COLMAP model in sparse/0 (cameras.bin or cameras.txt) or in a folder for each frame"
    return f"{', '.join(dict.fromkeys(names))} and {model}"


def _contents(folder: Path) -> str:
    """What lies in a folder, in a few words; what holds no frames first, since a calibration may be among it."""
    entries = sorted(list_folder(folder), key=holds_frames)
    if not entries:
        return "it is empty"
    names = [entry.name + "/" * entry.is_dir() for entry in entries[:_NAMED]]
    names = [name if name.isprintable() else ascii(name) for name in names]
    more = f" and {len(entries) - _NAMED} more" if len(entries) > _NAMED else ""
    return f"there are {', '.join(names)}{more}"


def _calibration_file(path: Path) -> dict[str, Reader]:
    if path.name in ("cameras.bin", "cameras.txt"):
        return {path.name: partial(_read_colmap, colmap.rig_folder_of(path.parent), path.parent)}
    for layout in (*_FIRST, *OTHERS):
        if any(fnmatch(path.name, PurePosixPath(pattern).name) for pattern in (*layout.patterns, *layout.if_given)):
            return {path.name: partial(layout.read, path)}
    refuse_pickles([path])
    raise RigError(f"{path}: not a calibration that can be read; give the rig's folder")


def _read_poses_bounds(folder: Path) -> Rig:
    is_n3dv = bool(n3dv.camera_entries(folder, n3dv.CAMERA_NAME))
    is_meetroom = bool(n3dv.camera_entries(folder, meetroom.CAMERA_NAME))
    if is_n3dv and is_meetroom:
        raise RigError(f"{folder}: frames named both camNN and cam_N; keep the ones poses_bounds.npy belongs to")
    return meetroom.read_meetroom(folder) if is_meetroom else n3dv.read_n3dv(folder)


def _read_colmap(folder: Path, model: Path) -> Rig:
    if model.name == colmap.MULTIPLE_VIEW:
        return multiple_view.read_multiple_view(folder, model)
    if colmap4d.has_times(model):
        return colmap4d.read_colmap4d(folder, model)
    names = [entry.stem for entry in list_folder(folder) if holds_frames(entry)]
    if any(meetroom.CAMERA_NAME.fullmatch(name) for name in names):
        return meetroom.read_meetroom(folder, model)
    return colmap.read_colmap_rig(folder, model)
