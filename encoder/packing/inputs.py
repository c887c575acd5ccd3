"""What is packed: numbered files of one frame each, or one file of a whole sequence."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from decogs.codec.scene.state import Rows
from decogs.formats.frames.names import is_numbered, numbered_files
from decogs.formats.splat_files import Room
from decogs.formats.splat_files.reading import read_splats
from decogs.formats.splat_sequences.opening import SEQUENCES, open_sequence
from decogs.formats.splats import Splats
from decogs.formats.system.callbacks import OnWarning


@dataclass(frozen=True, eq=False)
class InputFrame:
    """One frame. ``name``: of its file, and of its place in it, for errors.

    ``ids`` (N,): identify its Gaussians over time; None where nothing does.
    """

    name: str
    splats: Splats
    ids: Rows | None


@dataclass(frozen=True)
class PackInput:
    """What is packed. ``first``: the first frame's number; ``up``: the axis that its files have for up.

    ``frames``: reads them one at a time. Raises UsageError for what cannot be read.
    """

    paths: tuple[Path, ...]
    count: int
    first: int
    fps: float | None
    frames: Callable[[], Iterator[InputFrame]]
    up: Literal["Y", "-Y"]


def pack_input(files: Path, fps: float | None, room: Room, warn: OnWarning) -> PackInput:
    """Opens ``files``: a name with a place for the frame's number, or a .4dgs or .splat4d. Raises UsageError."""
    if files.suffix.lower() in SEQUENCES and not is_numbered(files):
        return _sequence(files, fps, room, warn)
    named = numbered_files(files)
    paths = tuple(path for _, path in named)
    up: Literal["Y", "-Y"] = "Y" if files.suffix.lower() == ".spz" else "-Y"
    return PackInput(paths, len(paths), named[0][0], fps, lambda: _of_files(paths, room, warn), up)


def _sequence(path: Path, fps: float | None, room: Room, warn: OnWarning) -> PackInput:
    sequence = open_sequence(path, room, fps)

    def frames() -> Iterator[InputFrame]:
        for index, frame in enumerate(sequence.frames()):
            name = f"{path}, frame {index}"
            for text in frame.left_out:
                warn(f"{name}: {text}")
            if index == 0:
                _warn_of_opacity(path, warn)
            yield InputFrame(name, frame.splats, frame.ids)

    return PackInput((path,), sequence.frame_count, 0, sequence.fps, frames, sequence.up)


def _of_files(paths: tuple[Path, ...], room: Room, warn: OnWarning) -> Iterator[InputFrame]:
    for path in paths:
        file = read_splats(path, room)
        for text in file.left_out:
            warn(f"{path}: {text}")
        if path == paths[0] and not file.compensated:
            _warn_of_opacity(path, warn)
        yield InputFrame(str(path), file.splats, None)


def _warn_of_opacity(path: Path, warn: OnWarning) -> None:
    warn(
        f"{path}: does not say that it was trained with antialiasing (Mip-Splatting), which our renderer has: "
        "Gaussians smaller than a pixel are shown fainter than by its own"
    )
