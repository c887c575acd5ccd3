"""What a picture file says before its pixels: size, EXIF orientation, and how its colours are coded.

Headers are walked here because no library does it as cheaply and as quietly. OpenCV cannot stop at one (7 to 24 ms for
a picture of 1345x1008 instead of 0.03 to 0.13) and prints what is wrong with a damaged file; OpenEXR prints too when
pixels are missing, and does not give the chunk table's place. Pillow passes 165 of 182 cut JPEGs unless it decodes
them, and refuses sizes by a limit of the whole process.

Sources: PNG (third edition), ITU-T T.81 (JPEG), ICC.1 annex B (profiles in files), TIFF 6.0, CIPA DC-008 (EXIF),
RFC 9649 (WebP), Microsoft's BITMAPINFOHEADER (BMP), OpenEXR File Layout.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ..errors import RigError

PICTURE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".exr"})
PICTURE_KINDS = "PNG, JPEG, TIFF, WebP, BMP or EXR"
"""The same in words."""
TIFF_SUFFIXES = frozenset({".tif", ".tiff"})

MAX_PIXELS = 1 << 28
"""No picture larger than this is decoded: a few header bytes must not be able to claim all memory."""

MAX_PROFILE = 4 << 20
"""Bytes of an ICC profile that is looked at; those for printing, the largest, have 2 MiB."""

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_EXR_MAGIC = b"\x76\x2f\x31\x01"
_IN_JPEG = b"ICC_PROFILE\0"

_PNG_PRIMARIES = (31270, 32900, 64000, 33000, 30000, 60000, 15000, 6000)
"""cHRM of sRGB: white, red, green, blue, times 100 000."""
_PNG_GAMMA = 45455
"""gAMA that stands for sRGB's curve."""

_TRANSFERS = {4: "gamma 2.2", 5: "gamma 2.8", 8: "linear light", 16: "PQ", 17: "SMPTE 428", 18: "HLG"}
_PRIMARIES = {9: "BT.2020", 10: "XYZ", 11: "DCI-P3", 12: "Display P3"}
"""ITU-T H.273: codes that show when they are taken for sRGB's."""

_ORIENTATION, _STRIPS, _TILES, _PROFILE, _EXTRA_SAMPLES = 274, (273, 279), (324, 325), 34675, 338
_EXIF, _INTEROPERABILITY = 34665, 40965
_TYPES = {1: "B", 2: "B", 3: "H", 4: "I", 7: "B", 13: "I", 16: "Q"}
"""TIFF's types of whole numbers without a sign, and its bytes and texts."""
_MAX_TAGS, _MAX_VALUES, _MAX_SAMPLES = 4096, 1 << 20, 8


@dataclass(frozen=True)
class PictureHeader:
    """Width and height in pixels, of the picture as it is stored; ``orientation``: EXIF's 1 to 8, 1 for none.

    ``profile``: the ICC profile, b"" where there is none; None for one that is damaged or too large.
    ``coding``: how colours are coded if not as sRGB's, where the file says so without a profile; "" otherwise.
    """

    width: int
    height: int
    orientation: int = 1
    profile: bytes | None = b""
    coding: str = ""


def read_header(path: Path, data: bytes) -> PictureHeader:
    """The header of the picture file ``path``, whose bytes are ``data``. Raises RigError."""
    suffix = path.suffix.lower()
    try:
        if suffix == ".png":
            header = _png_header(path, data)
        elif suffix in (".jpg", ".jpeg"):
            header = _jpeg_header(path, data)
        elif suffix in TIFF_SUFFIXES:
            header = _tiff_header(path, data)
        elif suffix == ".webp":
            header = _webp_header(path, data)
        elif suffix == ".bmp":
            header = PictureHeader(*_bmp_size(path, data))
        elif suffix == ".exr":
            header = PictureHeader(*_exr_size(path, data))
        else:
            raise RigError(f"{path}: not a picture format that can be read; use {PICTURE_KINDS}")
    except (struct.error, IndexError, ValueError):
        raise damaged(path, "the picture's header is damaged or truncated") from None
    if header.width < 1 or header.height < 1 or header.width * header.height > MAX_PIXELS:
        raise damaged(path, f"the header claims {header.width} x {header.height} pixels, which is not a usable size")
    return header


def damaged(path: Path, what: str) -> RigError:
    """The error of a file that cannot be mended."""
    return RigError(f"{path}: {what}; write the picture again from its source")


# --- PNG ------------------------------------------------------------------------------------------------------------


def _png_header(path: Path, data: bytes) -> PictureHeader:
    if data[:8] != PNG_SIGNATURE or data[12:16] != b"IHDR":
        raise damaged(path, "this is not a PNG file")
    width, height = struct.unpack_from(">II", data, 16)
    chunks = dict(_png_chunks(data))
    orientation = Ifd(chunks[b"eXIf"]).number(_ORIENTATION, 1) if b"eXIf" in chunks else 1
    profile, coding = _png_colours(chunks)
    return PictureHeader(width, height, orientation, profile, coding)


def _png_chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """The chunks beside IHDR and the pixels, by name."""
    at, kind = 33, b""
    while at <= len(data) - 12 and kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, at)
        if kind != b"IDAT":
            yield kind, data[at + 8 : at + 8 + length]
        at += 12 + length


def _png_colours(chunks: dict[bytes, bytes]) -> tuple[bytes | None, str]:
    """ICC profile and coding; of several statements the first of PNG's own order counts."""
    if b"cICP" in chunks:
        primaries, transfer = chunks[b"cICP"][:2]
        return b"", ", ".join(filter(None, (_TRANSFERS.get(transfer), _PRIMARIES.get(primaries))))
    if b"iCCP" in chunks:
        unpacking = zlib.decompressobj()
        try:
            profile = unpacking.decompress(chunks[b"iCCP"].partition(b"\0")[2][1:], MAX_PROFILE)
        except zlib.error:
            return None, ""
        return profile if profile and unpacking.eof else None, ""
    if b"sRGB" in chunks:
        return b"", ""
    coding = []
    if b"gAMA" in chunks and abs((gamma := int.from_bytes(chunks[b"gAMA"], "big")) - _PNG_GAMMA) > 0.02 * _PNG_GAMMA:
        coding.append(f"gamma {100_000 / max(gamma, 1):.2g}")
    if b"cHRM" in chunks:
        stated = struct.unpack(">8I", chunks[b"cHRM"])
        if max(abs(one - other) for one, other in zip(stated, _PNG_PRIMARIES, strict=True)) > 500:
            coding.append("primaries other than sRGB's")
    return b"", ", ".join(coding)


# --- JPEG -----------------------------------------------------------------------------------------------------------


def _jpeg_header(path: Path, data: bytes) -> PictureHeader:
    if data[:2] != b"\xff\xd8":
        raise damaged(path, "this is not a JPEG file")
    size, exif, parts = (0, 0), Ifd(b""), {}
    for marker, at, end in _jpeg_segments(path, data):
        if 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 1)
            size = width, height
        elif marker == 0xE1 and data[at : at + 6] == b"Exif\0\0":
            exif = Ifd(data[at + 6 : end])
        elif marker == 0xE2 and data[at : at + 12] == _IN_JPEG:
            parts[data[at + 12]] = data[at + 14 : end]
    profile = b"".join(parts[number] for number in sorted(parts))
    coding = "" if parts else _coding_by_camera(exif)
    return PictureHeader(*size, exif.number(_ORIENTATION, 1), profile if len(profile) <= MAX_PROFILE else None, coding)


def _jpeg_segments(path: Path, data: bytes) -> Iterator[tuple[int, int, int]]:
    """Marker, first byte and end of each segment before the first scan."""
    at = 2
    while True:
        if data[at] != 0xFF:
            raise damaged(path, f"the JPEG marker at byte {at} is damaged")
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte before a marker
            at += 1
        elif marker == 0xDA:
            return
        else:
            end = at + 2 + int(struct.unpack_from(">H", data, at + 2)[0])
            yield marker, at + 4, end
            at = end


# --- TIFF, and EXIF, which is one -----------------------------------------------------------------------------------


class Ifd:
    """A directory, the first one, of a TIFF (also a BigTIFF) or of EXIF data: numbers by tag, read when asked for.

    Empty where ``data`` is none. Nothing is read that does not lie within ``data``.
    """

    def __init__(self, data: bytes, at: int | None = None) -> None:
        self._data, self._entries = data, dict[int, tuple[int, int, int]]()
        self._order = {b"II": "<", b"MM": ">"}.get(data[:2], "")
        if not self._order or len(data) < 16:
            return
        kind = struct.unpack_from(self._order + "H", data, 2)[0]
        if kind == 42:
            self._walk("IH", "HHI", 4, at)
        elif kind == 43:
            self._walk("QQ", "HHQ", 8, at)

    def _walk(self, head: str, entry: str, inline: int, at: int | None) -> None:
        try:
            if at is None:
                (at,) = struct.unpack_from(self._order + head[0], self._data, inline)
            (count,) = struct.unpack_from(self._order + head[1], self._data, at)
            at += struct.calcsize(self._order + head[1])
            size = struct.calcsize(self._order + entry)
            for _ in range(min(count, _MAX_TAGS)):
                tag, kind, values = struct.unpack_from(self._order + entry, self._data, at)
                offset = at + size
                if kind in _TYPES and values * struct.calcsize("=" + _TYPES[kind]) > inline:
                    (offset,) = struct.unpack_from(self._order + head[0], self._data, offset)
                self._entries.setdefault(tag, (kind, values, offset))
                at += size + inline
        except (struct.error, OverflowError):
            self._entries.clear()  # cut off

    def __contains__(self, tag: int) -> bool:
        return tag in self._entries

    def offset(self, tag: int) -> int:
        """Byte where the tag's values begin."""
        return self._entries[tag][2]

    def numbers(self, tag: int) -> tuple[int, ...]:
        """The tag's values; () where it is missing, of another type, not whole, or absurdly long."""
        kind, count, offset = self._entries.get(tag, (0, 0, 0))
        if (
            kind not in _TYPES
            or count > _MAX_VALUES
            or count * struct.calcsize("=" + _TYPES[kind]) > len(self._data) - offset
        ):
            return ()
        return struct.unpack_from(f"{self._order}{count}{_TYPES[kind]}", self._data, offset)

    def number(self, tag: int, missing: int) -> int:
        """The tag's first value."""
        return next(iter(self.numbers(tag)), missing)

    def inside(self, tag: int) -> Ifd:
        """The directory whose place the tag has; an empty one where it is missing."""
        return Ifd(self._data if tag in self else b"", self.number(tag, 0))

    def raw(self, tag: int) -> bytes:
        """The tag's values as bytes; b"" where it is missing or not whole."""
        kind, count, offset = self._entries.get(tag, (0, 0, 0))
        return self._data[offset : offset + count] if kind in (1, 2, 7) and count <= len(self._data) - offset else b""


def _coding_by_camera(ifd: Ifd) -> str:
    """Cameras that are set to Adobe RGB say so in EXIF data, often without a profile. Source: DCF 2.0."""
    return "Adobe RGB" if ifd.inside(_EXIF).inside(_INTEROPERABILITY).raw(1)[:3] == b"R03" else ""


def _tiff_header(path: Path, data: bytes) -> PictureHeader:
    ifd = Ifd(data)
    if 256 not in ifd or 257 not in ifd:
        raise damaged(path, "this is not a TIFF file, or it is damaged")
    _check_tiff_kind(path, ifd)
    _check_tiff_whole(path, ifd, len(data))
    profile: bytes | None = ifd.raw(_PROFILE)
    if _PROFILE in ifd and not 0 < len(profile or b"") <= MAX_PROFILE:
        profile = None
    return PictureHeader(ifd.number(256, 0), ifd.number(257, 0), ifd.number(_ORIENTATION, 1), profile)


def _check_tiff_kind(path: Path, ifd: Ifd) -> None:
    """Refuses what OpenCV reads wrongly or not at all."""
    bits, samples, meaning = set(ifd.numbers(258)) or {1}, ifd.number(277, 1), ifd.number(262, 1)
    if set(ifd.numbers(339)) - {1} or not bits <= {1, 2, 4, 8, 16} or len(bits) > 1:
        raise RigError(f"{path}: TIFF of other numbers than whole ones of 8 or 16 bit is not read; write it as EXR")
    if meaning not in (0, 1, 2, 3, 6) or samples > _MAX_SAMPLES:
        raise RigError(f"{path}: TIFF of colours that are neither RGB nor grey is not read; write it as RGB")
    if bits == {16} and (meaning == 0 or (samples > 1 and ifd.number(284, 1) == 2)):
        raise RigError(f"{path}: TIFF of 16 bit with inverted or separate planes is not read; write it as plain RGB")
    if ifd.number(322, 1) * ifd.number(323, 1) > MAX_PIXELS:
        raise damaged(path, "the header claims tiles of an unusable size")


def _check_tiff_whole(path: Path, ifd: Ifd, length: int) -> None:
    """Every strip or tile lies inside the file: libtiff leaves what is missing black."""
    offsets, sizes = (ifd.numbers(tag) for tag in (_TILES if _TILES[0] in ifd else _STRIPS))
    # A strip whose size is not stated ends with the file.
    ends = [offset + size for offset, size in zip(offsets, sizes, strict=False)] or list(offsets)
    if not ends or max(ends) > length:
        raise damaged(path, "the TIFF file is truncated")


def tiff_as_stored(data: bytes) -> bytes:
    """The TIFF file, saying that it is upright and its alpha is no alpha: OpenCV would turn and multiply."""
    ifd, out = Ifd(data), bytearray(data)
    for tag, plain in ((_ORIENTATION, 1), (_EXTRA_SAMPLES, 0)):
        if ifd.numbers(tag):
            order = "big" if data[:1] == b"M" else "little"
            out[ifd.offset(tag) : ifd.offset(tag) + 2] = plain.to_bytes(2, order)  # type: ignore[arg-type]
    return bytes(out)


# --- WebP and BMP ---------------------------------------------------------------------------------------------------


def _webp_header(path: Path, data: bytes) -> PictureHeader:
    """Also checks that the file is whole."""
    if data[:4] != b"RIFF" or data[8:12] != b"WEBP":
        raise damaged(path, "this is not a WebP file")
    chunks, at, end = dict[bytes, bytes](), 12, 8 + int(struct.unpack_from("<I", data, 4)[0])
    while at < end - 8:
        kind, length = struct.unpack_from("<4sI", data, at)
        chunks.setdefault(kind, data[at + 8 : at + 8 + length])
        at += 8 + length + length % 2
    if max(at, end) > len(data):
        raise damaged(path, "the WebP file is truncated")
    if b"ANIM" in chunks:
        raise RigError(f"{path}: a moving WebP is not read; write a picture for each frame, or a video")
    if b"VP8X" in chunks:
        low, high = struct.unpack("<4x3s3s", chunks[b"VP8X"])
        size = int.from_bytes(low, "little") + 1, int.from_bytes(high, "little") + 1
    elif b"VP8L" in chunks:
        (bits,) = struct.unpack_from("<I", chunks[b"VP8L"], 1)
        size = (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    elif b"VP8 " in chunks:
        width, height = struct.unpack_from("<HH", chunks[b"VP8 "], 6)
        size = width & 0x3FFF, height & 0x3FFF
    else:
        raise damaged(path, "the WebP file holds no picture")
    profile: bytes | None = chunks.get(b"ICCP", b"")
    if profile is not None and len(profile) > MAX_PROFILE:
        profile = None
    exif = Ifd(chunks.get(b"EXIF", b"").removeprefix(b"Exif\0\0"))
    return PictureHeader(*size, exif.number(_ORIENTATION, 1), profile)


def _bmp_size(path: Path, data: bytes) -> tuple[int, int]:
    """Also checks that the file is whole, and of a kind that OpenCV reads as it is meant."""
    if data[:2] != b"BM":
        raise damaged(path, "this is not a BMP file")
    start, header, width, height, _, bits, coding = struct.unpack_from("<IIiiHHI", data, 10)
    if header < 40 or bits not in (8, 24, 32) or coding not in ((0, 3) if bits == 32 else (0,)):
        raise RigError(f"{path}: BMP of other than 8, 24 or 32 plain bits is not read; write it as PNG")
    if width > 0 and start + (width * bits + 31) // 32 * 4 * abs(height) > len(data):
        raise damaged(path, "the BMP file is truncated")
    return width, abs(height)


# --- EXR ------------------------------------------------------------------------------------------------------------


def _exr_size(path: Path, data: bytes) -> tuple[int, int]:
    attributes, _ = exr_attributes(path, data)
    if "displayWindow" not in attributes or "dataWindow" not in attributes:
        raise damaged(path, "the EXR header has no data or display window")
    boxes = [struct.unpack("<4i", attributes[key]) for key in ("dataWindow", "displayWindow")]
    for x0, y0, x1, y1 in boxes:
        if x1 < x0 or y1 < y0 or (x1 - x0 + 1) * (y1 - y0 + 1) > MAX_PIXELS:
            raise damaged(path, f"the EXR header claims a window of {x1 - x0 + 1} x {y1 - y0 + 1} pixels")
    x0, y0, x1, y1 = boxes[1]
    return x1 - x0 + 1, y1 - y0 + 1


def exr_attributes(path: Path, data: bytes) -> tuple[dict[str, bytes], int]:
    """Attributes of the (first) part by name, and the byte where its header ends."""
    if data[:4] != _EXR_MAGIC:
        raise damaged(path, "this is not an EXR file")
    attributes: dict[str, bytes] = {}
    at = 8
    while data[at] != 0:
        name_end = data.index(b"\0", at)
        type_end = data.index(b"\0", name_end + 1)
        size = int(struct.unpack_from("<I", data, type_end + 1)[0])
        value = type_end + 5
        if size > len(data) - value:
            raise damaged(path, "the EXR header is truncated")
        attributes[data[at:name_end].decode("latin-1")] = data[value : value + size]
        at = value + size
    return attributes, at + 1
