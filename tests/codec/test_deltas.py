"""Applying deltas: what is touched, removed, added; what is left alone; the digest kept up to date."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from decogs.codec.packets.deltas import Delta, apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state, new_state
from decogs.codec.scene.digest import combine, digest, mix, row_hashes
from decogs.codec.scene.state import NARROW, Attributes, all_rows, empty_attributes, take_rows

INT32 = np.iinfo(np.int32)
ARRAYS = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
SHAPES = ((3, 3), (3, 3), (3, 4), (3,), (3, 4, 3))
NONE = np.zeros(0, np.int64)
cases = given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 60),
    touched=st.integers(0, 60),
    removed=st.integers(0, 60),
    added=st.integers(0, 20),
    degree=st.integers(0, 3),
)


@cases
@settings(deadline=None)
def test_running_digest_equals_the_full_one(samples, seed, n, touched, removed, added, degree) -> None:
    rng = np.random.default_rng(seed)
    state = samples.state(rng, n, (degree + 1) ** 2)
    for _ in range(3):
        state = apply_delta(state, samples.delta(rng, state, touched, removed, added))
        hashes = row_hashes(state, state.ids)
        assert np.array_equal(state.hashes, hashes)
        assert digest(state) == combine(int(hashes.sum()), len(state), state.next_id)


@cases
@settings(deadline=None)
def test_rows_outside_the_delta_are_bit_identical(samples, seed, n, touched, removed, added, degree) -> None:
    rng = np.random.default_rng(seed)
    state = samples.state(rng, n, (degree + 1) ** 2)
    delta = samples.delta(rng, state, touched, removed, added)
    copies = {name: getattr(state, name).copy() for name in (*ARRAYS, "ids")}
    after = apply_delta(state, delta)
    for name, copy in copies.items():
        assert np.array_equal(getattr(state, name), copy)
    alone = np.setdiff1d(np.arange(n), np.concatenate([delta.rows, delta.removed]))
    where = np.searchsorted(after.ids, state.ids[alone])
    assert np.array_equal(after.ids[where], state.ids[alone])
    assert samples.same(take_rows(after, where), take_rows(state, alone))


@cases
@settings(deadline=None)
def test_difference_leads_to_the_values_it_was_made_from(samples, seed, n, touched, removed, added, degree) -> None:
    rng = np.random.default_rng(seed)
    state = samples.state(rng, n, (degree + 1) ** 2, size=INT32.max)
    rows, gone = rng.permutation(n)[:touched], rng.permutation(n)[:removed]
    current = samples.attributes(rng, len(rows), state.coefficients, size=INT32.max)
    new = samples.attributes(rng, added, state.coefficients)
    after = apply_delta(state, difference(state, rows, current, removed=gone, added=new))
    stays = np.setdiff1d(np.arange(n), gone)
    assert after.ids.tolist() == [*state.ids[stays], *range(state.next_id, state.next_id + added)]
    expected = take_rows(state, np.arange(n))
    for name in ARRAYS:
        getattr(expected, name)[rows] = getattr(current, name)
    assert samples.same(take_rows(after, np.arange(len(stays))), take_rows(expected, stays))
    appended = take_rows(after, np.arange(len(stays), len(after)))
    assert sorted(appended.means.tolist()) == sorted(new.means.tolist())


def test_a_delta_without_content_shares_every_array(samples) -> None:
    state = samples.state(np.random.default_rng(0), 30)
    after = apply_delta(state, difference(state, np.zeros(0, np.int64), empty_attributes(1)))
    assert after.frame == state.frame + 1
    assert all(np.shares_memory(getattr(after, name), getattr(state, name)) for name in ARRAYS)


def test_only_the_groups_that_change_are_copied(samples) -> None:
    state = samples.state(np.random.default_rng(0), 30)
    rows = np.array([3, 5])
    moved = take_rows(state, rows)
    moved = replace(moved, means=moved.means + np.int32(1))
    after = apply_delta(state, difference(state, rows, moved))
    assert np.shares_memory(after.sh, state.sh)
    assert not np.shares_memory(after.means, state.means)


def test_rows_that_do_not_change_or_are_removed_are_left_out(samples) -> None:
    state = samples.state(np.random.default_rng(1), 30)
    rows = np.array([9, 2, 5, 7])
    current = take_rows(state, rows)
    log_scales = current.log_scales.copy()
    log_scales[:3] += 1
    delta = difference(state, rows, replace(current, log_scales=log_scales), removed=np.array([5]))
    assert delta.rows.tolist() == [2, 9]
    assert list(delta.residuals) == ["log_scales"]


def test_residuals_wrap_at_32_bits(samples) -> None:
    state = samples.state(np.random.default_rng(2), 1)
    low = Attributes(*(np.full_like(getattr(all_rows(state), name), INT32.min) for name in ARRAYS))
    bottom = new_state(low)
    high = replace(low, means=np.full((1, 3), INT32.max, np.int32))
    delta = difference(bottom, np.array([0]), high)
    assert delta.residuals["means"].tolist() == [[-1, -1, -1]]
    after = apply_delta(bottom, delta)
    assert after.means.tolist() == [[INT32.max] * 3]
    assert np.array_equal(after.hashes, row_hashes(after, after.ids))


@pytest.mark.parametrize("dtype", [np.int8, np.int16, np.int32])
@pytest.mark.parametrize("edge", [NARROW, -NARROW])
def test_an_array_is_wide_from_when_an_integer_leaves_the_narrow_ones(dtype, edge: int) -> None:
    """The largest step of each type of residual, away from zero, at either end of the narrow integers."""
    state, none = new_state(Attributes(*(np.full(shape, edge, np.int32) for shape in SHAPES))), empty_attributes(4)
    assert {getattr(state, name).dtype for name in ARRAYS} == {np.dtype(np.int16)}
    step = np.iinfo(dtype).max if edge > 0 else np.iinfo(dtype).min
    after = apply_delta(state, Delta(np.array([1]), {"sh_rest": np.full((1, 9), step, dtype)}, NONE, none))
    assert (after.sh.dtype, after.means.dtype) == (np.int32, np.int16)
    wide = all_rows(state)
    wide.sh[1, 1:] += np.int32(step)
    assert np.array_equal(after.sh, wide.sh)
    back = apply_delta(after, Delta(np.array([0]), {"sh_dc": np.ones((1, 3), dtype)}, NONE, none))
    wide.sh[0, 0] += np.int32(1)
    assert np.array_equal(back.sh, wide.sh)
    assert np.array_equal(back.hashes, row_hashes(wide, back.ids))


def test_a_gaussian_of_large_integers_widens_the_arrays_it_joins(samples) -> None:
    rng = np.random.default_rng(8)
    state = samples.state(rng, 12)
    large = replace(samples.attributes(rng, 1), means=np.full((1, 3), INT32.max, np.int32))
    after = apply_delta(state, difference(state, NONE, empty_attributes(1), removed=np.array([3]), added=large))
    assert (after.means.dtype, after.sh.dtype) == (np.int32, np.int16)
    assert after.means.tolist() == [*np.delete(state.means, 3, axis=0).tolist(), [INT32.max] * 3]
    assert np.array_equal(after.hashes, row_hashes(after, after.ids))


def test_everything_can_be_removed_and_ids_are_not_reused(samples) -> None:
    rng = np.random.default_rng(3)
    state = samples.state(rng, 12)
    empty = apply_delta(state, difference(state, np.arange(0), empty_attributes(1), removed=np.arange(12)))
    assert len(empty) == 0
    assert empty.row_sum == 0
    again = apply_delta(empty, difference(empty, np.arange(0), empty_attributes(1), added=samples.attributes(rng, 2)))
    assert again.ids.tolist() == [12, 13]


def test_state_arrays_cannot_be_written(samples) -> None:
    state = samples.state(np.random.default_rng(0), 5)
    with pytest.raises(ValueError, match="read-only"):
        state.means[0] = 0


@pytest.mark.parametrize("rows", [[-1], [30], [2, 2], [0.5], [[1]]])
def test_difference_refuses_rows_that_are_none(samples, rows: list) -> None:
    state = samples.state(np.random.default_rng(0), 30)
    with pytest.raises(ValueError, match="row"):
        difference(state, np.array(rows), take_rows(state, np.zeros(np.size(rows), np.int64)))


def test_difference_refuses_values_of_another_length_or_degree(samples) -> None:
    rng = np.random.default_rng(0)
    state = samples.state(rng, 30)
    with pytest.raises(ValueError, match="values"):
        difference(state, np.array([1, 2]), samples.attributes(rng, 3))
    with pytest.raises(ValueError, match="degree"):
        difference(state, np.array([1]), samples.attributes(rng, 1, 4))


def test_ids_must_increase(samples) -> None:
    attributes = samples.attributes(np.random.default_rng(0), 3)
    for ids in ([0, 2, 2], [3, 2, 1], [-1, 0, 1], [0, 1]):
        with pytest.raises(ValueError, match="ids"):
            new_state(attributes, ids=np.array(ids))
    with pytest.raises(ValueError, match="next id"):
        new_state(attributes, next_id=2)


def test_keyframe_order_maps_rows_to_the_callers(samples) -> None:
    attributes = samples.attributes(np.random.default_rng(4), 50)
    state, order = keyframe_state(attributes, 7, first_id=100)
    assert samples.same(take_rows(attributes, order), take_rows(state, np.arange(50)))
    assert (state.frame, state.next_id, state.ids[0]) == (7, 150, 100)


def test_mix_is_splitmix64() -> None:
    # Second and third output of the published generator seeded with 0 (Vigna, splitmix64.c).
    golden = 0x9E3779B97F4A7C15
    assert mix(golden) == 0xE220A8397B1DCDAF
    assert mix(2 * golden) == 0x6E789E6AA1B965F4


def test_digest_tells_swapped_rows_channels_and_counters_apart(samples) -> None:
    state = samples.state(np.random.default_rng(5), 20)
    base = digest(state)
    swapped = new_state(take_rows(state, np.array([1, 0, *range(2, 20)])))
    turned = new_state(replace(take_rows(state, np.arange(20)), means=all_rows(state).means[:, ::-1].copy()))
    assert len({base, digest(swapped), digest(turned), digest(replace(state, next_id=99))}) == 4


def test_digest_by_the_letter_of_the_specification(samples) -> None:
    """The same numbers from plain integers, one row after the other."""
    state, mask = samples.state(np.random.default_rng(6), 5, 4), (1 << 64) - 1
    keys = [mix((j + 1) * 0x9E3779B97F4A7C15) | 1 for j in range(60)]
    total = 0
    for row in range(5):
        values = [int(state.ids[row])]
        for name in ARRAYS:
            values += getattr(state, name)[row].reshape(-1).tolist()
        total += mix(sum(key * value for key, value in zip(keys, values, strict=False)) & mask)
    assert digest(state) == mix(mix(mix(total & mask) + 5) + state.next_id)


def test_a_row_both_touched_and_removed_is_gone(samples) -> None:
    state = samples.state(np.random.default_rng(7), 6)
    step = np.ones((2, 3), np.int32)
    both = Delta(np.array([1, 4]), {"means": step}, np.array([1, 2]), empty_attributes(1))
    alone = Delta(np.array([4]), {"means": step[:1]}, np.array([1, 2]), empty_attributes(1))
    after = apply_delta(state, both)
    assert samples.same(after, apply_delta(state, alone))
    assert after.ids.tolist() == [0, 3, 4, 5]
    assert np.array_equal(after.means[2], state.means[4] + 1)
    assert np.array_equal(after.hashes, row_hashes(after, after.ids))
