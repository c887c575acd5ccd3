"""Faults made on purpose: each is named, of the right camera, and nothing else is.

On a wall that five cameras see, for `make test`; the whole matrix, on four kinds of scene, takes minutes.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.encoder import EncodeJob, encode
from decogs.encoder.analysis.analyse import Analysis, analyse
from decogs.encoder.analyze_command import analyze_main
from decogs.formats.cameras import Camera
from decogs.formats.colours.srgb import linear_from_srgb
from decogs.formats.errors import RigError, UsageError
from decogs.formats.rigs import open_rig, without_cameras
from decogs.rig.check.faults import GOOD, HARMFUL, USABLE, Findings, faults_of
from decogs.rig.check.moving import moves_through
from decogs.rig.check.recordings import detail, find_lost
from decogs.rig.check.registration import camera_path
from faults.make import FAULTS, with_fault, write_faulty, write_rig

DATA = Path(os.environ.get("DECOGS_SHARED", Path(__file__).resolve().parents[4] / "shared")) / "data"
NAMES = {
    "none": None,
    "blur2": "blurred",
    "blur4": "blurred",
    "frozen5": "frozen",
    "dead": "dead",
    "dead3": "dead",
    "bright": "exposure",
    "dark": "exposure",
    "noise": "noisy",
    "late3": "late",
}
"""The word for a fault; others are their own."""
VERDICTS = {"exposure": USABLE, "noisy": USABLE, "dropped": USABLE}
FRAMES = 12


@pytest.fixture(scope="session")
def wall(plane_views: Callable[..., tuple[list[Camera], list[np.ndarray]]]) -> tuple[list[Camera], list[np.ndarray]]:
    """Five cameras before a wall, twelve pictures of each with another noise."""
    cameras, pictures = plane_views()
    random = np.random.default_rng(5)
    noisy = [own + random.normal(0, 1.2, (FRAMES, *own.shape)) for own in pictures]
    return cameras, [np.clip(np.rint(own), 0, 255).astype(np.uint8) for own in noisy]


def trouble(analysis: Analysis) -> dict[str, tuple[str, ...]]:
    return {camera.camera: camera.trouble for camera in analysis.check.cameras if camera.trouble}


def expected(fault: str, cameras: list[str], row: int) -> dict[str, tuple[str, ...]]:
    word = NAMES.get(fault, fault)
    rows = [row, row + 1] if fault == "swapped" else [row]
    return {cameras[k]: (word,) for k in rows} if word else {}


@pytest.mark.parametrize(
    "fault", ["none", "turned", "swapped", "blur2", "blur4", "frozen5", "dropped", "dead3", "bright", "dark", "noise"]
)
def test_a_fault_is_named_and_nothing_else(
    wall: tuple[list[Camera], list[np.ndarray]], tmp_path: Path, fault: str
) -> None:
    rig = write_rig(*with_fault(*wall, fault, 1), tmp_path / "rig")
    analysis = analyse(rig, threads=1)
    named = expected(fault, [camera.name for camera in wall[0]], 1)
    assert trouble(analysis) == named
    for camera in analysis.check.cameras:
        words = named.get(camera.camera, ())
        assert camera.verdict == (VERDICTS.get(words[0], HARMFUL) if words else GOOD)
    assert len(list(analysis.check.warnings())) == len(named)
    assert analysis.to_json()["checks"]["cam01"]["trouble"] == list(named.get("cam01", ()))
    assert ("--exclude cam01" in analysis.check.advice()) == (
        analysis.check.cameras[1].verdict == HARMFUL and fault != "swapped"
    )


def test_a_black_camera_does_not_pass_for_a_noisy_one(
    wall: tuple[list[Camera], list[np.ndarray]], tmp_path: Path
) -> None:
    """It did: 4.7 levels where the picture went, and a threshold of 58."""
    found = analyse(write_rig(*with_fault(*wall, "dead3", 1), tmp_path / "rig"), threads=1)
    noise = next(finding.decision for finding in found.findings if finding.decision.effect == "sensor_noise")
    thresholds = noise.figures["min_threshold"]
    assert thresholds["cam01"] <= 1.2 * thresholds["cam00"], "6 deviations of a noise that all share"


def test_what_most_cameras_repeat_or_lose_is_no_fault() -> None:
    """A recorder that repeats a frame for all, and a room without light."""
    random = np.random.default_rng(2)
    pictures = [random.integers(40, 200, (6, 48, 64, 3)).astype(np.uint8) for _ in range(4)]
    for own in pictures:
        own[3] = own[2]
        own[5] = 0
    lost = find_lost(pictures)
    assert not lost.blank.any()
    assert not lost.repeats.any()


def changing(frames: range, count: int = 12) -> list[np.ndarray]:
    """Four cameras whose pictures change in these frames."""
    random = np.random.default_rng(2)
    pictures = [random.integers(40, 200, (count, 48, 64, 3)).astype(np.uint8) for _ in range(4)]
    for own in pictures:
        for frame in range(1, count):
            if frame not in frames:
                own[frame] = own[frame - 1]
    return pictures


@pytest.mark.parametrize(
    ("changes", "froze", "came_back", "step", "hung", "dropped"),
    [
        (range(12), 9, None, 1, [10, 11], []),  # for good, near the end of what is looked at
        (range(12), 2, None, 1, list(range(3, 12)), []),
        (range(0, 12, 2), 1, None, 1, [2, 4, 6, 8, 10], []),  # 30 pictures a second in a video of 60
        (range(12), 5, 7, 8, [6], []),  # of every eighth frame: eight were missed
        (range(12), 5, 7, 1, [], [6]),
        (range(12), 10, None, 1, [], [11]),
        (range(7, 12), 8, 10, 1, [], [9]),  # after a rest of all
    ],
)
def test_a_camera_that_freezes_for_good_is_told_from_one_that_drops_frames(
    changes: range, froze: int, came_back: int | None, step: int, hung: list[int], dropped: list[int]
) -> None:
    pictures = changing(changes)
    pictures[1][froze:came_back] = pictures[1][froze]
    lost = find_lost(pictures, step)
    assert np.flatnonzero(lost.hung(1)).tolist() == hung
    assert np.flatnonzero(lost.dropped(1)).tolist() == dropped
    assert not any(lost.hung(camera).any() or lost.dropped(camera).any() for camera in (0, 2, 3))


def carried(step: float) -> tuple[list[Camera], list[np.ndarray]]:
    """A floor, four units deep above and one and a half below, before five cameras, of which cam02 is carried on."""
    random = np.random.default_rng(4)
    floor = cv2.GaussianBlur(random.uniform(0, 255, (264, 900, 3)).astype(np.float32), (0, 0), 1.5)
    floor = np.clip((floor - 127) * 5 + 127, 0, 255)
    columns, rows = np.meshgrid(np.arange(352, dtype=np.float32), np.arange(264, dtype=np.float32))
    shift = 300 / np.linspace(4, 1.5, 264, dtype=np.float32)[:, None]
    cameras, pictures = [], []
    for number in range(5):
        pose = np.eye(4)
        pose[0, 3] = -0.2 * number
        cameras.append(Camera(f"cam{number:02d}", 352, 264, 300.0, 300.0, 176.0, 132.0, pose))
        shown = []
        for frame in range(8):
            at = 0.2 * number + (step * frame if number == 2 else 0.0)
            picture = cv2.remap(floor, columns + 100 + shift * at, rows, cv2.INTER_LINEAR)
            noise = np.random.default_rng(8 * number + frame).normal(0, 1.2, picture.shape)
            shown.append(np.clip(np.rint(picture + noise), 0, 255).astype(np.uint8))
        pictures.append(np.stack(shown))
    return cameras, pictures


@pytest.mark.parametrize(("step", "named"), [(0.0, {}), (0.04, {"cam02": ("moving",)})])
def test_a_camera_that_is_carried_is_refused_by_name(
    step: float, named: dict[str, tuple[str, ...]], tmp_path: Path
) -> None:
    """Eight pixels a frame near by, three far away: no turn does that."""
    rig = write_rig(*carried(step), tmp_path / "rig")
    assert trouble(analyse(rig, threads=1)) == named
    if named:
        with pytest.raises(RigError, match=r"camera cam02 moves through the scene.*--exclude cam02"):
            encode(EncodeJob(rig, tmp_path / "scene.dgs", "live", threads=1))
        assert not list(tmp_path.glob("scene*"))


def test_a_camera_that_stands_before_a_plain_wall_is_not_carried_though_all_that_has_corners_moves() -> None:
    """As in a long take on a stage: none of a performer's corners is where, or what, it was in the first picture."""
    cameras, pictures = carried(0.04)
    assert moves_through(cameras[2], pictures[2], camera_path(pictures[2]))
    random = np.random.default_rng(9)
    wall = np.full((8, 264, 352, 3), 120.0)
    for frame, shown in enumerate(wall):
        if frame != 1:  # first it moves on, which looks like a shake; then it turns
            cloth = cv2.GaussianBlur(random.uniform(0, 255, (150, 110, 3)), (0, 0), 1.5)
        shown[60:210, 40 + 2 * frame : 150 + 2 * frame] = 5 * (cloth - 127) + 127
    stands = np.clip(np.rint(wall), 0, 255).astype(np.uint8)
    path = camera_path(stands)
    assert path.shakes
    assert not moves_through(cameras[2], stands, path)


def test_an_excluded_camera_is_as_if_it_had_never_been(
    moving_rig: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "analysis.json"
    assert analyze_main([str(moving_rig), "--exclude", "cam02", "--json", str(out), "-q"]) == 0
    capfd.readouterr()
    document = json.loads(out.read_text())
    assert "cam02" not in document["cameras"]
    assert document["held_out"] == []
    rig = without_cameras(open_rig(moving_rig), ["cam02"])
    assert [camera.name for camera in rig.cameras] == ["cam00", "cam01", "cam03", "cam04"]
    assert len(rig.sources) == 4
    with pytest.raises(UsageError, match="has no such camera"):
        without_cameras(rig, ["cam02"])
    assert analyze_main([str(moving_rig), "--exclude", "cam99"]) == 2
    assert "--exclude cam99: " in capfd.readouterr().err


class _Page(HTMLParser):
    """What of a page's elements is open, and what it says."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: object) -> None:
        self.tags.append(tag)

    def handle_data(self, data: str) -> None:
        self.text += data


def test_the_page_shows_the_plan_every_camera_and_what_is_wrong(
    wall: tuple[list[Camera], list[np.ndarray]], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    rig = write_rig(*with_fault(*wall, "blur2", 1), tmp_path / "rig")
    assert analyze_main([str(rig), "-o", str(tmp_path / "page"), "-q"]) == 0
    capfd.readouterr()
    page = _Page()
    document = (tmp_path / "page" / "index.html").read_text()
    page.feed(document)
    assert page.tags.count("polygon") == page.tags.count("img") == 5
    assert page.tags.count("line") >= 4, "neighbours see one wall"
    assert "camera cam01 is out of focus" in page.text
    assert "src='http" not in document
    assert analyze_main([str(rig), "-o", str(rig / "cam00.mp4"), "-q"]) == 2
    assert "cam00.mp4" in capfd.readouterr().err
    assert (rig / "cam00.mp4").stat().st_size


SCENES = {
    "workbench": ("rigs/workbench", "cam03", range(4, 20)),
    "stage": ("rigs/stage", "cam03", range(3, 19)),
    "green": ("rigs/green", "cam06", range(3, 16)),
    "basketball": ("real/panoptic_basketball", "cam10", range(4, 20)),
}


@pytest.mark.slow
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("scene", SCENES)
def test_the_matrix(scene: str, fault: str, tmp_path: Path) -> None:
    folder, camera, frames = SCENES[scene]
    if not (DATA / folder).is_dir():
        pytest.skip(f"the rig {folder} is not at {DATA}")
    rig = open_rig(DATA / folder)
    analysis = analyse(write_faulty(rig, fault, camera, tmp_path / "rig", frames))
    names = [each.name for each in rig.cameras]
    assert trouble(analysis) == expected(fault, names, names.index(camera))


KNOWN = {"desk_charuco_4cam": {"cam01": ("late",)}}
"""What is wrong with rigs as they come. Its board's corners, too, say that cam01 is out of step, by half a frame: they
are nearer to their epipolar lines one frame later against cam03, in the same frame against cam00."""


@pytest.mark.slow
@pytest.mark.parametrize("folder", ["rigs", "real", "real_static"])
def test_nothing_else_is_named_on_untouched_rigs(folder: str) -> None:
    found = sorted(path for path in (DATA / folder).glob("*") if path.is_dir())
    if not found:
        pytest.skip(f"no rigs at {DATA / folder}")
    assert {path.name: trouble(analyse(path)) for path in found} == {
        path.name: KNOWN.get(path.name, {}) for path in found
    }


@pytest.mark.parametrize(("matched", "words"), [(False, ["noise"]), (True, ["moving", "blurred", "noisy"])])
def test_noise_that_no_other_camera_shares_is_the_only_fault(matched: bool, words: list[str]) -> None:
    found = Findings("cam05", noise=74.0, usual_noise=1.2, sharpness=0.04, moving=True, matched=matched)
    assert [fault.word for fault in faults_of(found)] == words


def test_an_encode_of_white_noise_says_that_it_is_noise(
    wall: tuple[list[Camera], list[np.ndarray]], tmp_path: Path
) -> None:
    cameras, pictures = wall
    random = np.random.default_rng(2)
    noise = [random.integers(0, 256, own[:3].shape, dtype=np.uint8) for own in pictures]
    with pytest.raises(
        RigError, match=r"camera cam\w+ shows noise of \d\d levels and nothing that two cameras agree on"
    ):
        encode(EncodeJob(write_rig(cameras, noise, tmp_path / "rig"), tmp_path / "a.dgs", "live", effects="auto"))


def test_details_are_of_levels_whether_a_picture_is_coded_or_linear() -> None:
    levels = np.random.default_rng(1).integers(0, 256, (48, 64, 3)).astype(np.uint8)
    linear = linear_from_srgb(levels.astype(np.float32) / np.float32(255))
    np.testing.assert_allclose(detail(linear), detail(levels), rtol=1e-4)  # of float32 powers
