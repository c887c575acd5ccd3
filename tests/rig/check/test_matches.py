"""What neighbouring cameras share: points, and lenses that bend beyond the calibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.decoder.cameras.lens import distort_pixels, undistort_pixels, with_k1
from decogs.encoder.analysis.lens_distortion import LensDistortion
from decogs.formats.cameras import Camera
from decogs.rig.check.light import light_at, light_overall, mismatch, own_light, shared_points
from decogs.rig.check.matches import features_of, find_matches, matched
from decogs.rig.check.recordings import BANDS, Recordings
from decogs.rig.check.rig_statistics import RigStatistics

Views = tuple[list[Camera], list[np.ndarray]]


def statistics_of(cameras: list[Camera], pictures: list[np.ndarray]) -> RigStatistics:
    """A look at one frame, with what is measured on a single one."""
    untold = np.full((len(cameras), 1), np.nan)
    matches = find_matches(cameras, pictures, map)
    points = shared_points(cameras, matches)
    lights = [light_at(picture[None], points.pixels_of(number)) for number, picture in enumerate(pictures)]
    return RigStatistics(
        cameras=tuple(cameras),
        scales=(1.0,) * len(cameras),
        frames=(0,),
        step=1,
        pictures=tuple(picture[None] for picture in pictures),
        noise=untold,
        light=own_light(points, lights, [light_overall(picture[None]) for picture in pictures]),
        mismatch=mismatch(points, lights),
        paths=(),
        matches=matches,
        recordings=Recordings(
            *np.zeros((2, len(cameras), 1), bool), 1, np.zeros(1, bool), np.zeros((len(cameras), 1), bool)
        ),
        details=np.full((len(cameras), BANDS), np.nan),
        moving=(False,) * len(cameras),
    )


def decision(effect: Any, views: Views) -> Any:
    stats = statistics_of(*views)
    return effect.decide(stats, effect.evidence(stats))


def test_straight_lenses_are_told_straight(plane_views: Callable[..., Views]) -> None:
    found = decision(LensDistortion(), plane_views())
    assert not found.detected
    assert found.confidence > 0.9


def test_a_lens_beyond_the_calibration_is_found_and_measured(plane_views: Callable[..., Views]) -> None:
    """k1 to a tenth: the wall is flat, which tells less than a scene with depth."""
    found = decision(LensDistortion(), plane_views(cam03=0.1))
    assert found.cameras == ("cam03",)
    assert found.figures["k1"]["cam03"] == pytest.approx(0.1, rel=0.1)


def test_a_fisheye_beyond_its_calibration_is_measured_in_its_own_k1(plane_views: Callable[..., Views]) -> None:
    """Equidistant pictures, but for one camera's; to a tenth, as above."""
    true = 0.15
    cameras, pictures = plane_views()
    across, down = np.meshgrid(np.arange(352) + 0.5, np.arange(264) + 0.5)
    for number, camera in enumerate(cameras):
        lens = replace(camera, distortion_model="fisheye", distortion=(true if number == 3 else 0.0, 0.0, 0.0, 0.0))
        straight = undistort_pixels(lens, np.stack([across, down], axis=-1)) - 0.5
        pictures[number] = cv2.remap(pictures[number], straight.astype(np.float32), None, cv2.INTER_CUBIC)
        cameras[number] = replace(lens, distortion=(0.0, 0.0, 0.0, 0.0))
    found = decision(LensDistortion(), (cameras, pictures)).figures["k1"]
    assert list(found) == ["cam03"]
    assert with_k1(cameras[3], found["cam03"]).distortion[0] == pytest.approx(true, rel=0.1)


def test_a_calibrated_lens_is_called_for_and_not_found_again(plane_views: Callable[..., Views]) -> None:
    """The corner's displacement is the calibration's own; what it explains is not beyond it."""
    cameras, pictures = plane_views(cam03=0.1)
    cameras[3] = replace(cameras[3], distortion_model="opencv", distortion=(0.1, 0.0, 0.0, 0.0))
    stats = statistics_of(cameras, pictures)
    evidence = LensDistortion().evidence(stats)
    found = LensDistortion().decide(stats, evidence)
    assert found.cameras == ("cam03",)
    assert found.figures["k1"] == {}
    corner = np.array([[0.0, 0.0]])
    assert evidence.peak == pytest.approx(float(np.linalg.norm(distort_pixels(cameras[3], corner) - corner)))


def test_cameras_that_share_nothing_tell_nothing() -> None:
    plain = np.full((264, 352, 3), 90, np.uint8)
    cameras = [Camera(f"cam{k}", 352, 264, 300.0, 300.0, 176.0, 132.0, np.eye(4)) for k in range(3)]
    lens = decision(LensDistortion(), (cameras, [plain] * 3))
    assert (lens.detected, lens.confidence) == (False, 0.0)


def test_matches_are_those_of_opencvs_matcher(plane_views: Callable[..., Views]) -> None:
    """Mutual nearest neighbours whose distance is below 0.8 of the second nearest's."""
    cameras, pictures = plane_views()
    one, two = (features_of(camera, picture) for camera, picture in zip(cameras[:2], pictures[:2], strict=True))
    matcher = cv2.BFMatcher(cv2.NORM_L2)
    back = {match.queryIdx: match.trainIdx for match in matcher.match(two.descriptors, one.descriptors)}
    expected = [
        (best.queryIdx, best.trainIdx)
        for best, second in matcher.knnMatch(one.descriptors, two.descriptors, k=2)
        if best.distance < 0.8 * second.distance and back[best.trainIdx] == best.queryIdx
    ]
    assert len(expected) > 30
    pair = matched(0, 1, one, two)
    np.testing.assert_array_equal(pair.first_pixels, one.pixels[[row for row, _ in expected]])
    np.testing.assert_array_equal(pair.second_pixels, two.pixels[[row for _, row in expected]])


def test_features_of_a_part_lie_in_it(plane_views: Callable[..., Views]) -> None:
    """With most of the whole picture's there, to a tenth of a pixel, and weaker ones. An empty mask has none."""
    cameras, pictures = plane_views()
    mask = np.zeros(pictures[0].shape[:2], np.uint8)
    mask[30:90, 50:110] = 1
    whole, part = features_of(cameras[0], pictures[0]), features_of(cameras[0], pictures[0], mask)
    inside = [mask[tuple(np.floor(each.pixels[:, ::-1]).astype(int).T)] == 1 for each in (whole, part)]
    assert inside[1].all()
    apart = np.linalg.norm(whole.pixels[inside[0], None] - part.pixels[None], axis=2).min(axis=1)
    assert 10 < len(apart) < len(part.pixels)
    assert np.mean(apart < 0.1) > 0.8
    assert not len(features_of(cameras[0], pictures[0], np.zeros_like(mask)).pixels)
