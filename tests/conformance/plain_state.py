"""Section 5 of the plain decoder: a scene's state, its digest, and its values on the lattice."""

from __future__ import annotations

from dataclasses import dataclass, field

from plain_container import TWO_TO_64
from plain_header import Header


@dataclass(frozen=True)
class State:
    """The scene after a frame (section 5): rows of integers, each with an id; and what is told of its cameras."""

    frame: int
    next_id: int
    ids: list[int]
    rows: list[list[int]]
    corrections: dict[str, dict[str, int]] = field(default_factory=dict)


# Section 5: state and lattice


def wrapped(integer: int) -> int:
    """The integer modulo 2^32, in two's complement."""
    return (integer + 2**31) % 2**32 - 2**31


def mix(z: int) -> int:
    z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9 % TWO_TO_64
    z = (z ^ (z >> 27)) * 0x94D049BB133111EB % TWO_TO_64
    return z ^ (z >> 31)


def digest(state: State, channels: int) -> int:
    keys = [mix((j + 1) * 0x9E3779B97F4A7C15 % TWO_TO_64) | 1 for j in range(channels + 1)]
    total = 0
    for name, row in zip(state.ids, state.rows, strict=True):
        products = (key * value for key, value in zip(keys[1:], row, strict=True))
        total += mix((keys[0] * name + sum(products)) % TWO_TO_64)
    return mix((mix((mix(total % TWO_TO_64) + len(state.ids)) % TWO_TO_64) + state.next_id) % TWO_TO_64)


def floats(state: State, header: Header) -> list[list[float]]:
    """Mean, log-scales, quaternion, opacity logit and SH of each row, in float64; float32 is one rounding away."""
    lattice = header.lattice
    shown = []
    for row in state.rows:
        means = [row[axis] * lattice["means"][axis] + lattice["origin"][axis] for axis in range(3)]
        log_scales = [min(max(value * lattice["log_scales"], -40.0), 40.0) for value in row[3:6]]
        quaternion = [value * lattice["quaternions"] for value in row[6:10]] if any(row[6:10]) else [1.0, 0.0, 0.0, 0.0]
        opacity_logit = min(max(row[10] * lattice["opacity_logits"], -80.0), 80.0)
        sh_dc = [value * lattice["sh_dc"] for value in row[11:14]]
        sh_rest = [value * lattice["sh_rest"] for value in row[14:]]
        shown.append([*means, *log_scales, *quaternion, opacity_logit, *sh_dc, *sh_rest])
    return shown
