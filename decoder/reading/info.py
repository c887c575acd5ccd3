"""What a .dgs stream holds and where its bytes go: the facts behind ``decogs-info``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from decogs.codec.header.header import StreamHeader
from decogs.codec.header.profiles import Load, Profile, load
from decogs.codec.packets.sound import BLOCK, RATE, SoundTrack
from decogs.codec.scene.state import GROUPS
from decogs.formats.errors import UsageError
from decogs.formats.stream.container import PACKET_OVERHEAD
from decogs.formats.system.callbacks import OnProgress

from ..limits import DEFAULT_MAX_MEMORY
from .damage import Damage
from .frame import DecodedFrame
from .stream import Stream, open_stream


@dataclass(frozen=True)
class FrameInfo:
    """One frame's packet: bytes on disk, Gaussians after it, how many it touched, added and removed.

    ``kind``: "key", "delta", "skip", or "lost" when the frame is damaged and shows the last good one.
    ``refers_to_first``: a keyframe coded as the difference from the stream's first one, which its counts then refer to.
    ``bytes_by_purpose`` splits the payload (header, index set, attribute groups); with the container's overhead it adds
    up to ``bytes``.
    """

    index: int
    kind: str
    bytes: int
    gaussians: int
    touched: int
    added: int
    removed: int
    bytes_by_purpose: dict[str, int]
    refers_to_first: bool

    @property
    def touched_fraction(self) -> float:
        """Touched, added and removed Gaussians as a share of those that are there."""
        return min(1.0, (self.touched + self.added + self.removed) / max(1, self.gaussians))


PURPOSES = ("header", "corrections", "index", *GROUPS, *(f"added.{group}" for group in GROUPS), "ids", "removed")
"""What a frame's payload can hold, in the order of tables; "container" follows, its packet around the payload."""

CONTAINER = "container"


@dataclass(frozen=True)
class ByteTable:
    """Bytes on disk by frame and purpose: ``rows[i][j]`` are frame i's of ``purposes[j]``, those that occur.

    ``around``: what belongs to no frame (prologue, header packet, index, end) or is damaged. ``totals`` has the sum of
    each column, ``around`` counted as the container's, so that it adds up to the file's bytes.
    """

    purposes: tuple[str, ...]
    rows: tuple[tuple[int, ...], ...]
    kinds: tuple[str, ...]
    around: int

    @property
    def totals(self) -> tuple[int, ...]:
        """The sum of each column in bytes, ``around`` counted as the container's."""
        columns = [sum(column) for column in zip(*self.rows, strict=True)] or [0] * len(self.purposes)
        return (*columns[:-1], columns[-1] + self.around)

    @property
    def means(self) -> dict[str, tuple[float, ...]]:
        """Mean of each column over the frames of each kind that occurs, lost ones left out."""
        by_kind: dict[str, list[tuple[int, ...]]] = {}
        for row, kind in zip(self.rows, self.kinds, strict=True):
            if kind != "lost":
                by_kind.setdefault(kind, []).append(row)
        return {
            kind: tuple(sum(column) / len(rows) for column in zip(*rows, strict=True)) for kind, rows in by_kind.items()
        }

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values; columns as in ``purposes``."""
        return {
            "purposes": list(self.purposes),
            "frames": [list(row) for row in self.rows],
            "around": self.around,
            "totals": list(self.totals),
            "means": {kind: list(means) for kind, means in self.means.items()},
        }


@dataclass(frozen=True)
class SoundInfo:
    """One track of sound: seconds in which it is there, and the bytes of its packets on disk."""

    track: SoundTrack
    seconds: float
    bytes: int

    def to_json(self) -> dict[str, Any]:
        """Plain JSON values."""
        return {**self.track.as_document(), "rate": RATE, "seconds": self.seconds, "bytes": self.bytes}


@dataclass(frozen=True)
class StreamInfo:
    """A whole stream; every frame that is not lost was reconstructed and its digest verified.

    ``sounds``: its tracks of sound. ``loads``: what each layer, with those below, asks of a player; none where damage
    leaves that open.
    """

    path: Path
    file_bytes: int
    version: tuple[int, int]
    complete: bool
    unfinished_bytes: int
    header: StreamHeader
    frames: tuple[FrameInfo, ...]
    damage: tuple[Damage, ...] = ()
    sounds: tuple[SoundInfo, ...] = ()
    loads: tuple[Load, ...] = ()

    @property
    def totals(self) -> dict[str, Any]:
        """Counts and means; bytes per frame with the first keyframe (the whole file) and without (the later packets).

        ``bytes_by_purpose`` adds up to the file: "container" is what packets, header packet and index take, and what is
        damaged; the table has sound in it.
        """
        keys = [frame.bytes for frame in self.frames if frame.kind == "key"]
        later = [frame for frame in self.frames[1:] if frame.kind != "lost"]
        others = [frame for frame in self.frames if frame.kind in ("delta", "skip")]
        deltas = [frame.bytes for frame in self.frames if frame.kind == "delta"]
        table = self.byte_table
        return {
            "frames": len(self.frames),
            "key_frames": len(keys),
            "delta_frames": len(deltas),
            "skip_frames": len(others) - len(deltas),
            "lost_frames": len(self.frames) - len(keys) - len(others),
            "file_bytes": self.file_bytes,
            "bytes_per_frame": _mean(self.file_bytes, len(self.frames)),
            "bytes_per_frame_without_first_key": _mean(sum(frame.bytes for frame in later), len(later)),
            "mean_key_bytes": _mean(sum(keys), len(keys)),
            "mean_delta_bytes": _mean(sum(deltas), len(deltas)),
            "mean_touched_fraction": _mean(sum(frame.touched_fraction for frame in others), len(others)),
            "bytes_by_purpose": self._with_sound(dict(zip(table.purposes, table.totals, strict=True))),
        }

    def _with_sound(self, by_purpose: dict[str, int]) -> dict[str, int]:
        sound = sum(each.bytes for each in self.sounds)
        return {**by_purpose, CONTAINER: by_purpose[CONTAINER] - sound, "sound": sound} if sound else by_purpose

    @property
    def byte_table(self) -> ByteTable:
        """Where every byte of the file goes, frame by frame."""
        present = {purpose for frame in self.frames for purpose in frame.bytes_by_purpose}
        purposes = [*(purpose for purpose in PURPOSES if purpose in present), *sorted(present.difference(PURPOSES))]
        rows = []
        for frame in self.frames:
            payload = [frame.bytes_by_purpose.get(purpose, 0) for purpose in purposes]
            rows.append((*payload, frame.bytes - sum(payload)))
        around = self.file_bytes - sum(frame.bytes for frame in self.frames)
        return ByteTable((*purposes, CONTAINER), tuple(rows), tuple(frame.kind for frame in self.frames), around)

    def check(self, profile: Profile) -> None:
        """Raises UsageError unless the stream, or the base of one in layers, keeps within the profile."""
        if not self.loads:
            raise UsageError(f"{self.path}: is damaged, which leaves open what it asks of a player")
        if excess := self.loads[0].excess(profile):
            raise UsageError(f"{self.path}: does not keep within profile {profile.name}: {excess}")

    def to_json(self) -> dict[str, Any]:
        """The same as plain JSON values, for ``decogs-info --json``."""
        header = self.header
        return {
            "file": str(self.path),
            "version": list(self.version),
            "complete": self.complete,
            "unfinished_bytes": self.unfinished_bytes,
            "header": {
                "cameras": [
                    {
                        "name": camera.name,
                        "width": camera.width,
                        "height": camera.height,
                        "distortion_model": camera.distortion_model,
                        "held_out": camera.name in header.held_out,
                        "corrected": list(header.camera_effects(camera.name)),
                    }
                    for camera in header.cameras
                ],
                "fps": header.fps,
                "first_frame": header.first_frame,
                "sh_degree": header.sh_degree,
                "background": list(header.background),
                "effects": list(header.effects),
                "subject": header.subject,
                "layers": [layer.as_document() for layer in header.layers],
                "profiles": list(header.profiles),
                "presentation": header.presentation.as_document(),
                "sound": [sound.to_json() for sound in self.sounds],
                "lattice": {name: _plain(value) for name, value in vars(header.lattice).items()},
                "units": header.units,
                "axes": header.axes,
                "source_text": header.source_text,
                "licence": header.licence,
                "writer": header.writer,
                "settings": dict(header.settings),
            },
            "profiles": [each.profile for each in self.loads],
            "damage": [
                {
                    "frames": [damage.frames.start, damage.frames.stop],
                    "held": damage.held,
                    "packet": damage.error.packet,
                    "offset": damage.error.offset,
                    "reason": damage.error.reason,
                    "message": str(damage.error),
                }
                for damage in self.damage
            ],
            "frames": [vars(frame) | {"touched_fraction": frame.touched_fraction} for frame in self.frames],
            "totals": self.totals,
            "bytes": self.byte_table.to_json(),
        }


def info(
    stream: str | os.PathLike[str],
    *,
    strict: bool = False,
    max_memory: int = DEFAULT_MAX_MEMORY,
    on_frame: OnProgress | None = None,
) -> StreamInfo:
    """Facts about a stream, whose every complete frame is reconstructed and verified on the way.

    ``strict`` and ``max_memory`` (bytes) are those of ``open_stream``; without ``strict``, damage is among the facts.
    ``on_frame(done, all)`` is called with progress. Raises StreamError, OSError when the file cannot be read.
    """
    damages: list[Damage] = []
    with open_stream(stream, strict=strict, max_memory=max_memory, on_damage=damages.append) as opened:
        frames, loads = [], list[list[tuple[int, int]]]()
        for frame in opened.frames():
            frames.append(_frame_info(frame))
            loads.append(frame.layer_loads)
            if on_frame is not None:
                on_frame(len(frames), opened.frame_count)
        sounds, sound_sizes = _sounds(opened)  # which finds damage, too
        header = opened.header
        return StreamInfo(
            opened.path,
            opened.file_bytes,
            opened.version,
            opened.complete,
            opened.unfinished_bytes,
            header,
            tuple(frames),
            tuple(damages),
            sounds,
            () if damages else _loads(header, loads, sound_sizes),
        )


def _sounds(stream: Stream) -> tuple[tuple[SoundInfo, ...], list[int]]:
    """The tracks, and how many bytes of all of them each frame has."""
    tracks = stream.header.sound
    blocks, sizes, of_frames = [0] * len(tracks), [0] * len(tracks), list[int]()
    for packets in stream.sounds():
        of_frames.append(0)
        for packet in packets:
            size = PACKET_OVERHEAD + len(packet.payload())
            blocks[packet.track] += len(packet.blocks)
            sizes[packet.track] += size
            of_frames[-1] += size
    seconds = [count * BLOCK / RATE for count in blocks]
    return tuple(SoundInfo(*each) for each in zip(tracks, seconds, sizes, strict=True)), of_frames


def _loads(
    header: StreamHeader, frames: Sequence[Sequence[tuple[int, int]]], sounds: Sequence[int]
) -> tuple[Load, ...]:
    return tuple(
        load(
            [(gaussians, size + sound) for (gaussians, size), sound in zip(layer, sounds, strict=True)],
            header.sh_degree,
            header.fps,
        )
        for layer in zip(*frames, strict=True)
    )


def _frame_info(frame: DecodedFrame) -> FrameInfo:
    changes = frame.changes
    return FrameInfo(
        frame.index,
        "lost" if frame.kind is None else frame.kind.name.lower(),
        frame.packet_bytes,
        len(frame.state),
        changes.touched,
        changes.added,
        changes.removed,
        {purpose: count for purpose, count in frame.costs.items() if count},
        frame.refers_to_first,
    )


def _mean(total: float, count: int) -> float | None:
    return total / count if count else None


def _plain(value: Any) -> Any:
    return list(value) if isinstance(value, tuple) else value
