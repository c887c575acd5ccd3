"""Frames as float32 arrays behind a general-purpose compressor: whole frames, or only what changes in each."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import zstandard
from numpy.typing import NDArray

from decogs.codec.scene.state import Rows
from decogs.formats.splats import FloatArray, Splats

from .sequences import FilePerFrame, Frames, Rival, SceneFrame, Sizes, WithoutDirections, numbered, write_numbered

_COUNTS = np.dtype("<u4")
_SUFFIX = ".f32.zst"


@dataclass(frozen=True)
class FloatArrays:
    """The arrays of a frame one after the other, float32, as one zstd frame."""

    level: int = 19
    suffix: ClassVar[str] = _SUFFIX

    def encode(self, splats: Splats) -> bytes:
        table = _table(splats)
        counts = np.array([len(splats), splats.sh.shape[1]], _COUNTS)
        return _compressed(self.level, counts, _by_column(table))

    def decode(self, data: bytes) -> Splats:
        raw = zstandard.ZstdDecompressor().decompress(data)
        count, coefficients = (int(value) for value in np.frombuffer(raw, _COUNTS, 2))
        values, _ = _take_table(raw, 2 * _COUNTS.itemsize, count, coefficients)
        return _splats(values, coefficients)


@dataclass(frozen=True)
class FloatDeltas:
    """The first frame whole; of each later one the numbers of the rows that differ, and their new float32 values.

    Removed and added rows are distinct; rows that are the same to the bit cost nothing.
    """

    level: int = 19

    def missing(self) -> str | None:
        return None

    def write(self, frames: Frames, folder: Path) -> Sizes:
        return write_numbered(folder, _SUFFIX, self._files(frames()))

    def read(self, folder: Path) -> Iterator[Splats]:
        first, *later = numbered(folder, _SUFFIX)
        splats = FloatArrays().decode(first.read_bytes())
        coefficients, values = splats.sh.shape[1], _table(splats)
        yield splats
        for path in later:
            values = _changed(values, zstandard.ZstdDecompressor().decompress(path.read_bytes()), coefficients)
            yield _splats(values, coefficients)

    def _files(self, frames: Iterator[SceneFrame]) -> Iterator[bytes]:
        before = next(frames)
        yield FloatArrays(self.level).encode(before.splats)
        for frame in frames:
            yield self._delta(before, frame)
            before = frame

    def _delta(self, before: SceneFrame, after: SceneFrame) -> bytes:
        gone = np.flatnonzero(~np.isin(before.ids, after.ids, assume_unique=True))
        old, new = np.delete(_table(before.splats), gone, axis=0), _table(after.splats)
        # Ids only grow: what stays keeps its order, and what comes stands behind it.
        rows = np.flatnonzero((new[: len(old)] != old).any(axis=1))
        counts = np.array([len(gone), len(rows), len(new) - len(old)], _COUNTS)
        return _compressed(
            self.level, counts, _gaps(gone), _gaps(rows), _by_column(new[rows]), _by_column(new[len(old) :])
        )


def _changed(values: FloatArray, raw: bytes, coefficients: int) -> FloatArray:
    gone, rows, added = (int(value) for value in np.frombuffer(raw, _COUNTS, 3))
    offset = 3 * _COUNTS.itemsize
    gone_rows = np.cumsum(np.frombuffer(raw, _COUNTS, gone, offset), dtype=np.int64)
    offset += gone * _COUNTS.itemsize
    changed_rows = np.cumsum(np.frombuffer(raw, _COUNTS, rows, offset), dtype=np.int64)
    offset += rows * _COUNTS.itemsize
    values = np.delete(values, gone_rows, axis=0)
    values[changed_rows], offset = _take_table(raw, offset, rows, coefficients)
    appended, _ = _take_table(raw, offset, added, coefficients)
    return np.concatenate([values, appended])


def _compressed(level: int, *parts: NDArray[Any]) -> bytes:
    return zstandard.ZstdCompressor(level=level).compress(b"".join(part.tobytes() for part in parts))


def _gaps(rows: Rows) -> NDArray[np.uint32]:
    return np.diff(rows, prepend=0).astype(_COUNTS)


def _table(splats: Splats) -> FloatArray:
    """All values of a Gaussian in a row, (N, 11 + 3 K)."""
    return np.concatenate([array.reshape(len(splats), -1) for array in astuple(splats)], axis=1)


def _by_column(table: FloatArray) -> FloatArray:
    return np.ascontiguousarray(table.T)


def _take_table(raw: bytes, offset: int, count: int, coefficients: int) -> tuple[FloatArray, int]:
    channels = 11 + 3 * coefficients
    values = np.frombuffer(raw, "<f4", count * channels, offset).reshape(channels, count)
    return np.array(values.T, np.float32, order="C"), offset + values.nbytes


def _splats(table: FloatArray, coefficients: int) -> Splats:
    means, log_scales, quaternions, opacity_logits, sh = np.split(table, [3, 6, 10, 11], axis=1)
    arrays = (means, log_scales, quaternions, opacity_logits[:, 0], sh.reshape(len(table), coefficients, 3))
    return Splats(*(np.ascontiguousarray(array) for array in arrays))


RIVALS = (
    Rival("float32", "float32 + zstd", "float32 arrays per frame, zstd 19", FilePerFrame(FloatArrays())),
    Rival(
        "float32-sh0",
        "float32 + zstd",
        "float32 arrays per frame, SH degree 0 only, zstd 19",
        WithoutDirections(FilePerFrame(FloatArrays())),
        "View-dependent colour is left out: what the formats without it can reach at best.",
    ),
    Rival("float32-deltas", "float32 deltas + zstd", "float32 of the rows that change, zstd 19", FloatDeltas()),
)
