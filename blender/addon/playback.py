"""Frames of a stream in any order, as arrays for Blender. Knows nothing of Blender; needs numpy and the reader."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.codec.header.header import StreamHeader
from decogs.decoder.reading.damage import Damage
from decogs.decoder.reading.frame import DecodedFrame
from decogs.decoder.reading.stream import Stream, open_stream
from decogs.formats.splats import SH_C0, sigmoid

FloatArray = NDArray[np.float32]

_KEPT_BYTES = 256 << 20
_STEPS = 30
"""Frames that are stepped over rather than sought: a seek decodes from the keyframe before, which may be the first."""
_HASH = 0x9E3779B97F4A7C15
"""2^64 over the golden ratio (Knuth 6.4): its multiples spread evenly, whatever ids follow each other."""


@dataclass(frozen=True)
class ShownFrame:
    """N Gaussians as Blender shows them, float32, in the stream's axes and units.

    ``ids`` (N,) int64; ``positions`` and ``scales`` (N, 3), standard deviations; ``rotations`` (N, 4) unit quaternions
    wxyz; ``opacities`` (N,); ``colours`` (N, 3) display-referred, of SH degree 0.
    """

    ids: NDArray[np.int64]
    positions: FloatArray
    scales: FloatArray
    rotations: FloatArray
    opacities: FloatArray
    colours: FloatArray

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays."""
        return sum(values.nbytes for values in vars(self).values())


def shown(frame: DecodedFrame) -> ShownFrame:
    """A decoded frame, activated."""
    splats = frame.splats
    norms = np.linalg.norm(splats.quaternions, axis=1, keepdims=True)
    identity = np.array([1, 0, 0, 0], np.float32)
    return ShownFrame(
        ids=frame.state.ids,
        positions=splats.means,
        scales=np.exp(splats.log_scales),
        rotations=np.where(norms > 0, splats.quaternions / np.where(norms > 0, norms, 1), identity),
        opacities=sigmoid(splats.opacity_logits),
        colours=np.maximum(np.float32(0.5) + np.float32(SH_C0) * splats.sh[:, 0], 0),
    )


def ranks(ids: NDArray[np.int64]) -> FloatArray:
    """A number in [0, 1) for every id, the same in all frames, spread evenly: a fraction of them is below it."""
    high = (ids.astype(np.uint64) * np.uint64(_HASH)) >> np.uint64(40)
    return np.asarray(high.astype(np.float32) / np.float32(1 << 24))


class Playback:
    """An open stream whose frames are asked for in any order.

    Going on is one step; going back decodes from the keyframe before, unless the frame is among those that are kept
    (256 MB of them). ``on_damage`` is called once for every damaged place. Raises what ``open_stream`` and ``frames``
    raise.
    """

    def __init__(self, path: str | os.PathLike[str], on_damage: Callable[[Damage], None]) -> None:
        self._stream: Stream = open_stream(path, on_damage=on_damage)
        self._frames: Iterator[DecodedFrame] = iter(())
        self._at: int | None = None
        self._kept: OrderedDict[int, ShownFrame] = OrderedDict()
        self._kept_bytes = 0

    @property
    def path(self) -> Path:
        return self._stream.path

    @property
    def header(self) -> StreamHeader:
        return self._stream.header

    @property
    def frame_count(self) -> int:
        return self._stream.frame_count

    def close(self) -> None:
        """Closes the file; frames cannot be asked for any more."""
        self._stream.__exit__(None, None, None)

    def frame(self, index: int) -> ShownFrame:
        """The frame at ``index``, or the nearest one that the stream has."""
        index = min(max(index, 0), self.frame_count - 1)
        if index in self._kept:
            self._kept.move_to_end(index)
            return self._kept[index]
        try:
            found = shown(self._decoded(index))
        except BaseException:
            # A generator that raised is at its end: the next request seeks.
            self._at = None
            raise
        self._keep(index, found)
        return found

    def _decoded(self, index: int) -> DecodedFrame:
        if self._at is None or not 0 < index - self._at <= _STEPS:
            self._frames = self._stream.frames(index)
        for frame in self._frames:
            self._at = frame.index
            if frame.index == index:
                return frame
        raise IndexError(f"{self.path}: has no frame {index}")

    def _keep(self, index: int, found: ShownFrame) -> None:
        self._kept[index] = found
        self._kept_bytes += found.nbytes
        while self._kept_bytes > _KEPT_BYTES and len(self._kept) > 1:
            _, dropped = self._kept.popitem(last=False)
            self._kept_bytes -= dropped.nbytes
