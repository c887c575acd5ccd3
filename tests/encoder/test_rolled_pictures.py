"""What moves in a keyframe's pictures is put where it is at the frame's instant; what rests stays as recorded."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from decogs.encoder.input.rolled_pictures import at_one_instant
from decogs.formats.cameras import Camera
from decogs.formats.rigs.timeline import RigTime, RowTimes
from decogs.rig.pictures.ingest import RigFrame, View

HEIGHT, WIDTH = 96, 128
SPEED = np.array([4.0, 1.0])
"""Pixels a frame, right and down."""
NOISE = 1 / 255


def texture(seed: int, height: int, width: int) -> np.ndarray:
    noise = np.random.default_rng(seed).uniform(0.1, 0.9, (height // 4, width // 4, 3)).astype(np.float32)
    return cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC).clip(0, 1)


WALL, THING = texture(1, HEIGHT, WIDTH), texture(2, 48, 48)


def shown(time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A thing that moves before a wall, (3, H, W), and what it covers, (H, W): each row at its own ``time`` (H,)."""
    rows, columns = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    across = columns - 30 - (SPEED[0] * time[:, None]).astype(np.float32)
    down = rows - 24 - (SPEED[1] * time[:, None]).astype(np.float32)
    thing = cv2.remap(THING, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    covered = (across >= 0) & (across < 47) & (down >= 0) & (down < 47)
    return np.where(covered[..., None], thing, WALL).transpose(2, 0, 1), covered.astype(np.float32)


def recorded(late: float, readout: float, frame: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    share = (np.arange(HEIGHT) + 0.5) / HEIGHT
    picture, alpha = shown(frame + late + readout * (share - 0.5))
    noise = np.random.default_rng(int(frame) + 5).normal(0, NOISE, picture.shape)
    return (picture + noise).clip(0, 1).astype(np.float32), alpha


CAMERA = Camera("a", WIDTH, HEIGHT, 100.0, 100.0, WIDTH / 2, HEIGHT / 2, np.eye(4))
VIEWS = [View(CAMERA, CAMERA, None), View(replace(CAMERA, name="b"), replace(CAMERA, name="b"), None)]


@pytest.mark.parametrize(("late", "readout"), [(0.0, 0.9), (0.0, -0.5), (0.5, 0.0), (0.3, 0.4)])
def test_what_moves_is_put_where_it_is_at_the_instant(late: float, readout: float) -> None:
    """Of what rows' times change on the thing's inside, nine tenths go; the other camera stays as it was."""
    (now, alpha), (then, later_alpha) = recorded(late, readout), recorded(late, readout, 1)
    wanted, _ = shown(np.zeros(HEIGHT))
    frame = RigFrame(0, [now, now], [], alpha=[alpha, alpha])
    later = RigFrame(1, [then, then], [], alpha=[later_alpha, later_alpha])
    made = at_one_instant(frame, later, VIEWS, {"a": RowTimes(RigTime(late), RigTime(readout))}, map)
    assert made.training[1] is now
    assert made.alpha[1] is alpha
    inside = np.s_[:, 30:65, 36:70]
    before, after = (np.square(each - wanted)[inside].mean() for each in (now, made.training[0]))
    assert after - NOISE**2 < 0.1 * before
    static = np.s_[:, :, 110:]
    np.testing.assert_array_equal(made.training[0][static], now[static])
    # Alpha goes along; edges that are covered or uncovered meanwhile stay.
    _, wanted_alpha = shown(np.zeros(HEIGHT))
    assert np.abs(made.alpha[0] - wanted_alpha).mean() < np.abs(alpha - wanted_alpha).mean()


def test_a_still_picture_and_a_camera_without_the_next_one_stay() -> None:
    (now, _), (then, _) = recorded(0.0, 0.9), recorded(0.0, 0.9, 1)
    times = {"a": RowTimes(readout=RigTime(0.9))}
    frame = RigFrame(0, [now, now], [])
    still = at_one_instant(frame, RigFrame(1, [now, then], []), VIEWS, times, map)
    assert still.training[0] is now
    lost = at_one_instant(frame, RigFrame(1, [then, then], [], lost={"a": "it cannot be read"}), VIEWS, times, map)
    assert lost.training[0] is now
    assert lost.alpha == frame.alpha
