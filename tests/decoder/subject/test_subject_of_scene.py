"""The subject of a whole scene's stream: Gaussians in the hull of mattes that are known, exported and decoded."""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from pxr import Usd, UsdGeom

from decogs.codec.packets.corrections import ANGLE_STEP, Correction
from decogs.decoder import DecodedFrame, Stream, decode, export, open_stream
from decogs.decoder.cameras.corrections import as_it_stood
from decogs.decoder.cameras.lens import Undistortion, distort_pixels
from decogs.decoder.commands import decode_main, export_main
from decogs.decoder.subject import hull, subject
from decogs.formats.cameras import Camera, as_pinhole, in_picture, project
from decogs.formats.errors import DecogsError
from decogs.formats.splat_files import splat_formats
from packets import with_header

FRAMES = 8
USED = ("cam00", "wide")
"""The stream holds out cam01, whose mattes are not needed."""
EDGE = {"cam00": 42, "wide": 34}
"""Column from which the first frame's mattes are black."""
MARGIN = 4
"""Pixels: the hull's 2, and what a lens's interpolation and the shrunk grid add."""


def edge(name: str, frame: int) -> int:
    return EDGE[name] - frame


@pytest.fixture
def masks(small_stream: Any, tmp_path: Path) -> Path:
    """White left of an edge that goes to the left, so that frames lose Gaussians."""
    for camera in small_stream.header.cameras:
        if camera.name in USED:
            folder = tmp_path / "masks" / camera.name
            folder.mkdir(parents=True)
            for frame in range(FRAMES):
                matte = np.zeros((camera.height, camera.width), np.uint8)
                matte[:, : edge(camera.name, frame)] = 255
                cv2.imwrite(str(folder / f"{frame:04d}.png"), matte)
    return tmp_path / "masks"


def scene(stream: Path) -> list[np.ndarray]:
    with open_stream(stream) as opened:
        return [frame.splats.means for frame in opened.frames()]


def columns(camera: Camera, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the camera with its lens shows points, and which of them its pinhole does."""
    pinhole = as_pinhole(camera)
    u, v, depth = project(pinhole, xyz)
    return distort_pixels(camera, np.stack([u, v], -1))[:, 0], in_picture(pinhole, u, v, depth)


def exported(stream: Path, output: Path, masks: Path, suffix: str = ".ply", **options: Any) -> list[np.ndarray]:
    export(stream, output / f"x_##{suffix}", up="none", subject=masks, **options)
    form = splat_formats()[suffix]()
    return [form.decode(path.read_bytes()).means for path in sorted(output.glob(f"x_*{suffix}"))]


def test_what_all_mattes_show_is_exported_and_nothing_else(small_stream: Any, masks: Path, tmp_path: Path) -> None:
    """With a fisheye among the cameras, frame by frame."""
    cameras = {camera.name: camera for camera in small_stream.header.cameras}
    found = exported(small_stream.path, tmp_path, masks)
    for frame, (whole, held_means) in enumerate(zip(scene(small_stream.path), found, strict=True)):
        inside, outside = np.ones(len(whole), bool), np.zeros(len(whole), bool)
        for name in USED:
            u, seen = columns(cameras[name], whole)
            inside &= seen & (u < edge(name, frame) - MARGIN)
            outside |= ~seen | (u > edge(name, frame) + MARGIN)
        held = np.array([(held_means == point).all(axis=1).any() for point in whole])
        assert held[inside].all()
        assert not held[outside].any()
        assert held.sum() == len(held_means)
        assert min(inside.sum(), outside.sum()) > 3, "or it says nothing"


@pytest.mark.parametrize("suffix", [".spz", ".sog", ".splat", ".glb"])
def test_every_format_holds_the_subject(small_stream: Any, masks: Path, tmp_path: Path, suffix: str) -> None:
    expected = [len(each) for each in exported(small_stream.path, tmp_path, masks)]
    assert [len(each) for each in exported(small_stream.path, tmp_path, masks, suffix)] == expected
    assert len(set(expected)) > 2


def test_usd_holds_a_subject_of_changing_population(small_stream: Any, masks: Path, tmp_path: Path) -> None:
    expected = [len(each) for each in exported(small_stream.path, tmp_path, masks)]
    export(small_stream.path, tmp_path / "x.usdc", subject=masks)
    stage = Usd.Stage.Open(str(tmp_path / "x.usdc"))
    instancers = [UsdGeom.PointInstancer(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.PointInstancer)]
    shown = [sum(int(np.sum(each.ComputeMaskAtTime(t) or [True] * each.GetInstanceCount(t))) for each in instancers)
             for t in range(FRAMES)]  # fmt: skip
    assert shown == expected


def test_decoded_pictures_of_the_subject_have_alpha(small_stream: Any, masks: Path, tmp_path: Path) -> None:
    """Far right of the mattes' edge there is nothing."""
    decode(small_stream.path, tmp_path / "subject", view="cam00", subject=masks)
    for frame in range(FRAMES):
        picture = cv2.imread(str(tmp_path / f"subject/cam00_{frame:06d}.png"), cv2.IMREAD_UNCHANGED)
        assert picture.shape[2] == 4
        assert picture[:, : edge("cam00", frame), 3].max() > 100
        assert not picture[:, -4:, 3].any()
    arguments = ["--view", "cam00", "-o", f"{tmp_path}/x_#.exr", "--subject", str(masks)]
    assert decode_main([str(small_stream.path), *arguments]) == 0


def test_mattes_count_from_the_rigs_first_frame(small_stream: Any, masks: Path, tmp_path: Path) -> None:
    """As many as the stream's frames are taken in order; more are told by their numbers."""
    later = with_header(small_stream.path, tmp_path / "later.dgs", first_frame=3)
    expected = exported(small_stream.path, tmp_path, masks)
    in_order = exported(later, tmp_path, masks)
    for name in USED:
        for frame in reversed(range(FRAMES)):
            (masks / name / f"{frame:04d}.png").rename(masks / name / f"{frame + 3:04d}.png")
        for frame in range(3):
            shutil.copy(masks / name / f"{FRAMES:04d}.png", masks / name / f"{frame:04d}.png")
    by_number = exported(later, tmp_path, masks)
    for one, two, three in zip(expected, in_order, by_number, strict=True):
        np.testing.assert_array_equal(one, two)
        np.testing.assert_array_equal(one, three)
    for name in USED:
        (masks / name / "0000.png").unlink()
    with pytest.raises(DecogsError, match=r"fit neither .*count them from 0 at the rig's first frame"):
        exported(later, tmp_path, masks)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda masks: shutil.rmtree(masks), "there is no such folder"),
        (lambda masks: shutil.rmtree(masks / "wide"), "no mattes of camera wide"),
        (lambda masks: (masks / "wide/0005.png").unlink(), "wide: no matte of frame 5"),
        (lambda masks: cv2.imwrite(str(masks / "wide/0005.png"), np.zeros((9, 9), np.uint8)), "9 x 9 pixels"),
        (lambda masks: cv2.imwrite(str(masks / "wide/0000.png"), np.full((50, 50), 255, np.uint8)), "white all over"),
    ],
)
def test_mattes_that_cannot_be_used_are_one_line(
    small_stream: Any, masks: Path, tmp_path: Path, damage: Any, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    damage(masks)
    for main, output in ((export_main, "x_#.ply"), (export_main, "x.usdc"), (decode_main, "x")):
        view = ["--view", "cam00"] if main is decode_main else []
        assert main([str(small_stream.path), "-o", str(tmp_path / output), "-q", "--subject", str(masks), *view]) == 2
        text = capsys.readouterr().err
        assert said in text
        assert text.count("\n") == 1
    assert not list(tmp_path.glob("x*"))


def test_a_subjects_stream_is_one_already(small_stream: Any, masks: Path, tmp_path: Path) -> None:
    subject = with_header(small_stream.path, tmp_path / "subject.dgs", subject=True)
    with pytest.raises(DecogsError, match="is a subject without a background already"):
        export(subject, tmp_path / "x.usdc", subject=masks)


def test_only_frames_asked_for_need_mattes(small_stream: Any, masks: Path, tmp_path: Path) -> None:
    expected = exported(small_stream.path, tmp_path, masks)[2:4]
    for name in USED:
        for frame in (0, 1, 4, 5, 6, 7):
            (masks / name / f"{frame:04d}.png").unlink()
    (tmp_path / "again").mkdir()
    for one, two in zip(
        expected, exported(small_stream.path, tmp_path / "again", masks, frames=slice(2, 4)), strict=True
    ):
        np.testing.assert_array_equal(one, two)


def test_a_shaken_camera_is_taken_where_it_stood(
    small_stream: Any, masks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As if the rig's calibration had it there."""
    turn = Correction(yaw=round(math.radians(5) / ANGLE_STEP))
    first, *others = small_stream.header.cameras
    there = with_header(small_stream.path, tmp_path / "there.dgs", cameras=(as_it_stood(first, turn), *others))
    still, expected = (exported(stream, tmp_path, masks) for stream in (small_stream.path, there))
    whole = Stream.frames

    def shaken(*arguments: Any) -> Iterator[DecodedFrame]:
        for frame in whole(*arguments):
            frame.corrections = {first.name: turn}
            yield frame

    monkeypatch.setattr(Stream, "frames", shaken)
    for one, two, three in zip(exported(small_stream.path, tmp_path, masks), expected, still, strict=True):
        np.testing.assert_array_equal(one, two)
        assert len(one) != len(three)


def test_mattes_are_undistorted(
    small_stream: Any, masks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a strong lens, as with straightened mattes of its pinhole, which has white where nothing was recorded."""
    monkeypatch.setattr(subject, "check_mattes", lambda *given: None)  # white borders look inverted
    monkeypatch.setattr(hull, "_MIN_VIEWS", 1)  # what was not recorded is no look
    for file in (masks / "cam00").iterdir():
        cv2.imwrite(str(file), np.full((48, 64), 255, np.uint8))
    first, held_out, wide = small_stream.header.cameras
    bent = replace(wide, distortion_model="opencv", distortion=(-0.6, 0.0, 0.0, 0.0))
    plan = Undistortion(bent)
    lens = with_header(small_stream.path, tmp_path / "lens.dgs", cameras=(first, held_out, bent))
    pinhole = with_header(small_stream.path, tmp_path / "pinhole.dgs", cameras=(first, held_out, plan.pinhole))
    found = exported(lens, tmp_path, masks)
    unlike = exported(small_stream.path, tmp_path, masks)
    for file in (masks / wide.name).iterdir():
        matte = plan.apply(cv2.imread(str(file), cv2.IMREAD_GRAYSCALE))
        cv2.imwrite(str(file), np.where(plan.valid, matte, 255))
    for one, two in zip(found, exported(pinhole, tmp_path, masks), strict=True):
        np.testing.assert_array_equal(one, two)
    assert [len(one) for one in found] != [len(one) for one in unlike]


def test_pictures_do_not_replace_mattes(small_stream: Any, masks: Path) -> None:
    with pytest.raises(DecogsError, match="is read, as `subject`"):
        decode(small_stream.path, masks / "cam00/####.png", view="cam00", subject=masks)
