"""Activated values of Gaussians, and numbers as bytes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from decogs.formats.splat_files.quantised import logits, opacities, to_bytes, unit_rotations
from decogs.formats.splats import empty_splats


def test_a_quaternion_of_no_length_is_no_rotation() -> None:
    values = np.float32([[0, 0, 0, 0], [0, 0, -3, 0], [1e-30, 0, 0, 0], [1, 1, 1, 1]])
    np.testing.assert_array_equal(
        unit_rotations(replace(empty_splats(0), quaternions=values)),
        np.float32([[1, 0, 0, 0], [0, 0, -1, 0], [1, 0, 0, 0], [0.5, 0.5, 0.5, 0.5]]),
    )


def test_opacities_of_any_logit_come_back_finite() -> None:
    shown = opacities(replace(empty_splats(0), opacity_logits=np.float32([-1e4, -2, 0, 2, 1e4])))
    np.testing.assert_allclose(shown[[0, 2, 4]], [0, 0.5, 1], atol=1e-30)
    back = logits(shown)
    assert np.isfinite(back).all()
    np.testing.assert_allclose(back[1:4], [-2, 0, 2], atol=1e-6)  # float32
    np.testing.assert_allclose(back[[0, 4]], np.log(1e-6 / (1 - 1e-6)) * np.array([1, -1]), rtol=1e-4)


def test_bytes_are_the_nearest_that_there_are() -> None:
    assert to_bytes(np.float32([-3, 0.49, 0.51, 254.6, 300])).tolist() == [0, 0, 1, 255, 255]
