"""OpenEXR pictures: scene-linear RGB with Rec. 709's primaries, over black."""

from __future__ import annotations

import math
import struct
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..colours.primaries import to_rec709
from ..errors import RigError
from .headers import MAX_PIXELS, damaged, exr_attributes

MAX_SAMPLES = 4 * MAX_PIXELS
"""Numbers in all channels and parts of an EXR, which are decoded together: 4 GiB of floats."""

_TILED, _DEEP, _MULTI_PART = 0x200, 0x800, 0x1000
_LINES_PER_CHUNK = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256, 10: 256, 11: 32}
_OPAQUE = 0.998
"""Half a level of 255 from 1."""
_REC709_NAMES = (b"lin_rec709_scene", b"lin_rec709", b"unknown", b"data")


def read_exr(path: Path, data: bytes, width: int, height: int) -> NDArray[np.float32]:
    """The display window of the file, whose bytes are ``data``, (H, W, 3). Raises RigError."""
    attributes, _ = exr_attributes(path, data)
    matrix = _matrix(path, attributes)
    colours = _colours(path, _channels(path, data))
    if matrix is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            colours = colours @ matrix.T.astype(np.float32)
    picture = _in_display_window(attributes, colours)
    if picture.shape != (height, width, 3):
        raise damaged(path, "the EXR pixels do not fit the header")
    _check_finite(path, np.asarray(np.isfinite(picture).all(axis=2)))
    return picture


def read_exr_alpha(path: Path, data: bytes) -> NDArray[np.float32] | None:
    """The alpha over the display window, (H, W), clipped to 0..1; None where there is no channel A. Raises RigError."""
    attributes, _ = exr_attributes(path, data)
    alpha = _channels(path, data).get("A") if "A" in _names(attributes) else None
    if alpha is None:
        return None
    if alpha.ndim != 2:
        raise RigError(f"{path}: subsampled EXR channels are not supported; write it as plain RGB")
    _check_finite(path, np.isfinite(alpha))
    return np.clip(_in_display_window(attributes, alpha.astype(np.float32)), 0, 1)


def _check_finite(path: Path, finite: NDArray[np.bool_]) -> None:
    if not finite.all():
        y, x = (int(v) for v in np.argwhere(~finite)[0])
        count = int(finite.size - np.count_nonzero(finite))
        raise RigError(
            f"{path}: {count} pixel(s) are NaN or infinite, the first at column {x}, row {y}; "
            "clamp them or write the picture again"
        )


def exr_warnings(path: Path, data: bytes) -> Iterator[str]:
    """What the file says of itself that shows in the colours; its pixels are decoded if it has alpha.

    Raises RigError for colours that will not be read.
    """
    attributes, _ = exr_attributes(path, data)
    names = _names(attributes)
    _colour_names(path, names)
    _matrix(path, attributes)
    named = attributes.get("colorInteropID", b"unknown").strip(b"\0")
    if "chromaticities" not in attributes and named not in _REC709_NAMES:
        yield (
            f"its colours are tagged {named.decode('ascii', 'replace')!r} without chromaticities, and are taken for "
            "linear Rec. 709's; convert the pictures for right ones"
        )
    alpha = _channels(path, data).get("A") if "A" in names else None
    if alpha is not None and alpha.min() < _OPAQUE:
        yield "has alpha below 1; where that is not used, its colours are premultiplied, which is over black"


def _names(attributes: dict[str, bytes]) -> list[str]:
    """Channels of the (first) part. Source: OpenEXR File Layout, chlist."""
    listed, at = attributes.get("channels", b""), 0
    names = []
    while (end := listed.find(b"\0", at)) > at:
        names.append(listed[at:end].decode("latin-1"))
        at = end + 17
    return names


def _matrix(path: Path, attributes: dict[str, bytes]) -> NDArray[np.float64] | None:
    if "chromaticities" not in attributes:
        return None
    try:
        return to_rec709(struct.unpack("<8f", attributes["chromaticities"]))
    except (struct.error, ValueError):
        raise RigError(
            f"{path}: the chromaticities of its header span no colours; write them right, or leave them out"
        ) from None


def _check_chunks(path: Path, data: bytes) -> None:
    """Every chunk of a single-part scanline file lies inside the file; other kinds are left to the library."""
    (version,) = struct.unpack_from("<I", data, 4)
    if version & _DEEP:
        raise RigError(f"{path}: deep EXR is not supported; flatten it")
    attributes, table = exr_attributes(path, data)
    lines = _LINES_PER_CHUNK.get(attributes.get("compression", b"\xff")[0])
    if version & (_TILED | _MULTI_PART) or lines is None:
        return
    _, y0, _, y1 = struct.unpack("<4i", attributes["dataWindow"])
    chunks = -(-(y1 - y0 + 1) // lines)
    if chunks * 8 > len(data) - table:
        raise damaged(path, "the EXR file is truncated")
    for offset in struct.unpack_from(f"<{chunks}Q", data, table):
        if offset > len(data) - 8 or struct.unpack_from("<I", data, offset + 4)[0] > len(data) - offset - 8:
            raise damaged(path, "the EXR file is truncated")


def _check_samples(path: Path) -> None:
    """Everything is decoded, not only the colours of the first part: its sum must not be able to claim all memory."""
    import OpenEXR

    try:
        headers = [part.header for part in OpenEXR.File(str(path), header_only=True).parts]
        samples = sum(len(header["channels"]) * _area(*header["dataWindow"]) for header in headers)
    except Exception:  # as in _channels
        raise damaged(path, "the EXR header is damaged") from None
    if samples > MAX_SAMPLES:
        raise RigError(f"{path}: holds {samples} numbers in all its channels and parts; write it as plain RGB")


def _area(first: NDArray[np.int32], last: NDArray[np.int32]) -> int:
    """Pixels in a window, both corners included."""
    return math.prod(int(end) - int(start) + 1 for start, end in zip(first, last, strict=True))


def _channels(path: Path, data: bytes) -> dict[str, NDArray[np.floating]]:
    """The (first) part's channels over the data window, (h, w) where they are not subsampled."""
    import OpenEXR

    _check_samples(path)
    try:
        _check_chunks(path, data)
    except (struct.error, IndexError, ValueError):
        raise damaged(path, "the EXR header is damaged") from None
    try:
        channels = OpenEXR.File(str(path), separate_channels=True).channels()
        return {name: np.asarray(channel.pixels) for name, channel in channels.items()}
    except Exception:  # the binding throws RuntimeError, ValueError and others for a damaged file
        raise damaged(path, "the EXR file cannot be decoded") from None


def _colour_names(path: Path, names: Collection[str]) -> tuple[str, str, str]:
    """The channels that are red, green and blue."""
    if {"R", "G", "B"} <= set(names):
        return "R", "G", "B"
    if "Y" in names and ({"RY", "BY"} & set(names) or {"X", "Z"} <= set(names)):  # Z alone is depth
        raise RigError(f"{path}: luminance/chroma (Y, RY, BY) and XYZ EXR are not read; write it as plain RGB")
    if "Y" not in names:
        listed = ", ".join(repr(name) for name in sorted(names)) or "none"
        raise RigError(f"{path}: needs channels R, G, B (or Y), but has {listed}; write it as plain RGB")
    return "Y", "Y", "Y"


def _colours(path: Path, pixels: dict[str, NDArray[np.floating]]) -> NDArray[np.float32]:
    """R, G, B (or Y three times) over the data window, (h, w, 3)."""
    names = _colour_names(path, pixels)
    planes = [pixels[name] for name in names]
    if any(plane.ndim != 2 or plane.shape != planes[0].shape for plane in planes):
        raise RigError(f"{path}: subsampled EXR channels are not supported; write it as plain RGB")
    return np.stack(planes, axis=2).astype(np.float32)


def _in_display_window(attributes: dict[str, bytes], pixels: NDArray[np.float32]) -> NDArray[np.float32]:
    """The data window's pixels where they fall into the display window; black elsewhere (overscan is cut off)."""
    x0, y0, _, _ = struct.unpack("<4i", attributes["dataWindow"])
    left, top, right, bottom = struct.unpack("<4i", attributes["displayWindow"])
    width, height = right - left + 1, bottom - top + 1
    if (x0, y0) == (left, top) and pixels.shape[:2] == (height, width):
        return np.ascontiguousarray(pixels)
    picture = np.zeros((height, width, *pixels.shape[2:]), np.float32)
    to_x, to_y = max(x0 - left, 0), max(y0 - top, 0)
    part = pixels[max(top - y0, 0) :, max(left - x0, 0) :][: max(height - to_y, 0), : max(width - to_x, 0)]
    picture[to_y : to_y + part.shape[0], to_x : to_x + part.shape[1]] = part
    return picture
