"""``grade``: exposure, white balance and saturation of all, or of a region."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.keyframes import new_state
from decogs.codec.scene.state import State, all_rows
from decogs.formats.cli.command_line import Parser, colour, number
from decogs.formats.errors import UsageError
from decogs.formats.splats import SH_C0

from ..regions import REGION_HELP, Region, region_of
from ..scene import positions
from ..segments import rows_among, with_choices
from ..take import Frame, Take
from .base import Opener, Operation

_LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Shares of red, green and blue in brightness (BT.709)."""

_GAMMA = 2.2
"""Of display-referred values: a stop of light multiplies them by 2^(1/2.2)."""

_MOST_STOPS = 10.0

_LARGEST_HARMONIC = 0.75
"""No harmonic of degree 1 to 3 is above this in any direction."""


@dataclass(frozen=True)
class Grade(Operation):
    """Changes colours, display-referred values as they are stored, and rounds them to the colours' lattice.

    One after the other: ``white``, RGB, becomes a grey of the same brightness; ``exposure`` in stops; ``saturation``, 1
    as it is, 0 none. ``region``: only Gaussians whose centres lie in it in any frame of a segment; the others keep
    their bits. A row whose colour does not change goes on not changing, so that deltas stay small.
    """

    exposure: float = 0.0
    white: tuple[float, float, float] = (1.0, 1.0, 1.0)
    saturation: float = 1.0
    region: Region | None = None
    name = "grade"
    summary = "exposure, white balance and saturation, of all or of a region"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same frames in other colours. Raises UsageError for values that are none."""
        if not (abs(self.exposure) <= _MOST_STOPS and 0 <= self.saturation <= _MOST_STOPS and min(self.white) > 0):
            raise UsageError("grade: give an exposure of -10 to 10, a saturation of 0 to 10, and a white above 0")
        matrix, lattice = self.matrix, take.header.lattice
        if np.array_equal(matrix, np.eye(3)):
            raise UsageError("grade: nothing is to be done; say what to change")
        note = f"grade: rounded to the lattice of colours, by at most {lattice.sh_dc * SH_C0 / 2:.3f} of 0 to 1"
        if take.header.sh_degree:
            note += f", and {lattice.sh_rest * _LARGEST_HARMONIC / 2:.3f} for each harmonic"
        region = self.region
        if region is None:
            graded = take.each_scene(lambda state: _graded(take.header, state, matrix, np.ones(len(state), bool)))
            return graded.with_note(note)
        chosen = with_choices(take, lambda state: [region.depth(positions(take.header, state)) >= 0])

        def read(start: int, stop: int) -> Iterator[Frame]:
            for frame, (ids,) in chosen(start, stop):
                yield frame.of(_graded(take.header, frame.state, matrix, rows_among(frame.state, ids)))

        return replace(take, read=read).with_note(note)

    @property
    def matrix(self) -> NDArray[np.float64]:
        """What becomes of red, green and blue (3, 3)."""
        white = np.array(self.white)
        balanced = np.diag(_LUMA @ white / white)
        saturated = self.saturation * np.eye(3) + (1 - self.saturation) * np.tile(_LUMA, (3, 1))
        return np.asarray(saturated @ (2 ** (self.exposure / _GAMMA) * balanced))

    @staticmethod
    def add_options(parser: Parser) -> None:
        """What is done, in this order."""
        parser.add_argument(
            "--white", type=colour, metavar="R,G,B", help="the colour that becomes grey, as a card shows it"
        )
        parser.add_argument("--exposure", type=number, default=0.0, metavar="STOPS", help="brighter, or darker below 0")
        parser.add_argument("--saturation", type=number, default=1.0, metavar="S", help="1 as it is, 0 grey")
        parser.add_argument("--in", dest="region", nargs="+", metavar="REGION", help=f"only there: {REGION_HELP}")

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Grade:
        """Of the options as they are named."""
        region = None if options.region is None else region_of(options.region)
        return cls(options.exposure, options.white or (1.0, 1.0, 1.0), options.saturation, region)


def _graded(header: StreamHeader, state: State, matrix: NDArray[np.float64], rows: NDArray[np.bool_]) -> State:
    """A colour is .5 and the sum of its harmonics: the constant one takes what becomes of the .5."""
    if not rows.any():
        return state
    attributes = all_rows(state)
    sh = attributes.sh.copy()
    graded = np.einsum("ij,nkj->nki", matrix, sh[rows].astype(np.float64))
    graded[:, 0] += (matrix.sum(axis=1) - 1) * 0.5 / SH_C0 / header.lattice.sh_dc
    sh[rows] = np.clip(np.rint(graded), -(2**31), 2**31 - 1)
    return new_state(replace(attributes, sh=sh), state.frame, ids=state.ids, next_id=state.next_id)
