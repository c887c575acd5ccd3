"""Which files are a camera's frames, how they are numbered and turned, and what they say of their colours."""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from PIL import Image, ImageOps

from decogs.formats.errors import RigError
from decogs.formats.rigs import files_of, open_rig, read_frames
from decogs.formats.rigs.sources import PictureSource, list_folder, open_pictures

APPLE_DOUBLE = b"\0\5\x16\7\0\2\0\0Mac OS X        " + bytes(100)


def grey_of(frame: int) -> int:
    return 30 + 20 * frame


def write_frames(
    folder: Path, make: Any, name: Callable[[int, int], str], cameras: int = 3, frames: int = 3, **save: Any
) -> None:
    """Frame k of every camera is grey, by 20 k brighter than the first, and by its camera's number."""
    for camera in range(cameras):
        for frame in range(frames):
            path = folder / name(camera, frame)
            path.parent.mkdir(parents=True, exist_ok=True)
            level = grey_of(frame) + camera
            Image.fromarray(np.full((make.height, make.width, 3), level, np.uint8)).save(path, **save)
    np.save(folder / "poses_bounds.npy", np.stack([make.poses_bounds_row(i) for i in range(cameras)]))


def greys(folder: Path) -> list[list[int]]:
    """Of every frame and camera, less what tells cameras apart."""
    return [[int(picture[0, 0, 0]) - i for i, picture in enumerate(seen)] for _, seen in read_frames(open_rig(folder))]


# --- hidden files ---------------------------------------------------------------------------------------------------


def hide_things(folder: Path, make: Any) -> None:
    """What macOS, Windows and file servers leave beside a rig's files."""
    for path in [*folder.rglob("*")]:
        if path.suffix in (".png", ".mp4"):
            path.with_name("._" + path.name).write_bytes(APPLE_DOUBLE)
    for name in ("@eaDir", "__MACOSX", ".AppleDouble", ".Trash-1000", "#recycle", "$RECYCLE.BIN"):
        make.pictures(folder / name, frames=2)
        make.pictures(folder / name / "images", frames=2)
        make.video(folder / name / "cam00.mp4", frames=2)
    for name in (".DS_Store", "Thumbs.db", "desktop.ini"):
        (folder / name).write_bytes(b"\0" * 40)


@pytest.mark.parametrize("layout", ["n3dv", "meetroom", "colmap", "nerfstudio", "rig.json"])
def test_hidden_files_are_no_frames_and_no_cameras(tmp_path: Path, make: Any, layout: str) -> None:
    name = "cam_{}" if layout == "meetroom" else "cam{:02d}"
    folders = [name.format(i) for i in range(3)]
    write_frames(tmp_path, make, lambda camera, frame: f"{folders[camera]}/{frame:04d}.png")
    if layout not in ("n3dv", "meetroom"):
        (tmp_path / "poses_bounds.npy").unlink()
    if layout == "colmap":
        make.colmap_model(tmp_path / "sparse" / "0", [f"{folder}/0000.png" for folder in folders], text=False)
    if layout == "nerfstudio":
        (tmp_path / "transforms.json").write_text(json.dumps(make.transforms_values(folders)))
    if layout == "rig.json":
        values = make.rig_json_values()
        del values["frame_count"]
        for record in values["cameras"]:
            record["file"] = record["file"].removesuffix(".mp4")
        (tmp_path / "rig.json").write_text(json.dumps(values))
    hide_things(tmp_path, make)
    for folder in folders:
        hide_things(tmp_path / folder, make)
    rig = open_rig(tmp_path)
    assert (rig.layout, len(rig.cameras), rig.frame_count, rig.warnings) == (layout, 3, 3, ())
    assert greys(tmp_path) == [[grey_of(frame)] * 3 for frame in range(3)]


def test_hidden_videos_are_no_cameras(tmp_path: Path, make: Any) -> None:
    make.colmap(tmp_path, text=True)
    hide_things(tmp_path, make)
    assert [camera.name for camera in open_rig(tmp_path).cameras] == ["cam00", "cam01", "cam02"]


def test_a_folder_s_entries_are_the_user_s(tmp_path: Path, make: Any) -> None:
    write_frames(tmp_path, make, lambda camera, frame: f"cam{camera:02d}/{frame:04d}.png")
    hide_things(tmp_path, make)
    assert [entry.name for entry in list_folder(tmp_path)] == ["cam00", "cam01", "cam02", "poses_bounds.npy"]


# --- names ----------------------------------------------------------------------------------------------------------

NAMES: dict[str, Callable[[int, int], str]] = {
    "camera last": lambda camera, frame: f"cam{camera:02d}/{frame:04d}_cam{camera:02d}.png",
    "camera first": lambda camera, frame: f"cam{camera:02d}/cam{camera:02d}_{frame}.png",
    "take and camera": lambda camera, frame: f"cam{camera:02d}/take2_{frame:06d}_{camera}_v003.png",
    "time stamp": lambda camera, frame: f"cam{camera:02d}/{frame:04d}_{1716300000 + 33333 * frame + 7 * camera}.png",
    "time stamp first": lambda camera, frame: f"cam{camera:02d}/{1716300000 + 33 * frame + camera}_{frame:04d}.png",
    "seconds": lambda camera, frame: f"cam{camera:02d}/t{frame // 2}.{500 * (frame % 2):03d}_c{camera}.png",
}


@pytest.mark.parametrize("name", NAMES)
def test_frame_numbers_are_told_from_other_numbers(tmp_path: Path, make: Any, name: str) -> None:
    write_frames(tmp_path, make, NAMES[name], frames=5)
    assert greys(tmp_path) == [[grey_of(frame)] * 3 for frame in range(5)]


@pytest.mark.parametrize("name", NAMES)
def test_gaps_are_found_beside_other_numbers(tmp_path: Path, make: Any, name: str) -> None:
    write_frames(tmp_path, make, NAMES[name], frames=6)
    (tmp_path / NAMES[name](2, 3)).unlink()
    for camera in (0, 1):
        (tmp_path / NAMES[name](camera, 5)).unlink()
    number = "1 500" if name == "seconds" else "3"
    with pytest.raises(RigError, match=f"cam02: no picture of frame {number}, which cam00 has; give all cameras the"):
        open_rig(tmp_path)


@pytest.mark.parametrize("names", [("a", "b"), ("a1", "b"), ("a1", "b1"), ("1_2", "3")])
def test_names_without_a_count_say_nothing_of_gaps(tmp_path: Path, names: tuple[str, ...]) -> None:
    assert PictureSource(tmp_path, tuple(tmp_path / f"{name}.png" for name in names), 4, 4).frame_numbers() is None


# --- endings --------------------------------------------------------------------------------------------------------


def renamed(folder: Path, ending: str) -> None:
    for path in [*folder.rglob("*.png"), *folder.rglob("*.mp4")]:
        path.rename(path.with_suffix(ending))


@pytest.mark.parametrize("layout", ["n3dv", "n3dv folders", "meetroom", "nerfstudio", "rig.json"])
def test_an_ending_that_is_not_known_is_named(tmp_path: Path, make: Any, layout: str) -> None:
    folders = [f"cam{i:02d}" for i in range(3)]
    if layout == "meetroom":
        make.n3dv(tmp_path, name="cam_{}")
    elif layout == "n3dv folders":
        write_frames(tmp_path, make, lambda camera, frame: f"{folders[camera]}/{frame:04d}.png")
    elif layout == "rig.json":
        values = make.rig_json_values()
        for record in values["cameras"]:
            record["file"] = record["name"] + ".r3d"
        make.rig_json(tmp_path, values)
    elif layout == "nerfstudio":
        make.nerfstudio(tmp_path, make.transforms_values([f"{folder}.r3d" for folder in folders]))
    else:
        make.n3dv(tmp_path)
    renamed(tmp_path, ".r3d")
    for path in tmp_path.rglob("*.r3d"):
        path.write_bytes(bytes(1000))
    (tmp_path / "notes.txt").write_text("beside")
    with pytest.raises(
        RigError, match=r"cam_?00?(/0000)?\.r3d: files ending in \.r3d are not read as frames; convert them "
    ):
        open_rig(tmp_path)


def test_what_lies_beside_a_camera_s_frames_is_no_hindrance(tmp_path: Path, make: Any) -> None:
    make.n3dv(tmp_path)
    for i in range(3):
        (tmp_path / f"cam{i:02d}.wav").write_bytes(b"")
        (tmp_path / f"cam{i:02d}.json").write_text("{}")
    assert len(open_rig(tmp_path).cameras) == 3
    (tmp_path / "cam01.mp4").rename(tmp_path / "cam01.r3d")
    with pytest.raises(RigError, match=r"cam01\.r3d: files ending in \.r3d are not read"):
        open_rig(tmp_path)


def test_a_file_of_another_ending_is_named_where_one_is_missing(tmp_path: Path, make: Any) -> None:
    make.rig_json(tmp_path)
    (tmp_path / "cam01.mp4").rename(tmp_path / "cam01.heic")
    with pytest.raises(RigError, match=r"cam01\.mp4 is missing, but cam01\.heic is there; put it back"):
        open_rig(tmp_path)


# --- EXIF orientation -----------------------------------------------------------------------------------------------


def exif(orientation: int) -> bytes:
    data = Image.Exif()
    data[274] = orientation
    return data.tobytes()


def shown(stored: np.ndarray, orientation: int) -> np.ndarray:
    """The upright picture, as Pillow turns it."""
    picture = Image.fromarray(stored)
    picture.getexif()[274] = orientation
    return np.asarray(ImageOps.exif_transpose(picture))


def oriented_rig(
    folder: Path, make: Any, stored: np.ndarray, size: tuple[int, int], orientation: int, suffix: str
) -> None:
    for camera in range(2):
        path = folder / f"cam{camera:02d}" / f"0000{suffix}"
        path.parent.mkdir(parents=True)
        options = {"exif": exif(orientation)} if suffix != ".tif" else {"tiffinfo": {274: orientation}}
        Image.fromarray(stored).save(path, **options)
    np.save(folder / "poses_bounds.npy", np.stack([make.poses_bounds_row(i, size=size) for i in range(2)]))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
@pytest.mark.parametrize("scale", [1, 2])
def test_pictures_are_turned_where_only_then_they_are_what_was_calibrated(
    tmp_path: Path, make: Any, orientation: int, suffix: str, scale: int
) -> None:
    stored = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    oriented_rig(tmp_path, make, stored, (48 * scale, 64 * scale), orientation, suffix)
    if orientation < 5:
        with pytest.raises(RigError, match="64 x 48 pixels, but camera cam00 is calibrated for"):
            open_rig(tmp_path)
        return
    rig = open_rig(tmp_path)
    assert {(camera.width, camera.height) for camera in rig.cameras} == {(48, 64)}
    assert {(source.width, source.height) for source in rig.sources} == {(48, 64)}
    ((_, (picture, _)),) = read_frames(rig)
    assert picture.flags.c_contiguous
    if suffix == ".jpg":
        stored = np.asarray(Image.open(tmp_path / "cam00" / "0000.jpg"))
    np.testing.assert_array_equal(picture, shown(stored, orientation))
    assert next(file for file, _ in files_of(rig)).name == f"0000{suffix}"


def test_a_rig_json_that_states_the_upright_size(tmp_path: Path, make: Any) -> None:
    """There sizes must be equal, and one camera may be turned while another is not."""
    stored = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    values = make.rig_json_values(2)
    del values["frame_count"]
    for record, size, orientation in zip(values["cameras"], ((48, 64), (64, 48)), (8, 8), strict=True):
        record |= {"file": record["name"] + ".jpg", "width": size[0], "height": size[1]}
        Image.fromarray(stored).save(tmp_path / record["file"], exif=exif(orientation))
    (tmp_path / "rig.json").write_text(json.dumps(values))
    ((_, (turned, other)),) = read_frames(open_rig(tmp_path))
    np.testing.assert_array_equal(turned, np.rot90(other))


@pytest.mark.parametrize("size", [(64, 48), (64, 64)])
@pytest.mark.parametrize("orientation", [3, 6])
def test_pictures_stay_as_stored_where_they_were_calibrated_so(
    tmp_path: Path, make: Any, size: tuple[int, int], orientation: int
) -> None:
    """As in COLMAP; square ones fit either way, and stay."""
    stored = np.random.default_rng(1).integers(0, 256, (size[1], size[0], 3), dtype=np.uint8)
    oriented_rig(tmp_path, make, stored, size, orientation, ".png")
    ((_, (picture, _)),) = read_frames(open_rig(tmp_path))
    np.testing.assert_array_equal(picture, stored)


def test_all_frames_of_a_camera_are_turned_alike(tmp_path: Path, make: Any) -> None:
    """A camera that looks down does not know where up is: its frames may say different things."""
    stored = np.random.default_rng(1).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    oriented_rig(tmp_path, make, stored, (48, 64), 6, ".png")
    for camera in range(2):
        Image.fromarray(stored).save(tmp_path / f"cam{camera:02d}" / "0001.png", exif=exif(8 if camera else 1))
    for _, seen in read_frames(open_rig(tmp_path)):
        for picture in seen:
            np.testing.assert_array_equal(picture, shown(stored, 6))


def test_damaged_exif_data_say_nothing(tmp_path: Path, make: Any) -> None:
    stored = np.full((48, 64, 3), 99, np.uint8)
    good = exif(6)
    random = np.random.default_rng(5)
    for k in range(200):
        broken = bytearray(good)
        broken[int(random.integers(6, len(good)))] ^= int(random.integers(1, 256))
        file = io.BytesIO()
        Image.fromarray(stored).save(
            file, "JPEG", exif=bytes(broken[: int(random.integers(6, len(good) + 1))]) if k % 2 else bytes(broken)
        )
        path = tmp_path / f"{k}.jpg"
        path.write_bytes(file.getvalue())
        source = open_pictures(tmp_path, [path])
        assert (source.width, source.height) == (64, 48)


# --- what frames say of themselves ----------------------------------------------------------------------------------


def test_cameras_that_say_the_same_share_a_warning(tmp_path: Path, make: Any) -> None:
    plane = np.full((make.height, make.width), 0.5, np.float16)
    for camera in range(4):
        (tmp_path / f"cam{camera:02d}").mkdir()
        names = ("R", "G", "B", "A") if camera else ("R", "G", "B")
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        header |= {"colorInteropID": "lin_ap1_scene"} if camera == 3 else {}
        OpenEXR.File(header, dict.fromkeys(names, plane)).write(str(tmp_path / f"cam{camera:02d}" / "0000.exr"))
    np.save(tmp_path / "poses_bounds.npy", np.stack([make.poses_bounds_row(i) for i in range(4)]))
    assert open_rig(tmp_path).warnings == (
        f"{tmp_path}/cam01 and 2 more: has alpha below 1; where that is not used, its colours are premultiplied, which "
        "is over black",
        f"{tmp_path}/cam03: its colours are tagged 'lin_ap1_scene' without chromaticities, and are taken for linear "
        "Rec. 709's; convert the pictures for right ones",
    )
