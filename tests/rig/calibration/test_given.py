"""Lenses that the user gives: read from what there is, and held against what pictures say."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from board_videos import BOARD, FOCAL, SIZE, write_board_videos
from decogs.formats.errors import RigError, UsageError
from decogs.formats.rigs import open_rig
from decogs.rig.calibration.commands import calibrate_main
from decogs.rig.calibration.footage import open_footage
from decogs.rig.calibration.given import Given, given_lenses
from decogs.rig.calibration.lenses import Lens


def lens_record(name: str, **others: Any) -> dict[str, Any]:
    centre = [(SIZE[0] - 1) / 2, (SIZE[1] - 1) / 2]
    return {"name": name, "width": SIZE[0], "height": SIZE[1], "focal": [FOCAL] * 2, "centre": centre} | others


def write_lenses(path: Path, *records: dict[str, Any]) -> Path:
    path.write_text(json.dumps({"pixel_convention": "(0,0)", "cameras": records}))
    return path


@pytest.fixture
def videos(tmp_path: Path) -> Path:
    write_board_videos(tmp_path / "videos", frames=2)
    return tmp_path / "videos"


def test_one_lens_is_every_camera_s_and_is_scaled(videos: Path, tmp_path: Path) -> None:
    file = write_lenses(
        tmp_path / "one.json", lens_record("x", width=1280, height=960, focal=[900, 910], centre=[639.5, 479.5])
    )
    given = given_lenses(file, open_footage(videos))
    assert [lens.focal for lens in given.lenses] == [(450, 455)] * 3
    # The middle of the large picture is at 640 of 1280 from its edge; so it is in the small one.
    assert given.lenses[0].centre == pytest.approx((319.5, 239.5))


def test_what_does_not_suit_the_videos_is_named(videos: Path, tmp_path: Path) -> None:
    footage = open_footage(videos)
    with pytest.raises(UsageError, match="has no lens for b, c, but for a, x"):
        given_lenses(write_lenses(tmp_path / "two.json", lens_record("a"), lens_record("x")), footage)
    with pytest.raises(UsageError, match="x is for 480 x 640 pixels, but a has 640 x 480"):
        given_lenses(write_lenses(tmp_path / "tall.json", lens_record("x", width=480, height=640)), footage)
    with pytest.raises(RigError, match="'focal' has 1 numbers"):
        given_lenses(write_lenses(tmp_path / "short.json", lens_record("x", focal=[1])), footage)
    bent = lens_record("x", distortion=[1, 2, 3], distortion_model="opencv")
    with pytest.raises(UsageError, match="3 distortion coefficients"):
        given_lenses(write_lenses(tmp_path / "bent.json", bent), footage)


def test_a_focal_length_is_contradicted_only_with_certainty() -> None:
    given = Given(Path("x"), (Lens("none", (500.0, 500.0), (0.0, 0.0), (0.0,) * 4),))
    assert given.fits(0, 509.0)
    assert not given.fits(0, 511.0)
    assert given.fits(0, 511.0, deviation=0.01)


def test_exchanged_videos_are_named() -> None:
    lenses = [Lens("none", (focal, focal), (0.0, 0.0), (0.0,) * 4) for focal in (500.0, 600.0, 550.0)]
    footage: Any = [type("Footage", (), {"name": name})() for name in "abc"]
    said = str(Given(Path("x"), tuple(lenses)).contradicted(footage, {0: 598.0, 1: 503.0}))
    assert "a: given 500.0 px, found 598.0 px, as given for b: are their videos exchanged?" in said


def test_the_board_contradicts_a_wrong_focal_length_and_takes_a_right_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_board_videos(tmp_path / "videos")
    arguments = [str(tmp_path / "videos"), "-o", str(tmp_path / "rig"), "-q", "--board", BOARD, "--intrinsics"]
    wrong = write_lenses(
        tmp_path / "wrong.json", lens_record("a"), lens_record("b", focal=[550, 550]), lens_record("c")
    )
    assert calibrate_main([*arguments, str(wrong)]) == 2
    assert "pictures contradict focal lengths (b: given 550.0 px, found 50" in capsys.readouterr().err
    assert not (tmp_path / "rig").exists()
    right = write_lenses(tmp_path / "right.json", lens_record("x"))
    assert calibrate_main([*arguments, str(right)]) == 0
    assert [camera.fx for camera in open_rig(tmp_path / "rig").cameras] == [FOCAL] * 3
    # What it wrote serves as given lenses, too.
    assert given_lenses(tmp_path / "rig", open_footage(tmp_path / "videos")).lenses[0].focal == (FOCAL, FOCAL)


def test_lenses_alone_come_from_a_board_in_one_camera(tmp_path: Path) -> None:
    write_board_videos(tmp_path / "videos")
    for other in "bc":
        for file in (tmp_path / "videos" / other).iterdir():
            file.unlink()
        (tmp_path / "videos" / other).rmdir()
    arguments = [str(tmp_path / "videos"), "-o", str(tmp_path / "lens"), "-q", "--board", BOARD, "--lenses-only"]
    assert calibrate_main(arguments) == 0
    (camera,) = json.loads((tmp_path / "lens" / "calibration.json").read_text())["cameras"]
    assert "pose" not in camera
    assert np.allclose(camera["focal"], FOCAL, rtol=0.01)  # the goal of the focal length


def test_threads_do_not_change_what_is_found(tmp_path: Path) -> None:
    write_board_videos(tmp_path / "videos", frames=10)
    for threads in ("1", "3"):
        arguments = [str(tmp_path / "videos"), "-o", str(tmp_path / threads), "-q", "--board", BOARD, "--lenses-only"]
        assert calibrate_main([*arguments, "--threads", threads]) == 0
    assert (tmp_path / "1/calibration.json").read_bytes() == (tmp_path / "3/calibration.json").read_bytes()


@pytest.mark.parametrize("name", ["rig.json", "calibration.json", "report.html"])
@pytest.mark.parametrize("more", [[], ["--lenses-only"]])
def test_files_of_somebody_else_are_not_written_over(
    name: str, more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / name).write_text("{}")
    assert calibrate_main([str(tmp_path), "-o", str(tmp_path), "-q", "--board", BOARD, *more]) == 2
    assert f"{name}: is not of an earlier decogs-calibrate like this one" in capsys.readouterr().err
    assert (tmp_path / name).read_text() == "{}"


@pytest.mark.slow
def test_a_calibration_replaces_its_like_but_not_lenses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_board_videos(tmp_path / "videos")
    lenses, placed = [[str(tmp_path / "videos"), "-q", "--board", BOARD, "-o", str(tmp_path / name)] for name in "lp"]
    for arguments in (lenses := [*lenses, "--lenses-only"], lenses, placed, placed):
        assert calibrate_main(arguments) == 0, capsys.readouterr().err
    refused = {
        "rig.json: is not of": [*placed, "--lenses-only"],
        "calibration.json: is not of": lenses[:-1],
        "the lenses are read from it": [*placed, "--intrinsics", str(tmp_path / "p")],
        "p/rig.json: the lenses are": [*placed, "--intrinsics", str(tmp_path / "p" / "rig.json")],
    }
    for said, arguments in refused.items():
        assert calibrate_main(arguments) == 2
        assert said in capsys.readouterr().err


def test_lenses_that_are_not_there_are_named(videos: Path) -> None:
    with pytest.raises(UsageError, match=r"nowhere\.json: is not there"):
        given_lenses(Path("nowhere.json"), open_footage(videos))
