"""Small random scenes, states and deltas; factories, so that property tests can draw as many as they like."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import Delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.scene.lattice import default_lattice
from decogs.codec.scene.state import Attributes, State, take_rows
from decogs.formats.cameras import Camera

INT32 = np.iinfo(np.int32)


def random_attributes(rng: np.random.Generator, n: int, coefficients: int = 1, size: int = 300) -> Attributes:
    def draw(*shape: int) -> np.ndarray:
        return rng.integers(-size, size, (n, *shape), endpoint=True).astype(np.int32)

    return Attributes(draw(3), draw(3), draw(4), draw(), draw(coefficients, 3))


def nudged(rng: np.random.Generator, attributes: Attributes, share: float, size: int) -> Attributes:
    def nudge(values: np.ndarray) -> np.ndarray:
        steps = rng.integers(-size, size, values.shape, endpoint=True) * (rng.random(values.shape) < share)
        return values + steps.astype(np.int32)

    return Attributes(
        nudge(attributes.means),
        nudge(attributes.log_scales),
        nudge(attributes.quaternions),
        nudge(attributes.opacity_logits),
        nudge(attributes.sh),
    )


def random_delta(rng: np.random.Generator, state: State, touched: int, removed: int, added: int) -> Delta:
    rows = rng.permutation(len(state))[:touched]
    gone = rng.permutation(len(state))[:removed]
    current = nudged(rng, take_rows(state, rows), 0.5, 40)
    return difference(state, rows, current, removed=gone, added=random_attributes(rng, added, state.coefficients))


@dataclass(frozen=True)
class Samples:
    """What the tests of this folder build their cases from."""

    attributes: Callable[..., Attributes] = random_attributes
    delta: Callable[..., Delta] = random_delta

    def state(self, rng: np.random.Generator, n: int, coefficients: int = 1, size: int = 300) -> State:
        return keyframe_state(random_attributes(rng, n, coefficients, size))[0]

    def header(self, sh_degree: int = 0) -> StreamHeader:
        camera = Camera("cam00", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))
        return StreamHeader(cameras=(camera,), lattice=default_lattice(4.0), sh_degree=sh_degree)

    def same(self, first: Attributes, second: Attributes) -> bool:
        """Equal integers, and for states equal ids, counters and running sums too."""
        names = ["means", "log_scales", "quaternions", "opacity_logits", "sh"]
        if isinstance(first, State) and isinstance(second, State):
            names.append("ids")
            if (first.next_id, first.row_sum) != (second.next_id, second.row_sum):
                return False
        return all(np.array_equal(getattr(first, name), getattr(second, name)) for name in names)


@pytest.fixture(scope="session")
def samples() -> Samples:
    return Samples()
