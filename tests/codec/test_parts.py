"""Round trips of the parts: zigzag, planes, varints, index sets, Morton codes, coded blocks, attribute groups."""

from __future__ import annotations

import hypothesis.extra.numpy as arrays
import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from decogs.codec.coding.entropy import MAX_WINDOW, coded_block, read_block, skip_block
from decogs.codec.coding.groups import CHANNELS, MORTON, read_group, write_residuals, write_values
from decogs.codec.coding.index_sets import read_index_set, read_varints, skip_index_set, write_index_set, write_varints
from decogs.codec.coding.planes import join_planes, split_planes, unzigzag, zigzag
from decogs.codec.scene.morton import morton_codes, morton_order, morton_positions
from decogs.formats.errors import StreamError
from decogs.formats.stream.cursor import Cursor

INT32 = np.iinfo(np.int32)
int32_tables = arrays.arrays(
    np.int32,
    st.tuples(st.integers(0, 40), st.sampled_from([1, 3, 4, 45])),
    elements=st.one_of(st.integers(-3, 3), st.integers(-70000, 70000), st.integers(INT32.min, INT32.max)),
)


def test_zigzag_has_the_values_of_the_specification() -> None:
    values = np.array([0, -1, 1, -2, INT32.max, INT32.min], np.int32)
    codes = zigzag(values)
    assert codes.tolist() == [0, 1, 2, 3, 2**32 - 2, 2**32 - 1]
    assert unzigzag(codes).tolist() == values.tolist()


@given(int32_tables)
def test_planes_round_trip(values: np.ndarray) -> None:
    counts, data = split_planes(zigzag(values))
    assert len(data) == int(counts.sum()) * len(values)
    assert np.array_equal(unzigzag(join_planes(counts, data, len(values))), values)


def test_planes_of_zeros_take_no_bytes_and_large_values_take_four() -> None:
    values = np.array([[0, 1, 300, INT32.min]], np.int32)
    counts, data = split_planes(zigzag(values))
    assert counts.tolist() == [0, 1, 2, 4]
    # Zigzag codes 2, 600 = 0x258 and 0xffffffff: plane 0 of three channels, plane 1 of two, then 2 and 3 of one.
    assert data.hex() == "0258ff" + "02ff" + "ff" + "ff"


@given(st.lists(st.integers(0, 2**35 - 1), max_size=60))
def test_varints_round_trip(values: list[int]) -> None:
    raw = write_varints(np.array(values, np.uint64))
    assert read_varints(Cursor(b""), raw, len(values)).tolist() == values


@pytest.mark.parametrize("raw", [b"\x80", b"\x80\x00", b"\x01\x01", b"", b"\x80\x80\x80\x80\x80\x01"])
def test_varints_refuse_unfinished_long_and_miscounted_numbers(raw: bytes) -> None:
    with pytest.raises(StreamError, match="bad-index-set"):
        read_varints(Cursor(b""), raw, 1)


@given(st.integers(0, 3000), st.floats(0, 1), st.integers(0, 2**32 - 1))
@settings(deadline=None)
def test_index_sets_round_trip(population: int, share: float, seed: int) -> None:
    rows = np.nonzero(np.random.default_rng(seed).random(population) < share)[0]
    data = write_index_set(rows, population, 3)
    cursor = Cursor(data)
    assert np.array_equal(read_index_set(cursor, population), rows)
    assert cursor.remaining == 0
    skipped = Cursor(data)
    skip_index_set(skipped)
    assert skipped.remaining == 0


def test_index_set_is_one_byte_for_none_and_all() -> None:
    assert write_index_set(np.zeros(0, np.int64), 5, 3) == b"\0"
    assert write_index_set(np.arange(5), 5, 3) == b"\1"


def test_clustered_index_set_in_order_costs_under_three_bits_a_row() -> None:
    rng = np.random.default_rng(5)
    rows = np.nonzero(np.repeat(rng.random(2000) < 0.12, 20) & (rng.random(40000) < 0.8))[0]
    assert len(write_index_set(rows, 40000, 19)) * 8 / len(rows) < 3


@pytest.mark.parametrize(
    "data",
    [
        b"\x02" + coded_block(b"\xff\x03"),
        b"\x03\x02\0\0\0" + coded_block(b"\x00\x09"),
        b"\x03\x00\0\0\0" + coded_block(b""),
        b"\x03\xff\xff\xff\xff" + coded_block(b"\x00"),
        b"\x02" + coded_block(b"\xff"),
        b"\x09",
        b"",
    ],
)
def test_index_set_refuses_rows_beyond_the_last_and_wrong_sizes(data: bytes) -> None:
    with pytest.raises(StreamError):
        read_index_set(Cursor(data), 9)


def test_morton_codes_interleave_with_x_lowest() -> None:
    codes = morton_codes(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [3, 3, 3]], np.int32))
    assert codes.tolist() == [0, 1, 2, 4, 63]


@given(arrays.arrays(np.int32, st.tuples(st.integers(1, 50), st.just(3)), elements=st.integers(-(2**20), 2**20 - 1)))
def test_morton_positions_invert_the_codes(means: np.ndarray) -> None:
    origin = means.min(axis=0)
    assert np.array_equal(morton_positions(morton_codes(means)) + origin, means)


def test_morton_order_is_stable_and_takes_the_whole_int32_range() -> None:
    means = np.array([[INT32.max] * 3, [INT32.min] * 3, [INT32.max] * 3, [0, 0, 0]], np.int32)
    assert morton_order(means).tolist() == [1, 3, 0, 2]


@given(st.binary(max_size=400))
def test_blocks_round_trip(raw: bytes) -> None:
    data = coded_block(raw) + b"next"
    cursor = Cursor(data)
    assert read_block(cursor, len(raw), len(raw)) == raw
    assert bytes(cursor.take(4)) == b"next"
    skipped = Cursor(data)
    skip_block(skipped)
    assert skipped.remaining == 4


def test_compressed_blocks_need_a_window_of_at_most_8_mib() -> None:
    raw = np.random.default_rng(0).integers(0, 4, 9 << 20, dtype=np.uint8).tobytes()
    data = coded_block(raw, level=1)
    assert zstandard.get_frame_parameters(data[5:]).window_size <= MAX_WINDOW
    assert read_block(Cursor(data), len(raw), len(raw)) == raw


def _zstd_block(frame: bytes) -> bytes:
    return b"\x01" + len(frame).to_bytes(4, "little") + frame


@pytest.mark.parametrize(
    "frame",
    [
        zstandard.ZstdCompressor().compress(bytes(1 << 20)),
        zstandard.ZstdCompressor(write_content_size=False).compress(bytes(64)),
        zstandard.ZstdCompressor().compress(bytes(64)) * 2,
        zstandard.ZstdCompressor().compress(bytes(64))[:-1],
        b"\x50\x2a\x4d\x18\x04\0\0\0abcd",
        b"not zstd",
        b"",
    ],
    ids=["too much", "size unknown", "two frames", "cut", "skippable frame", "garbage", "empty"],
)
def test_blocks_refuse_frames_that_are_not_exactly_what_was_declared(frame: bytes) -> None:
    with pytest.raises(StreamError, match="bad-compression"):
        read_block(Cursor(_zstd_block(frame)), 64, 64)


def test_blocks_refuse_codecs_of_later_versions() -> None:
    with pytest.raises(StreamError, match="unsupported-mode"):
        read_block(Cursor(b"\x02\x01\0\0\0x"), 1, 1)


@given(int32_tables)
@settings(deadline=None)
def test_residual_groups_round_trip(values: np.ndarray) -> None:
    cursor = Cursor(write_residuals(values, 3))
    assert np.array_equal(read_group(cursor, "sh_dc", *values.shape, values=False), values)
    assert cursor.remaining == 0


@given(int32_tables, st.booleans())
@settings(deadline=None)
def test_value_groups_round_trip(values: np.ndarray, sort: bool) -> None:
    if sort and values.shape[1] == 3:
        values = values[morton_order(values)]
    group = "means" if values.shape[1] == 3 else "sh_rest"
    cursor = Cursor(write_values(values, group, 3))
    assert np.array_equal(read_group(cursor, group, *values.shape, values=True), values)
    assert cursor.remaining == 0


def test_positions_on_a_surface_take_the_morton_mode() -> None:
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(4000, 3))
    means = np.rint(1000 * direction / np.linalg.norm(direction, axis=1, keepdims=True)).astype(np.int32)
    data = write_values(means[morton_order(means)], "means", 19)
    assert data[0] == MORTON


def test_colours_that_are_nearly_grey_are_told_as_differences_between_their_channels() -> None:
    rng = np.random.default_rng(2)
    colours = (rng.integers(-60, 60, (4000, 1)) + rng.integers(-2, 3, (4000, 3))).astype(np.int32)
    data = write_values(colours, "sh_dc", 15)
    assert data[0] == CHANNELS
    assert np.array_equal(read_group(Cursor(data), "sh_dc", *colours.shape, values=True), colours)
    # 120 numbers and more in each channel, 6.9 bits and more each, without looking at the others.
    assert len(data) < 0.8 * 4000 * 3 * 6.9 / 8


def test_constant_channels_take_no_planes() -> None:
    values = np.full((1000, 4), -123456, np.int32)
    assert len(write_values(values, "quaternions", 19)) <= 1 + 16 + 4 + 5


@pytest.mark.parametrize(("mode", "values"), [(1, False), (2, False), (3, False), (4, False), (5, True), (255, True)])
def test_groups_refuse_modes_that_are_not_theirs(mode: int, values: bool) -> None:
    data = bytes([mode]) + bytes(40)
    with pytest.raises(StreamError, match="unsupported-mode"):
        read_group(Cursor(data), "means", 1, 3, values=values)


def test_groups_refuse_morton_codes_beyond_63_bits() -> None:
    for gaps in ([1 << 63], [(1 << 63) - 1, 1 << 63]):
        counts, data = split_planes(np.array(gaps, np.uint64)[:, None])
        group = bytes([MORTON]) + bytes(12) + counts.tobytes() + coded_block(data)
        with pytest.raises(StreamError, match="bad-payload"):
            read_group(Cursor(group), "means", len(gaps), 3, values=True)
