"""What a container says of its video that OpenCV does not pass on: the edit list, and the colours' coding.

Sources: ISO 14496-12 (boxes; edit list 8.6.6, colour information 12.1.5), RFC 9559 (Matroska's "Colour"), and ITU-T
H.273 for the codes. What cannot be read says nothing: whether the file is sound is found by others.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

_MAX_BYTES = 64 << 20
"""Of a table of contents: hours of video have a tenth of that."""
_CLUSTER = b"\x1f\x43\xb6\x75"
_MATROSKA_HEAD = 1 << 20

_TRANSFERS = {8: "linear light", 16: "PQ", 18: "HLG"}
"""Curves that are not shown right when they are taken for the usual one, sRGB's or BT.709's."""
_WIDE = {9: "BT.2020", 11: "DCI-P3", 12: "Display P3"}
"""Primaries whose colours become pale when they are taken for sRGB's."""


@dataclass(frozen=True)
class VideoTags:
    """``shown``: seconds of the track that its edit list shows, None where it has none; ``colours``: how they are coded
    if not as sRGB or BT.709 are, as the user knows it, such as "PQ, BT.2020"."""

    shown: float | None = None
    colours: str = ""


def read_tags(path: Path) -> VideoTags:
    """What an MP4, MOV or Matroska file says; nothing for other files, and where it cannot be read."""
    try:
        if path.suffix.lower() in (".mkv", ".webm"):
            with path.open("rb") as file:
                head = file.read(_MATROSKA_HEAD).partition(_CLUSTER)[0]
            return VideoTags(colours=_named(_element(head, b"\x55\xba"), _element(head, b"\x55\xbb")))
        moov = _contents(path)
        track = next(track for track in _inside(moov, b"trak") if _is_video(track))
        return VideoTags(_shown(moov, track), _boxed_colours(track))
    except (OSError, struct.error, StopIteration, ZeroDivisionError):
        return VideoTags()


def _contents(path: Path) -> bytes:
    """What the box ``moov`` holds, empty if there is none."""
    with path.open("rb") as file:
        at, end = 0, path.stat().st_size
        while at <= end - 8:
            file.seek(at)
            size, kind, long_size = struct.unpack(">I4sQ", file.read(16).ljust(16, b"\0"))
            head = 16 if size == 1 else 8
            size = end - at if size == 0 else long_size if size == 1 else size
            if size < head:
                break
            if kind == b"moov":
                file.seek(at + head)
                return file.read(min(size - head, _MAX_BYTES))
            at += size
    return b""


def _inside(data: bytes, kind: bytes) -> Iterator[bytes]:
    """The contents of the boxes of this kind that lie directly in ``data``."""
    at = 0
    while at <= len(data) - 8:
        size, name = struct.unpack_from(">I4s", data, at)
        if size < 8:
            return
        if name == kind:
            yield data[at + 8 : at + size]
        at += size


def _is_video(track: bytes) -> bool:
    return any(handler[8:12] == b"vide" for media in _inside(track, b"mdia") for handler in _inside(media, b"hdlr"))


def _shown(moov: bytes, track: bytes) -> float | None:
    lists = [edits for holder in _inside(track, b"edts") for edits in _inside(holder, b"elst")]
    movie = next(_inside(moov, b"mvhd"), None)
    if not lists or movie is None:
        return None
    (timescale,) = struct.unpack_from(">I", movie, 20 if movie[0] else 12)
    edit = struct.Struct(">QqI" if lists[0][0] else ">IiI")
    (count,) = struct.unpack_from(">I", lists[0], 4)
    edits = [edit.unpack_from(lists[0], 8 + i * edit.size) for i in range(min(count, len(lists[0]) // edit.size))]
    # An edit from before the beginning is a pause; one of no length, in a fragmented file, is everything.
    lasting = sum(duration for duration, begin, _ in edits if begin >= 0)
    return lasting / timescale if lasting else None


def _boxed_colours(track: bytes) -> str:
    found = re.search(rb"colrncl[xc](..)(..)", track, re.DOTALL)
    return "" if found is None else _named(int.from_bytes(found[2], "big"), int.from_bytes(found[1], "big"))


def _element(data: bytes, name: bytes) -> int:
    """An unsigned integer of one byte in Matroska; 0 when it is not there."""
    found = re.search(re.escape(name) + rb"\x81(.)", data, re.DOTALL)
    return 0 if found is None else found[1][0]


def _named(transfer: int, primaries: int) -> str:
    return ", ".join(filter(None, (_TRANSFERS.get(transfer), _WIDE.get(primaries))))
