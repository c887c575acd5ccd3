"""Reads one picture from a file: OpenEXR as scene-linear floats, all others as display-referred bytes.

A damaged file is refused before its decoder sees it where that is cheap (PNG checksums, JPEG end marker, places of TIFF
strips, lengths of WebP and BMP, EXR chunk table): the decoders print to the terminal or hand out half a picture instead
of failing. docs/colours.md says what the numbers mean.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..colours.profiles import conversion, to_srgb
from ..errors import RigError
from ..files.regular_files import open_regular
from ..system.quiet import quiet_opencv
from .exr import exr_warnings, read_exr, read_exr_alpha
from .headers import (
    MAX_PIXELS,
    PICTURE_KINDS,
    PICTURE_SUFFIXES,
    TIFF_SUFFIXES,
    PictureHeader,
    damaged,
    read_header,
    tiff_as_stored,
)

__all__ = [
    "MAX_PIXELS", "PICTURE_KINDS", "PICTURE_SUFFIXES", "Picture", "PictureFacts", "decode_picture", "picture_facts",
    "read_alpha", "read_picture",
]  # fmt: skip

Picture: TypeAlias = NDArray[np.uint8] | NDArray[np.float32]
"""(H, W, 3) RGB, C-contiguous: uint8 display-referred (sRGB-coded), or float32 scene-linear."""

_PNG_WITH_ALPHA = (4, 6)
"""Colour types. Source: PNG specification, section 11.2.1."""
_PNG_PIXELS = frozenset({b"IHDR", b"PLTE", b"tRNS", b"IDAT", b"IEND"})


@dataclass(frozen=True)
class PictureFacts:
    """What is known of a picture before it is read: size in pixels as stored, EXIF orientation (1 to 8, 1 for none),
    and what it says of itself that is not an error, but shows in its colours, a line each."""

    width: int
    height: int
    orientation: int
    warnings: tuple[str, ...]


def read_picture(path: Path) -> Picture:
    """The picture in ``path``, RGB, (H, W, 3): float32 from EXR, uint8 sRGB from all others.

    Alpha is dropped, grey is repeated, 16 bit are rounded to 8; pixels stay as stored (EXIF orientation is not
    applied). Colours with an ICC profile are converted to sRGB, an EXR's with other chromaticities to Rec. 709. An EXR
    is returned in its display window.
    Raises RigError if the file is missing, damaged, of another kind, or holds a NaN or infinite pixel.
    """
    return decode_picture(path, _read_bytes(path))


def decode_picture(path: Path, data: bytes) -> Picture:
    """The picture in the bytes of a file, whose name says by its ending what they are; as ``read_picture``."""
    header = read_header(path, data)
    if path.suffix.lower() == ".exr":
        return read_exr(path, data, header.width, header.height)
    return _read_coded(path, data, header)


def read_alpha(path: Path) -> NDArray[np.float32] | None:
    """The alpha (H, W), 0..1, of a PNG, WebP or EXR, as stored; None where the file has none. Raises RigError."""
    suffix = path.suffix.lower()
    if suffix not in (".png", ".webp", ".exr"):
        return None
    data = _read_bytes(path)
    header = read_header(path, data)
    if suffix == ".exr":
        return read_exr_alpha(path, data)
    if suffix == ".png" and data[25] not in _PNG_WITH_ALPHA and b"tRNS" not in data[: data.find(b"IDAT")]:
        return None
    import cv2

    coded = _checked_png(path, data) if suffix == ".png" else data
    pixels = _decoded(path, coded, header, cv2.IMREAD_UNCHANGED)
    if pixels.ndim < 3 or pixels.shape[2] != 4:
        return None
    return np.asarray(pixels[..., 3] / np.float32(np.iinfo(pixels.dtype).max), np.float32)


def picture_facts(path: Path) -> PictureFacts:
    """Size, orientation and warnings; no pixel is decoded, but an EXR's that has alpha. Raises RigError."""
    data = _read_bytes(path)
    header = read_header(path, data)
    warnings = exr_warnings(path, data) if path.suffix.lower() == ".exr" else _warnings(header)
    return PictureFacts(header.width, header.height, header.orientation, tuple(warnings))


def _warnings(header: PictureHeader) -> list[str]:
    unusable = header.profile is None or (header.profile and conversion(header.profile) is None)
    coding = "by an ICC profile that is damaged, or of neither RGB nor grey" if unusable else header.coding
    text = f"its colours are tagged {coding}, and are taken for sRGB's; convert the pictures to sRGB for right ones"
    return [text] if coding else []


def _read_bytes(path: Path) -> bytes:
    try:
        with open_regular(path) as file:
            return file.read()
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); put the picture back or fix its rights") from None


def _checked_png(path: Path, data: bytes) -> bytes:
    """The PNG file with the chunks that hold pixels: of others, which were looked at, libpng prints what it dislikes.

    Every chunk is whole and its checksum fits. Source: PNG specification, section 5.
    """
    at, kind, kept = 8, b"", [data[:8]]
    while kind != b"IEND":
        if len(data) - at < 12:
            raise damaged(path, "the PNG file is truncated")
        length, kind = struct.unpack_from(">I4s", data, at)
        if length > len(data) - at - 12:
            raise damaged(path, "the PNG file is truncated")
        (stored,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(data[at + 4 : at + 8 + length]) != stored:
            raise damaged(path, f"a checksum of the PNG file does not fit at byte {at}")
        if kind in _PNG_PIXELS:
            kept.append(data[at : at + 12 + length])
        at += 12 + length
    return b"".join(kept)


def _check_jpeg(path: Path, data: bytes) -> None:
    # Markers cannot occur inside coded data, so a whole file has its end marker after its last scan.
    if data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda"):
        raise damaged(path, "the JPEG file is truncated")


def _read_coded(path: Path, data: bytes, header: PictureHeader) -> NDArray[np.uint8]:
    import cv2

    suffix = path.suffix.lower()
    if suffix == ".png":
        data = _checked_png(path, data)
    elif suffix in TIFF_SUFFIXES:
        data = tiff_as_stored(data)
    elif suffix in (".jpg", ".jpeg"):
        _check_jpeg(path, data)
    bgr = _decoded(path, data, header, cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION)
    rgb = bgr[:, :, ::-1]
    if header.profile:
        rgb = to_srgb(rgb, header.profile)
    if rgb.dtype == np.uint16:
        rgb = ((rgb.astype(np.uint32) + 128) // 257).astype(np.uint8)
    return np.ascontiguousarray(rgb, np.uint8)


def _decoded(path: Path, data: bytes, header: PictureHeader, flags: int) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """The pixels as OpenCV's ``flags`` ask for them, channels in its order."""
    import cv2

    try:
        with quiet_opencv():
            pixels = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        pixels = None
    if pixels is None or pixels.shape[:2] != (header.height, header.width):
        raise damaged(path, "the picture cannot be decoded")
    if pixels.dtype not in (np.uint8, np.uint16):
        raise RigError(f"{path}: pixels of type {pixels.dtype} are not supported; use 8 or 16 bit")
    return pixels  # type: ignore[return-value]
