"""``set``: what the header says of the stream."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from typing import Any

from decogs.formats.cli.command_line import Parser, colour, number, whole_number
from decogs.formats.errors import UsageError

from ..cameras import check_names
from ..take import Take
from .base import Opener, Operation

_OF_PRESENTATION = ("title", "poster", "first_view")
_OF_HEADER = ("licence", "source_text", "background")


@dataclass(frozen=True)
class Set(Operation):
    """Sets what is not None. No frame changes, so that all packets stay.

    ``title``, ``licence``, ``source_text``: texts. ``poster``: the frame that stands for the stream, from 0.
    ``first_view``: a camera's name. ``background``: display-referred RGB. ``near``: pairs of a camera's name, "" for
    all of them, and the distance in world units before which it shows nothing; a later pair counts.
    """

    title: str | None = None
    licence: str | None = None
    source_text: str | None = None
    poster: int | None = None
    first_view: str | None = None
    background: tuple[float, float, float] | None = None
    near: tuple[tuple[str, float], ...] = ()
    name = "set"
    keeps_scenes = True
    summary = "set title, poster frame, first view, background, near planes, licence"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same frames under another header. Raises UsageError for a camera or frame that is not there."""
        header, given = take.header, {name: value for name, value in vars(self).items() if value not in (None, ())}
        if not given:
            raise UsageError("set: nothing is to be set; decogs-edit set --help lists what can be")
        check_names(self.name, header, [name for name, _ in self.near if name])
        check_names(self.name, header, [] if self.first_view is None else [self.first_view])
        if self.poster is not None and not 0 <= self.poster < take.frame_count:
            raise UsageError(f"set: the poster, frame {self.poster}, is none of 0:{take.frame_count}")
        near = {camera.name: camera.near for camera in header.cameras}
        for name, distance in self.near:
            stored = distance / header.presentation.similarity.scale
            near |= {name: stored} if name else dict.fromkeys(near, stored)
        header = replace(
            header,
            presentation=replace(header.presentation, **_some(given, _OF_PRESENTATION)),
            cameras=tuple(replace(camera, near=near[camera.name]) for camera in header.cameras),
            **_some(given, _OF_HEADER),
        )
        return replace(take, header=header).with_note(f"set: {', '.join(given).replace('_', ' ')}")

    @staticmethod
    def add_options(parser: Parser) -> None:
        """One option for each member."""
        parser.add_argument("--title", metavar="TEXT", help="what the stream is called; '' for none")
        parser.add_argument("--poster", type=whole_number, metavar="N", help="the frame that stands for the stream")
        parser.add_argument("--first-view", metavar="CAM", help="the camera from which a player begins")
        parser.add_argument(
            "--background", type=colour, metavar="R,G,B", help="0 to 1 each, or black, grey, white: behind the scene"
        )
        parser.add_argument(
            "--near",
            type=_near,
            action="append",
            default=[],
            metavar="[CAM=]D",
            help="distance before which a camera, or every one, shows nothing, in world units (repeatable)",
        )
        parser.add_argument("--licence", metavar="TEXT", help="who may use it")
        parser.add_argument("--source", dest="source_text", metavar="TEXT", help="what the footage is")

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Set:
        """Of the options as they are named."""
        return cls(**{**vars(options), "near": tuple(options.near)})


def _some(given: dict[str, Any], names: tuple[str, ...]) -> dict[str, Any]:
    return {name: given[name] for name in names if name in given}


def _near(text: str) -> tuple[str, float]:
    camera, _, distance = text.rpartition("=")
    return camera, number(distance)
