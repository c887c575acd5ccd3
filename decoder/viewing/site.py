"""A folder that plays a stream on any static web server: the page, and the stream under its own name."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from decogs.codec.header.header import StreamHeader
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.files.outputs import Output, check_folder_name, check_outputs, files_read, staged_files
from decogs.formats.files.regular_files import Unchanged, open_regular
from decogs.formats.system.callbacks import OnProgress

from ..output.pictures import to_8bit
from ..reading.stream import open_stream
from ..rendering.views import render_view
from .notebook import check_header
from .page_files import FENCE, INDEX, POSTER, page_files
from .recorded_pictures import jpeg

_MEGABYTE = 1_000_000


@dataclass(frozen=True)
class SiteReport:
    """What was written: the folder, how many files, and their bytes."""

    folder: Path
    file_count: int
    file_bytes: int


def write_site(
    stream: str | os.PathLike[str],
    folder: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    url: str | None = None,
    fence: str | os.PathLike[str] | None = None,
    on_megabytes: OnProgress | None = None,
) -> SiteReport:
    """Writes the page, its poster and a copy of the stream into ``folder``, which appears when it is whole.

    An existing folder is written into when it is empty, or when this made it and nothing else was put there; any other
    one with ``overwrite``, where files of other names stay. ``url``: where the folder will be on the web, for the
    picture beside links to it. ``fence``: a map of where the scene holds, in which views stay. Raises UsageError for
    what cannot be written, or is read, StreamError for what is no readable stream, OSError when the file cannot be
    read.
    """
    source, target = Path(stream), Path(folder)
    with open_regular(source) as opened:
        unchanged = Unchanged(opened, source)
        check_header(source, follow=False)
        header, poster = _shown_first(source)
        title, subject = header.presentation.title, header.subject
        held = None if fence is None else _fence(Path(fence))
        files = page_files(source.name, title=title, poster=poster, subject=subject, url=url, fence=held)
        # One that was written before may have had a poster, or a fence.
        names = {file.name for file in files} | {source.name, POSTER, FENCE}
        check_outputs([Output("output", target / name) for name in names], files_read(stream=source, fence=fence))
        _check_folder(target, names, overwrite)
        with staged_files(target) as staging:
            copied = _copy(opened, staging / source.name, on_megabytes)
            unchanged.check_name()  # the poster is of the stream that is copied
            for file in files:
                (staging / file.name).write_bytes(file.data)
    return SiteReport(target, len(files) + 1, copied + sum(len(file.data) for file in files))


def _shown_first(stream: Path) -> tuple[StreamHeader, bytes | None]:
    """The header, and the picture of the poster frame as JPEG: before the player, and in links.

    That of a subject is over black, as the page is. None of a stream whose frame is damaged.
    """
    with open_stream(stream, on_damage=lambda damage: None) as opened:
        header = opened.header
        shown = header.presentation
        seen = [camera.name for camera in header.cameras if camera.name not in header.held_out]
        view = shown.first_view or (seen[0] if seen else header.cameras[0].name)
        poster = max(0, min(shown.poster or 0, opened.frame_count - 1))
        behind = (0.0, 0.0, 0.0) if header.subject else None
        try:
            frame = next(opened.frames(poster, poster + 1))
        except (StreamError, StopIteration):
            return header, None
        return header, jpeg(to_8bit(render_view(header, frame.splats, view, background=behind, undistorted=True).image))


def _fence(path: Path) -> bytes:
    """A file that says where views stay; raises UsageError for another one."""
    with open_regular(path) as file:
        data = file.read(_MEGABYTE)
    try:
        is_fence = "within" in json.loads(data)
    except (ValueError, TypeError):
        is_fence = False
    if not is_fence:
        raise UsageError(f"`fence` {path}: is no map of where a scene holds; decogs-report -o fence.json writes one")
    return data


def _check_folder(folder: Path, names: set[str], overwrite: bool) -> None:
    check_folder_name(folder)
    if not folder.exists():
        return
    existing = {path.name for path in folder.iterdir()}
    if existing and not overwrite and not (existing <= names and _is_ours(folder / INDEX)):
        raise UsageError(f"{folder}: holds files already; name a new folder, or write into it with `overwrite`")


def _is_ours(index: Path) -> bool:
    try:
        return b"<decogs-player" in index.read_bytes()
    except OSError:
        return False


def _copy(source: BinaryIO, to: Path, on_megabytes: OnProgress | None) -> int:
    """Copies what there is, a megabyte at a time; returns the bytes."""
    done, size = 0, os.fstat(source.fileno()).st_size
    with to.open("wb") as copy:
        while data := source.read(_MEGABYTE):
            done += copy.write(data)
            if on_megabytes is not None:
                on_megabytes(done // _MEGABYTE, size // _MEGABYTE)
    return done
