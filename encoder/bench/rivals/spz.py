""".spz version 3: fixed point and 8-bit values behind gzip.

Source: nianticlabs/spz, README.md "File Format" and src/cc/load-spz.cc. Its library turns axes to right, up, back when
it gets the input's; that flips signs only, so that the world's own axes are kept here. Its library, in
splat-transform 2.7.1, reads what is written here with the values that ``decode`` gives.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray, Splats

from .sequences import logits, opacities, to_bytes, unit_rotations

_HEADER = struct.Struct("<IIIBBBB")
_MAGIC, _VERSION = 0x5053474E, 3
_COLOUR = 0.15
_LARGEST = 0.5**0.5
_MAGNITUDE = 511
_GZIP = 16 + zlib.MAX_WBITS


@dataclass(frozen=True)
class Spz:
    """One frame. Defaults are the library's.

    ``fraction_bits``: of a position, in world units; it has 24 bits in all, and what lies outside them is put at their
    ends. ``sh1_bits``, ``sh_rest_bits``: kept of the 8 of each SH coefficient of degree 1 and above.
    """

    fraction_bits: int = 12
    sh1_bits: int = 5
    sh_rest_bits: int = 4
    suffix: ClassVar[str] = ".spz"

    def encode(self, splats: Splats) -> bytes:
        sh = splats.sh[:, 1:]
        bits = np.where(np.arange(sh.shape[1]) < 3, self.sh1_bits, self.sh_rest_bits)[:, None]
        raw = b"".join(
            (
                _HEADER.pack(_MAGIC, _VERSION, len(splats), splats.sh_degree, self.fraction_bits, 0, 0),
                _fixed_point(splats.means, self.fraction_bits).tobytes(),
                to_bytes(opacities(splats) * 255).tobytes(),
                to_bytes(splats.sh[:, 0] * (_COLOUR * 255) + 127.5).tobytes(),
                to_bytes((splats.log_scales + 10) * 16).tobytes(),
                _smallest_three(unit_rotations(splats)).tobytes(),
                _bucketed(sh, 1 << (8 - bits)).tobytes(),
            )
        )
        packer = zlib.compressobj(-1, zlib.DEFLATED, _GZIP, 9)
        return packer.compress(raw) + packer.flush()

    def decode(self, data: bytes) -> Splats:
        raw = zlib.decompress(data, _GZIP)
        _, _, count, degree, fraction_bits, _, _ = _HEADER.unpack_from(raw)
        rest = (degree + 1) ** 2 - 1
        widths = np.array([9, 1, 3, 3, 4, 3 * rest]) * count
        columns = np.split(np.frombuffer(raw, np.uint8, offset=_HEADER.size), np.cumsum(widths)[:-1])
        means, alphas, colours, scales, rotations, sh = (column.reshape(count, -1) for column in columns)
        dc = (colours / 255 - 0.5) / _COLOUR
        higher = ((sh.astype(np.float64) - 128) / 128).reshape(count, rest, 3)
        arrays = (
            _from_fixed_point(means, fraction_bits),
            scales / 16 - 10.0,
            _from_smallest_three(np.ascontiguousarray(rotations).view("<u4")[:, 0]),
            logits(alphas[:, 0] / np.float32(255)),
            np.concatenate([dc[:, None], higher], axis=1),
        )
        return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))


def _fixed_point(means: FloatArray, fraction_bits: int) -> NDArray[np.uint8]:
    bound = 1 << 23
    points = np.clip(np.rint(means.astype(np.float64) * (1 << fraction_bits)), -bound, bound - 1).astype("<i4")
    return np.ascontiguousarray(points.view(np.uint8).reshape(len(means), 3, 4)[..., :3])


def _from_fixed_point(data: NDArray[np.uint8], fraction_bits: int) -> NDArray[np.float64]:
    wide = np.zeros((len(data), 3, 4), np.uint8)
    wide[..., 1:] = data.reshape(len(data), 3, 3)
    # The three bytes stand highest, so that the shift brings the sign along.
    points = wide.view("<i4")[..., 0] >> 8
    return np.asarray(points / (1 << fraction_bits), np.float64)


def _smallest_three(rotations: FloatArray) -> NDArray[np.uint32]:
    """Number of the largest component, then a sign and nine bits for each of the others, x, y, z, w."""
    xyzw = np.roll(rotations, -1, axis=1)
    row = np.arange(len(xyzw))
    largest = np.abs(xyzw).argmax(axis=1)
    xyzw = xyzw * np.where(xyzw[row, largest] < 0, -1, 1)[:, None]
    packed = largest.astype("<u4")
    for i in range(4):
        magnitude = (np.abs(xyzw[:, i]) / _LARGEST * _MAGNITUDE + 0.5).astype("<u4")
        code = (xyzw[:, i] < 0).astype("<u4") << np.uint32(9) | magnitude
        packed = np.where(largest == i, packed, packed << np.uint32(10) | code)
    return np.asarray(packed, "<u4")


def _from_smallest_three(packed: NDArray[np.uint32]) -> NDArray[np.float64]:
    largest = (packed >> np.uint32(30)).astype(np.int64)
    xyzw = np.zeros((len(packed), 4))
    left = packed.copy()
    for i in (3, 2, 1, 0):
        value = (left & np.uint32(_MAGNITUDE)) / _MAGNITUDE * _LARGEST
        value = np.where(left >> np.uint32(9) & np.uint32(1), -value, value)
        xyzw[:, i] = np.where(largest == i, 0, value)
        left = np.where(largest == i, left, left >> np.uint32(10))
    xyzw[np.arange(len(packed)), largest] = np.sqrt(np.maximum(0, 1 - (xyzw**2).sum(axis=1)))
    return np.roll(xyzw, 1, axis=1)


def _bucketed(sh: FloatArray, bucket: NDArray[np.int64]) -> NDArray[np.uint8]:
    """128ths of a unit around 128, the lower bits rounded away: they stay in their byte, and gzip finds them."""
    whole = np.rint(sh.astype(np.float64) * 128).astype(np.int64) + 128
    return np.asarray(np.clip((whole + bucket // 2) // bucket * bucket, 0, 255), np.uint8)
