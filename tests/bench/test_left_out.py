"""Viewpoints where no camera stood: what the rig sees of them, what hangs in the air, and the report."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.bench.commands import bench_main
from decogs.bench.views import left_out
from decogs.bench.views.surfaces import Surfaces, midway
from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.lattice import default_lattice
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import EncodeJob
from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.rigs import open_rig
from decogs.formats.splats import SH_C0, Splats, join_splats, logit

WALL = 4.0


def camera(name: str, x: float, width: int = 48) -> Camera:
    """Looks along z from (x, 0, 0)."""
    pose = np.eye(4)
    pose[0, 3] = -x
    return Camera(name, width, 32, 40.0, 40.0, width / 2, 16.0, pose)


def gaussians(places: list[tuple[float, float, float]], size: float, opacity: float) -> Splats:
    count = len(places)
    return Splats(
        np.array(places, np.float32),
        np.full((count, 3), np.log(size), np.float32),
        np.tile(np.float32([1, 0, 0, 0]), (count, 1)),
        np.full(count, logit(opacity), np.float32),
        np.full((count, 1, 3), 0.2 / SH_C0, np.float32),
    )


def wall() -> Splats:
    grid = np.arange(-8, 8.1, 0.2)
    return gaussians([(x, y, WALL) for x in grid for y in grid if abs(y) < 3], 0.15, 0.9)


def surfaces_of(cameras: list[Camera]) -> tuple[StreamHeader, Surfaces]:
    header = StreamHeader(tuple(cameras), default_lattice(1.0))
    return header, Surfaces(header, wall(), 1)


def test_a_pixel_counts_the_cameras_that_see_its_surface() -> None:
    own, near, far = camera("own", 0.0), camera("near", 0.5), camera("far", 1.5)
    _, surfaces = surfaces_of([own, near, far])
    count = surfaces.seen_by(own, [near, far])
    # A camera at x sees from x - 2.4 to x + 2.4 of a wall in 4 units' distance, this one from -2.4 to 2.4.
    where = (np.arange(48) + 0.5 - 24) / 40 * WALL
    expected = (where > 0.5 - 2.4).astype(int) + (where > 1.5 - 2.4)
    inner = np.abs(where - (0.5 - 2.4)) + 1e-9 > 0.25
    assert np.array_equal(np.median(count, axis=0)[inner], expected[inner])


def test_another_surface_is_not_seen() -> None:
    own, near = camera("own", 0.0), camera("near", 0.5)
    _, surfaces = surfaces_of([own, near])
    behind = replace(near, world_to_camera=near.world_to_camera @ np.diag([-1.0, 1.0, -1.0, 1.0]), name="behind")
    assert not surfaces.seen_by(own, [behind]).any()


def test_what_hangs_in_the_air_is_counted_and_what_lies_on_the_wall_is_not() -> None:
    own = camera("own", 0.0)
    header, surfaces = surfaces_of([own])
    clean = surfaces.air(header, wall(), own)
    assert (clean.haze, clean.floaters) == (0.0, 0)
    veil = gaussians([(0.0, 0.0, 2.0)], 0.4, 0.5)
    hazy = surfaces.air(header, join_splats(wall(), veil), own)
    assert hazy.floaters == 1
    # sigma is 40 * .4 / 2 pixels; a ray off the axis meets the ball a few per cent farther out than its centre's plane.
    row, column = np.indices((32, 48)) + 0.5
    expected = 0.5 * np.exp(-((column - 24) ** 2 + (row - 16) ** 2) / (2 * 8**2))
    assert hazy.haze == pytest.approx(expected.mean(), rel=0.1)
    assert surfaces.air(header, join_splats(wall(), gaussians([(0.0, 0.0, 3.9)], 0.1, 0.5)), own).floaters == 0


def test_midway_is_between_neighbours() -> None:
    moved = midway(camera("own", 0.0), [camera("far", -3.0), camera("near", 1.0)])
    assert np.allclose(camera_centre(moved), [0.5, 0.0, 0.0])
    assert np.array_equal(moved.world_to_camera[:3, :3], np.eye(3))


@pytest.fixture
def left(monkeypatch: pytest.MonkeyPatch, short_presets: None) -> list[tuple[str, ...]]:
    """What each encode leaves out; the reference is tiny, too."""
    names: list[tuple[str, ...]] = []
    encode = left_out.encode

    def observed(job: EncodeJob, **options: Any) -> Any:
        names.append(tuple(job.holdout))
        return encode(job, **options)

    monkeypatch.setattr(left_out, "encode", observed)
    monkeypatch.setattr(left_out, "REFERENCE", "tiny")
    return names


def run_without_cam00(rig: Path, folder: Path) -> left_out.LeftOut:
    options = left_out.LeftOutOptions(cameras=1, settings="tiny", threads=1)
    return left_out.RigViewpoints(rig, folder, options).run("cam00")


def test_the_whole_report(
    three_frames: Path, tmp_path: Path, left: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "report"
    command = ["views", str(three_frames), "-o", str(folder), "--preset", "tiny", "--threads", "1"]
    assert bench_main([*command, "--cameras", "2", "--frames", ":2"]) == 0
    assert capsys.readouterr().out == f"{folder / 'views.md'}\n"
    names = [camera.name for camera in open_rig(three_frames).cameras]
    chosen = [names[0], names[len(names) // 2]]
    assert left == [(chosen[0],), (), (chosen[1],)]
    figures = json.loads((folder / "views.json").read_text())["rigs"][three_frames.name]
    assert list(figures) == chosen
    page = (folder / "views.md").read_text()
    for name in chosen:
        assert f"| {name} | {figures[name]['psnr']:.2f} |" in page
        assert min(figures[name]["psnr"], figures[name]["training"]) > 5
        assert 0 < figures[name]["seen"] <= 1
    shown = [line.split("(")[1][:-1] for line in page.splitlines() if line.startswith("![")]
    assert len(shown) == 2
    for path in shown:
        assert cv2.imread(str(folder / path)) is not None
    assert not list(folder.rglob("*.part"))
    assert [path.parent.name for path in folder.rglob("*.dgs")] == ["references"]

    left.clear()
    (folder / shown[0]).with_suffix(".json").unlink()
    assert bench_main([*command, "--cameras", ",".join(chosen), "--frames", ":2"]) == 0
    assert len(left) == 1  # the other camera's result and the reference are still there
    assert json.loads((folder / "views.json").read_text())["rigs"][three_frames.name].keys() == figures.keys()


def test_subject_and_rest_are_measured_apart_where_a_rig_has_mattes(
    three_frames: Path, tmp_path: Path, left: list[Any]
) -> None:
    rig = shutil.copytree(three_frames, tmp_path / "rig")
    without = run_without_cam00(rig, tmp_path / "without").frames[0]
    assert (without.psnr_subject, without.psnr_rest) == (None, None)
    size = open_rig(rig).cameras[0]
    matte = np.zeros((size.height, size.width), np.uint8)
    matte[: size.height // 4] = 255
    (rig / "truth/mattes/cam00").mkdir(parents=True)
    cv2.imwrite(str(rig / "truth/mattes/cam00/0000.png"), matte)
    found = run_without_cam00(rig, tmp_path / "with").frames[0]
    assert found.psnr == without.psnr
    subject, rest, whole = (10 ** (-each / 10) for each in (found.psnr_subject, found.psnr_rest, found.psnr))
    assert whole == pytest.approx(0.25 * subject + 0.75 * rest, rel=1e-3)  # figures are kept to 4 digits


def test_cameras_are_the_streams_with_their_near_planes(
    three_frames: Path, tmp_path: Path, left: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A rig's own camera has none: it would look at its housing from inside, where a viewer does not."""
    drawn: list[str] = []
    render = left_out.render_view

    def observed(header: StreamHeader, scene: Splats, view: str, **options: Any) -> Any:
        drawn.append(view)
        assert header.near_planes[view] > 0
        return render(header, scene, view, **options)

    monkeypatch.setattr(left_out, "render_view", observed)
    run_without_cam00(three_frames, tmp_path)
    assert drawn == ["cam00"]


def test_a_presets_effects_are_detected_as_in_an_encode_of_the_users(
    three_frames: Path, tmp_path: Path, left: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without colours that are matched, a dome's camera that is left out has 24 instead of 30 dB."""
    found: list[Any] = []
    encode = left_out.encode

    def observed(job: EncodeJob, **options: Any) -> Any:
        report = encode(job, **options)
        with open_stream(job.output) as made:
            found.append(made.header.settings["effects"])
        return report

    monkeypatch.setattr(left_out, "encode", observed)
    run_without_cam00(three_frames, tmp_path)
    rig, stream = open_rig(three_frames), tmp_path / "users.dgs"
    observed(EncodeJob(rig, stream, "tiny", frames=slice(1), holdout=("cam00",), threads=1))
    assert found == [found[-1]] * 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--cameras", "0"], "--cameras 0: leave out at least 1"),
        (["--cameras", "cam9"], "--cameras cam9: "),
        (["--frames", "9:"], "--frames: "),
        (["--preset", "nope"], "--preset nope: "),
        (["--holdout", "cam00"], "unrecognized arguments: --holdout"),
    ],
)
def test_impossible_options_are_refused(
    three_frames: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], options: list[str], message: str
) -> None:
    folder = tmp_path / "report"
    try:
        code: Any = bench_main(["views", str(three_frames), "-o", str(folder), *options])
    except SystemExit as error:
        code = error.code
    printed = capfd.readouterr()
    assert (code, printed.out, printed.err.count("\n")) == (2, "", 1)
    assert message in printed.err
    assert not folder.exists()
