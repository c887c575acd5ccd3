"""Names in either form of Unicode are the same, whichever the files have and whichever a calibration states."""

from __future__ import annotations

import json
import unicodedata
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import pytest

import rig_layouts as layouts
from decogs.encoder.commands import encode_parser
from decogs.formats.cameras import Camera
from decogs.formats.errors import RigError
from decogs.formats.files.unicode_forms import as_it_lies
from decogs.formats.mattes import matte_rig, pictures_per_camera
from decogs.formats.rigs import open_rig
from decogs.rig.calibration.commands import calibrate_parser
from decogs.rig.calibration.footage import open_footage
from decogs.rig.calibration.given import given_lenses
from decogs.rig.synchronisation.sync_file import read_starts

Form = Literal["NFC", "NFD"]
OTHER: dict[Form, Form] = {"NFC": "NFD", "NFD": "NFC"}
NAMES = ("für", "l'été", "ナガヤ")


def in_form(form: Form) -> list[str]:
    return [unicodedata.normalize(form, name) for name in NAMES]


def rename_all(folder: Path, form: Form) -> None:
    """As a file server or an archive would."""
    for entry in sorted(folder.rglob("*"), key=lambda entry: -len(entry.parts)):
        entry.rename(entry.with_name(unicodedata.normalize(form, entry.name)))


def write_rig_json(folder: Path, rig: Sequence[Camera]) -> None:
    records = []
    for camera in rig:
        layouts.write_video(folder / camera.name / f"{camera.name}.mp4", layouts.SIZE)
        lens = {"fx": camera.fx, "fy": camera.fy, "cx": camera.cx, "cy": camera.cy, "distortion_model": "none"}
        size = {"width": camera.width, "height": camera.height}
        pose = {"world_to_camera": camera.world_to_camera.tolist()}
        records.append({"name": camera.name, "file": f"{camera.name}/{camera.name}.mp4", **size, **lens, **pose})
    (folder / "rig.json").write_text(json.dumps({"cameras": records}, ensure_ascii=False), encoding="utf-8")


def write_colmap(folder: Path, rig: Sequence[Camera]) -> None:
    """Videos in a folder with an accent."""
    place = rig[0].name
    layouts.write_model(folder / "sparse/0", [(f"{place}/{camera.name}.png", camera) for camera in rig])
    for camera in rig:
        layouts.write_video(folder / place / f"{camera.name}.mp4", layouts.SIZE)


@pytest.mark.parametrize("form", ["NFC", "NFD"])
@pytest.mark.parametrize(
    "write",
    [
        write_rig_json,
        write_colmap,
        layouts.write_aniposelib,
        layouts.write_qualisys,
        layouts.write_immersive,
        layouts.write_splits,
        layouts.write_actors_hq,
        layouts.write_colmap4d,
        layouts.write_frame_folders,
    ],
)
def test_every_layout_finds_its_frames(tmp_path: Path, write: Callable[..., None], form: Form) -> None:
    lens = "fisheye" if write is layouts.write_immersive else "opencv"
    write(tmp_path, layouts.cameras(lens, in_form(OTHER[form])))
    rename_all(tmp_path, form)
    rig = open_rig(tmp_path)
    assert sorted(camera.name for camera in rig.cameras) == sorted(in_form("NFC"))
    assert rig.frame_count == layouts.FRAMES


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_what_lies_beside_a_rig_belongs_to_its_cameras(tmp_path: Path, form: Form) -> None:
    (tmp_path / "rig").mkdir()
    write_rig_json(tmp_path / "rig", layouts.cameras("none", in_form(OTHER[form])))
    rename_all(tmp_path / "rig", form)
    rig = open_rig(tmp_path / "rig")
    for name in in_form(form):
        (tmp_path / "masks" / name).mkdir(parents=True)
        for k in range(layouts.FRAMES):
            cv2.imwrite(str(tmp_path / "masks" / name / f"{k}.png"), np.full(layouts.SIZE[::-1], 200, np.uint8))
        (tmp_path / "plates").mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / "plates" / f"{name}.png"), np.zeros(layouts.SIZE[::-1], np.uint8))
    names = [camera.name for camera in rig.cameras]
    assert [camera.name for camera in matte_rig(tmp_path / "masks", rig, names, range(1)).cameras] == names
    assert sorted(pictures_per_camera(tmp_path / "plates", names)) == sorted(names)
    starts = [{"name": name, "offset": k} for k, name in enumerate(in_form(form))]
    (tmp_path / "sync.json").write_text(json.dumps({"cameras": starts}), encoding="utf-8")
    assert sorted(read_starts(tmp_path / "sync.json", rig)) == sorted(names)


@pytest.mark.parametrize("form", ["NFC", "NFD"])
def test_videos_without_poses_are_named_as_their_lenses(tmp_path: Path, form: Form) -> None:
    (tmp_path / "rig").mkdir()
    write_rig_json(tmp_path / "rig", layouts.cameras("none", in_form(OTHER[form])))
    for name in in_form(form):
        layouts.write_video(tmp_path / "videos" / f"{name}.mp4", layouts.SIZE)
    footage = open_footage(tmp_path / "videos")
    assert sorted(camera.name for camera in footage) == sorted(in_form("NFC"))
    assert len(given_lenses(tmp_path / "rig", footage).lenses) == 3


def test_a_path_is_found_as_it_lies(tmp_path: Path) -> None:
    composed, taken_apart = (tmp_path / in_form(form)[0] / in_form(form)[1] for form in ("NFC", "NFD"))  # type: ignore[index]
    assert as_it_lies(composed) == composed, "nothing there"
    taken_apart.mkdir(parents=True)
    assert as_it_lies(composed) == taken_apart
    assert as_it_lies(composed / "new.png") == taken_apart / "new.png"
    composed.mkdir(parents=True)
    assert as_it_lies(composed) == composed, "both there"


def test_two_cameras_of_one_name_are_refused(tmp_path: Path) -> None:
    for form in ("NFC", "NFD"):
        layouts.write_video(tmp_path / f"{in_form(form)[0]}.mp4", layouts.SIZE)  # type: ignore[arg-type]
    with pytest.raises(RigError, match="two files are called für"):
        open_footage(tmp_path)


def test_options_name_cameras_in_either_form() -> None:
    composed, taken_apart = (in_form(form)[0] for form in ("NFC", "NFD"))  # type: ignore[arg-type]
    given = ["rig", "-o", "x.dgs", "--holdout", taken_apart, "--exclude", composed]
    options = encode_parser().parse_args(given)
    assert (options.holdout, options.exclude) == ([composed], [composed])
    options = calibrate_parser().parse_args(["videos", "-o", "rig", "--distance", f"{taken_apart}:b:2"])
    assert options.distance == f"{composed}:b:2"
