"""The starts that agree best with what pairs of cameras say, where these contradict each other."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from decogs.rig.synchronisation.agreement import Agreement, agreement
from decogs.rig.synchronisation.joint import StartEstimate, _lead, joint_starts

REACH, EVIDENCE = 6, 40.0


def pair(first: int, second: int, lag: float, evidence: float = EVIDENCE) -> Agreement:
    """Two cameras whose agreement is a parabola about ``lag``."""
    curve = 1 - ((np.arange(-REACH, REACH + 1) - lag) / REACH) ** 2
    return Agreement(first, second, evidence * np.maximum(curve, 0), curve)


def found(starts: list[float], wrong: dict[tuple[int, int], float] | None = None) -> StartEstimate:
    """Of cameras with these starts, whose pairs say so but for those that are ``wrong`` by some frames."""
    pairs = combinations(range(len(starts)), 2)
    return joint_starts(
        len(starts), [pair(a, b, starts[b] - starts[a] + (wrong or {}).get((a, b), 0.0)) for a, b in pairs]
    )


def from_first(joint: StartEstimate) -> np.ndarray:
    return np.asarray(joint.starts - joint.starts[0])


STARTS = [0.0, 2.25, -1.5, 0.75, 1.0]


@pytest.mark.parametrize(
    ("evidence", "lead"),
    [([0, 8, 9, 7, 5, 0, 6], 3), ([9, 8, 1, 0, 0], 8), ([0, 2, 0, 8, 9], 7), ([8, 9, 8], 9), ([4, 0, 4, 0], 0)],
    ids=["beside it", "first", "last", "alone", "twice"],
)
def test_a_pair_leads_by_what_its_best_lag_has_over_those_not_beside_it(evidence: list[float], lead: float) -> None:
    assert _lead(Agreement(0, 1, np.array(evidence, np.float64), np.zeros(len(evidence)))) == lead


def test_pairs_that_agree_tell_fractions_exactly() -> None:
    joint = found(STARTS)
    assert from_first(joint) == pytest.approx(STARTS, abs=1e-2)  # by what ties the starts to whole frames
    assert joint.pair_agreement.tolist() == [1.0] * 5
    # All that is left is what a calibration's faults may hide: .08 of the evidence of a parabola 6 frames wide.
    assert joint.errors == pytest.approx([np.sqrt(0.08 * 2 * REACH**2 / 2 / 4)] * 5, rel=0.02)


def test_a_pair_that_contradicts_the_others_counts_less() -> None:
    """Wrong by 1.4 frames, it would move each of its cameras by a fifth of it, if it counted as the others."""
    joint = found(STARTS, {(1, 3): 1.4})
    assert from_first(joint) == pytest.approx(STARTS, abs=0.15)
    assert joint.pair_agreement.tolist() == [1.0] * 5, "it is within 1.5 frames"
    agreed = found(STARTS).errors
    # Its pairs share their faults: twice the error that a mean of four would have, of which one is off by all of it.
    weight = 0.25 / 1.4
    scatter = weight * 1.4**2 / (3 + weight) / 3
    assert joint.errors[[1, 3]] ** 2 - agreed[[1, 3]] ** 2 == pytest.approx([4 * scatter] * 2, rel=0.15)
    assert joint.errors[[0, 2, 4]] == pytest.approx(agreed[[0, 2, 4]], rel=0.05)


def test_a_pair_that_is_frames_off_has_no_vote_and_no_say() -> None:
    joint = found(STARTS, {(1, 3): 4.0})
    assert from_first(joint) == pytest.approx(STARTS, abs=1e-2)
    assert joint.pair_agreement == pytest.approx([1, 0.75, 1, 0.75, 1], abs=0.01)


def test_a_pair_whose_best_lag_says_little_does_not_count() -> None:
    told = [pair(0, 1, 2.0), pair(1, 2, 1.0), pair(0, 2, 3.0), pair(2, 3, 1.0, evidence=2.9)]
    joint = joint_starts(4, told)
    assert from_first(joint)[:3] == pytest.approx([0, 2, 3], abs=1e-2)
    assert np.isnan([joint.starts[3], joint.errors[3]]).all()
    assert joint.pair_agreement[3] == 0


def at_lag(first: int, second: int, lag: int, evidence: float, reach: int = REACH) -> Agreement:
    """Two cameras that agree at one lag only."""
    spike = (np.arange(-reach, reach + 1) == lag).astype(np.float64)
    return Agreement(first, second, evidence * spike, spike)


def test_the_pair_that_stands_out_most_is_overruled_by_all_others_together() -> None:
    """Beginning with it, two pairs of cameras stay four frames apart, beyond what the weaker ones were compared at."""
    beside = [at_lag(0, 2, 0, 20.0), at_lag(1, 3, 0, 20.0)]
    across = [at_lag(0, 3, 0, 6.0, reach=3), at_lag(1, 2, 0, 6.0, reach=3), at_lag(2, 3, 0, 6.0, reach=3)]
    assert joint_starts(4, [*beside, *across, at_lag(0, 1, 4, 10.0)]).starts == pytest.approx([0] * 4, abs=1e-9)
    alone = joint_starts(4, [*beside, *across, at_lag(0, 1, 4, 19.0)])
    assert from_first(alone) == pytest.approx([0, 4, 0, 4], abs=1e-9)


def test_agreement_needs_five_changes_that_both_cameras_recorded() -> None:
    signal = np.random.default_rng(1).normal(size=(1, 9, 20)).astype(np.float32)
    of_lags = agreement(0, 1, signal, signal, reach=6)
    assert np.flatnonzero(np.isfinite(of_lags.correlation)).tolist() == [2, 3, 4, 5, 6, 7, 8, 9, 10]  # lags -4 to 4
    assert of_lags.correlation[6] == pytest.approx(1)
