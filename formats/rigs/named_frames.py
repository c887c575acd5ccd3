"""Which frames belong to which camera of a calibration, by their names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

from ..errors import RigError
from ..files.unicode_forms import composed
from .sources import GENERIC_FOLDERS, holds_frames, list_folder, refuse_unknown_kinds

_CAM = "(?i:cam(?:era)?)[ _-]?"
"""What may stand before a camera's name in a file's: aniposelib's tutorial calls camera A's ``...-camA.MOV``."""


@dataclass(frozen=True)
class NamedFrames:
    """Videos and picture folders by camera, and what was left out, a line each."""

    of: dict[str, Path]
    warnings: tuple[str, ...]


def frames_of_cameras(
    calibration: Path,
    folders: Sequence[Path],
    spellings: Mapping[str, Sequence[str]],
    *,
    may_lack: bool = False,
) -> NamedFrames:
    """The frames of the cameras in ``calibration``, in the first of ``folders`` that has any.

    ``spellings``: for each camera the names that its video or folder may have. Where none of these is there, one that
    holds such a name as a word, or is a word of it, belongs to the camera: ``take1_left.mp4`` and ``take1-camleft.mp4``
    to ``left``. ``take1_cam2.mp4`` is camera 2's, though 1 is a word of it as well.
    ``may_lack``: cameras without frames are left out with a warning, as are frames without a camera. Raises RigError.
    """
    spellings = {name: [composed(one) for one in spelled] for name, spelled in spellings.items()}
    for folder in folders:
        entries = [entry for entry in list_folder(folder) if holds_frames(entry)]
        by_camera = {name: _entry(name, spelled, entries) for name, spelled in spellings.items()}
        of = {name: entry for name, entry in by_camera.items() if entry is not None}
        if of:
            break
    else:
        names = list(chain(*spellings.values()))
        beside = (entry for folder in folders for entry in list_folder(folder) if entry != calibration)
        refuse_unknown_kinds(entry for entry in beside if _fits(entry, names))
        looked_in = ", ".join(dict.fromkeys(str(folder) for folder in folders))
        name = next(iter(spellings), "")
        raise RigError(
            f"{calibration}: no video or picture folder of a camera, such as {name!r}, in {looked_in}; put the frames "
            "there, named as the cameras"
        )
    _check_one_each(of)
    lacking = [name for name in spellings if name not in of]
    if lacking and not may_lack:
        beside = (entry for entry in list_folder(folder) if entry != calibration)
        refuse_unknown_kinds(entry for entry in beside if _fits(entry, spellings[lacking[0]]))
        raise RigError(
            f"{calibration}: no video or picture folder of camera {lacking[0]!r}{_more(lacking)} in {folder}; put it "
            "back, name it as the camera, or take the camera out of the calibration"
        )
    lost = [entry for entry in entries if entry not in of.values()]
    warnings = [f"{calibration}: camera {lacking[0]}{_more(lacking)} left out, without frames"] if lacking else []
    warnings += [f"{lost[0]}{_more(lost)}: left out, without a camera in {calibration.name}"] if lost else []
    return NamedFrames(of, tuple(warnings))


def rig_folder_of(calibration: Path) -> Path:
    """The folder that a calibration is in, or around it where that one is called ``calibration``."""
    folder = calibration.parent
    return folder.parent if folder.name == "calibration" else folder


def usual_folders(folder: Path) -> list[Path]:
    """A rig's folder, and those in it that commonly hold the cameras' frames."""
    return [folder, *(entry for entry in list_folder(folder) if entry.name.lower() in GENERIC_FOLDERS)]


def _entry(camera: str, spelled: Sequence[str], entries: Sequence[Path]) -> Path | None:
    """The one entry of a camera; None without one."""
    exactly = [entry for entry in entries if _name(entry) in spelled]
    as_camera = [entry for entry in entries if any(_is_word(one, _name(entry), _CAM) for one in spelled)]
    fitting = exactly or as_camera or [entry for entry in entries if _fits(entry, spelled)]
    if len(fitting) > 1:
        raise RigError(
            f"{fitting[0]}: {fitting[1].name} may hold frames of camera {camera!r}, too; name the right one as the "
            "camera, or move the other away"
        )
    return fitting[0] if fitting else None


def _check_one_each(of: Mapping[str, Path]) -> None:
    by_entry: dict[Path, str] = {}
    for camera, entry in of.items():
        other = by_entry.setdefault(entry, camera)
        if other != camera:
            raise RigError(f"{entry}: may be of camera {other!r} or {camera!r}; name the files as the cameras")


def _fits(entry: Path, spelled: Sequence[str]) -> bool:
    return any(_is_word(one, _name(entry), f"(?:{_CAM})?") or _is_word(_name(entry), one) for one in spelled)


def _name(entry: Path) -> str:
    return composed(entry.name if entry.is_dir() else entry.stem)


def _is_word(word: str, text: str, before: str = "") -> bool:
    return bool(word) and re.search(rf"(?<![A-Za-z0-9]){before}{re.escape(word)}(?![A-Za-z0-9])", text) is not None


def _more(items: Sequence[object]) -> str:
    return f" and {len(items) - 1} more" if len(items) > 1 else ""
