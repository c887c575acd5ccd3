"""``strip``: leaves out what only tells of the making."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

from decogs.formats.cli.command_line import Parser
from decogs.formats.errors import UsageError

from ..cameras import renamed_corrections, with_cameras
from ..take import Take, silence
from .base import Opener, Operation

PARTS = ("provenance", "rig", "sound", "layers")
_ONLY_CAMERA = "view"


@dataclass(frozen=True)
class Strip(Operation):
    """Leaves out ``parts``: "provenance" is the encoder's settings, the source, the writer and what tracks of sound are
    called, which is their files' names; the licence stays.

    "rig" is all cameras but the one to begin with, since a stream has at least one; that is called "view". "sound" is
    all tracks. "layers": all Gaussians are in one.
    """

    parts: tuple[str, ...]
    name = "strip"
    summary = "leave out provenance (settings, source, writer, names of tracks), the rig's cameras, sound, or layers"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same frames, less told of them. Raises UsageError for an unknown part."""
        for part in self.parts:
            if part not in PARTS:
                raise UsageError(f"strip: there is no {part!r} to strip; choose from {', '.join(PARTS)}")
        if "provenance" in self.parts:
            sound = tuple(replace(track, title="") for track in take.header.sound)
            take = replace(take, header=replace(take.header, settings={}, source_text="", writer="", sound=sound))
        if "rig" in self.parts:
            take = _with_one_camera(take)
        if "sound" in self.parts:
            take = replace(take, header=replace(take.header, sound=()), hear=silence)
        if "layers" in self.parts:
            take = take.without_layers()
        return take.with_note(f"strip: {', '.join(self.parts)}")

    @staticmethod
    def add_options(parser: Parser) -> None:
        """The parts."""
        parser.add_argument(
            "parts", nargs="+", choices=PARTS, metavar="PART", help=f"one or more of {', '.join(PARTS)}"
        )

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Strip:
        """Of the parts as they are named."""
        return cls(tuple(options.parts))


def _with_one_camera(take: Take) -> Take:
    kept = take.header.presentation.first_view or take.header.cameras[0].name

    def name_of(name: str) -> str | None:
        return _ONLY_CAMERA if name == kept else None

    stripped = replace(take, header=with_cameras(take.header, name_of))
    return stripped.each(lambda frame: replace(frame, corrections=renamed_corrections(frame.corrections, name_of)))
