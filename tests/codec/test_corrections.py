"""The corrections block: what a frame says of its cameras' faults, written and read back."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import (
    LARGEST,
    CorrectedCameras,
    Correction,
    turn,
    write_corrections,
)
from decogs.codec.packets.frame_payload import split_payload
from decogs.codec.packets.syntax import write_skip
from decogs.codec.reconstruct import reconstruct
from decogs.formats.errors import StreamError
from decogs.formats.stream.container import PACKET_HEADER_SIZE, Packet, PacketKind

ALL = CorrectedCameras(("b", "a"), ("a",), ("c", "a"))
number = st.integers(-LARGEST, LARGEST)


@given(st.lists(number, min_size=10, max_size=10), st.binary(max_size=20))
def test_the_block_comes_back_and_leaves_the_rest(numbers: list[int], rest: bytes) -> None:
    told = {
        "a": Correction(*numbers[:6]),
        "b": Correction(exposure=numbers[6]),
        "c": Correction(yaw=numbers[7], pitch=numbers[8], roll=numbers[9]),
    }
    block = write_corrections(told, ALL)
    found, body = split_payload(Packet(PacketKind.SKIP, 3, block + rest, offset=50), ALL)
    assert found == told
    assert (body.payload, body.offset, body.frame) == (block + rest, 50, 3)
    cursor = body.cursor()
    assert (cursor.remaining, bytes(cursor.take(len(rest)))) == (len(rest), rest)


def test_the_block_lies_as_specified() -> None:
    told = {"a": Correction(1, -2, 3, 4, 5, -6), "b": Correction(7), "c": Correction(0, 0, 0, 8, 9, 10)}
    numbers = [7, 1, -2, 3, 8, 9, 10, 4, 5, -6]
    assert write_corrections(told, ALL) == np.array(numbers, "<i2").tobytes()
    assert ALL.block_bytes == 20


def test_cameras_of_which_nothing_is_known_get_zeros() -> None:
    assert write_corrections({}, ALL) == bytes(20)


def test_streams_without_corrected_cameras_have_no_block() -> None:
    packet = Packet(PacketKind.SKIP, 0, b"12345678")
    found, body = split_payload(packet, CorrectedCameras())
    assert (found, write_corrections({}, CorrectedCameras())) == ({}, b"")
    assert body is packet


def test_numbers_too_large_are_not_written() -> None:
    with pytest.raises(ValueError, match="32767"):
        write_corrections({"b": Correction(exposure=LARGEST + 1)}, ALL)


@pytest.mark.parametrize("size", [0, 1, 19])
def test_a_payload_shorter_than_the_block_is_refused_where_it_lies(size: int) -> None:
    with pytest.raises(StreamError) as caught:
        split_payload(Packet(PacketKind.KEY, 0, bytes(size), ordinal=1, offset=700), ALL)
    assert (caught.value.reason, caught.value.packet) == ("bad-payload", 1)
    assert caught.value.offset == 700 + PACKET_HEADER_SIZE


def test_odds_are_multiplied_by_channel() -> None:
    assert Correction(exposure=4096, red=-4096, blue=2048).odds_gain == (1.0, math.e, math.exp(1.5))
    assert Correction(yaw=5).odds_gain == (1.0, 1.0, 1.0)


@given(*[st.floats(-1.5, 1.5)] * 3)
def test_a_turn_is_the_product_of_its_three(yaw: float, pitch: float, roll: float) -> None:
    def about(axis: int, angle: float) -> np.ndarray[Any, Any]:
        c, s, rotation = math.cos(angle), math.sin(angle), np.eye(3)
        one, other = (axis + 1) % 3, (axis + 2) % 3
        rotation[one, one] = rotation[other, other] = c
        rotation[other, one], rotation[one, other] = s, -s
        return rotation

    product = about(1, yaw) @ about(0, pitch) @ about(2, roll)
    np.testing.assert_allclose(turn(yaw, pitch, roll), product, atol=1e-15)


def test_the_scene_knows_nothing_of_corrections(samples: Any) -> None:
    """The same state follows with and without the block; a payload without it is none of such a stream."""
    state, header = samples.state(np.random.default_rng(0), 5), samples.header()
    name, payload = header.cameras[0].name, write_skip(state).payload
    corrected = replace(header, effects=("exposure_drift",), corrected=CorrectedCameras(exposure_drift=(name,)))
    assert StreamHeader.from_bytes(corrected.to_bytes()).corrected == corrected.corrected
    block = write_corrections({name: Correction(exposure=-300)}, corrected.corrected)
    plain = reconstruct(state, Packet(PacketKind.SKIP, 1, payload), header)
    assert samples.same(plain, reconstruct(state, Packet(PacketKind.SKIP, 1, block + payload), corrected))
    with pytest.raises(StreamError, match="bad-payload"):
        reconstruct(state, Packet(PacketKind.SKIP, 1, payload), corrected)


def test_a_header_without_corrections_says_nothing_of_them(samples: Any) -> None:
    assert b"corrected" not in samples.header().to_bytes()
