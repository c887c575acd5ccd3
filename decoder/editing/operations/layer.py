"""``layer``: a base that stands alone, and what makes it whole again."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from importlib.metadata import entry_points

from decogs.formats.cli.command_line import Parser, number
from decogs.formats.errors import UsageError
from decogs.formats.system.extras import install

from ..take import Take
from .base import Opener, Operation

SHARE = 0.25
"""Of the Gaussians in a base, if no other is asked for."""
_MAKERS = "decogs.layering"
"""Entry points that make a base; training is the encoder's, which need not be installed."""


@dataclass(frozen=True)
class MakeLayers(Operation):
    """Writes the frames in two layers: a base of ``share`` of the Gaussians, trained to look like all of them, and the
    rest.

    All together are the very Gaussians of before. Needs the encoder, and no rig: the base is trained on decoded frames.
    """

    share: float = SHARE
    name = "layer"
    keeps_scenes = True
    summary = "write a base that plays alone, for slow links and small devices, and what makes it whole"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same frames in layers. Raises UsageError without the encoder, and for a share that is none."""
        if not 0 < self.share < 1:
            raise UsageError(f"layer: a share of {self.share:g} is not possible; give one between 0 and 1")
        for maker in entry_points(group=_MAKERS):
            try:
                layered = maker.load()
            except ModuleNotFoundError:
                continue
            made: Take = layered(take, self.share)
            return made
        raise UsageError(f"layer: needs the encoder: {install('encode')}")

    @staticmethod
    def add_options(parser: Parser) -> None:
        """How large the base is."""
        parser.add_argument(
            "--share", type=number, default=SHARE, metavar="S", help=f"of the Gaussians in the base (default {SHARE})"
        )

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> MakeLayers:
        """Of the share."""
        return cls(options.share)
