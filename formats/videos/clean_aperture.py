"""How many pixels at the edges of a video's pictures are not to be shown, which PyAV's streams and frames do not say.

mp4 and mov state it as a clean aperture (``clap``: ISO 14496-12, section 12.1.4), Matroska and WebM as PixelCrop (RFC
9559, section 5.1.4.1.28). QuickTime, browsers and FFmpeg from 7.1 on show what is within.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from ..files.regular_files import open_regular

Edges = tuple[int, int, int, int]
"""Pixels on the left, at the top, on the right and at the bottom, before the picture is turned."""
NO_EDGES: Edges = (0, 0, 0, 0)

_MAX_PARTS = 1 << 16
"""Boxes or elements beside each other that are looked at."""
_EBML = b"\x1a\x45\xdf\xa3"
"""What a Matroska file begins with."""
_SEGMENT, _TRACKS, _TRACK, _VIDEO = 0x18538067, 0x1654AE6B, 0xAE, 0xE0
_CROP = (0x54CC, 0x54BB, 0x54DD, 0x54AA)
"""PixelCropLeft, -Top, -Right and -Bottom."""

_Span = tuple[int, int]
"""Where something begins and ends in a file."""
_Parts = Callable[[BinaryIO, _Span], Iterator[tuple[object, _Span]]]


def edges_of_track(path: Path, track: int, size: tuple[int, int]) -> Edges:
    """The edges of a ``track``, counted from 0, whose frames are decoded to this width and height.

    None where the file states nothing usable.
    """
    with suppress(OSError, StopIteration, LookupError, ValueError, ArithmeticError), open_regular(path) as file:
        whole = 0, path.stat().st_size
        if _read(file, 0, 4) == _EBML:
            edges = _pixel_crop(file, whole, track)
        else:
            edges = _outside(_clean_aperture(file, whole, track), size)
        if min(edges) >= 0 and edges[0] + edges[2] < size[0] and edges[1] + edges[3] < size[1]:
            return edges
    return NO_EDGES


def _clean_aperture(file: BinaryIO, whole: _Span, track: int) -> list[Fraction]:
    """Width and height of what is shown, and how far its middle is right of the picture's and below it."""
    begin, end = _within(file, whole, _boxes, b"moov", (b"trak", track), b"mdia", b"minf", b"stbl", b"stsd")
    _, (begin, end) = next(_boxes(file, (begin + 8, end)))  # of several descriptions the first
    at, _ = _within(file, (begin + 78, end), _boxes, b"clap")
    numbers = struct.unpack(">IIIIiIiI", _read(file, at, 32))
    return [Fraction(*pair) for pair in zip(numbers[::2], numbers[1::2], strict=True)]


def _outside(aperture: list[Fraction], size: tuple[int, int]) -> Edges:
    """The edges around a clean aperture, rounded as FFmpeg does it."""
    first = [(whole - shown) / 2 + off for whole, shown, off in zip(size, aperture, aperture[2:], strict=False)]
    last = [int(begin + shown - 1) for begin, shown in zip(first, aperture, strict=False)]
    return int(first[0]), int(first[1]), size[0] - 1 - last[0], size[1] - 1 - last[1]


def _pixel_crop(file: BinaryIO, whole: _Span, track: int) -> Edges:
    video = dict(_elements(file, _within(file, whole, _elements, _SEGMENT, _TRACKS, (_TRACK, track), _VIDEO)))
    spans = [video.get(kind, (0, 0)) for kind in _CROP]
    left, top, right, bottom = (int.from_bytes(_read(file, at, min(end - at, 8)), "big") for at, end in spans)
    return left, top, right, bottom


def _within(file: BinaryIO, span: _Span, parts: _Parts, *kinds: object) -> _Span:
    """Where the content of the first part of a kind lies, inside that of another; (kind, n) for one but the first."""
    for kind in kinds:
        kind, number = kind if isinstance(kind, tuple) else (kind, 0)
        span = next(islice((inner for name, inner in parts(file, span) if name == kind), number, None))
    return span


def _boxes(file: BinaryIO, span: _Span) -> Iterator[tuple[object, _Span]]:
    """The boxes of an mp4 or mov file in a span: kinds, and where their content is. Source: ISO 14496-12, 4.2."""
    at, end = span
    for _ in range(_MAX_PARTS):
        if at > end - 8:
            return
        size, kind = struct.unpack(">I4s", _read(file, at, 8))
        begin = at + 8
        if size == 1:
            size, begin = struct.unpack(">Q", _read(file, begin, 8))[0], begin + 8
        following = end if size == 0 else min(at + size, end)
        if following < begin:
            return
        yield kind, (begin, following)
        at = following


def _elements(file: BinaryIO, span: _Span) -> Iterator[tuple[object, _Span]]:
    """The elements of a Matroska file in a span: kinds, and where their content is. Source: RFC 8794, sections 4 to 6.

    One of unknown size goes to the end of the span.
    """
    at, end = span
    for _ in range(_MAX_PARTS):
        if at >= end:
            return
        kind, at = _variable(file, at)
        length, begin = _variable(file, at)
        bits = 7 * (begin - at)
        length &= (1 << bits) - 1
        following = end if length == (1 << bits) - 1 else min(begin + length, end)
        yield kind, (begin, following)
        at = following


def _variable(file: BinaryIO, at: int) -> tuple[int, int]:
    """A number of variable length, with its marker, and where it ends."""
    (first,) = _read(file, at, 1)
    size = 9 - first.bit_length()
    return int.from_bytes(_read(file, at, size), "big"), at + size


def _read(file: BinaryIO, at: int, size: int) -> bytes:
    """So many bytes; raises ValueError where the file ends before."""
    file.seek(at)
    data = file.read(size)
    if len(data) < size:
        raise ValueError("the file ends")
    return data
