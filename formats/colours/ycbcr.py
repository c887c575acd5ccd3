"""From a decoded frame to RGB as shown: by the matrix, range and place of chroma that the stream states.

Where it states no matrix, the usual convention holds: BT.709 from 1280 columns or more than 576 rows on, BT.601 below.
Where it states no range, it is the limited one. Chroma is interpolated linearly between where it lies; the result is
rounded once, to 8 bit. Own code, because streams must not depend on the version of a library or on the processor, and
because FFmpeg's conversion is either four times as slow or up to 1.5 levels too dark.

Sources: ITU-T H.273 (matrices, primaries, curves), BT.601, BT.709, BT.2020.
"""

from __future__ import annotations

import ctypes
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import av
import numpy as np
from av.video.reformatter import Interpolation
from numpy.typing import NDArray

from ..system.kernels import check_memory, load_kernel

if TYPE_CHECKING:
    from av import VideoFrame

_BT709, _BT601 = 1, 5
_FULL = 2
_LUMA_WEIGHTS = {
    1: (0.2126, 0.0722),
    4: (0.30, 0.11),
    5: (0.299, 0.114),
    6: (0.299, 0.114),
    7: (0.212, 0.087),
    9: (0.2627, 0.0593),
}
"""Weight of red and of blue in luma by matrix coefficients (H.273, table 4): BT.709, FCC, BT.601 twice, SMPTE 240M,
BT.2020."""
_OTHER_MATRICES = {8: "YCgCo", 10: "BT.2020 in constant luminance", 11: "YDzDx", 14: "ICtCp"}
_HD_WIDTH, _SD_HEIGHT = 1280, 576

_TRANSFERS = {8: "linear light", 16: "PQ", 18: "HLG"}
"""Curves that are not shown right when they are taken for the usual one, sRGB's or BT.709's."""
_WIDE = {9: "BT.2020", 11: "DCI-P3", 12: "Display P3"}
"""Primaries whose colours become pale when they are taken for sRGB's."""

_PLANAR = re.compile(r"yuv[aj]?(?P<kind>420|422|440|444)p(?:(?P<bits>9|10|12)le)?")
"""FFmpeg's formats that the kernel reads."""
_UNBIASED = Interpolation.BILINEAR | 0x40000
"""SWS_ACCURATE_RND: without it FFmpeg cuts off every product."""
_RAMP = 32
"""Levels from one chroma sample to the next, in the planes that show where FFmpeg sees them."""
HEEDS_SITING = int(av.__version__.split(".")[0]) >= 17
"""Before, chroma is taken to lie where most codecs have it unless they say otherwise: on the first column, half a pixel
below the first row."""
_BITS = 20
"""Of the fraction in the kernel's matrix (kernel/ycbcr.cpp)."""

Siting: TypeAlias = tuple[bool, bool]
"""Whether the first chroma sample lies on the first column, and on the first row, of luma samples; otherwise it lies
half a pixel further."""


class _Samples(ctypes.Structure):
    """Planes of YCbCr as the kernel reads them (kernel/ycbcr.cpp)."""

    _fields_ = [
        *((name, ctypes.c_void_p) for name in ("luma", "blue", "red")),
        *((name, ctypes.c_int64) for name in ("luma_stride", "blue_stride", "red_stride")),
        *((name, ctypes.c_int32) for name in ("width", "height", "wide", "halved_columns", "halved_rows")),
        *((name, ctypes.c_int32) for name in ("on_column", "on_row")),
        ("matrix", ctypes.c_int32 * 12),
    ]


@dataclass(frozen=True)
class YCbCr:
    """A picture's planes: Y (H, W), and Cb and Cr of as many samples or half as many along an axis, rounded up; uint8,
    or uint16 of ``bits``. ``full``: Y is 0 to 255 rather than 16 to 235, in 8 bit. ``matrix``: H.273's number."""

    planes: tuple[NDArray[Any], NDArray[Any], NDArray[Any]]
    bits: int
    matrix: int
    full: bool
    siting: Siting


def colours_of(transfer: int, primaries: int) -> str:
    """How a video's colours are coded if not as sRGB or BT.709 are, such as "PQ, BT.2020"; "" otherwise."""
    return ", ".join(filter(None, (_TRANSFERS.get(transfer), _WIDE.get(primaries))))


def to_rgb(frame: VideoFrame, siting: Siting) -> NDArray[np.uint8]:
    """A decoded frame as RGB uint8 (H, W, 3); alpha is dropped. Raises ValueError, with its name, for a matrix that is
    not read."""
    if frame.format.is_rgb or len(frame.format.components) < 3:
        planar = frame.reformat(format="gbrp", interpolation=_UNBIASED, dst_color_range=_FULL)
        green, blue, red = (_samples(plane) for plane in planar.planes)
        return np.stack([red, green, blue], axis=-1)
    matrix, full = _matrix(frame), int(frame.color_range) == _FULL or frame.format.name.startswith("yuvj")
    kind = _PLANAR.fullmatch(frame.format.name)
    if kind is None:  # another order of samples: chroma is filled up by FFmpeg, which knows where it lies
        deep = frame.format.components[0].bits > 8
        form, stated = "yuv444p12le" if deep else "yuv444p", int(frame.color_range)
        frame = frame.reformat(format=form, interpolation=_UNBIASED, src_color_range=stated, dst_color_range=stated)
        kind = _PLANAR.fullmatch(frame.format.name)
        assert kind is not None
    bits = int(kind["bits"] or 8)
    luma, blue, red = (_samples(plane, wide=bits > 8) for plane in frame.planes[:3])
    return rgb_of(YCbCr((luma, blue, red), bits, matrix, full, siting))


def rgb_of(picture: YCbCr) -> NDArray[np.uint8]:
    """RGB uint8 (H, W, 3) of planes, each value rounded to nearest."""
    (height, width), (rows, columns), _ = (plane.shape for plane in picture.planes)
    rgb = np.empty((height, width, 3), np.uint8)
    samples = _Samples(
        *(plane.ctypes.data for plane in picture.planes),
        *(plane.strides[0] // plane.itemsize for plane in picture.planes),
        width,
        height,
        picture.bits > 8,
        columns != width,
        rows != height,
        *picture.siting,
        (ctypes.c_int32 * 12)(*_fixed_matrix(picture).ravel().tolist()),
    )
    _library().decogs_rgb_of_ycbcr(ctypes.byref(samples), rgb.ctypes.data_as(ctypes.c_void_p))
    return rgb


def ycbcr_to_rgb(matrix: int, *, full: bool, bits: int = 8) -> NDArray[np.float64]:
    """(3, 4): RGB in 0 to 255 from (Y, Cb, Cr, 1) in ``bits``. Source: H.273, MatrixCoefficients, solved for RGB."""
    red, blue = _LUMA_WEIGHTS[matrix]
    green = 1 - red - blue
    coded = np.array(
        [
            [1, 0, 2 * (1 - red)],
            [1, -2 * (1 - blue) * blue / green, -2 * (1 - red) * red / green],
            [1, 2 * (1 - blue), 0],
        ]
    )
    unit = 1 << bits - 8
    black, ranges = (0, [256 * unit - 1] * 3) if full else (16 * unit, [219 * unit, 224 * unit, 224 * unit])
    product = coded * (255 / np.array(ranges))
    return np.concatenate([product, -product @ [[black], [128 * unit], [128 * unit]]], axis=1)


def chroma_siting(frame: VideoFrame) -> Siting:
    """Where the chroma samples lie by what the stream says.

    PyAV does not pass that on, but its conversion heeds it from version 17 on: a ramp shows where it sees the samples.
    """
    kind = _PLANAR.fullmatch(frame.format.name)
    if not HEEDS_SITING or kind is None or kind["kind"] == "444" or min(frame.width, frame.height) < 8:
        return True, False
    frame.make_writable()
    bits, chroma = int(kind["bits"] or 8), frame.planes[1:3]
    own = [bytes(plane) for plane in chroma]
    for plane, axis in zip(chroma, (1, 0), strict=True):
        samples = _samples(plane, wide=bits > 8, padded=True)
        ramp = np.minimum(np.indices(samples.shape)[axis] * _RAMP, 255) << (bits - 8)
        plane.update(ramp.astype(samples.dtype).tobytes())
    filled = frame.reformat(format="yuvj444p" if "j" in frame.format.name else "yuv444p", interpolation=_UNBIASED)
    for plane, data in zip(chroma, own, strict=True):
        plane.update(data)
    columns, rows = (_samples(plane) for plane in filled.planes[1:])
    # Luma sample 3 is at 1.5 chroma samples where both begin together, else at 1.25.
    return bool(columns[0, 3] > 1.375 * _RAMP), bool(rows[3, 0] > 1.375 * _RAMP)


def _matrix(frame: VideoFrame) -> int:
    stated = int(frame.colorspace)
    if stated in _OTHER_MATRICES:
        raise ValueError(_OTHER_MATRICES[stated])
    if stated in _LUMA_WEIGHTS:
        return stated
    return _BT709 if frame.width >= _HD_WIDTH or frame.height > _SD_HEIGHT else _BT601


def _fixed_matrix(picture: YCbCr) -> NDArray[np.int64]:
    matrix = ycbcr_to_rgb(picture.matrix, full=picture.full, bits=picture.bits)
    matrix[:, 1:3] /= 16  # the kernel has chroma in sixteenths
    return np.rint(matrix * (1 << _BITS)).astype(np.int64)


def _samples(plane: Any, *, wide: bool = False, padded: bool = False) -> NDArray[Any]:
    """A plane's samples (H, W) as they lie in FFmpeg's memory; ``padded``: with what fills up its rows."""
    kind = np.dtype("<u2" if wide else "u1")
    samples = np.frombuffer(plane, kind).reshape(plane.height, plane.line_size // kind.itemsize)
    return samples if padded else samples[:, : plane.width]


@lru_cache(maxsize=1)
def _library() -> ctypes.CDLL:
    library = load_kernel(Path(__file__).parent, "_ycbcr", [_Samples])
    library.decogs_rgb_of_ycbcr.restype = check_memory
    library.decogs_rgb_of_ycbcr.argtypes = [ctypes.POINTER(_Samples), ctypes.c_void_p]
    return library
