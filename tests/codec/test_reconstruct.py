"""The closed loop: what the writers write, reconstruction turns into exactly the state that was meant."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from damaged_streams import EVERY
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import new_state
from decogs.codec.packets.syntax import payload_costs, refers_to_first, write_delta, write_key, write_skip
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.digest import digest
from decogs.codec.scene.state import Attributes, empty_attributes, take_rows
from decogs.formats.errors import StreamError
from decogs.formats.stream.container import PACKET_OVERHEAD, Packet, PacketKind, packet_bytes

INT32 = np.iinfo(np.int32)


def key(state) -> Packet:
    return Packet(PacketKind.KEY, state.frame, write_key(state, level=3).payload)


def referring_key(state, first) -> Packet:
    """A keyframe coded as the difference from the first one, which must be the smaller way."""
    packet = Packet(PacketKind.KEY, state.frame, write_key(state, first=first, level=3).payload)
    assert refers_to_first(packet)
    return packet


def delta_packet(state, delta) -> Packet:
    return Packet(PacketKind.DELTA, state.frame + 1, write_delta(state, delta, level=3).payload)


@given(st.integers(0, 2**32 - 1), st.integers(0, 80), st.integers(0, 3), st.sampled_from([3, 300, INT32.max]))
@settings(deadline=None)
def test_key_packets_round_trip(samples, seed, n, degree, size) -> None:
    state = samples.state(np.random.default_rng(seed), n, (degree + 1) ** 2, size=size)
    assert samples.same(reconstruct(None, key(state), samples.header(degree)), state)


@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 60),
    touched=st.integers(0, 60),
    removed=st.integers(0, 60),
    added=st.integers(0, 20),
    degree=st.integers(0, 3),
    size=st.sampled_from([3, 300, INT32.max]),
)
@settings(deadline=None)
def test_delta_packets_round_trip(samples, seed, n, touched, removed, added, degree, size) -> None:
    rng, header = np.random.default_rng(seed), samples.header(degree)
    encoder = samples.state(rng, n, (degree + 1) ** 2, size=size)
    decoder = reconstruct(None, key(encoder), header)
    for _ in range(3):
        delta = samples.delta(rng, encoder, touched, removed, added)
        packet = delta_packet(encoder, delta)
        encoder, decoder = apply_delta(encoder, delta), reconstruct(decoder, packet, header)
        assert samples.same(decoder, encoder)
        assert decoder.frame == encoder.frame == packet.frame


def test_listed_ids_round_trip_in_a_later_keyframe(samples) -> None:
    rng, header = np.random.default_rng(0), samples.header()
    state = samples.state(rng, 50)
    state = apply_delta(state, samples.delta(rng, state, 5, 20, 3))
    packet = key(state)
    assert samples.same(reconstruct(None, packet, header), state)
    assert payload_costs(packet, 1)["ids"] > 0
    far = new_state(take_rows(state, np.arange(3)), ids=np.array([0, 2**34, 2**62]), next_id=2**63 - 1)
    with pytest.raises(ValueError, match="apart"):
        write_key(far)
    far = new_state(take_rows(state, np.arange(3)), ids=np.array([2**62, 2**62 + 1, 2**62 + 2**34]))
    assert samples.same(reconstruct(None, key(far), header), far)


@given(
    seed=st.integers(0, 2**32 - 1),
    touched=st.integers(0, 60),
    removed=st.integers(0, 40),
    added=st.integers(0, 5),
    degree=st.integers(0, 3),
)
@settings(deadline=None, max_examples=40)
def test_later_keyframes_refer_to_the_first(samples, seed, touched, removed, added, degree) -> None:
    rng, header = np.random.default_rng(seed), samples.header(degree)
    first = state = samples.state(rng, 120, (degree + 1) ** 2)
    for _ in range(3):
        state = apply_delta(state, samples.delta(rng, state, touched, min(removed, len(state)), added))
    packet = Packet(PacketKind.KEY, state.frame, write_key(state, first=first, level=3).payload)
    assert len(packet.payload) <= len(key(state).payload)
    for before in (None, first):
        after = reconstruct(before, packet, header, first=first)
        assert samples.same(after, state)
        assert after.frame == 3
    assert sum(payload_costs(packet, first.coefficients).values()) == len(packet.payload)


def test_a_referring_keyframe_costs_what_has_changed_since_the_first(samples) -> None:
    rng, header = np.random.default_rng(0), samples.header()
    first = samples.state(rng, 3000)
    for frame in (1, 7):
        packet = referring_key(replace(first, frame=frame), first)
        assert len(packet.payload) == 36
        assert samples.same(reconstruct(None, packet, header, first=first), first)
    delta = samples.delta(rng, first, 50, 4, 3)
    state = apply_delta(first, delta)
    packet, by_itself = referring_key(state, first), delta_packet(first, delta)
    assert len(packet.payload) <= len(by_itself.payload) + 30, "the delta, and the key packet's own fields"
    assert set(payload_costs(packet, 1)) >= {"index", "removed", "means", "added.means"}
    gone = apply_delta(state, difference(state, np.arange(0), empty_attributes(1), removed=np.array([len(state) - 2])))
    listed = referring_key(gone, first)
    assert payload_costs(listed, 1)["ids"] > 0
    assert samples.same(reconstruct(None, listed, header, first=first), gone)


def test_what_does_not_descend_from_the_first_keyframe_is_written_whole(samples) -> None:
    rng = np.random.default_rng(0)
    first, stranger = samples.state(rng, 40), samples.state(rng, 41)
    assert write_key(stranger, first=first) == write_key(stranger)
    sparse = new_state(take_rows(first, np.arange(0, 40, 2)), ids=first.ids[::2], next_id=first.next_id)
    assert write_key(first, first=sparse) == write_key(first), "an id between those of the first"


def test_a_referring_keyframe_needs_the_right_first_one(samples) -> None:
    rng, header = np.random.default_rng(0), samples.header()
    first = samples.state(rng, 300)
    state = apply_delta(first, samples.delta(rng, first, 9, 2, 2))
    packet = referring_key(state, first)
    assert reason_of(None, packet, header) == "missing-key"
    assert reason_of(None, packet, header, first=samples.state(rng, 300)) == "digest-mismatch"
    assert reason_of(None, packet, header, first=samples.state(rng, 299)) in {"bad-payload", "bad-index-set"}
    assert reason_of(None, packet, header, first=first, max_gaussians=299) == "too-many-gaussians"
    for offset, value, reason in ((16, 299, "bad-payload"), (22, 299, "bad-payload"), (20, 2, "unsupported-mode")):
        damaged = bytearray(packet.payload)
        damaged[offset : offset + 2] = value.to_bytes(2, "little")
        assert reason_of(None, Packet(PacketKind.KEY, 1, bytes(damaged)), header, first=first) == reason


def test_empty_keyframe_then_additions(samples) -> None:
    rng, header = np.random.default_rng(0), samples.header(1)
    state = new_state(empty_attributes(4))
    packet = key(state)
    assert len(packet.payload) == 31
    state = reconstruct(None, packet, header)
    delta = difference(state, np.arange(0), empty_attributes(4), added=samples.attributes(rng, 9, 4))
    after = reconstruct(state, delta_packet(state, delta), header)
    assert samples.same(after, apply_delta(state, delta))


def test_removal_of_everything(samples) -> None:
    state = samples.state(np.random.default_rng(0), 40)
    delta = difference(state, np.arange(0), empty_attributes(1), removed=np.arange(40))
    packet = delta_packet(state, delta)
    assert len(packet.payload) == 14
    assert len(reconstruct(state, packet, samples.header())) == 0


def test_all_equal_attributes_cost_next_to_nothing(samples) -> None:
    n = 5000
    same = Attributes(*(np.full(shape, -77777, np.int32) for shape in ((n, 3), (n, 3), (n, 4), (n,), (n, 1, 3))))
    state = new_state(same)
    packet = key(state)
    assert len(packet.payload) < 200
    assert samples.same(reconstruct(None, packet, samples.header()), state)


def test_extremes_of_32_bits_go_back_and_forth(samples) -> None:
    shapes = ((2, 3), (2, 3), (2, 4), (2,), (2, 4, 3))
    low, high = (Attributes(*(np.full(s, v, np.int32) for s in shapes)) for v in (INT32.min, INT32.max))
    header, state = samples.header(1), new_state(low)
    state = reconstruct(None, key(state), header)
    for target in (high, low, high):
        state = reconstruct(state, delta_packet(state, difference(state, np.arange(2), target)), header)
        assert samples.same(target, take_rows(state, np.arange(2)))


def test_accumulated_deltas_wrap_on_both_sides_alike(samples) -> None:
    header, encoder = samples.header(), new_state(samples.attributes(np.random.default_rng(0), 3, size=5))
    decoder = reconstruct(None, key(encoder), header)
    for _ in range(5):
        moved = replace(take_rows(encoder, np.arange(3)), opacity_logits=encoder.opacity_logits + np.int32(2**30 + 1))
        delta = difference(encoder, np.arange(3), moved)
        packet = delta_packet(encoder, delta)
        encoder, decoder = apply_delta(encoder, delta), reconstruct(decoder, packet, header)
        assert samples.same(decoder, encoder)


def test_skip_packets_are_a_few_bytes_and_change_nothing(samples) -> None:
    state = samples.state(np.random.default_rng(0), 40)
    payload = write_skip(state).payload
    assert len(packet_bytes(PacketKind.SKIP, 1, payload)) == PACKET_OVERHEAD + 8 <= 64
    after = reconstruct(state, Packet(PacketKind.SKIP, 1, payload), samples.header())
    assert samples.same(after, state)
    assert after.frame == 1
    assert after.means is state.means


@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
@settings(deadline=None)
def test_costs_add_up_and_can_be_told_from_the_bytes(samples, seed, degree) -> None:
    rng, coefficients = np.random.default_rng(seed), (degree + 1) ** 2
    state = samples.state(rng, 30, coefficients)
    delta = samples.delta(rng, state, *rng.integers(0, 30, 3))
    for kind, coded in (
        (PacketKind.KEY, write_key(state)),
        (PacketKind.DELTA, write_delta(state, delta)),
        (PacketKind.SKIP, write_skip(state)),
    ):
        assert sum(coded.costs.values()) == len(coded.payload)
        assert payload_costs(Packet(kind, 0, coded.payload), coefficients) == coded.costs


def test_equal_input_gives_equal_bytes(samples) -> None:
    first, second = (samples.state(np.random.default_rng(8), 500, 4) for _ in range(2))
    assert write_key(first).payload == write_key(second).payload


def reason_of(state, packet, header, **limits) -> str:
    with pytest.raises(StreamError) as caught:
        reconstruct(state, packet, header, **limits)
    return caught.value.reason


def test_a_delta_on_the_wrong_state_is_noticed(samples) -> None:
    rng, header = np.random.default_rng(0), samples.header()
    state = samples.state(rng, 40)
    packet = delta_packet(state, samples.delta(rng, state, 10, 0, 2))
    off_by_one = take_rows(state, np.arange(40))
    log_scales = off_by_one.log_scales.copy()
    log_scales[39, 2] += 1
    other = new_state(replace(off_by_one, log_scales=log_scales))
    assert reason_of(other, packet, header) == "digest-mismatch"
    assert reason_of(other, Packet(PacketKind.SKIP, 1, write_skip(state).payload), header) == "digest-mismatch"


def test_frames_must_follow_each_other(samples) -> None:
    state, header = samples.state(np.random.default_rng(0), 4), samples.header()
    skip = write_skip(state).payload
    assert reason_of(None, Packet(PacketKind.SKIP, 0, skip), header) == "missing-key"
    assert reason_of(state, Packet(PacketKind.SKIP, 0, skip), header) == "frame-order"
    assert reason_of(state, Packet(PacketKind.SKIP, 2, skip), header) == "frame-order"
    assert reason_of(state, key(state), header) == "frame-order"
    assert reason_of(state, Packet(PacketKind.END, 1, skip), header) == "misplaced-packet"


def test_limits_hold_before_anything_is_allocated(samples) -> None:
    rng, header = np.random.default_rng(0), samples.header()
    state = samples.state(rng, 40)
    assert reason_of(None, key(state), header, max_gaussians=39) == "too-many-gaussians"
    grown = difference(state, np.arange(0), empty_attributes(1), added=samples.attributes(rng, 3))
    assert reason_of(state, delta_packet(state, grown), header, max_gaussians=42) == "too-many-gaussians"
    huge = bytearray(key(state).payload)
    huge[16:20] = b"\xff\xff\xff\xff"
    assert reason_of(None, Packet(PacketKind.KEY, 0, bytes(huge)), header) == "too-many-gaussians"


def test_errors_name_packet_and_offset(samples) -> None:
    state = samples.state(np.random.default_rng(0), 4)
    packet = Packet(PacketKind.KEY, 0, key(state).payload + b"x", True, ordinal=7, offset=1000)
    with pytest.raises(StreamError) as caught:
        reconstruct(None, packet, samples.header())
    assert (caught.value.packet, caught.value.offset) == (7, 1000 + 20 + len(packet.payload) - 1)


def _accepts_or_refuses(state, kind, payload, header, first=None) -> None:
    """Damage that no checksum caught: an error, or a state whose digest the payload declares. Never anything else."""
    packet = Packet(kind, 0 if state is None else 1, payload)
    try:
        after = reconstruct(state, packet, header, first=first, max_gaussians=1000)
    except StreamError:
        return
    assert digest(after) == int.from_bytes(payload[:8], "little")


@pytest.mark.parametrize("step", EVERY)
@pytest.mark.parametrize("degree", [0, 2])
def test_cut_and_flipped_payloads_are_refused(samples, degree, step: int) -> None:
    rng, header = np.random.default_rng(0), samples.header(degree)
    state = samples.state(rng, 40, (degree + 1) ** 2)
    delta = samples.delta(rng, state, 20, 5, 6)
    for before, kind, payload in (
        (None, PacketKind.KEY, write_key(state).payload),
        (None, PacketKind.KEY, referring_key(apply_delta(state, delta), state).payload),
        (state, PacketKind.DELTA, write_delta(state, delta).payload),
        (state, PacketKind.SKIP, write_skip(state).payload),
    ):
        for size in range(0, len(payload), step):
            with pytest.raises(StreamError):
                reconstruct(before, Packet(kind, 0 if before is None else 1, payload[:size]), header, first=state)
        for position in range(0, len(payload), step):
            flipped = bytearray(payload)
            flipped[position] ^= 1 << (position % 8)
            _accepts_or_refuses(before, kind, bytes(flipped), header, state)


@given(data=st.data())
@settings(deadline=None, max_examples=60)  # make fuzz draws tens of thousands
def test_mutated_payloads_raise_stream_errors_only(samples, data) -> None:
    rng, header = np.random.default_rng(1), samples.header(1)
    state = samples.state(rng, 30, 4)
    delta = samples.delta(rng, state, 10, 5, 6)
    before, kind, payload = data.draw(
        st.sampled_from(
            [
                (None, PacketKind.KEY, write_key(state, level=1).payload),
                (None, PacketKind.KEY, referring_key(apply_delta(state, delta), state).payload),
                (state, PacketKind.DELTA, write_delta(state, delta, level=1).payload),
            ]
        )
    )
    mutated = bytearray(payload)
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(mutated)))
        mutated[start : start + data.draw(st.integers(0, 8))] = data.draw(st.binary(max_size=8))
    _accepts_or_refuses(before, kind, bytes(mutated), header, state)


@given(st.sampled_from([PacketKind.KEY, PacketKind.DELTA, PacketKind.SKIP]), st.binary(max_size=200))
@settings(deadline=None)
def test_random_payloads_raise_stream_errors_only(samples, kind, payload) -> None:
    state = None if kind == PacketKind.KEY else samples.state(np.random.default_rng(1), 30)
    _accepts_or_refuses(state, kind, payload, samples.header())
