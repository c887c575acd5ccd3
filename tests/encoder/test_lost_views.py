"""A take is not lost to one picture: what is wrong with one view of a later frame costs that view, and is said."""

from __future__ import annotations

import math
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import OpenEXR
import pytest

from decogs.encoder import EncodeReport, MatteChoice, join
from decogs.encoder.analysis.analyse import analyse
from decogs.encoder.output.reports import FrameReport, left_out_warnings
from decogs.formats.errors import RigError
from decogs.formats.rigs import open_rig
from decogs.rig.check.faults import DAMAGED, DROPPED, FROZEN
from encode_rig import encode_rig
from noting_kernel import NotingKernel
from packets import iterate_packets

CAMERA, HELD_OUT, FRAME = "cam01", "cam02", 1
SIZE = (64, 48)
Damage = Callable[[Path, str, int], dict[str, Any]]


def of(rig: Path, camera: str, frame: int) -> Path:
    return rig / camera / f"{frame:04d}.png"


def shorten(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:200])


def every_picture(rig: Path, change: Callable[[np.ndarray, Path], None]) -> None:
    for file in sorted(rig.glob("cam*/*.png")):
        change(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), file)


# Each prepares a rig whose frame is damaged in one camera; returns the choice of mattes.


def a_truncated_png(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    shorten(of(rig, camera, frame))
    return {}


def a_missing_png(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    of(rig, camera, frame).unlink()
    return {}


def another_size(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    cv2.imwrite(str(of(rig, camera, frame)), np.zeros((10, 10, 3), np.uint8))
    return {}


def a_truncated_jpeg(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    def as_jpeg(picture: np.ndarray, file: Path) -> None:
        cv2.imwrite(str(file.with_suffix(".jpg")), picture)
        file.unlink()

    every_picture(rig, as_jpeg)
    shorten(of(rig, camera, frame).with_suffix(".jpg"))
    return {}


def as_exr(rig: Path) -> None:
    def write(picture: np.ndarray, file: Path) -> None:
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
        OpenEXR.File(header, {"RGB": (picture[..., ::-1] / 255.0).astype(np.float32)}).write(
            str(file.with_suffix(".exr"))
        )
        file.unlink()

    every_picture(rig, write)


def nan_in_an_exr(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    as_exr(rig)
    pixels = np.full((SIZE[1], SIZE[0], 3), np.nan, np.float32)
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": pixels}).write(str(of(rig, camera, frame).with_suffix(".exr")))
    return {}


def a_truncated_exr(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    as_exr(rig)
    shorten(of(rig, camera, frame).with_suffix(".exr"))
    return {}


def a_damaged_video(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    """Each frame is a keyframe, so that the next one is whole."""
    video = rig / f"{camera}.mkv"
    with av.open(str(video), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"g": "1", "crf": "5"})
        stream.width, stream.height, stream.pix_fmt = *SIZE, "yuv420p"
        for file in sorted((rig / camera).iterdir()):
            picture = av.VideoFrame.from_ndarray(cv2.imread(str(file)), format="bgr24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    with av.open(str(video)) as container:
        packet = [bytes(packet) for packet in container.demux(video=0) if packet.size][frame]
    video.write_bytes(video.read_bytes().replace(packet, bytes(len(packet))))
    shutil.rmtree(rig / camera)
    (rig / "rig.json").write_text(
        (rig / "rig.json").read_text().replace(f'"file": "{camera}"', f'"file": "{video.name}"')
    )
    return {}


def matte() -> np.ndarray:
    alpha = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    alpha[10:40, 15:50] = 255
    return alpha


def mattes(rig: Path) -> Path:
    folder = rig.parent / "masks"

    def write(_: np.ndarray, file: Path) -> None:
        (folder / file.parent.name).mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(folder / file.parent.name / file.name), matte())

    every_picture(rig, write)
    return folder


def a_truncated_matte(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    folder = mattes(rig)
    shorten(of(folder, camera, frame))
    return {"masks": folder}


def a_missing_matte(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    folder = mattes(rig)
    of(folder, camera, frame).unlink()
    return {"masks": folder}


def a_matte_in_colour(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    folder = mattes(rig)
    cv2.imwrite(str(of(folder, camera, frame)), np.dstack([matte(), 0 * matte(), 0 * matte()]))
    return {"masks": folder}


def a_white_matte(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    folder = mattes(rig)
    cv2.imwrite(str(of(folder, camera, frame)), np.full_like(matte(), 255))
    return {"masks": folder}


def an_opaque_picture(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    every_picture(rig, lambda picture, file: cv2.imwrite(str(file), np.dstack([picture, matte()])))
    picture = cv2.imread(str(of(rig, camera, frame)))
    cv2.imwrite(str(of(rig, camera, frame)), np.dstack([picture, np.full_like(matte(), 255)]))
    return {}


def a_picture_without_alpha(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    plain = of(rig, camera, frame).read_bytes()
    every_picture(rig, lambda picture, file: cv2.imwrite(str(file), np.dstack([picture, matte()])))
    of(rig, camera, frame).write_bytes(plain)
    return {}


def before_green(rig: Path, camera: str, frame: int) -> None:
    """The subject of the pictures before a green backdrop, which it covers in one of them."""

    def cut(picture: np.ndarray, file: Path) -> None:
        covers = file == of(rig, camera, frame)
        subject = picture * np.array([1, 0, 1], np.uint8)
        cv2.imwrite(str(file), np.where((matte() > 0)[..., None] | covers, subject, np.uint8([40, 200, 40])))

    every_picture(rig, cut)


def a_covered_screen(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    before_green(rig, camera, frame)
    return {"key": "green"}


def a_covered_backdrop(rig: Path, camera: str, frame: int) -> dict[str, Any]:
    before_green(rig, camera, frame)
    plates = rig.parent / "plates"
    plates.mkdir()
    for folder in rig.glob("cam*"):
        cv2.imwrite(str(plates / f"{folder.name}.png"), np.full((SIZE[1], SIZE[0], 3), (40, 200, 40), np.uint8))
    return {"background_plate": plates}


KINDS: dict[Damage, str] = {
    a_truncated_png: "the PNG file is truncated",
    a_missing_png: r"cam0[12]/0001\.png: cannot be read",
    another_size: "10 x 10 pixels",
    a_truncated_jpeg: "truncated|damaged",
    nan_in_an_exr: "are NaN or infinite",
    a_truncated_exr: "truncated|damaged",
    a_damaged_video: r"cam0[12]\.mkv: frame 1 is damaged or missing",
    a_truncated_matte: r"masks/cam0[12]/0001\.png: the PNG file is truncated",
    a_missing_matte: "masks/cam0[12]: no matte of this frame",
    a_matte_in_colour: r"masks/cam0[12]/0001\.png: is a picture in colour",
    a_white_matte: "camera cam0[12]: its matte is white all over",
    an_opaque_picture: "camera cam0[12]: its matte is white all over",
    a_picture_without_alpha: r"cam0[12]/0001\.png: has no alpha",
    a_covered_screen: "camera cam0[12] shows no screen",
    a_covered_backdrop: "camera cam0[12]: most of its picture differs",
}


@pytest.fixture
def rig(moving_rig: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(moving_rig, tmp_path / "rig"))


@pytest.fixture
def encoded(moving: Any, tiny_settings: Any, tmp_path: Path) -> Callable[..., tuple[EncodeReport, list[str]]]:
    """Encodes a rig from the moving rig's keyframe, one camera held out, and says what it warned of."""

    def run(rig: Path, output: str = "a.dgs", **fields: Any) -> tuple[EncodeReport, list[str]]:
        warnings: list[str] = []
        given = {"settings": tiny_settings, "keyframe": moving.path, "holdout": [HELD_OUT]} | fields
        report = encode_rig(rig, tmp_path / output, on_warning=warnings.append, **given)
        return report, [text for text in warnings if "is it of other footage" not in text]

    return run


@pytest.mark.parametrize("camera", [CAMERA, HELD_OUT])
@pytest.mark.parametrize("damage", KINDS, ids=lambda damage: damage.__name__)
def test_a_view_of_a_later_frame_is_lost_alone(rig: Path, encoded: Any, damage: Damage, camera: str) -> None:
    report, (warning,) = encoded(rig, mattes=MatteChoice(**damage(rig, camera, FRAME)))
    assert re.match(rf"camera {camera} was left out of frame {FRAME}: .*({KINDS[damage]})", warning)
    assert [list(frame.dropped) for frame in report.frames] == [[], [camera], [], []]
    assert report.frames[FRAME].effects, "the other views were trained"
    measured = [frame.held_out_psnr is not None for frame in report.frames]
    assert measured == [True, camera != HELD_OUT, True, True]


@pytest.mark.parametrize("damage", KINDS, ids=lambda damage: damage.__name__)
def test_the_same_in_the_first_frame_is_an_error(rig: Path, encoded: Any, damage: Damage, tmp_path: Path) -> None:
    with pytest.raises(RigError):
        encoded(rig, mattes=MatteChoice(**damage(rig, CAMERA, 0)))
    assert not list(tmp_path.glob("a.dgs*"))


def test_a_held_out_camera_needs_no_screen(rig: Path, encoded: Any) -> None:
    """Not in the first frame, either: nothing is measured there."""
    report, (warning,) = encoded(rig, mattes=MatteChoice(**a_covered_screen(rig, HELD_OUT, 0)))
    assert f"camera {HELD_OUT} was left out of frame 0: camera {HELD_OUT} shows no screen" in warning
    assert [frame.held_out_psnr is not None for frame in report.frames] == [False, True, True, True]


def test_what_stands_for_a_lost_picture_teaches_nothing(rig: Path, encoded: Any, tmp_path: Path) -> None:
    """Whatever the file holds; and the frame after it is compared with the last picture that there was."""
    shorten(of(rig, CAMERA, FRAME))
    one, _ = encoded(rig, "one.dgs")
    of(rig, CAMERA, FRAME).write_bytes(b"")
    encoded(rig, "other.dgs")
    another_size(rig, CAMERA, FRAME)
    encoded(rig, "third.dgs", scale=1.0)
    assert len({(tmp_path / name).read_bytes() for name in ("one.dgs", "other.dgs", "third.dgs")}) == 1
    assert not any(frame.left_out for frame in one.frames[FRAME + 1 :])


def test_a_frame_without_any_picture_repeats_the_one_before(rig: Path, encoded: Any, tiny_settings: Any) -> None:
    for file in rig.glob(f"cam*/{FRAME:04d}.png"):
        shorten(file)
    for method in ("decogs", "3dgstream"):
        settings = replace(tiny_settings, method=method)
        report, warnings = encoded(rig, f"{method}.dgs", settings=settings)
        assert len(warnings) == len(list(rig.glob("cam*")))
        assert [frame.kind for frame in report.frames] == ["key", "skip", *(frame.kind for frame in report.frames[2:])]
        assert report.frames[FRAME].held_out_psnr is None
        assert math.isfinite(report.frames[FRAME].training_psnr)
        assert report.frames[3].effects or method == "3dgstream"


def test_a_dense_method_leaves_the_view_out(
    rig: Path, encode: Any, moving: Any, tiny_rig: Any, tiny_settings: Any
) -> None:
    kernel, settings = NotingKernel(), replace(tiny_settings, method="3dgstream")
    shorten(of(rig, CAMERA, FRAME))
    encode(rig, settings=settings, keyframe=moving.path, kernel=kernel, stop=2)
    trained = [name for name in tiny_rig.names if name not in (CAMERA, HELD_OUT)]
    assert min(kernel.rendered[name] for name in trained) > 10 > kernel.rendered[CAMERA], (
        "it is rendered to be measured, once or twice"
    )


def test_scaled_pictures_and_cameras_own_size(rig: Path, encoded: Any) -> None:
    shorten(of(rig, HELD_OUT, FRAME))
    report, _ = encoded(rig, scale=0.5, keyframe=None)
    measured = [frame.held_out_own_size_psnr is not None for frame in report.frames]
    assert measured == [True, False, True, True]


def test_a_resumed_encode_has_the_same_bytes(rig: Path, encoded: Any, tmp_path: Path) -> None:
    shorten(of(rig, CAMERA, FRAME))
    encoded(rig)
    with (tmp_path / "a.dgs").open("rb") as file:
        ends = [packet.offset + packet.size for packet in iterate_packets(file)]
    for frames in (1, 2, 3):
        (tmp_path / "b.dgs.part").write_bytes((tmp_path / "a.dgs").read_bytes()[: ends[frames]])
        encoded(rig, "b.dgs", resume=True)
        assert (tmp_path / "b.dgs").read_bytes() == (tmp_path / "a.dgs").read_bytes()
        (tmp_path / "b.dgs").unlink()


def test_parts_have_the_same_bytes(rig: Path, tiny_rig: Any, tiny_settings: Any, moving: Any, tmp_path: Path) -> None:
    """Also where a view is lost in the first frame of a part, and in the one before it."""
    take = tiny_rig.write(tmp_path / "take", frames=(0, 1, 3, 1, 3, 0))
    for camera, frame in ((CAMERA, 1), (CAMERA, 2), ("cam03", 3), ("cam04", 4)):
        shorten(of(take, camera, frame))
    given: dict[str, Any] = {"settings": tiny_settings, "segment": 2, "closed": True, "threads": 1}
    encode_rig(take, tmp_path / "whole.dgs", **given)
    parts = [tmp_path / f"{start}.dgs" for start in (0, 2, 4)]
    for start, part in zip((0, 2, 4), parts, strict=True):
        keyframe = parts[0] if start else None
        encode_rig(take, part, only=range(start, start + 2), keyframe=keyframe, **given)
    join(parts, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == (tmp_path / "whole.dgs").read_bytes()


def test_many_damaged_pictures_are_one_line(rig: Path) -> None:
    lost = {f"{name}/{frame}.png: is damaged": [frame] for name in ("a",) for frame in range(1, 9)}
    frames = [report(frame, {"a": why}) for why, (frame,) in lost.items()] + [report(9, {"b": "late"})]
    lines = [
        "camera a was left out of frames 1 to 8: a/1.png: is damaged (and 7 more such)",
        "camera b was left out of frame 9: late",
    ]
    assert list(left_out_warnings(frames, {})) == lines
    assert list(left_out_warnings(frames, {"a": range(8), "b": {9}})) == lines[:1], "of one frame nothing was said"


def test_a_lost_view_is_warned_of_once(rig: Path, tiny_settings: Any, tmp_path: Path) -> None:
    """The analysis has seen it, and the encode meets it again."""
    shorten(of(rig, CAMERA, FRAME))
    said: list[str] = []
    encode_rig(rig, tmp_path / "scene.dgs", tiny_settings, effects="auto", threads=1, on_warning=said.append)
    assert [line.split(";")[0] for line in said if CAMERA in line] == [
        f"camera {CAMERA} has no picture in frame {FRAME}"
    ]


def report(frame: int, dropped: dict[str, str]) -> FrameReport:
    return FrameReport(frame, "delta", 1, 1, 0.0, 30.0, None, {}, {}, 0.0, dropped=dropped)


def test_an_analysis_names_the_camera_and_frame(rig: Path) -> None:
    shorten(of(rig, CAMERA, FRAME))
    check = analyse(open_rig(rig)).check
    faults = [fault for camera in check.cameras for fault in camera.faults if fault.word in (DAMAGED, FROZEN, DROPPED)]
    assert [(fault.camera, fault.word, fault.looks) for fault in faults] == [
        (CAMERA, DAMAGED, "has no picture in frame 1")
    ]
    assert "cam01/0001.png: the PNG file is truncated" in str(faults[0])
