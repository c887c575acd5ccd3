"""Byte planes: integers by significance, so that a general coder sees their structure (SPEC.md, "Byte planes")."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .state import IntArray

PlaneCounts = NDArray[np.uint8]


def zigzag(values: IntArray) -> NDArray[np.uint32]:
    """0, -1, 1, -2, ... to 0, 1, 2, 3, ...: small magnitudes become small unsigned numbers."""
    return np.asarray((values << np.int32(1)) ^ (values >> np.int32(31))).view(np.uint32)


def unzigzag(codes: NDArray[np.uint32]) -> IntArray:
    """The inverse of ``zigzag``, for every 32-bit code."""
    return np.asarray((codes >> np.uint32(1)) ^ (np.uint32(0) - (codes & np.uint32(1)))).view(np.int32)


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


def join_planes(counts: PlaneCounts, data: bytes, n: int, dtype: type[np.unsignedinteger[Any]]) -> NDArray[Any]:
    """The codes (n, channels) from their planes; ``data`` has ``counts.sum() * n`` bytes."""
    codes = np.zeros((len(counts), n), dtype)
    planes = np.frombuffer(data, np.uint8).reshape(int(counts.sum(dtype=np.int64)), n)
    start = 0
    for p in range(int(counts.max(initial=0))):
        wanted = counts > p
        stop = start + int(wanted.sum())
        if wanted.all():
            codes |= planes[start:stop].astype(dtype) << dtype(8 * p)
        else:
            codes[wanted] |= planes[start:stop].astype(dtype) << dtype(8 * p)
        start = stop
    return np.asarray(codes.T)
