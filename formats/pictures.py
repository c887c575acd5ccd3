"""Reads one picture from a file: PNG and JPEG as display-referred bytes, OpenEXR as scene-linear floats.

A damaged file is refused before its decoder sees it where that is cheap (PNG checksums, JPEG end marker, EXR chunk
table): the decoders print to the terminal or hand out half a picture instead of failing.

Headers are walked here because no library does it as cheaply and as quietly. OpenCV cannot stop at one (7 to 24 ms for
a picture of 1345x1008 instead of 0.03 to 0.13) and prints what is wrong with a damaged file; OpenEXR prints too when
pixels are missing, and does not give the chunk table's place. Pillow would be 7.1 MB more to download, passes 165
of 182 cut JPEGs unless it decodes them, and refuses sizes by a limit of the whole process.
"""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .errors import RigError
from .quiet import quiet_opencv

Picture: TypeAlias = NDArray[np.uint8] | NDArray[np.float32]
"""(H, W, 3) RGB, C-contiguous: uint8 display-referred (sRGB-coded), or float32 scene-linear."""

PICTURE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".exr"})

MAX_PIXELS = 1 << 28
"""No picture larger than this is decoded: a few header bytes must not be able to claim all memory."""

MAX_EXR_SAMPLES = 4 * MAX_PIXELS
"""Numbers in all channels and parts of an EXR, which are decoded together: 4 GiB of floats."""

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_EXR_MAGIC = b"\x76\x2f\x31\x01"
_EXR_TILED, _EXR_DEEP, _EXR_MULTI_PART = 0x200, 0x800, 0x1000
_EXR_LINES_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256, 10: 256, 11: 32}


def read_picture(path: Path) -> Picture:
    """The picture in ``path``, RGB, (H, W, 3): uint8 from PNG and JPEG, float32 from EXR.

    Alpha is dropped, grey is repeated, 16-bit PNG is rounded to 8 bit; pixels stay as stored (EXIF rotation is not
    applied, as calibration tools do not apply it). An EXR is returned in its display window.
    Raises RigError if the file is missing, damaged, of another kind, or holds a NaN or infinite pixel.
    """
    data = _read_bytes(path)
    width, height = _size(path, data)
    if path.suffix.lower() == ".exr":
        return _read_exr(path, data, width, height)
    return _read_coded(path, data, width, height)


def picture_size(path: Path) -> tuple[int, int]:
    """Width and height in pixels from the file's header alone; no pixel is decoded. Raises RigError."""
    return _size(path, _read_bytes(path))


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); put the picture back or fix its rights") from None


def _damaged(path: Path, what: str) -> RigError:
    return RigError(f"{path}: {what}; write the picture again from its source")


def _size(path: Path, data: bytes) -> tuple[int, int]:
    suffix = path.suffix.lower()
    try:
        if suffix == ".png":
            width, height = _png_size(path, data)
        elif suffix in (".jpg", ".jpeg"):
            width, height = _jpeg_size(path, data)
        elif suffix == ".exr":
            width, height = _exr_size(path, data)
        else:
            raise RigError(f"{path}: not a picture format that can be read; use PNG, JPEG or EXR")
    except (struct.error, IndexError, ValueError):
        raise _damaged(path, "the picture's header is damaged or truncated") from None
    if width < 1 or height < 1 or width * height > MAX_PIXELS:
        raise _damaged(path, f"the header claims {width} x {height} pixels, which is not a usable size")
    return width, height


def _png_size(path: Path, data: bytes) -> tuple[int, int]:
    if data[:8] != _PNG_SIGNATURE or data[12:16] != b"IHDR":
        raise _damaged(path, "this is not a PNG file")
    width, height = struct.unpack_from(">II", data, 16)
    return width, height


def _jpeg_size(path: Path, data: bytes) -> tuple[int, int]:
    if data[:2] != b"\xff\xd8":
        raise _damaged(path, "this is not a JPEG file")
    at = 2
    while True:
        if data[at] != 0xFF:
            raise _damaged(path, f"the JPEG marker at byte {at} is damaged")
        marker = data[at + 1]
        if marker == 0xFF:  # fill byte before a marker
            at += 1
        elif 0xC0 <= marker <= 0xCF and marker not in (0xC4, 0xC8, 0xCC):
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + int(struct.unpack_from(">H", data, at + 2)[0])


def _exr_size(path: Path, data: bytes) -> tuple[int, int]:
    attributes, _ = _exr_header(path, data)
    if "displayWindow" not in attributes or "dataWindow" not in attributes:
        raise _damaged(path, "the EXR header has no data or display window")
    boxes = [struct.unpack("<4i", attributes[key]) for key in ("dataWindow", "displayWindow")]
    for x0, y0, x1, y1 in boxes:
        if x1 < x0 or y1 < y0 or (x1 - x0 + 1) * (y1 - y0 + 1) > MAX_PIXELS:
            raise _damaged(path, f"the EXR header claims a window of {x1 - x0 + 1} x {y1 - y0 + 1} pixels")
    x0, y0, x1, y1 = boxes[1]
    return x1 - x0 + 1, y1 - y0 + 1


def _exr_header(path: Path, data: bytes) -> tuple[dict[str, bytes], int]:
    """Attributes of the (first) part by name, and the byte where its header ends. Source: OpenEXR File Layout."""
    if data[:4] != _EXR_MAGIC:
        raise _damaged(path, "this is not an EXR file")
    attributes: dict[str, bytes] = {}
    at = 8
    while data[at] != 0:
        name_end = data.index(b"\0", at)
        type_end = data.index(b"\0", name_end + 1)
        size = int(struct.unpack_from("<I", data, type_end + 1)[0])
        value = type_end + 5
        if size > len(data) - value:
            raise _damaged(path, "the EXR header is truncated")
        attributes[data[at:name_end].decode("latin-1")] = data[value : value + size]
        at = value + size
    return attributes, at + 1


def _check_png(path: Path, data: bytes) -> None:
    """Every chunk is whole and its checksum fits. Source: PNG specification, section 5."""
    at, kind = 8, b""
    while kind != b"IEND":
        if len(data) - at < 12:
            raise _damaged(path, "the PNG file is truncated")
        length, kind = struct.unpack_from(">I4s", data, at)
        if length > len(data) - at - 12:
            raise _damaged(path, "the PNG file is truncated")
        (stored,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(data[at + 4 : at + 8 + length]) != stored:
            raise _damaged(path, f"a checksum of the PNG file does not fit at byte {at}")
        at += 12 + length


def _check_jpeg(path: Path, data: bytes) -> None:
    # Markers cannot occur inside coded data, so a whole file has its end marker after its last scan.
    if data.rfind(b"\xff\xd9") < data.rfind(b"\xff\xda"):
        raise _damaged(path, "the JPEG file is truncated")


def _read_coded(path: Path, data: bytes, width: int, height: int) -> NDArray[np.uint8]:
    import cv2

    if path.suffix.lower() == ".png":
        _check_png(path, data)
    else:
        _check_jpeg(path, data)
    flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    try:
        with quiet_opencv():
            bgr = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        bgr = None
    if bgr is None or bgr.shape != (height, width, 3):
        raise _damaged(path, "the picture cannot be decoded")
    if bgr.dtype == np.uint16:
        bgr = ((bgr.astype(np.uint32) + 128) // 257).astype(np.uint8)
    if bgr.dtype != np.uint8:
        raise RigError(f"{path}: pixels of type {bgr.dtype} are not supported; use 8 or 16 bit")
    return np.ascontiguousarray(bgr[:, :, ::-1], np.uint8)


def _check_exr_chunks(path: Path, data: bytes) -> None:
    """Every chunk of a single-part scanline file lies inside the file; other kinds are left to the library."""
    (version,) = struct.unpack_from("<I", data, 4)
    if version & _EXR_DEEP:
        raise RigError(f"{path}: deep EXR is not supported; flatten it")
    attributes, table = _exr_header(path, data)
    lines = _EXR_LINES_PER_CHUNK.get(attributes.get("compression", b"\xff")[0])
    if version & (_EXR_TILED | _EXR_MULTI_PART) or lines is None:
        return
    _, y0, _, y1 = struct.unpack("<4i", attributes["dataWindow"])
    chunks = -(-(y1 - y0 + 1) // lines)
    if chunks * 8 > len(data) - table:
        raise _damaged(path, "the EXR file is truncated")
    for offset in struct.unpack_from(f"<{chunks}Q", data, table):
        if offset > len(data) - 8 or struct.unpack_from("<I", data, offset + 4)[0] > len(data) - offset - 8:
            raise _damaged(path, "the EXR file is truncated")


def _read_exr(path: Path, data: bytes, width: int, height: int) -> NDArray[np.float32]:
    _check_exr_samples(path)
    try:
        _check_exr_chunks(path, data)
    except (struct.error, IndexError, ValueError):
        raise _damaged(path, "the EXR header is damaged") from None
    picture = _in_display_window(path, data, _exr_channels(path))
    if picture.shape != (height, width, 3):
        raise _damaged(path, "the EXR pixels do not fit the header")
    finite = np.isfinite(picture).all(axis=2)
    if not finite.all():
        y, x = (int(v) for v in np.argwhere(~finite)[0])
        count = int(finite.size - np.count_nonzero(finite))
        raise RigError(
            f"{path}: {count} pixel(s) are NaN or infinite, the first at column {x}, row {y}; "
            "clamp them or write the picture again"
        )
    return picture


def _check_exr_samples(path: Path) -> None:
    """Everything is decoded, not only the colours of the first part: its sum must not be able to claim all memory."""
    import OpenEXR

    try:
        headers = [part.header for part in OpenEXR.File(str(path), header_only=True).parts]
        samples = sum(len(header["channels"]) * _area(*header["dataWindow"]) for header in headers)
    except Exception:  # as in _exr_channels
        raise _damaged(path, "the EXR header is damaged") from None
    if samples > MAX_EXR_SAMPLES:
        raise RigError(f"{path}: holds {samples} numbers in all its channels and parts; write it as plain RGB")


def _area(first: NDArray[np.int32], last: NDArray[np.int32]) -> int:
    """Pixels in a window, both corners included."""
    return math.prod(int(end) - int(start) + 1 for start, end in zip(first, last, strict=True))


def _exr_channels(path: Path) -> NDArray[np.float32]:
    """R, G, B (or Y three times) over the data window, (h, w, 3)."""
    import OpenEXR

    try:
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
        pixels = {name: np.asarray(channel.pixels) for name, channel in channels.items()}
    except Exception:  # the binding throws RuntimeError, ValueError and others for a damaged file
        raise _damaged(path, "the EXR file cannot be decoded") from None
    names = ("R", "G", "B") if {"R", "G", "B"} <= pixels.keys() else ("Y", "Y", "Y")
    if "Y" in names and "Y" not in pixels:
        found = ", ".join(repr(name) for name in sorted(pixels)) or "none"
        raise RigError(f"{path}: needs channels R, G, B (or Y), but has {found}; write it as plain RGB")
    planes = [pixels[name] for name in names]
    if any(plane.ndim != 2 or plane.shape != planes[0].shape for plane in planes):
        raise RigError(f"{path}: subsampled EXR channels are not supported; write it as plain RGB")
    return np.stack(planes, axis=2).astype(np.float32)


def _in_display_window(path: Path, data: bytes, pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """The data window's pixels where they fall into the display window; black elsewhere (overscan is cut off)."""
    attributes, _ = _exr_header(path, data)
    x0, y0, _, _ = struct.unpack("<4i", attributes["dataWindow"])
    left, top, right, bottom = struct.unpack("<4i", attributes["displayWindow"])
    width, height = right - left + 1, bottom - top + 1
    if (x0, y0) == (left, top) and pixels.shape[:2] == (height, width):
        return np.ascontiguousarray(pixels)
    picture = np.zeros((height, width, 3), np.float32)
    to_x, to_y = max(x0 - left, 0), max(y0 - top, 0)
    part = pixels[max(top - y0, 0) :, max(left - x0, 0) :][: max(height - to_y, 0), : max(width - to_x, 0)]
    picture[to_y : to_y + part.shape[0], to_x : to_x + part.shape[1]] = part
    return picture
