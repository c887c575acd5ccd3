"""``audio``: one more track, of a file, and what the header says of a track."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from decogs.codec.packets.sound import SLOWEST, SoundTrack
from decogs.formats.cli.command_line import Parser, number, vector, whole_number
from decogs.formats.errors import UsageError

from ..sound import with_file
from ..take import Take
from .base import Opener, Operation


@dataclass(frozen=True)
class Audio(Operation):
    """Adds the sound of a file as a track, or says of one what it is and where it comes from. Frames keep their bits.

    ``path``: the file, which is heard from ``begin`` seconds on with frame 0; None adds none. ``title`` and
    ``position``, in the world as it is shown, are of the ``track``, None for the last one; ``nowhere`` takes a
    position away.
    """

    path: Path | None = None
    begin: float = 0.0
    track: int | None = None
    title: str | None = None
    position: tuple[float, float, float] | None = None
    nowhere: bool = False
    name = "audio"
    keeps_scenes = True
    summary = "add a file's sound, say what a track is and where it comes from"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same frames, with other sound. Raises UsageError for a file without sound, or a track that is none."""
        if self == Audio():
            raise UsageError("audio: nothing is to be done; decogs-edit audio --help lists what can be")
        if self.path is not None:
            take = self._added(take, self.path)
        tracks = list(take.header.sound)
        index = len(tracks) - 1 if self.track is None else self.track
        if not 0 <= index < len(tracks):
            raise UsageError(f"audio: there is no track {max(index, 0)}; the stream has {len(tracks)}")
        track = tracks[index]
        title = track.title if self.title is None else self.title
        position = None if self.nowhere else track.position
        if self.position is not None:
            x, y, z, _ = (take.header.presentation.similarity.inverse.matrix @ (*self.position, 1.0)).tolist()
            position = (x, y, z)
        tracks[index] = replace(track, title=title, position=position)
        note = f"audio: track {index}" + (f", {title}" if title else "")
        return replace(take, header=replace(take.header, sound=tuple(tracks))).with_note(note)

    def _added(self, take: Take, path: Path) -> Take:
        from decogs.formats.sound.tracks import sound_channels, sound_title

        fps = take.header.fps
        if fps is None or fps < SLOWEST:
            raise UsageError(f"audio: a stream needs a frame rate of at least {SLOWEST:g} for it; `retime` it before")
        channels = sound_channels(path)
        if channels is None:
            raise UsageError(f"{path}: has no sound; name a file that has")
        hear = with_file(take, path, channels, self.begin, fps)
        header = replace(take.header, sound=(*take.header.sound, SoundTrack(channels, sound_title(path))))
        return replace(take, header=header, hear=hear, sources=(*take.sources, path))

    @staticmethod
    def add_options(parser: Parser) -> None:
        """The file, and one option for each member of a track."""
        parser.add_argument("path", nargs="?", type=Path, metavar="FILE", help="a file whose sound becomes a track")
        parser.add_argument(
            "--begin", type=number, default=0.0, metavar="S", help="second of the file that is heard with frame 0"
        )
        parser.add_argument(
            "--track", type=whole_number, metavar="N", help="the track that is meant (default: the last)"
        )
        parser.add_argument("--title", metavar="TEXT", help="what it is")
        index = parser.add_mutually_exclusive_group()
        index.add_argument("--position", type=vector, metavar="X,Y,Z", help="the place that it is heard from")
        index.add_argument("--nowhere", action="store_true", help="from no place; as it is")

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Audio:
        """Of the options as they are named."""
        return cls(**vars(options))
