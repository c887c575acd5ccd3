"""What an operation is: a name with words behind it, and what it makes of a take."""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, ClassVar

from decogs.formats.cli.command_line import Parser
from decogs.formats.errors import UsageError

from ..take import Take

Opener = Callable[[Path], Take]
"""Opens another stream as a take, for as long as the edit lasts."""

_SMALLEST, _LARGEST = 1e-12, 1e12
"""Magnitudes of what is asked for, but for 0: the larger one is a header's for coordinates."""


class Operation(ABC):
    """One step of an edit; a frozen dataclass whose fields are what was asked for."""

    name: ClassVar[str]
    """The word that asks for it on the command line and in recipes."""

    summary: ClassVar[str]
    """What it does, in a line."""

    keeps_scenes: ClassVar[bool] = False
    """Whether all layers of each frame show what they did before, whatever else it does."""

    @property
    def outputs(self) -> tuple[Path, ...]:
        """Files that it writes beside the stream."""
        return ()

    def check_numbers(self) -> None:
        """Raises UsageError for numbers with which nothing can be computed: infinite, no number, out of all bounds."""
        for number in _numbers(vars(self).values()):
            if not (number == 0 or _SMALLEST <= abs(number) <= _LARGEST):
                raise UsageError(f"{self.name}: {number:g} is not possible; give numbers of 1e-12 to 1e12, or 0")

    @abstractmethod
    def edit(self, take: Take, open_other: Opener) -> Take:
        """The edited take, whose frames are read when it is. Raises UsageError for what this take has not."""

    @staticmethod
    @abstractmethod
    def add_options(parser: Parser) -> None:
        """Gives a parser what may follow the name."""

    @classmethod
    @abstractmethod
    def of_options(cls, options: argparse.Namespace) -> Operation:
        """The operation that the parsed options ask for. Raises UsageError."""


def _numbers(values: Iterable[Any]) -> Iterator[float]:
    """Those among values and within tuples of them."""
    for value in values:
        if isinstance(value, tuple):
            yield from _numbers(value)
        elif isinstance(value, float):
            yield value
