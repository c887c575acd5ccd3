"""Where things are expected next: velocities over deferred frames, and medians over a neighbourhood."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.encoder.frame.commit import _motion_after
from decogs.encoder.training.warm_start import Motion, shared_displacements


def written_out(means: np.ndarray, displacements: np.ndarray, neighbours: int) -> np.ndarray:
    squares = ((means[:, None].astype(np.float64) - means[None]) ** 2).sum(axis=2)
    nearest = np.argsort(squares, axis=1)[:, :neighbours]
    return np.median(displacements[nearest], axis=1)


@pytest.mark.parametrize("neighbours", [3, 24])
def test_medians_over_the_nearest(neighbours: int) -> None:
    random = np.random.default_rng(0)
    means = random.normal(size=(400, 3)).astype(np.float32)
    displacements = random.normal(size=(400, 3)).astype(np.float32)
    found = shared_displacements(means, displacements, neighbours)
    np.testing.assert_array_equal(found, written_out(means, displacements, neighbours).astype(np.float32))


def test_a_new_gaussian_moves_with_its_neighbours_and_an_outlier_does_not_count() -> None:
    random = np.random.default_rng(1)
    means = random.normal(size=(50, 3)).astype(np.float32)
    displacements = np.tile(np.float32([0.1, 0, -0.2]), (50, 1))
    displacements[7] = 0
    displacements[9] = 50
    found = shared_displacements(means, displacements, 12)
    np.testing.assert_array_equal(found, np.tile(np.float32([0.1, 0, -0.2]), (50, 1)))


@pytest.mark.parametrize("count", [0, 1, 5])
def test_fewer_gaussians_than_neighbours(count: int) -> None:
    random = np.random.default_rng(2)
    means, displacements = random.normal(size=(2, count, 3)).astype(np.float32)
    found = shared_displacements(means, displacements, 24)
    assert found.shape == (count, 3)
    if count:
        np.testing.assert_allclose(found, np.tile(np.median(displacements, axis=0), (count, 1)), rtol=1e-6)
    np.testing.assert_array_equal(shared_displacements(means, displacements, 1), displacements)


WAY = np.float32([[0.5, 0, 0], [0, -0.25, 1]])


def test_what_moves_goes_on_as_far_as_frames_have_passed() -> None:
    """Frames 1, 3 and 4 are trained and 2 is deferred: what moved up to 3 took two frames, up to 4 one."""
    scene: Any = SimpleNamespace(displacements=lambda before: WAY, state=None)

    def after(motion: Motion, *, deferred: bool) -> Motion:
        plan: Any = SimpleNamespace(deferred=deferred)
        frame: Any = SimpleNamespace(restarted=False, scene=scene, memory=SimpleNamespace(motion=motion))
        return _motion_after(frame, plan, scene)

    trained = after(Motion.at_rest(2), deferred=False)
    np.testing.assert_array_equal(trained.predict(), WAY)
    waiting = after(trained, deferred=True)
    np.testing.assert_array_equal(waiting.predict(), 2 * WAY)
    again = after(waiting, deferred=False)
    np.testing.assert_array_equal(again.predict(), WAY / 2)
    np.testing.assert_array_equal(after(again, deferred=False).predict(), WAY)


def test_a_restarted_frame_has_no_velocity() -> None:
    given: Any = SimpleNamespace(
        restarted=True, deferred=False, state=range(2), memory=SimpleNamespace(motion=Motion(WAY))
    )
    assert not _motion_after(given, given, given).predict().any()
