"""The codec at the ends of its range: what fits comes back to the bit, what does not is refused, nothing is clipped."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key
from decogs.codec.reconstruct import reconstruct
from decogs.codec.scene.digest import digest
from decogs.codec.scene.lattice import Lattice, default_lattice, dequantise, quantise
from decogs.codec.scene.state import ARRAYS, Attributes, State, take_rows
from decogs.encoder.coding.changes import quantise_changes
from decogs.encoder.settings.frame import SignificanceSettings
from decogs.formats.cameras import Camera
from decogs.formats.errors import TrainingError
from decogs.formats.splats import Splats
from decogs.formats.stream.container import Packet, PacketKind

INT32 = np.iinfo(np.int32)
EXTREMES = np.array([INT32.min, INT32.min + 1, -1, 0, 1, INT32.max - 1, INT32.max], np.int32)
HEADER = StreamHeader(
    cameras=(Camera("cam00", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4)),), lattice=default_lattice(4.0), sh_degree=1
)


def filled(count: int, draw: object) -> Attributes:
    """``count`` Gaussians whose every integer ``draw(shape)`` gives."""
    shapes = ((count, 3), (count, 3), (count, 4), (count,), (count, 4, 3))
    return Attributes(*(np.asarray(draw(shape), np.int32) for shape in shapes))  # type: ignore[operator]


def extreme(seed: int, count: int) -> Attributes:
    random = np.random.default_rng(seed)
    return filled(count, lambda shape: random.choice(EXTREMES, shape))


def through_key(state: State) -> State:
    payload = write_key(state).payload
    return reconstruct(
        None, Packet(kind=PacketKind.KEY, critical=True, frame=0, payload=payload, offset=0, ordinal=1), HEADER
    )


def through_delta(before: State, after: Attributes) -> State:
    """What a decoder that has ``before`` makes of the packet that leads to ``after``; checked against the encoder's."""
    delta = difference(before, np.arange(len(before)), after)
    payload, frame = write_delta(before, delta).payload, before.frame + 1
    packet = Packet(kind=PacketKind.DELTA, critical=True, frame=frame, payload=payload, offset=0, ordinal=frame + 1)
    decoded = reconstruct(before, packet, HEADER)
    assert digest(decoded) == digest(apply_delta(before, delta))
    return decoded


def equal(first: Attributes, second: Attributes) -> bool:
    return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in ARRAYS)


def splats_of(**changed: np.ndarray) -> Splats:
    plain = {
        "means": np.zeros((1, 3)),
        "log_scales": np.zeros((1, 3)),
        "quaternions": np.array([[1.0, 0, 0, 0]]),
        "opacity_logits": np.zeros(1),
        "sh": np.zeros((1, 4, 3)),
    }
    return Splats(**{name: np.ascontiguousarray(array, np.float32) for name, array in (plain | changed).items()})


def test_lattice_extremes_are_escaped_never_clipped() -> None:
    for seed in range(5):
        state, _ = keyframe_state(extreme(seed, 40))
        decoded = through_key(state)
        assert equal(decoded, state)
        assert equal(through_delta(decoded, extreme(100 + seed, 40)), extreme(100 + seed, 40))


@pytest.mark.parametrize("name", ["means", "log_scales", "opacity_logits", "sh"])
@pytest.mark.parametrize("sign", [1, -1])
def test_values_beyond_the_lattice_are_refused_by_name(name: str, sign: int) -> None:
    """The last lattice point is taken, the one beyond it refused: nothing is clipped in between."""
    lattice = Lattice((0, 0, 0), (1e-3, 1e-3, 1e-3), 1e-3, 1 / 32, 1e-3, 1e-3, 1e-3)
    value = np.float64(INT32.max) * 1e-3
    inside = np.full_like(getattr(splats_of(), name), sign * value * (1 - 1e-6))
    points = getattr(quantise(splats_of(**{name: inside}), lattice), name)
    assert (np.abs(points / (sign * np.float64(INT32.max)) - 1) < 2e-6).all()
    with pytest.raises(TrainingError, match=f"{name} do not fit 32 bits") as raised:
        quantise(splats_of(**{name: inside * 1.001}), lattice)
    assert "\n" not in str(raised.value)


def test_accumulated_deltas_that_overflow_stay_equal_on_both_sides() -> None:
    """Residuals add up modulo 2^32: a value that wraps at one frame is the encoder's at every frame."""
    state = through_key(keyframe_state(filled(9, lambda shape: np.full(shape, INT32.max - 5)))[0])
    expected = {name: getattr(state, name).astype(np.int64) for name in ARRAYS}
    for step in (3, 2**30 + 1, 2**31 - 1, -7, -(2**31)):
        expected = {name: array + step for name, array in expected.items()}
        wrapped = Attributes(*(expected[name].astype(np.int32) for name in ARRAYS))
        state = through_delta(state, wrapped)
        assert equal(state, wrapped)
    for array in vars(dequantise(state, HEADER.lattice)).values():
        assert np.isfinite(array).all()


def test_a_change_that_is_common_elsewhere_never_leaves_32_bits() -> None:
    """Bits are worth everything, so that the commonest change is taken wherever it can be: beyond the last integer the
    value stays as trained."""
    unit = Lattice((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), 1.0, 1.0, 1.0, 1.0, 1.0)
    before = filled(200, lambda shape: np.zeros(shape))
    before.quaternions[:] = (1, 0, 0, 0)
    before.means[0] = INT32.max - 127  # float32 has every 128th integer there.
    values = dequantise(before, unit)
    values.means[1:] += 256
    values.means[0] -= 256
    nothing = Splats(*(np.zeros_like(array) for array in vars(values).values()))
    moved = quantise_changes(values, before, unit, nothing, SignificanceSettings(rd_lambda=1.0))
    assert (moved.means[1:] == 256).all()
    np.testing.assert_array_equal(moved.means[0], quantise(values, unit).means[0])


def test_all_equal_attributes_come_back_and_cost_next_to_nothing() -> None:
    """A channel without entropy: no division by a width or spread of zero anywhere."""
    for value in (0, 7, INT32.min, INT32.max):
        same, _ = keyframe_state(filled(3000, lambda shape, value=value: np.full(shape, value)))
        decoded = through_key(same)
        assert equal(decoded, same)
        assert len(write_key(same).payload) < 250
        onward = filled(3000, lambda shape, value=value: np.full(shape, value // 2))
        assert equal(through_delta(decoded, onward), onward)


@pytest.mark.parametrize("name", ARRAYS)
def test_denormals_are_numbers_like_any_other(name: str) -> None:
    """Denormals round to lattice point 0 (a quaternion keeps its direction), and a lattice of denormal steps does not
    turn them into NaN."""
    tiny = np.full_like(getattr(splats_of(), name), 1e-41)
    points = quantise(splats_of(**{name: tiny}), HEADER.lattice)
    if name == "quaternions":
        assert points.quaternions.tolist() == [[32, 32, 32, 32]]
    else:
        assert not getattr(points, name).any()
    for array in vars(dequantise(points, HEADER.lattice)).values():
        assert np.isfinite(array).all()
    fine = replace(HEADER.lattice, means=(1e-41, 1e-41, 1e-41))
    exact = quantise(splats_of(means=np.full((1, 3), 1e-39)), fine)
    np.testing.assert_array_equal(dequantise(exact, fine).means, np.float32([[1e-39] * 3]))


def test_negative_zero_is_zero_on_the_lattice() -> None:
    """-0.0 and 0.0 are one lattice point: no change, no bytes, and no sign that encoder and decoder see differently."""
    plus = splats_of()
    minus = splats_of(
        **{name: -np.zeros_like(getattr(plus, name)) for name in ARRAYS if name != "quaternions"},
        quaternions=np.float32([[1, -0.0, -0.0, -0.0]]),
    )
    assert np.signbit(minus.means).all()
    state = through_key(keyframe_state(quantise(plus, HEADER.lattice))[0])
    points = quantise(minus, HEADER.lattice, near=take_rows(state, np.arange(1)))
    assert equal(points, state)
    assert len(difference(state, np.arange(1), points).rows) == 0
    assert not np.signbit(dequantise(points, HEADER.lattice).sh).any()
