"""docs/rig.md: its example is a rig, its tables are what the readers do, and no field is left out."""

from __future__ import annotations

import json
import re
from itertools import product
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.formats.cameras import camera_centre, project
from decogs.formats.errors import RigError
from decogs.formats.rigs import colmap, detection, fields, nerfstudio, open_rig, rig_json, sources

PAGE = (Path(__file__).parents[3] / "docs" / "rig.md").read_text()
EXAMPLE = re.search(r"```json\n(.*?)```", PAGE, re.DOTALL)
NAME = r"`([^`]+)`"


def section(title: str) -> str:
    """Its text, without the example."""
    return re.sub("```.*?```", "", PAGE.partition(f"\n## {title}")[2].partition("\n## ")[0], flags=re.DOTALL)


def rows(text: str, columns: int) -> list[list[str]]:
    """The rows of the tables that have so many columns, without their heads."""
    lines = [line.strip("|").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    tables = [[cell.strip(" |") for cell in line] for line in lines if len(line) == columns]
    return [line for line in tables if "`" in line[0]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory, make: Any) -> Path:
    """The frames that the page's rig.json names."""
    assert EXAMPLE is not None
    folder, values = tmp_path_factory.mktemp("rig"), json.loads(EXAMPLE[1])
    for camera in values["cameras"]:
        path, size = folder / camera["file"], (camera["width"], camera["height"])
        if path.suffix == ".mp4":
            make.video(path, frames=values["frame_count"], size=size, fps=values["fps"])
        else:
            make.pictures(path, frames=values["frame_count"], size=size)
    return folder


@pytest.fixture
def example(folder: Path) -> dict[str, Any]:
    """The page's rig.json, put into ``folder``."""
    assert EXAMPLE is not None
    (folder / "rig.json").write_text(EXAMPLE[1])
    values: dict[str, Any] = json.loads(EXAMPLE[1])
    return values


def test_the_example_is_the_rig_that_the_page_describes(folder: Path, example: dict[str, Any]) -> None:
    rig = open_rig(folder)
    assert [camera.name for camera in rig.cameras] == ["left", "right", "side"]
    assert (rig.layout, rig.fps, rig.frame_count) == ("rig.json", 30, example["frame_count"])
    assert (rig.length_unit, rig.source_text, rig.licence) == ("metre", example["source"], example["licence"])
    assert rig.warnings == ()
    for camera, stated in zip(rig.cameras, example["cameras"], strict=True):
        assert camera.distortion_model == stated["distortion_model"]
        assert list(camera.distortion) == stated.get("distortion", [])
        assert [camera.cx, camera.cy] == [stated["cx"], stated["cy"]]  # as decogs counts them, too
    # "`right` stands at (0.5, 0, 0) and looks ... along z. `side` stands at (3, 0, 3) and looks along -x."
    places = {"left": ([0, 0, 0], [0, 0, 1]), "right": ([0.5, 0, 0], [0, 0, 1]), "side": ([3, 0, 3], [-1, 0, 0])}
    for camera in rig.cameras:
        place, forward = places[camera.name]
        np.testing.assert_allclose(camera_centre(camera), place, atol=1e-15)
        np.testing.assert_allclose(camera.world_to_camera[2, :3], forward, atol=1e-15)


def test_axes_and_pixels_are_as_the_page_says(folder: Path, example: dict[str, Any]) -> None:
    """u = fx x / z + cx, v = fy y / z + cy of the point R X + t; half a pixel more if the first centre is (0,0)."""
    point = np.array([0.4, -0.3, 2.5])
    for convention, shift in ((example["pixel_convention"], 0.0), ("(0,0)", 0.5), (None, 0.5)):
        (folder / "rig.json").write_text(json.dumps(example | {"pixel_convention": convention}))
        for camera, stated in zip(open_rig(folder).cameras, example["cameras"], strict=True):
            pose = np.array(stated["world_to_camera"])
            x, y, z = pose[:3, :3] @ point + pose[:3, 3]
            u, v, depth = project(camera, point[None])
            expected = stated["fx"] * x / z + stated["cx"] + shift, stated["fy"] * y / z + stated["cy"] + shift, z
            np.testing.assert_allclose((u[0], v[0], depth[0]), expected, rtol=1e-12)


def test_lenses_are_as_the_page_says() -> None:
    """Its two formulas against OpenCV's functions, which decogs uses."""
    a, b, k = 0.3, -0.2, (0.1, -0.05, 0.02, 0.01, 0.03, -0.01)
    s = a * a + b * b
    radial = (1 + k[0] * s + k[1] * s**2 + k[2] * s**3) / (1 + k[3] * s + k[4] * s**2 + k[5] * s**3)
    point, none = np.array([[[a, b, 1.0]]]), np.zeros(3)
    bent = cv2.projectPoints(point, none, none, np.eye(3), np.array([k[0], k[1], 0, 0, k[2], k[3], k[4], k[5]]))[0]
    np.testing.assert_allclose(bent.ravel(), [a * radial, b * radial], rtol=1e-12)
    t = np.arctan(np.sqrt(s))
    radius = t * (1 + k[0] * t**2 + k[1] * t**4 + k[2] * t**6 + k[3] * t**8)
    bent = cv2.fisheye.projectPoints(point, none, none, np.eye(3), np.array(k[:4]))[0]
    np.testing.assert_allclose(np.linalg.norm(bent), radius, rtol=1e-12)


@pytest.mark.parametrize(
    ("reader", "title"), [(rig_json, "rig.json"), (nerfstudio, "nerfstudio")], ids=["rig.json", "transforms.json"]
)
def test_every_field_that_is_read_is_on_the_page(reader: Any, title: str) -> None:
    code = Path(reader.__file__).read_text()
    read = set(re.findall(r'(?:fields|record|values)\.(?!wrong)\w+\(\s*"(\w+)"', code))
    read |= set(re.findall(r'"(\w+)" (?:not )?in (?:fields|record)', code))
    assert len(read) > 8  # the patterns above would pass with none
    named = {name for words in re.findall(NAME, section(title)) for name in words.split()}
    assert read <= named


def test_every_member_of_a_field_list_is_on_the_page() -> None:
    named = set(re.findall(r"\w+", section("nerfstudio")))
    assert {*nerfstudio._COEFFICIENTS, nerfstudio._MASK, nerfstudio._CROP} <= named
    lenses = re.search(r"Lenses: (.*?)\. Others", section("COLMAP"), re.DOTALL)
    assert lenses is not None
    assert set(re.findall(r"\w+", lenses[1])) == set(colmap._PARAMETERS)
    folders = re.search(r"folders called (.*?) do not count", section("COLMAP"), re.DOTALL)
    assert folders is not None
    assert set(re.findall(NAME, folders[1])) == sources.GENERIC_FOLDERS


@pytest.mark.parametrize(("field", "without"), [(row[0], row[2]) for row in rows(section("rig.json"), 3)])
def test_what_is_left_out_is_as_the_table_says(folder: Path, example: dict[str, Any], field: str, without: str) -> None:
    for name in re.findall(NAME, field):
        if name in rig_json._COEFFICIENTS:  # the table of lenses
            continue
        for lacking in (True, False):  # left out, or null
            values = json.loads(json.dumps(example))
            inside = values["cameras"][1] if name in values["cameras"][1] else values
            inside[name] = None
            if lacking:
                del inside[name]
            (folder / "rig.json").write_text(json.dumps(values))
            if without == "refused":
                with pytest.raises(RigError, match=f"'{name}' is missing"):
                    open_rig(folder)
            else:
                open_rig(folder)


def test_a_colmap_model_that_is_named_has_to_be_there(folder: Path, example: dict[str, Any], make: Any) -> None:
    (folder / "rig.json").write_text(json.dumps(example | {"colmap_model": "colmap\\0"}))
    with pytest.raises(RigError, match=r"'colmap_model' names .*colmap/0, where no COLMAP model lies"):
        open_rig(folder)
    make.colmap_model(folder / "colmap/0", ["left.png"], text=True)
    points = open_rig(folder).points
    assert points is not None
    assert len(points) == len(make.points)


def test_every_calibration_of_others_is_in_the_table() -> None:
    table = section("Data sets and other programs")
    named = {name for cell in re.findall(r"^\|(.*)\|$", table, re.MULTILINE) for name in re.findall(NAME, cell)}
    looked_for = {pattern.replace("[Cc]", "c") for layout in detection.OTHERS for pattern in layout.patterns}
    assert len(looked_for) > 10
    by_ending = {pattern for pattern in looked_for if pattern.startswith("*calib*.y") or pattern.endswith(".xml")}
    in_folder = {pattern for pattern in looked_for if "/" in pattern}
    assert looked_for - by_ending - in_folder <= named
    assert {"." + pattern.rpartition(".")[2] for pattern in by_ending} <= named | {".yml"}
    assert {pattern.partition("/")[0] + "/" for pattern in in_folder} <= named


PAIRS = [
    (image, place)
    for images, places in rows(section("COLMAP"), 2)
    for image, place in product(re.findall(NAME, images), re.findall(NAME, places))
]


def test_pairs_are_found() -> None:
    assert len(PAIRS) >= 12


@pytest.mark.parametrize(("image", "place"), PAIRS)
def test_images_are_paired_as_the_table_says(tmp_path: Path, make: Any, image: str, place: str) -> None:
    path = tmp_path / place
    if path.suffix == ".mp4":
        make.video(path)
    elif place.endswith("/"):
        make.pictures(path)
    else:
        make.pictures(tmp_path, frames=1)
        (tmp_path / "0000.png").rename(path)
    make.colmap_model(tmp_path / "sparse/0", [image], text=True)
    rig = open_rig(tmp_path)
    assert ([camera.name for camera in rig.cameras], rig.sources[0].path) == (["cam00"], path)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_the_file_may_be_of_any_editor(folder: Path, example: dict[str, Any], encoding: str) -> None:
    text = json.dumps(example | {"source": "Köln"}, ensure_ascii=False)
    (folder / "rig.json").write_bytes(text.replace("{", "{\r\n").encode(encoding))
    assert open_rig(folder).source_text == "Köln"


def test_folders_may_be_separated_as_on_windows(folder: Path, example: dict[str, Any]) -> None:
    text = json.dumps(example)
    (folder / "rig.json").write_text(text.replace("pictures/right", "pictures\\\\right"))
    assert open_rig(folder).sources[1].path == folder / "pictures/right"
    (folder / "rig.json").write_text(text.replace("pictures/right", "D:/pictures/right"))
    with pytest.raises(RigError, match="'file' is 'D:/pictures/right', a place on a Windows machine"):
        open_rig(folder)


def test_fields_are_read_as_written() -> None:
    """``rows`` would pass with no row."""
    assert len(rows(section("rig.json"), 3)) >= 14
    assert fields.Fields({"a": None}, "x").text("a", "b") == "b"
