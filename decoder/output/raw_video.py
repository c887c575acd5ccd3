"""Uncompressed video for a pipe or a file: YUV4MPEG2 (.y4m), which FFmpeg and every encoder read, and raw RGB (.rgb).

Y4M is 8-bit 4:4:4 in BT.601, limited range: the format cannot name a matrix, and FFmpeg takes this one then.
Raw RGB is the pixels of the PNGs, 3 bytes each, row by row, picture by picture, without a header.

Source: yuv4mpeg(5) of mjpegtools; ITU-R BT.601, equations of 8-bit YCbCr.
"""

from __future__ import annotations

from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from decogs.formats.frames.rates import exact_rate

_YCBCR = np.array(
    [[65.481, 128.553, 24.966], [-37.797, -74.203, 112.0], [112.0, -93.786, -18.214]], np.float32
) / np.float32(255)
_OFFSET = np.array([16, 128, 128], np.float32)


class RawVideo:
    """Pictures (H, W, 3) uint8 of one size, one after the other, to an open file."""

    def __init__(self, file: BinaryIO, fps: float, *, y4m: bool) -> None:
        self._file, self._fps, self._y4m, self._begun = file, fps, y4m, False

    def write(self, picture: NDArray[np.uint8]) -> None:
        """Adds a display-referred picture."""
        if not self._y4m:
            self._file.write(np.ascontiguousarray(picture).tobytes())
            return
        if not self._begun:
            rate, (height, width) = exact_rate(self._fps), picture.shape[:2]
            self._file.write(
                f"YUV4MPEG2 W{width} H{height} F{rate.numerator}:{rate.denominator} Ip A1:1 C444\n".encode()
            )
            self._begun = True
        self._file.write(b"FRAME\n" + to_ycbcr(picture).tobytes())


def to_ycbcr(picture: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """RGB (H, W, 3) as planes (3, H, W) of Y, Cb and Cr."""
    planes = np.moveaxis(picture.astype(np.float32) @ _YCBCR.T + _OFFSET, -1, 0)
    return np.ascontiguousarray(np.rint(planes).astype(np.uint8))
