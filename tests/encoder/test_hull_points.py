"""Things that a stage's pictures show and the plane sweep misses, or that fly too fast to follow, get Gaussians."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.decoder.rasterise.native import render_planes
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.keyframe.first_points import FirstPoints
from decogs.encoder.keyframe.first_points.missed import with_missed
from decogs.encoder.training import hull_points
from decogs.encoder.training.hull_points import rule_of
from decogs.formats.cameras import project
from decogs.formats.rigs import open_rig
from decogs.rig.mattes import MatteChoice
from decogs.rig.pictures.ingest import Ingest, RigFrame
from decogs.rig.stage.stage import PlainStage, Stage, find_stage
from decogs.rig.stage.subject import subject_alone
from encode_rig import encode_rig as encode
from stages.make import write_stage
from stages.ray import Body
from stages.scenes import cameras, flying, on_stage

SIZE, SLOW_SIZE = (60, 80), (90, 120)
LEFT_OUT = "cam00"
TRAINED = [f"cam{index:02d}" for index in range(1, 16, 2)]
NEAR = 0.07
"""Metres: one and a half pixels at 4 m."""


@dataclass(frozen=True)
class Pictures:
    ingest: Ingest
    frame: RigFrame
    stage: Stage

    def missed(self, points: FirstPoints | None = None) -> FirstPoints:
        given = nothing(len(self.ingest.views)) if points is None else points
        return with_missed(given, self.stage, self.ingest.views, self.frame.training, most=4000, threads=1)


def made(folder: Path, size: tuple[int, int], names: Sequence[str], frames: int) -> Path:
    return write_stage("flying", folder, [each for each in cameras(size) if each.name in names], frames)


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made(tmp_path_factory.mktemp("hull") / "flying", SIZE, TRAINED, 1)


@pytest.fixture(scope="module")
def whole(rig: Path) -> Pictures:
    ingest = Ingest(open_rig(rig))
    frame = next(iter(ingest.frames(0, 1)))
    stage = find_stage(ingest.views, frame)
    assert isinstance(stage, PlainStage)
    return Pictures(ingest, frame, stage)


@pytest.fixture(scope="module")
def alone(rig: Path, whole: Pictures) -> Pictures:
    mattes = [
        cv2.imread(str(rig / f"truth/mattes/{view.camera.name}/0000.png"), cv2.IMREAD_UNCHANGED).astype(np.float32)
        / 255
        for view in whole.ingest.views
    ]
    shown = [picture * matte for picture, matte in zip(whole.frame.training, mattes, strict=True)]
    return Pictures(
        whole.ingest, replace(whole.frame, training=shown, alpha=mattes), subject_alone(whole.ingest.views, mattes)
    )


def nothing(views: int) -> FirstPoints:
    none = np.zeros(0, np.float32)
    return FirstPoints(
        np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), none, none, np.zeros((views, 0), bool), none > 0
    )


def distances(xyz: np.ndarray, bodies: Sequence[Body]) -> np.ndarray:
    """From the bodies' surfaces, metres, about; negative inside."""
    least = np.full(len(xyz), np.inf)
    for body in bodies:
        own = body.own(xyz.T.astype(np.float32)) / body.radii[:, None]
        own[2] -= np.clip(own[2], -body.half, body.half)
        least = np.minimum(least, (np.sqrt((own * own).sum(0)) - 1) * body.radii.min())
    return least


def taken(points: FirstPoints, which: np.ndarray) -> FirstPoints:
    kept = (points.xyz, points.rgb, points.spacing, points.confidence)
    return FirstPoints(*(values[which] for values in kept), points.seen[:, which], points.placed[which])


def test_points_of_a_hull_lie_on_what_the_mattes_show(alone: Pictures) -> None:
    found = alone.missed()
    off = distances(found.xyz, [*on_stage(0), *flying(0)])
    assert len(found.xyz) > 200
    assert (np.abs(off) < NEAR).mean() > 0.8
    assert np.count_nonzero(distances(found.xyz, flying(0)) < NEAR) > 10
    assert found.placed.all()
    assert (found.seen.sum(axis=0) >= 3).all()


@pytest.mark.parametrize(("step", "least"), [(2, 50), (3, 0)], ids=["four views", "three"])
def test_four_views_are_enough(alone: Pictures, step: int, least: int) -> None:
    views, mattes = alone.ingest.views[::step], alone.frame.alpha[::step]
    stage = subject_alone(views, mattes)
    found = with_missed(nothing(len(views)), stage, views, alone.frame.training[::step], most=4000, threads=1)
    assert bool(len(found.xyz)) == bool(least)
    if least:
        assert len(found.xyz) > least
        assert (np.abs(distances(found.xyz, [*on_stage(0), *flying(0)])) < NEAR).mean() > 0.6


def test_only_what_has_no_point_gets_some(alone: Pictures) -> None:
    all_points = alone.missed()
    on_ball = distances(all_points.xyz, flying(0)) < NEAR
    again = alone.missed(taken(all_points, ~on_ball))
    new = again.xyz[np.count_nonzero(~on_ball) :]
    back = distances(new, flying(0)) < NEAR
    assert np.count_nonzero(back) > 10
    assert len(alone.missed(all_points).xyz) - len(all_points.xyz) < 0.1 * len(all_points.xyz)


def test_points_are_no_more_than_there_is_room_for(alone: Pictures) -> None:
    few = with_missed(
        nothing(len(alone.ingest.views)), alone.stage, alone.ingest.views, alone.frame.training, most=200, threads=1
    )
    assert 40 < len(few.xyz) <= 100


def test_shadows_on_a_plain_stage_breed_no_points(whole: Pictures, monkeypatch: pytest.MonkeyPatch) -> None:
    bodies = [*on_stage(0), *flying(0)]
    off = distances(whole.missed().xyz, bodies)
    monkeypatch.setattr(hull_points._Search, "_is_explained", lambda self, index, ways, *_: np.zeros(len(ways), bool))
    careless = distances(whole.missed().xyz, bodies)
    assert np.count_nonzero(off > NEAR) < 0.6 * np.count_nonzero(careless > NEAR)
    assert np.count_nonzero(np.abs(off) < NEAR) > 0.9 * np.count_nonzero(np.abs(careless) < NEAR)


def test_threads_change_no_bit(alone: Pictures) -> None:
    given = nothing(len(alone.ingest.views)), alone.stage, alone.ingest.views, alone.frame.training
    one, three = (with_missed(*given, most=4000, threads=threads) for threads in (1, 3))
    assert one.xyz.tobytes() + one.rgb.tobytes() == three.xyz.tobytes() + three.rgb.tobytes()


def test_a_scene_that_is_no_stage_keeps_its_points(whole: Pictures) -> None:
    assert rule_of(None) is None
    given = nothing(len(whole.ingest.views))
    assert with_missed(given, None, whole.ingest.views, whole.frame.training, most=10, threads=1) is given


@pytest.mark.slow
def test_a_ball_that_flies_further_than_it_is_wide_is_there_in_the_next_frame(tmp_path: Path) -> None:
    rig = made(tmp_path / "rig", SLOW_SIZE, [LEFT_OUT, *TRAINED], 2)
    output = tmp_path / "flying.dgs"
    encode(rig, output, "live", holdout=[LEFT_OUT], mattes=MatteChoice(masks=rig / "truth/mattes"), effects="motion")
    with open_stream(output) as decoded:
        camera = next(each for each in decoded.header.cameras if each.name == LEFT_OUT)
        frames = list(decoded.frames())
    u, v, depth = (value.item() for value in project(camera, flying(1)[0].centre[None]))
    y, x = np.indices((camera.height, camera.width)) + 0.5
    inside = np.hypot(x - u, y - v) < 0.8 * 0.12 * camera.fx / depth
    shown, alpha, _ = render_planes(frames[1].splats, camera, (0, 0, 0), 1)
    truth = cv2.imread(str(rig / LEFT_OUT / "0001.png"))[..., ::-1].transpose(2, 0, 1) / 255
    error = ((np.clip(shown, 0, 1) - truth)[:, inside] ** 2).mean()
    assert alpha[inside].mean() > 0.9  # .97; without points of the hull .77
    assert error < 10**-2.4  # 29 dB; without 18
