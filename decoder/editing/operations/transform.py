"""``transform``: turns, scales and shifts the scene with its cameras, as one matrix in the header."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

from decogs.codec.header.presentation import MAX_SCALE, transform_of
from decogs.formats.cli.command_line import Parser, number, vector
from decogs.formats.errors import UsageError
from decogs.formats.geometry.similarity import Similarity
from decogs.formats.geometry.up_direction import AXES, turn_between, up_of

from ...reading.stream import in_its_world
from ..take import Take
from .base import Opener, Operation

_Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Transform(Operation):
    """Brings the scene, with its cameras, to where it is to be shown. No frame changes, so that all packets stay.

    One after the other: ``reset`` undoes earlier transforms; the point ``origin`` becomes the origin; the world's up,
    as its cameras have it, becomes ``up``, an axis such as "Y" or "-Z"; ``turns``: pairs of an axis "X", "Y" or "Z" and
    degrees, counterclockwise as seen from the axis' end; ``scale`` times as large; then shifted by ``shift``.
    """

    origin: _Vector = (0.0, 0.0, 0.0)
    up: str | None = None
    turns: tuple[tuple[str, float], ...] = ()
    scale: float = 1.0
    shift: _Vector = (0.0, 0.0, 0.0)
    reset: bool = False
    name = "transform"
    summary = "turn, scale and shift the scene with its cameras"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same frames with another transform. Raises UsageError for a scale that is none."""
        if not 1 / MAX_SCALE <= self.scale <= MAX_SCALE:
            raise UsageError(f"transform: a scale of {self.scale:g} is not possible; give one from 1e-6 to 1e6")
        if self == Transform():
            raise UsageError("transform: nothing is to be done; decogs-edit transform --help lists what can be")
        header = take.header
        if self.reset:
            header = replace(header, presentation=replace(header.presentation, transform=None))
        before = header.presentation.similarity
        by = Similarity(np.eye(3), shift=-np.array(self.origin))
        if self.up is not None:
            by = Similarity(turn_between(up_of(in_its_world(header).cameras), AXES[self.up])).after(by)
        for axis, degrees in self.turns:
            by = Similarity(_turn(axis, degrees)).after(by)
        by = Similarity(np.eye(3), self.scale, np.array(self.shift)).after(by)
        presentation = replace(header.presentation, transform=transform_of(by.after(before)))
        note = "transform: undone" if by.after(before).is_identity else "transform: one matrix in the header"
        return replace(take, header=replace(header, presentation=presentation)).with_note(note)

    @staticmethod
    def add_options(parser: Parser) -> None:
        """What is done, in this order."""
        parser.add_argument("--reset", action="store_true", help="undo earlier transforms")
        parser.add_argument("--origin", type=vector, metavar="X,Y,Z", help="the point that becomes the origin")
        parser.add_argument("--up", choices=tuple(AXES), help="turn so that up, as the cameras have it, is this axis")
        parser.add_argument(
            "--turn",
            dest="turns",
            type=_axis_turn,
            action="append",
            default=[],
            metavar="AXIS=DEGREES",
            help="turn about the x, y or z axis, such as y=90 (repeatable)",
        )
        parser.add_argument("--scale", type=number, default=1.0, metavar="S", help="make it S times as large")
        parser.add_argument("--shift", type=vector, metavar="X,Y,Z", help="shift it, in world units")

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Transform:
        """Of the options as they are named."""
        origin, shift = options.origin or (0.0, 0.0, 0.0), options.shift or (0.0, 0.0, 0.0)
        return cls(origin, options.up, tuple(options.turns), options.scale, shift, options.reset)


def _turn(axis: str, degrees: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """A rotation (3, 3); quarter turns are exact."""
    quarters = degrees / 90
    if quarters == round(quarters):
        cosine, sine = ((1, 0), (0, 1), (-1, 0), (0, -1))[round(quarters) % 4]
    else:
        cosine, sine = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    first, second = {"X": (1, 2), "Y": (2, 0), "Z": (0, 1)}[axis]
    rotation = np.eye(3)
    rotation[first, first] = rotation[second, second] = cosine
    rotation[first, second], rotation[second, first] = -sine, sine
    return rotation


def _axis_turn(text: str) -> tuple[str, float]:
    axis, _, degrees = text.partition("=")
    if axis.upper() not in ("X", "Y", "Z"):
        raise argparse.ArgumentTypeError(f"{text!r} is no turn; write an axis and degrees, such as y=90")
    return axis.upper(), number(degrees)
