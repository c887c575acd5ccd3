"""Streams in layers whose base is not trained: every fourth Gaussian, with values that differ at random."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from decogs.codec.header.layer_list import Layer
from decogs.codec.packets.keyframes import new_state
from decogs.codec.scene.state import ARRAYS, Attributes, State, take_rows
from decogs.decoder.editing import edit
from decogs.decoder.editing.operations.base import Operation
from decogs.decoder.editing.take import Frame, Take

ONE_IN = 4


@dataclass(frozen=True)
class AnyLayers(Operation):
    """Offsets are a Gaussian's own, from ``refreshed`` on others, and hold while it is there."""

    refreshed: int = 1 << 30
    name = "any-layers"
    summary = "for tests"

    def edit(self, take: Take, open_other: object) -> Take:
        def read(start: int, stop: int) -> Iterator[Frame]:
            for number, frame in enumerate(take.read(start, stop), start=start):
                yield replace(frame, base=some_of(frame.state, number >= self.refreshed), coded=None)

        return replace(take, header=replace(take.header, layers=(Layer(0, 0.0, 30.0), Layer(0, 0.0))), read=read)

    @staticmethod
    def add_options(parser: object) -> None:
        """None."""

    @classmethod
    def of_options(cls, options: object) -> AnyLayers:
        return cls()


def some_of(state: State, is_late: bool = False) -> State:
    """A base of a scene; its members are told by ids alone."""
    rows = np.flatnonzero(state.ids % ONE_IN == 0)
    values, ids = take_rows(state, rows), state.ids[rows]
    shift = ((ids * 7 + 3 * is_late) % 11 - 5).astype(np.int32)
    moved = {n: getattr(values, n) + shift.reshape(-1, *[1] * (getattr(values, n).ndim - 1)) for n in ARRAYS}
    return new_state(Attributes(**moved), state.frame, ids=ids, next_id=state.next_id)


def layered(stream: Path, output: Path, *, refreshed: int = 1 << 30) -> Path:
    """The stream in layers."""
    edit(stream, output, [AnyLayers(refreshed)])
    return output


def flat(values: np.ndarray) -> np.ndarray:
    return values.reshape(len(values), int(np.prod(values.shape[1:]))).astype(np.int64)


def rows_of(state: State) -> np.ndarray:
    """All Gaussians' integers (N, channels), in an order of their own."""
    rows = np.concatenate([flat(getattr(state, n)) for n in ARRAYS], axis=1)
    return rows[np.lexsort(rows.T)]
