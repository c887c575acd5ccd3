"""``profile``: says in the header for which players a stream is made."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

from decogs.codec.header.profiles import PROFILES
from decogs.formats.cli.command_line import Parser
from decogs.formats.errors import UsageError

from ..take import Take
from .base import Opener, Operation


@dataclass(frozen=True)
class KeepProfile(Operation):
    """Says which profile each layer keeps within; no frame changes.

    ``profile``: that of the base, or of the one layer; an edit that would ask more of a player fails.
    """

    profile: str
    name = "profile"
    keeps_scenes = True
    summary = "say for which players the stream is made: phone, headset or desktop"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same frames. Raises UsageError for an unknown profile."""
        if self.profile not in PROFILES:
            raise UsageError(f"profile: there is no {self.profile!r}; choose from {', '.join(PROFILES)}")
        return replace(take, profile=self.profile)

    @staticmethod
    def add_options(parser: Parser) -> None:
        """The profile."""
        parser.add_argument("profile", choices=list(PROFILES), metavar="PROFILE", help=f"one of {', '.join(PROFILES)}")

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> KeepProfile:
        """Of its name."""
        return cls(options.profile)
