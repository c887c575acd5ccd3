"""What an operation is: a name with words behind it, and what it makes of a take."""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

from decogs.formats.command_line import Parser

from ..take import Take

Opener = Callable[[Path], Take]
"""Opens another stream as a take, for as long as the edit lasts."""


class Operation(ABC):
    """One step of an edit; a frozen dataclass whose fields are what was asked for."""

    name: ClassVar[str]
    """The word that asks for it on the command line and in recipes."""

    summary: ClassVar[str]
    """What it does, in a line."""

    @property
    def outputs(self) -> tuple[Path, ...]:
        """Files that it writes beside the stream."""
        return ()

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
