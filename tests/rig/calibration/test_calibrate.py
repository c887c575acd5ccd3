"""Which calibrations are accepted, and what the command says of the others."""

from __future__ import annotations

import builtins
import json
import os
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from board_videos import BOARD, FOCAL, PHONES, POSES, write_board_videos, write_phone_videos
from decogs.formats.rigs import open_rig
from decogs.formats.system.extras import install
from decogs.rig.calibration.board_rig import BoardRig
from decogs.rig.calibration.boards import BoardView, parse_board
from decogs.rig.calibration.by_board import _placed_accurately
from decogs.rig.calibration.commands import calibrate_main
from decogs.rig.calibration.lenses import Lens, focal_deviation

CORNERS = parse_board("charuco:5x4:0.05:0.0375:DICT_4X4_50").corners()
LENS = Lens("none", (500.0, 500.0), (319.5, 239.5), (0.0,) * 4)


def _views(tilt: float, count: int = 10) -> list[BoardView]:
    """Sights of a board that is tilted by up to so many radians, with errors of .05 pixels."""
    draw = np.random.default_rng(5)
    views = []
    for _ in range(count):
        place = np.array([*draw.uniform(-0.1, 0.1, 2), 0.8])
        pixels = LENS.project(draw.uniform(-tilt, tilt, 3), place, CORNERS)[0]
        views.append(BoardView(np.arange(len(CORNERS)), pixels + 0.5 + draw.normal(0, 0.05, pixels.shape), False))
    return views


def test_a_board_that_is_never_tilted_leaves_the_focal_length_open() -> None:
    assert focal_deviation(_views(0.6), CORNERS, (640, 480)) < 0.01
    assert focal_deviation(_views(0.1), CORNERS, (640, 480)) > 0.02
    assert focal_deviation(_views(0.01), CORNERS, (640, 480)) == np.inf


def test_the_camera_with_too_large_an_error_is_left_out_and_the_rest_placed_anew() -> None:
    asked = []

    def place(lenses: dict[int, Lens], *_: object) -> BoardRig:
        asked.append(sorted(lenses))
        pose = np.zeros(3), np.zeros(3)
        return BoardRig(dict.fromkeys(lenses, pose), {number: [0.5, 1.5, 2.0][number] for number in lenses}, ())

    footage: Any = [type("Footage", (), {"size": (width, 800)}) for width in (1000, 1000, 3000)]
    rig, left_out = _placed_accurately(dict.fromkeys(range(3), LENS), {}, CORNERS, footage, place)
    assert asked == [[0, 1, 2], [0, 2]]
    assert sorted(rig.poses) == [0, 2]
    assert "off by 1.5 px" in left_out[1]


def test_without_pycolmap_the_command_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    real = builtins.__import__

    def without(name: str, *rest: Any, **named: Any) -> Any:
        if name == "pycolmap":
            raise ImportError(name)
        return real(name, *rest, **named)

    _write_pictures(tmp_path / "videos", ["a", "b", "c"])
    monkeypatch.setattr(builtins, "__import__", without)
    assert calibrate_main([str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q"]) == 2
    assert install("calibrate") in capsys.readouterr().err
    assert not (tmp_path / "rig").exists()


def test_two_cameras_are_too_few(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _write_pictures(tmp_path / "videos", ["a", "b"])
    assert calibrate_main([str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q"]) == 2
    assert "holds 2 cameras (a, b)" in capsys.readouterr().err


def test_photos_of_an_unknown_ending_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """All of them, or those of one camera."""
    _write_pictures(tmp_path / "videos", ["a", "b"])
    (tmp_path / "videos/c").mkdir()
    (tmp_path / "videos/c/IMG_0001.HEIC").write_bytes(b"0")
    (tmp_path / "photos").mkdir()
    (tmp_path / "videos/c").rename(tmp_path / "photos/c")
    assert calibrate_main([str(tmp_path / "photos"), "-o", str(tmp_path / "rig"), "-q"]) == 2
    assert "c/IMG_0001.HEIC: files ending in .HEIC are not read as frames; convert them" in capsys.readouterr().err
    (tmp_path / "photos/c").rename(tmp_path / "videos/c")
    assert calibrate_main([str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q"]) == 2
    said = capsys.readouterr().err
    assert "holds 2 cameras (a, b), and a rig needs 3" in said
    assert "or convert" in said
    assert "c/IMG_0001.HEIC, which is not read" in said


def test_a_board_that_nobody_sees_may_be_another_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _write_pictures(tmp_path / "videos", ["a", "b", "c"])
    arguments = [str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q", "--board", "charuco:5x4:0.05:0.0375"]
    assert calibrate_main(arguments) == 2
    assert "--board: no camera shows it in 2 frames looked at; check how many squares" in capsys.readouterr().err
    assert not (tmp_path / "rig").exists()


def test_the_command_places_cameras_by_a_board(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_board_videos(tmp_path / "videos")
    arguments = [str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q", "--board", BOARD]
    assert calibrate_main(arguments) == 0, capsys.readouterr().err
    rig = open_rig(tmp_path / "rig")
    first = rig.cameras[0].world_to_camera
    for camera, pose in zip(rig.cameras, POSES, strict=True):
        assert camera.fx == pytest.approx(FOCAL, rel=0.01)  # the goal of the focal length
        relative = (camera.world_to_camera @ np.linalg.inv(first))[:3, :3]
        turn = np.degrees(np.linalg.norm(cv2.Rodrigues(relative @ cv2.Rodrigues(pose[:3])[0].T)[0]))
        assert turn < 0.5  # a tenth of a pixel of drawn corners, over a small board


def test_a_camera_that_is_knocked_while_the_board_is_shown_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_board_videos(tmp_path / "videos")
    for file in sorted((tmp_path / "videos" / "b").iterdir())[12:]:
        cv2.imwrite(str(file), np.roll(cv2.imread(str(file)), 8, axis=1))
    assert calibrate_main([str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q", "--board", BOARD]) == 0
    said = capsys.readouterr().err.splitlines()
    assert [line.split(": ", 2)[2] for line in said] == [
        "b: 50% of its sights of the board are off; hold the board and the camera still, and synchronise the videos"
    ]


def test_a_mirrored_video_is_named_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_board_videos(tmp_path / "videos", mirrored="b")
    arguments = [str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q", "--board", BOARD]
    assert calibrate_main(arguments) == 2
    assert "b: sees the board mirrored" in capsys.readouterr().err
    assert not (tmp_path / "rig").exists()


def _write_pictures(folder: Path, names: list[str]) -> None:
    """Two grey pictures of each camera."""
    for name in names:
        (folder / name).mkdir(parents=True)
        for frame in range(2):
            cv2.imwrite(str(folder / name / f"{frame:04d}.png"), np.full((48, 64, 3), 128, np.uint8))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--distance", "a:d:1"], "--distance from d: there are a, b, c"),
        (["-o", "{file}"], "file: is a file; name a folder"),
        (["-o", "{file}/rig"], "file/rig: cannot be written to"),
        (["-o", "{file}", "--board", BOARD, "--lenses-only"], "file: is a file; name a folder"),
    ],
)
def test_what_cannot_be_done_is_said_before_the_work(
    more: list[str],
    said: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    _write_pictures(tmp_path / "videos", ["a", "b", "c"])
    (tmp_path / "file").write_text("kept")
    for module_of_work in ("footage", "by_motion", "by_board"):
        monkeypatch.delattr(f"decogs.rig.calibration.{module_of_work}.pictures_at")
    arguments = [str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q"]
    assert calibrate_main([*arguments, *(each.format(file=tmp_path / "file") for each in more)]) == 2
    assert said in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "kept"


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--shared-intrinsics"], "--shared-intrinsics: a board gives each camera a lens of its own"),
        (["--distance", "a:b:1"], "--distance: a board says what a metre is"),
        (["--lenses-only", "--distance", "a:b:1"], "--distance: says nothing of lenses alone"),
        (["--lenses-only", "--sync", "auto"], "--sync: says nothing of lenses alone"),
        (["--lenses-only", "--shared-intrinsics"], "--shared-intrinsics: says nothing of lenses alone"),
    ],
)
def test_options_that_would_do_nothing_are_refused(
    more: list[str], said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _write_pictures(tmp_path / "videos", ["a", "b", "c"])
    arguments = [str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q", "--board", BOARD]
    assert calibrate_main([*arguments, *more]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "rig").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="other systems do not take such names")
@pytest.mark.parametrize("name", ["a\nb", "\x1b[31m", os.fsdecode(b"\xff")])
def test_a_name_that_no_rig_could_state_is_refused(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _write_pictures(tmp_path / "videos", ["a", "b", "c"])
    (tmp_path / "videos" / "a").rename(tmp_path / "videos" / name)
    assert calibrate_main([str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q", "--board", BOARD]) == 2
    said = capsys.readouterr().err
    assert "has a name with control characters; rename it" in said
    assert said.rstrip("\n").isprintable()


@pytest.mark.slow
def test_phones_are_brought_in_step_by_what_they_heard(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_phone_videos(tmp_path / "phones")
    given = [str(tmp_path / "phones"), "--board", BOARD, "-q"]
    assert calibrate_main([*given, "-o", str(tmp_path / "apart")]) == 2
    capsys.readouterr()
    assert calibrate_main([*given, "-o", str(tmp_path / "rig"), "--sync", "auto"]) == 0
    assert "cameras start up to 5 frames apart" in capsys.readouterr().err
    rig = open_rig(tmp_path / "rig")
    # A tick of a thousandth of a second, and the coder's own blur of an onset.
    assert rig.starts == pytest.approx(PHONES, abs=0.1)
    assert rig.frame_count == 35
    for camera in rig.cameras:
        assert camera.fx == pytest.approx(FOCAL, rel=0.01)

    starts = {"fps": 30, "cameras": [{"name": name, "offset": start} for name, start in PHONES.items()]}
    (tmp_path / "sync.json").write_text(json.dumps(starts))
    assert calibrate_main([*given, "-o", str(tmp_path / "told"), "--sync", str(tmp_path / "sync.json")]) == 0
    assert open_rig(tmp_path / "told").starts == PHONES


def test_videos_of_which_nothing_says_the_start_are_taken_to_be_in_step(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_board_videos(tmp_path / "videos")
    assert (
        calibrate_main([str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "--board", BOARD, "--sync", "auto"]) == 0
    )
    assert "neither timecode nor sound says when its cameras start" in capsys.readouterr().err
    assert not open_rig(tmp_path / "rig").starts
