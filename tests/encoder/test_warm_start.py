"""Where the selected Gaussians have gone, by the views' optical flow, and medians over a neighbourhood."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.encoder.settings.frame import EmergenceSettings, FrameSettings
from decogs.encoder.training.warm_start import _fitted, _Flow, shared_displacements
from decogs.formats.cameras import project
from one_frame import Case, moved_square

UNTRAINED = FrameSettings(joint_iterations=0, grow_fraction=0.0, emergence=EmergenceSettings(max_seeds=0))
GONE = 0.1
"""What the tiny rig's square moves to the right in frame 1, world units; its pictures are 64 pixels across."""


@pytest.fixture(scope="module")
def case(moving_rig: Path, tiny_rig: Any) -> Case:
    return moved_square(moving_rig, tiny_rig)


def moved(case: Case, share: float = 1.0, **other: Any) -> np.ndarray:
    """Displacements (25, 3) of the square before the first step."""
    frame = case.train(replace(UNTRAINED, warm_start=share), **other)
    return frame.values.means - case.scene.means[case.selected]


def test_what_moves_begins_where_it_has_gone(case: Case) -> None:
    """Four fifths of the way are there before the first step, and no more than a tenth of it aside."""
    gone = moved(case)
    assert np.median(gone[:, 0]) > 0.8 * GONE
    assert np.abs(np.median(gone[:, 1:], axis=0)).max() < 0.1 * GONE
    np.testing.assert_allclose(moved(case, 0.5), 0.5 * gone, atol=1e-6)
    assert not moved(case, 0.0).any()


def test_what_light_alone_changes_stays(case: Case) -> None:
    lit = np.zeros(len(case.scene), bool)
    lit[np.flatnonzero(case.selected)[:10]] = True
    gone = moved(case, light_only=lit)
    assert not gone[:10].any()
    assert gone[10:].any(axis=1).all()
    assert not moved(case, relit=True).any(), "light says nothing of places where it changes everything"


def test_a_backdrop_stays(case: Case) -> None:
    """Shadows move over it."""
    left = np.quantile(case.scene.means[case.selected][:, 0], 0.4)
    stage: Any = SimpleNamespace(on_backdrop=lambda xyz: xyz[:, 0] < left, free=lambda xyz: np.zeros(len(xyz), bool))
    is_left = case.scene.means[case.selected][:, 0] < left
    gone = moved(case, stage=stage)
    assert not gone[is_left].any()
    assert gone[~is_left].any(axis=1).all()


def test_what_did_not_change_stays_beside_what_moves(case: Case) -> None:
    """Pixels of a region of interest that are still have no flow, whatever moves beside them."""
    masks, changed = case.masks(everywhere=True), []
    for number, view in enumerate(case.ingest.views):
        columns = project(view.pinhole, case.scene.means[case.selected])[0].astype(int)
        middle = int(np.median(columns))
        raw = masks[number].dilated & (np.arange(case.pictures[number].shape[2]) < middle)
        masks[number] = replace(masks[number], raw=raw)
        changed.append(columns < middle)
    gone, free = moved(case, masks=masks), moved(case)
    assert free.any(axis=1).all()
    still, moves = ~np.any(changed, axis=0), np.all(changed, axis=0)
    assert still.any()
    assert moves.any()
    assert not gone[still].any()
    assert (gone[moves, 0] > 0.5 * GONE).all()


def test_nothing_is_told_outside_of_the_regions_of_interest(case: Case) -> None:
    masks = case.masks(everywhere=False)
    assert not moved(case, masks=masks).any()


def test_results_do_not_depend_on_threads(case: Case) -> None:
    np.testing.assert_array_equal(moved(case, threads=1), moved(case, threads=5))


def slopes_of(random: np.random.Generator, rows: int) -> np.ndarray:
    """Projections of a view from somewhere, 50 pixels a unit."""
    way = np.linalg.qr(random.normal(size=(3, 3)))[0][:2]
    return np.tile(50 * way, (rows, 1, 1))


def test_a_displacement_fits_the_views_but_for_one_that_shows_what_is_behind() -> None:
    random = np.random.default_rng(0)
    true = random.normal(0, 0.2, (40, 3))
    flows = []
    for view in range(6):
        slopes = slopes_of(random, 40)
        flow = np.einsum("nij,nj->ni", slopes, true) * (view != 2)
        flows.append(_Flow(np.arange(40), slopes, flow))
    found, known = _fitted(flows, 40)
    assert known.all()
    np.testing.assert_allclose(found, true, atol=0.02)


def test_one_view_is_not_enough() -> None:
    random = np.random.default_rng(1)
    seen = [_Flow(np.arange(count), slopes_of(random, count), np.ones((count, 2))) for count in (4, 9)]
    _, known = _fitted(seen, 12)
    np.testing.assert_array_equal(known[4:], False)


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
