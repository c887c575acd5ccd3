"""``cameras``: the stream's list of cameras."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

from decogs.codec.header.header import MAX_CAMERAS
from decogs.formats.cameras import Camera
from decogs.formats.cli.command_line import Parser
from decogs.formats.errors import UsageError
from decogs.formats.geometry.length_units import metres_of
from decogs.formats.geometry.similarity import transformed_camera

from ...cameras.files import camera_file, read_camera_file
from ...cameras.path import ToFilm
from ...reading.stream import in_its_world
from ..cameras import check_names, renamed_corrections, with_cameras
from ..take import Take
from .base import Opener, Operation


@dataclass(frozen=True)
class Cameras(Operation):
    """Leaves out the cameras ``drop``, gives others new names by ``rename``, and adds those of the files ``add``.

    A file holds a camera or a path, as for ``decogs-decode --camera``. Its cameras are called after it, those of a
    path with their number behind, and count as held out, since no training saw them. No scene changes.
    """

    drop: tuple[str, ...] = ()
    rename: tuple[tuple[str, str], ...] = ()
    add: tuple[str, ...] = ()
    name = "cameras"
    summary = "drop, rename and add cameras"

    def edit(self, take: Take, open_other: Opener) -> Take:
        """The same scenes with other cameras. Raises UsageError for names that are not there, or there already."""
        if not (self.drop or self.rename or self.add):
            raise UsageError("cameras: nothing is to be done; say what to drop, rename or add")
        check_names(self.name, take.header, (*self.drop, *(name for name, _ in self.rename)))
        if both := set(self.drop) & {name for name, _ in self.rename}:
            raise UsageError(f"cameras: {min(both)} is dropped and renamed; choose one")
        renamed = dict(self.rename)

        def name_of(name: str) -> str | None:
            return None if name in self.drop else renamed.get(name, name)

        header = with_cameras(take.header, name_of)
        added = [camera for file in self.add for camera in _cameras_of(file, take)]
        header = replace(
            header,
            cameras=(*header.cameras, *added),
            held_out=(*header.held_out, *(camera.name for camera in added)),
        )
        _check_unique(header.cameras)
        take = replace(take, header=header, sources=(*take.sources, *(camera_file(file)[0] for file in self.add)))
        edited = take.each(lambda frame: replace(frame, corrections=renamed_corrections(frame.corrections, name_of)))
        counts = {"dropped": len(self.drop), "renamed": len(self.rename), "added": len(added)}
        return edited.with_note(f"cameras: {', '.join(f'{count} {word}' for word, count in counts.items() if count)}")

    @staticmethod
    def add_options(parser: Parser) -> None:
        """What happens to which."""
        parser.add_argument("--drop", action="append", default=[], metavar="CAM", help="leave one out (repeatable)")
        parser.add_argument(
            "--rename", type=_pair, action="append", default=[], metavar="OLD=NEW", help="rename one (repeatable)"
        )
        parser.add_argument(
            "--add",
            action="append",
            default=[],
            metavar="FILE",
            help="a free camera or a path of them, as for decogs-decode --camera (repeatable)",
        )

    @classmethod
    def of_options(cls, options: argparse.Namespace) -> Cameras:
        """Of the options as they are named."""
        return cls(tuple(options.drop), tuple(options.rename), tuple(options.add))


def _cameras_of(file: str, take: Take) -> list[Camera]:
    header = in_its_world(take.header)
    film = ToFilm(header.cameras, header.fps, take.frame_count, metres_of(header.units) or 1.0)
    path, named = camera_file(file)
    # A file has them in the world; a header has them where the scene is stored.
    back = header.presentation.similarity.inverse
    called = named or Path(path).stem
    cameras = [transformed_camera(camera, back) for camera in read_camera_file(file, film).cameras]
    if len(cameras) > MAX_CAMERAS:
        raise UsageError(f"{file}: has {len(cameras)} cameras, and a stream at most {MAX_CAMERAS}; add fewer")
    if len(cameras) == 1:
        return [replace(cameras[0], name=called)]
    return [replace(camera, name=f"{called}_{number:04d}") for number, camera in enumerate(cameras)]


def _check_unique(cameras: tuple[Camera, ...]) -> None:
    seen: set[str] = set()
    for camera in cameras:
        if camera.name in seen:
            raise UsageError(f"cameras: two cameras would be called {camera.name!r}; rename one")
        seen.add(camera.name)


def _pair(text: str) -> tuple[str, str]:
    old, equals, new = text.partition("=")
    if not (old and equals and new):
        raise argparse.ArgumentTypeError(f"{text!r} renames nothing; write OLD=NEW")
    return old, new
