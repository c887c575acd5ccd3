"""Profiles: what a stream asks of a player, frame after frame, and what the header says of it."""

from __future__ import annotations

import json
import math
from itertools import pairwise

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.profiles import BUFFER_SECONDS, PROFILES, load
from decogs.codec.scene.lattice import default_lattice
from decogs.formats.cameras import Camera

HEADER = StreamHeader((Camera("a", 8, 8, 5.0, 5.0, 4.0, 4.0, np.eye(4)),), default_lattice(1.0))
PHONE = PROFILES["phone"]
FPS = 25.0
RATE = PHONE.bytes_per_second / FPS
ROOM = BUFFER_SECONDS * PHONE.bytes_per_second


def of_sizes(*sizes: float, gaussians: int = 1, sh_degree: int = 0, fps: float | None = FPS) -> str:
    return load([(gaussians, math.floor(size)) for size in sizes], sh_degree, fps).profile


def test_a_first_frame_fills_the_buffer_and_no_more() -> None:
    assert of_sizes(ROOM) == "phone"
    assert of_sizes(ROOM + 1) == "headset"


def test_frames_at_the_rate_go_on_for_ever_and_larger_ones_fill_the_buffer() -> None:
    assert of_sizes(ROOM, *[RATE] * 500) == "phone"
    # 51 frames more than the rate by RATE overflow the buffer of 50.
    assert of_sizes(*[2 * RATE] * 49) == "phone"
    assert of_sizes(*[2 * RATE] * 51) == "headset"


def test_what_was_not_fetched_in_time_is_not_saved() -> None:
    """A pause gives no more room than the buffer has."""
    assert of_sizes(*[0] * 500, ROOM + 1) == "headset"


@pytest.mark.parametrize(
    ("gaussians", "sh_degree", "fps", "expected"),
    [
        (PHONE.gaussians, PHONE.sh_degree, FPS, "phone"),
        (PHONE.gaussians + 1, 0, FPS, "headset"),
        (1, PHONE.sh_degree + 1, FPS, "desktop"),
        (PROFILES["desktop"].gaussians + 1, 0, FPS, ""),
        (1, 0, None, ""),
    ],
)
def test_the_first_profile_with_enough_room(gaussians: int, sh_degree: int, fps: float | None, expected: str) -> None:
    assert of_sizes(1, gaussians=gaussians, sh_degree=sh_degree, fps=fps) == expected


def test_each_profile_has_room_for_what_those_before_it_have() -> None:
    rising = [(each.gaussians, each.sh_degree, each.bytes_per_second) for each in PROFILES.values()]
    for one, other in pairwise(rising):
        assert all(a <= b for a, b in zip(one, other, strict=True))


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (["phone"], ("phone",)),
        (["of later"], ("of later",)),
        ([""], ("",)),
        (["phone", "desktop"], ()),
        ([], ()),
        ("phone", ()),
        ([1], ()),
        (["x" * 33], ()),
        (["\n"], ()),
    ],
)
def test_what_is_out_of_bounds_counts_as_absent(said: object, expected: tuple[str, ...]) -> None:
    document = {**json.loads(HEADER.to_bytes()), "profiles": said}
    assert StreamHeader.from_bytes(json.dumps(document).encode()).profiles == expected
