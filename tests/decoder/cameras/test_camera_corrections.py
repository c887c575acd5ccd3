"""What a camera recorded, from what the scene shows: colours and pose."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import ANGLE_STEP, Correction, turn
from decogs.codec.scene.lattice import default_lattice
from decogs.decoder.cameras.corrections import apply_gain, as_it_stood
from decogs.decoder.rendering.views import correction_of
from decogs.formats.cameras import Camera, camera_centre

POSE = np.eye(4)
POSE[:3, :3] = turn(0.4, -0.3, 1.0)
POSE[:3, 3] = [0.5, -2.0, 7.0]
CAMERA = Camera("a", 100, 80, 90.0, 91.0, 50.0, 40.0, POSE)


@given(st.floats(0, 1), st.floats(-3, 3))
def test_odds_are_multiplied_and_the_inverse_undoes_it(value: float, shift: float) -> None:
    odds = float(np.exp(shift))
    seen = np.full((1, 3), value)
    recorded = apply_gain(seen, (odds, odds, odds))
    assert np.all((recorded >= 0) & (recorded <= 1))
    if max(value, recorded[0, 0]) < 1 - 1e-9:  # beyond, 1 - value has fewer than seven digits left
        assert recorded[0, 0] / (1 - recorded[0, 0]) == pytest.approx(odds * value / (1 - value), rel=1e-6)
    np.testing.assert_allclose(apply_gain(recorded, (1 / odds,) * 3), seen, atol=1e-12)


def test_black_white_and_what_lies_beyond_stay() -> None:
    values = np.array([[-0.2, 0.0, 1.0], [1.7, 30.0, 1.0]], np.float32)
    assert apply_gain(values, (1.4, 0.3, 2.0)).tobytes() == values.tobytes()


def test_channels_have_odds_of_their_own() -> None:
    shown = apply_gain(np.full((2, 3), 0.5), (3.0, 1.0, 1 / 3))
    np.testing.assert_allclose(shown, [[0.75, 0.5, 0.25]] * 2)


def test_a_turned_camera_sees_directions_through_its_rotation() -> None:
    correction = Correction(yaw=9000, pitch=-5000, roll=20000)
    stood = as_it_stood(CAMERA, correction)
    rotation = turn(*(angle * ANGLE_STEP for angle in (9000, -5000, 20000)))
    np.testing.assert_allclose(stood.world_to_camera[:3], (rotation.T @ POSE[:3]), atol=1e-12)
    np.testing.assert_allclose(camera_centre(stood), camera_centre(CAMERA), atol=1e-12)
    assert stood.world_to_camera[3].tolist() == [0, 0, 0, 1]


def test_a_camera_that_was_not_turned_is_itself() -> None:
    assert as_it_stood(CAMERA, Correction(exposure=5, red=3)) is CAMERA


def test_a_held_out_camera_is_shown_with_the_others_fall_off() -> None:
    cameras = tuple(replace(CAMERA, name=name) for name in ("a", "b", "left out"))
    colours = {"a": Correction(exposure=40, falloff=900), "b": Correction(falloff=1200)}
    header = StreamHeader(cameras, default_lattice(1.0), held_out=("left out",), camera_colours=colours)
    assert correction_of(header, "left out", {}) == Correction(falloff=900)
    assert correction_of(header, "left out", None) is None, "drift-free"
    assert correction_of(header, "a", {}) == colours["a"]
