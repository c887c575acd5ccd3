"""Reads .4dgs, Gaussians on a clock without frames, with the PyPI package ``fourdgs`` (0.6.0 was tried).

A file is of one of two temporal models. "gaussian-birth": each Gaussian moves in a line and fades about a moment of its
own; chunks hold those that are there for a while. "keyframe-delta": chunks one behind the other hold states of all, as
keyframes or differences, and moments within a chunk move and fade the same way. What a moment shows is evaluated by the
package. A file is hostile: what its numbers ask for is compared with the limit before the package unpacks it.
"""

from __future__ import annotations

import importlib.util
import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import UsageError
from ..splat_files import Room
from ..splat_files.quantised import logits
from ..splat_files.reading import finite_splats
from ..splats import SH_C0, Splats, empty_splats
from ..stream.container import MAX_FRAME
from . import SequenceFrame

_EVEN = 0.01
"""Share of a chunk's length by which lengths may differ and still be frames of one rate."""
_SLACK = 1e-3
"""Of a frame, within which a moment before the next chunk counts as its beginning: clocks are rounded."""
_HELD_EACH = 700
"""Bytes that a Gaussian takes in the package, besides our own: of all, packing took 1 240 where the room counts 1 632
(keyframe-delta), and 3 615 where it counts 3 792 (gaussian-birth, SH degree 3)."""
_STREAM = struct.Struct("<BBBBBIQ")
"""Before the values of an attribute: which, bytes of a value, mode, codec, channels, elements, bytes that follow."""
_MOST_CHANNELS = 21
"""Values of a Gaussian in one stream: a channel for each colour and coefficient of SH degree 3."""


class FourDGSFile:
    """A .4dgs, sampled ``fps`` times a second, or at the beginnings of its chunks if these are frames of one rate.

    Raises UsageError, also for a file without an index of its chunks, and where the package is not installed.
    """

    up: Literal["Y", "-Y"] = "-Y"

    def __init__(self, path: Path, room: Room, fps: float | None = None) -> None:
        if not has_fourdgs():
            raise UsageError(
                f"{path}: reading it needs the package fourdgs, which is not installed: pip install fourdgs"
            )
        self._path = path
        with _of(path):
            self._model = _model_of(path, room)
            self.fps: float = fps or self._model.own_rate()
            self.frame_count = self._model.frames_at(self.fps)

    def frames(self) -> Iterator[SequenceFrame]:
        states, more = self._model.states(self.fps), self._model.left_out
        while True:
            with _of(self._path):
                state = next(states, None)
                if state is None:
                    return
                found, rows, left_out = finite_splats(state[0])
            yield SequenceFrame(found, state[1][rows], (*more, *left_out))
            more = ()


def has_fourdgs() -> bool:
    """Whether the package is installed."""
    return importlib.util.find_spec("fourdgs") is not None


def _splats_of(scene: dict[str, Any]) -> Splats:
    """Gaussians of a moment as the package has them: linear sizes, quaternions xyzw, colours and opacities 0 to 1.

    ``scene``: centers (N, 3), scales (N, 3), rotations (N, 4), rgb (N, 3), opacity (N,) and, of degrees above 0, sh
    (N, K - 1, 3).
    """
    sh = ((scene["rgb"] - 0.5) / SH_C0)[:, None]
    arrays = (
        scene["centers"],
        np.log(np.maximum(scene["scales"], np.finfo(np.float32).tiny)),
        np.roll(scene["rotations"], 1, axis=1),
        logits(scene["opacity"]),
        np.concatenate([sh, scene["sh"]], axis=1) if "sh" in scene else sh,
    )
    return Splats(*(np.ascontiguousarray(array, np.float32) for array in arrays))


class _Model:
    """A file of one temporal model. ``length``: of its clock, seconds, which begins at 0.

    ``left_out``: what is not read of it, a line each.
    """

    left_out: tuple[str, ...] = ()

    def __init__(self, opened: Any, coefficients: int, size: int, room: Room) -> None:
        self._opened, self._coefficients, self._size, self._room = opened, coefficients, size, room
        self._index = opened.index
        self.length = float(opened.header.duration_sec)
        if not opened.index:
            raise UsageError("has no index of its chunks; write it with one")

    def own_rate(self) -> float:
        """Frames per second. Raises UsageError where the file has none."""
        raise UsageError("does not say how many frames a second has; give `fps`")

    def frames_at(self, fps: float) -> int:
        """How many frames it has at so many per second."""
        if not math.isfinite(self.length):
            raise UsageError("has no end; give a file of finite length")
        count = self.length * fps - _SLACK
        if count > MAX_FRAME:
            raise UsageError(f"takes {self.length:g} s, which are too many frames; give a smaller `fps`")
        return max(1, math.ceil(count))

    def states(self, fps: float) -> Iterator[tuple[Splats, NDArray[np.int64]]]:
        """The Gaussians of each frame, and their ids."""
        raise NotImplementedError

    def _check(self, count: int) -> None:
        self._room.check(count, self._coefficients, held=self._size + _HELD_EACH * count)

    def _check_block(self, head: Any, stored: Any) -> bytes:
        """The streams of a chunk, with a compression of all of them undone, if they fit."""
        from fourdgs.stream_reader import chunk_stream_bytes

        if self._room.memory is not None and head.uncompressed_size > self._room.memory:
            raise UsageError(f"unpacks to {head.uncompressed_size} bytes; allow more memory (`max_memory`)")
        return bytes(chunk_stream_bytes(head, stored))


class _OnDisk:
    """A file as the package reads one: by ranges, of which each is there in whole."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def size(self) -> int:
        return self._path.stat().st_size

    def read(self, offset: int, length: int) -> bytes:
        with self._path.open("rb") as file:
            file.seek(offset)
            data = file.read(min(length, self.size()))
        if len(data) != length:
            raise UsageError("is cut off; write it again")
        return data


class _Births(_Model):
    """The model "gaussian-birth": a Gaussian's id is its place in the file."""

    def __init__(self, path: Path, room: Room) -> None:
        from fourdgs import indexed_reader

        self._source = _OnDisk(path)
        opened = indexed_reader.open_indexed(self._source)
        self._degree = int(opened.header.sh_degree)
        # The file stays on the disk; chunks are read as they are needed.
        super().__init__(opened, (self._degree + 1) ** 2, 0, room)
        self._objects = indexed_reader.read_objects(self._source, opened)
        self._first_ids = np.cumsum([0, *(entry.gaussian_count for entry in self._index)])

    def states(self, fps: float) -> Iterator[tuple[Splats, NDArray[np.int64]]]:
        chunks: dict[int, Any] = {}
        for frame in range(self.frames_at(fps)):
            time = frame / fps
            needed = [number for number, entry in enumerate(self._index) if entry.covers(time)]
            self._check(sum(self._index[number].gaussian_count for number in needed))
            chunks = {number: chunks.get(number) or self._chunk(self._index[number]) for number in needed}
            scenes = [self._scene(chunk, time) for chunk in chunks.values()]
            if not scenes:
                yield empty_splats(self._degree), np.zeros(0, np.int64)
                continue
            ids = [self._first_ids[number] + rows for number, (_, rows) in zip(needed, scenes, strict=True)]
            joined = {key: np.concatenate([scene[key] for scene, _ in scenes]) for key in scenes[0][0]}
            yield _splats_of(joined), np.concatenate(ids)

    def _scene(self, chunk: Any, time: float) -> tuple[dict[str, Any], NDArray[np.int64]]:
        state = chunk.state_at(time, self._opened.header.cutoff)
        rows = state["indices"]
        centers, rotations = self._objects.apply(
            centers=state["centers"], orientations=state["orientations"], object_ids=state["object_id"], t=time
        )
        scene = {
            "centers": centers,
            "scales": chunk.scales[rows],
            "rotations": rotations,
            "rgb": chunk.colors[rows, :3],
            "opacity": state["opacity"],
        }
        if self._degree:
            scene["sh"] = _harmonics(chunk.sh[rows], self._degree)
        return scene, rows

    def _chunk(self, entry: Any) -> Any:
        from fourdgs import GaussianSet, indexed_reader
        from fourdgs.stream_reader import merge_chunk_bands, window_table_or_default

        self._check_chunk(entry)
        found = indexed_reader.read_chunk(self._source, self._opened, entry, max_sh_band=self._degree)
        windows = window_table_or_default(self._opened.windows)[found["window_index"]]
        sh = merge_chunk_bands([len(found["mu_t"])], [found["sh"]]) if self._degree else None
        return GaussianSet(
            positions=found["positions"],
            scales=found["scales"],
            rotations=found["rotations"],
            colors=found["colors"],
            motions=found["motions"],
            mu_t=found["mu_t"],
            sigma_t=found["sigma_t"],
            win_lo=windows[:, 0],
            win_hi=windows[:, 1],
            sh=sh,
            sh_degree=self._degree,
            object_id=found["object_id"],
        )

    def _check_chunk(self, entry: Any) -> None:
        from fourdgs import records

        head, stored = records.parse_chunk(self._record(entry.chunk_offset, entry.chunk_length))
        self._check(head.count)
        _check_streams(self._check_block(head, stored), head.count)
        for band, offset, length in entry.bands:
            if band <= self._degree:
                _check_streams(self._record(offset, length)[1:], head.count)

    def _record(self, offset: int, length: int) -> bytes:
        """A record's content."""
        if self._room.memory is not None and length > self._room.memory:
            raise UsageError(f"has a chunk of {length} bytes; allow more memory (`max_memory`)")
        return self._source.read(offset, length)[9:]


class _Deltas(_Model):
    """The model "keyframe-delta", without SH above degree 0, of which the package gives none."""

    def __init__(self, path: Path, room: Room) -> None:
        from fourdgs import keyframe_delta_file

        self._data = path.read_bytes()
        super().__init__(keyframe_delta_file.open_indexed(self._data), 1, len(self._data), room)
        self._index = sorted(self._index, key=lambda entry: entry.t0)
        if degree := self._opened.header.sh_degree:
            self.left_out = (f"view dependence (SH degree {degree}) is not read from this kind of .4dgs",)

    def own_rate(self) -> float:
        lengths = np.array([entry.t1 - entry.t0 for entry in self._index[:-1]])
        if not len(lengths) or not lengths.min() > 0 or np.ptp(lengths) > _EVEN * lengths.min():
            return super().own_rate()
        # Of many frames together, since their beginnings are rounded.
        return round(float(1 / lengths.mean()), 6)

    def states(self, fps: float) -> Iterator[tuple[Splats, NDArray[np.int64]]]:
        from fourdgs import keyframe_delta_file as files

        grids, windows = self._opened.grids, self._opened.windows
        scanned = files.scan_indexed(self._data, self._index, windows, self._check_entry, grids=grids)
        frame, frames = 0, self.frames_at(fps)
        for entry, state in scanned:
            while frame < frames and (frame + _SLACK) / fps < entry.t1:
                scene = files.reconstruct_at(state, grids, max(frame / fps, entry.t0))
                yield _splats_of(scene), scene["ids"]
                frame += 1
            if frame == frames:
                return

    def _check_entry(self, ordinal: int, entry: Any) -> None:
        """Raises UsageError for a chunk that would unpack to more than the room, before it does."""
        from fourdgs import records
        from fourdgs.serialization import Cursor

        content = self._data[entry.chunk_offset + 9 : entry.chunk_offset + entry.chunk_length]
        if entry.kind == 0:
            head, stored = records.parse_chunk(content)
            groups = [(head.count, self._check_block(head, stored))]
        else:
            head, stored = records.parse_delta_chunk_block(content)
            block = Cursor(self._check_block(head, stored))
            counts = (head.update_count, head.birth_count, head.death_count)
            groups = [(count, bytes(block.take(block.u64()))) for count in counts]
        self._check(max(entry.live_count, *(count for count, _ in groups), 0))
        for count, streams in groups:
            _check_streams(streams, count)
        for _, offset, length in entry.bands:
            _check_streams(self._data[offset + 10 : offset + length], max(entry.live_count, entry.gaussian_count))


def _model_of(path: Path, room: Room) -> _Births | _Deltas:
    from fourdgs import records
    from fourdgs.opcode import HEADER
    from fourdgs.serialization import MAGIC, check_magic

    with path.open("rb") as file:
        front = file.read(len(MAGIC) + 9)
        check_magic(front)
        length = int.from_bytes(front[-8:], "little")
        if len(front) < len(MAGIC) + 9 or front[len(MAGIC)] != HEADER or length > path.stat().st_size:
            raise UsageError("does not begin with its header; write it again")
        model = records.Header.parse(file.read(length)).temporal_model
    return _Deltas(path, room) if model == "keyframe-delta" else _Births(path, room)


def _check_streams(streams: bytes, count: int) -> None:
    """Raises UsageError where a stream of values would unpack to more than ``count`` Gaussians have.

    One that repeats a value says so in a few bytes, however many there are to be.
    """
    at = 0
    while at + _STREAM.size <= len(streams):
        *_, channels, elements, length = _STREAM.unpack_from(streams, at)
        if elements > count or channels > _MOST_CHANNELS:
            raise UsageError(f"is damaged: {elements} x {channels} values of {count} Gaussians; write it again")
        at += _STREAM.size + length


def _harmonics(codes: NDArray[np.uint8], degree: int) -> NDArray[np.float64]:
    """Coefficients (N, K - 1, 3) of bytes that hold all of red, then of green, then of blue."""
    from fourdgs.quantization import sh_coefficient

    coefficients = (degree + 1) ** 2 - 1
    values = np.asarray(sh_coefficient(codes)).reshape(len(codes), 3, codes.shape[1] // 3)
    return np.ascontiguousarray(values[:, :, :coefficients].transpose(0, 2, 1))


@contextmanager
def _of(path: Path) -> Iterator[None]:
    """Errors of a file name it, in one line; whatever else the package raises on a stranger's bytes is one of them."""
    try:
        with np.errstate(all="ignore"):
            yield
    except UsageError as error:
        raise UsageError(f"{path}: {error}") from None
    except (OSError, MemoryError):
        raise
    except Exception as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise UsageError(f"{path}: cannot be read by fourdgs: {reason}") from None
