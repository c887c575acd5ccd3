"""The frames before a closed segment's start are faded into it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.decoder.rasterise import render
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder import EncodeSettings
from decogs.encoder.backends import ATTRIBUTES, training_kernel
from decogs.encoder.backends.scene_views import SceneViews
from decogs.encoder.frame.cross_fade import CrossFade, cross_fade, fade_cameras
from decogs.encoder.frame.next_segment import with_following
from decogs.encoder.methods.decogs import DecogsTrainer
from decogs.encoder.settings.frame import FrameSettings, SignificanceSettings
from decogs.encoder.training.method import FrameInput, FrameMethod, TrainedFrame, TrainingContext
from decogs.formats.cameras import camera_centre
from decogs.formats.splats import Splats, empty_splats, take_splats
from decogs.rig.pictures.ingest import RigFrame
from encode_rig import encode_rig

STILL = (0, 1, 3, 3, 3, 3, 3)
"""Moments of a take whose second segment, of frame 6, begins as things have come to rest."""


def fading(settings: EncodeSettings, frames: int = 3, **changes: Any) -> EncodeSettings:
    frame = replace(settings.frame, joint_iterations=40)
    return replace(settings, segment=6, closed=True, cross_fade=frames, frame=frame, **changes)


@pytest.mark.parametrize(
    ("settings", "last", "expected"),
    [
        (EncodeSettings(segment=4, closed=True, cross_fade=2), 19, {12: [13, 14], 13: [14], 16: [17, 18], 17: [18]}),
        (EncodeSettings(segment=4, closed=True, cross_fade=2), 17, {12: [13, 14], 13: [14]}),
        (EncodeSettings(segment=4, closed=True, cross_fade=9), 14, {11: [12, 13, 14], 12: [13, 14], 13: [14]}),
        (EncodeSettings(segment=1, closed=True), 14, {}),
        (EncodeSettings(segment=4, closed=True, cross_fade=0), 19, {}),
        (EncodeSettings(segment=4), 19, {}),
        (EncodeSettings(), 19, {}),
    ],
)
def test_frames_that_go_over_have_those_up_to_the_next_start(
    settings: EncodeSettings, last: int, expected: dict[int, list[int]]
) -> None:
    """Segments of a take that begins with frame 10."""
    frames = [RigFrame(index, [], []) for index in range(11, last + 1)]
    given = list(with_following(frames, 10, settings))
    assert [frame for frame, _ in given] == frames
    assert {frame.index: [f.index for f in following] for frame, following in given if following} == expected


def test_cameras_stand_half_way_between_the_rigs(tiny_rig: Any) -> None:
    """On an arc: between each and the next one, and beyond its ends."""
    cameras = [tiny_rig.camera(index) for index in (0, 1, 3, 4)]
    found = fade_cameras(cameras)
    assert len({camera.name for camera in found}) == len(found) == 4 + 3 + 2
    for one, small in zip(cameras, found, strict=False):
        np.testing.assert_array_equal(one.world_to_camera, small.world_to_camera)
    between = next(camera for camera in found if camera.name == "cam01 +0.5 cam00")
    centres = [camera_centre(camera) for camera in cameras]
    np.testing.assert_allclose(camera_centre(between), (centres[0] + centres[1]) / 2)
    turns = [camera.world_to_camera[:3, :3] for camera in (cameras[0], between, cameras[1])]
    # Poses are rounded to 12 decimals.
    np.testing.assert_allclose(turns[1] @ turns[0].T, turns[2] @ turns[1].T, atol=1e-11)
    beyond = next(camera for camera in found if camera.name == "cam00 -0.5 cam01")
    np.testing.assert_allclose(camera_centre(beyond), 1.5 * centres[0] - 0.5 * centres[1])
    poses = {camera.world_to_camera.tobytes() for camera in found}
    assert len(poses) == len(found), "no camera is there twice"


def test_cameras_of_one_place_have_none_between_them(tiny_rig: Any) -> None:
    camera = tiny_rig.camera(0)
    assert len(fade_cameras([camera])) == 1
    assert len(fade_cameras([camera, replace(camera, name="twin")])) == 2


def test_large_cameras_are_compared_in_smaller_pictures(tiny_rig: Any) -> None:
    large = replace(tiny_rig.camera(0), width=1352, height=1014)
    (small,) = fade_cameras([large])
    assert 0.9 * 240_000 < small.width * small.height <= 241_000
    assert small.width / small.height == pytest.approx(4 / 3, rel=0.01)


def fade_views(kernel: Any, cameras: Sequence[Any]) -> SceneViews:
    return SceneViews(kernel, lambda: fade_cameras(cameras))


def test_a_frame_comes_to_show_the_mixture(tiny_rig: Any) -> None:
    """Also from a camera that has no part in it; and only the Gaussians that may change do."""
    kernel, cameras = training_kernel(threads=1), [tiny_rig.camera(index) for index in (0, 1, 3, 4)]
    scene, following = tiny_rig.scene_at(0), tiny_rig.scene_at(1)
    rows = np.flatnonzero(np.any(scene.means != following.means, axis=1))
    assert 0 < len(rows) < len(scene)
    fade = CrossFade(following, 0.5, rows, fade_views(kernel, cameras))
    none = empty_splats(scene.sh_degree)
    trained = TrainedFrame(np.zeros(0, np.int64), none, np.zeros(0, np.int64), none)
    settings = FrameSettings(joint_iterations=60, significance=SignificanceSettings(threshold=1e-3))
    given = {"extent": 2.0, "seed": (0, 1)}
    gone = cross_fade(kernel, scene, trained, fade, settings, **given)
    np.testing.assert_array_equal(gone.kept, rows)
    assert not len(gone.removed)
    assert not len(gone.added)
    after = take_splats(scene, np.arange(len(scene)))
    for name in ATTRIBUTES:
        getattr(after, name)[rows] = getattr(gone.values, name)
    for camera in (cameras[0], tiny_rig.camera(2)):
        was, now, wanted = (render(splats, camera, threads=1).image for splats in (scene, after, following))
        mixture = (was + wanted) / 2
        assert np.square(now - mixture).mean() < 0.3 * np.square(was - mixture).mean()
    assert cross_fade(kernel, scene, trained, replace(fade, scene=scene), settings, **given) is trained


def test_what_was_trained_and_added_goes_over_as_well(tiny_rig: Any) -> None:
    kernel, cameras = training_kernel(threads=1), [tiny_rig.camera(index) for index in (0, 1, 3, 4)]
    scene, following = tiny_rig.scene_at(0), tiny_rig.scene_at(1)
    moved = np.flatnonzero(np.any(scene.means != following.means, axis=1))
    kept, removed, rows = moved[:20:2], moved[1:20:2], moved[10:]
    new = tiny_rig.patch((0, 0, -0.5), 3, 3, 0.1, 5)
    trained = TrainedFrame(kept, take_splats(following, kept), removed, new)
    fade = CrossFade(following, 0.5, rows, fade_views(kernel, cameras))
    settings = FrameSettings(joint_iterations=8)
    gone = cross_fade(kernel, scene, trained, fade, settings, extent=2.0, seed=(0, 1))
    np.testing.assert_array_equal(gone.kept, np.setdiff1d(np.union1d(kept, rows), removed))
    np.testing.assert_array_equal(gone.removed, removed)
    assert len(gone.added) == len(new)
    assert not np.array_equal(gone.added.sh, new.sh)
    assert gone.sensitivity is not None
    assert len(gone.sensitivity) == len(gone.kept)


def test_what_training_found_to_show_still_counts_after_the_fade(tiny_rig: Any) -> None:
    """Of the Gaussians that were trained; the others count as the fade finds them, which is less."""
    kernel, cameras = training_kernel(threads=1), [tiny_rig.camera(index) for index in (0, 4)]
    scene, following = tiny_rig.scene_at(0), tiny_rig.scene_at(1)
    rows = np.flatnonzero(np.any(scene.means != following.means, axis=1))
    kept, values = rows[::2], take_splats(scene, rows[::2])
    large = Splats(*(np.full_like(getattr(values, name), 1e9) for name in ATTRIBUTES))
    trained = TrainedFrame(kept, values, rows[:0], empty_splats(scene.sh_degree), sensitivity=large)
    fade = CrossFade(following, 0.5, rows, fade_views(kernel, cameras))
    settings = FrameSettings(joint_iterations=2)
    gone = cross_fade(kernel, scene, trained, fade, settings, extent=2.0, seed=(0, 1))
    assert gone.sensitivity is not None
    was_trained = np.isin(gone.kept, kept)
    assert 0 < was_trained.sum() < len(was_trained)
    for name in ATTRIBUTES:
        sizes = getattr(gone.sensitivity, name)
        assert (sizes[was_trained] == np.float32(1e9)).all()
        assert (sizes[~was_trained] < 1e9).all()


@pytest.fixture(scope="module")
def still_rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return Path(tiny_rig.write(tmp_path_factory.mktemp("still") / "rig", frames=STILL, noise=1.0))


@pytest.fixture(scope="module")
def jumps(encode: Any, still_rig: Path, tiny_settings: Any) -> Any:
    """The take without a cross-fade."""
    return encode(still_rig, settings=fading(tiny_settings, 0))


@pytest.fixture(scope="module")
def fades(encode: Any, still_rig: Path, tiny_settings: Any) -> Any:
    return encode(still_rig, settings=fading(tiny_settings))


def test_a_start_does_not_jump(jumps: Any, fades: Any, tiny_rig: Any) -> None:
    """Things have come to rest, so that all that changes in the left-out view is what two trainings err differently."""
    sharp, soft = (changes(encoded.path, tiny_rig.held_out) for encoded in (jumps, fades))
    assert max(soft[2:]) < 0.7 * max(sharp[2:]), (soft, sharp)
    assert sharp[-1] == max(sharp[2:]), "without a cross-fade, the start is where it jumps"


def changes(path: Path, camera: str) -> list[float]:
    """Mean change of a camera's view from each frame of a stream to the next."""
    with open_stream(path) as stream:
        seen = [render_view(stream.header, frame.splats, camera, threads=1).image for frame in stream.frames()]
    return [float(np.abs(now - was).mean()) for was, now in pairwise(seen)]


class Noted(DecogsTrainer):
    """Notes the frames that it trains; one diverges."""

    def __init__(self, context: TrainingContext, noted: Counter[int], diverges: int) -> None:
        super().__init__(context)
        self._noted, self._diverges = noted, diverges

    def train(self, frame: FrameInput, /) -> TrainedFrame:
        self._noted[frame.index] += 1
        return replace(super().train(frame), rejected=frame.index == self._diverges)


@pytest.mark.parametrize("diverges", [-1, 6])
def test_a_segment_is_trained_once_for_all_frames_that_go_over_to_it(
    encode: Any, tiny_rig: Any, moving: Any, tiny_settings: Any, tmp_path: Path, diverges: int
) -> None:
    """Its first frame in three rounds, and from there back; those frames are counted on from the start."""
    rig, noted = tiny_rig.write(tmp_path / "rig", frames=(0, 1, 3, 1, 3, 1, 3)), Counter[int]()
    encoded = encode(
        rig,
        settings=replace(tiny_settings, segment=3, closed=True, cross_fade=2),
        keyframe=moving.path,
        context=lambda context: replace(
            context, method=FrameMethod(lambda constants: Noted(constants, noted, diverges))
        ),
    )
    by_itself, backwards = (1, 2, 4, 5), (4, 5, 7, 8)
    rounds = {3: 3, 6: 3 if diverges < 0 else 1}
    assert noted == Counter([*by_itself, *backwards]) + Counter(rounds)
    assert [frame.rejected for frame in encoded.report.frames] == [index == diverges for index in range(7)]


def test_the_start_itself_has_the_same_bits(jumps: Any, fades: Any) -> None:
    """With a cross-fade it is trained for the frames before it, and written as it was trained."""
    for name in (*ATTRIBUTES, "ids"):
        np.testing.assert_array_equal(getattr(fades.states[6], name), getattr(jumps.states[6], name))
    assert len(fades.states) == len(STILL)
    was, now = (stream.report.frames[6] for stream in (jumps, fades))
    assert (now.held_out_psnr, now.bytes, now.effects) == (was.held_out_psnr, was.bytes, was.effects)


def test_a_cross_fade_is_resumed_to_the_same_bytes(
    encode: Any, still_rig: Path, fades: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    for frames in (3, 4, 6):
        path = tmp_path / f"{frames}.dgs"
        path.with_name(f"{path.name}.part").write_bytes(fades.cut_off(frames, 9))
        resumed = encode(still_rig, settings=fading(tiny_settings), output=path, resume=True)
        assert resumed.data == fades.data, frames


def test_no_frame_goes_over_to_another_scene(encode: Any, tiny_rig: Any, tiny_settings: Any, tmp_path: Path) -> None:
    folder = tiny_rig.write(tmp_path / "rig", frames=STILL, noise=1.2)
    for name in tiny_rig.names:
        picture = folder / name / "0006.png"
        other = np.random.default_rng(5).integers(0, 255, (6, 8, 3)).repeat(8, 0).repeat(8, 1)
        tiny_rig.write_png(picture, other[: tiny_rig.height, : tiny_rig.width].astype(np.uint8))
    jumps, fades = (encode(folder, settings=fading(tiny_settings, frames)) for frames in (0, 3))
    assert jumps.report.frames[6].cut
    assert [r.bytes for r in jumps.report.frames] == [r.bytes for r in fades.report.frames]


def test_the_log_has_the_steps_of_the_frames_that_are_written(
    still_rig: Path, fades: Any, tiny_rig: Any, tiny_settings: Any, tmp_path: Path
) -> None:
    log, given = tmp_path / "steps.jsonl", {"threads": 1, "keyframe": fades.path, "holdout": [tiny_rig.held_out]}
    encode_rig(still_rig, tmp_path / "x.dgs", fading(tiny_settings), convergence_log=log, **given)
    stages: dict[int, dict[str, int]] = {}
    for record in map(json.loads, log.read_text().splitlines()):
        counts = stages.setdefault(record["frame"], {})
        counts[record["stage"]] = counts.get(record["stage"], 0) + 1
    assert [frame for frame, counts in stages.items() if "fade" in counts] == [3, 4, 5]
    assert all(counts["fade"] == 80 and counts.get("joint", 40) == 40 for counts in stages.values() if "fade" in counts)
