"""Byte planes: integers by significance, so that a general coder sees their structure (SPEC.md, "Byte planes")."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..scene.state import Integers

PlaneCounts = NDArray[np.uint8]


def zigzag(values: Integers) -> NDArray[np.uint32]:
    """0, -1, 1, -2, ... to 0, 1, 2, 3, ...: small magnitudes become small unsigned numbers."""
    values = values.astype(np.int32, copy=False)
    return np.asarray((values << np.int32(1)) ^ (values >> np.int32(31))).view(np.uint32)


def unzigzag(codes: NDArray[np.unsignedinteger[Any]]) -> Integers:
    """The inverse of ``zigzag``, for every code of an unsigned type, in the signed type of its width."""
    one = codes.dtype.type(1)
    signs = codes & one
    np.negative(signs, out=signs)
    signs ^= codes >> one
    return np.asarray(signs.view(f"i{codes.itemsize}"))


def split_planes(codes: NDArray[Any]) -> tuple[PlaneCounts, bytes]:
    """Unsigned codes (n, channels) as planes: how many each channel needs, and the bytes.

    Plane 0 (the lowest bytes) of every channel that has one, channel after channel, then plane 1, and so on.
    """
    n, channels = codes.shape
    peaks = codes.max(axis=0) if n else np.zeros(channels, codes.dtype)
    counts = np.array([(int(peak).bit_length() + 7) // 8 for peak in peaks], np.uint8)
    planes = [
        (codes[:, counts > p] >> codes.dtype.type(8 * p)).astype(np.uint8).T.tobytes()
        for p in range(int(counts.max(initial=0)))
    ]
    return counts, b"".join(planes)


def join_planes(counts: PlaneCounts, data: bytes, n: int) -> NDArray[np.unsignedinteger[Any]]:
    """The codes (n, channels) from their planes; ``data`` has ``counts.sum() * n`` bytes.

    Their type is the narrowest that holds as many bytes as the longest channel has planes: most residuals fit one byte,
    and what is narrow is quickly turned.
    """
    planes = np.frombuffer(data, np.uint8).reshape(int(counts.sum(dtype=np.int64)), n)
    longest = int(counts.max(initial=0))
    if longest == 1 and counts.all():
        return np.asarray(planes.T)
    width = next(w for w in (1, 2, 4, 8) if w >= longest)
    digits = np.zeros((len(counts), n, width), np.uint8)
    start = 0
    for p in range(longest):
        wanted = counts > p
        stop = start + int(wanted.sum())
        digits[wanted, :, p] = planes[start:stop]
        start = stop
    return np.asarray(digits.view(f"<u{width}")[:, :, 0].T)
