"""Resuming an interrupted encode: the stream that it left, and whether it fits this encode.

The stream is all that is kept. Keyframe, lattice and near planes are its own, and every whole frame is replayed: all
that encoding it did but for the training, whose result is in the packet. Nothing random is carried from frame to frame,
so the finished file has the bytes of one that was never cut off. A time budget's control begins anew; then only the
frames that were there keep their bytes. The first frame's pictures show that it is the same footage
(`input.recordings`).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

from decogs.codec.header.header import StreamHeader
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.files.regular_files import open_regular
from decogs.formats.stream.container import (
    FRAME_KINDS,
    IndexEntry,
    Packet,
    PacketKind,
    PacketReader,
    check_count,
    read_packet_at,
)
from decogs.rig.pictures.recording_digests import difference

from ..settings.encode import EncodeSettings
from ..settings.frame import FrameSettings
from ..settings.keyframe import KeyframeSettings

_PARAMETERS = {
    "frame.significance": "`quality` or `lossless`",
    "keyframe.rd_lambda": "`quality`",
    "lattice": "`quality`",
    "frame_budget": "`bytes_per_frame`",
    "time_budget": "`time_budget`",
    "target_psnr": "`target_psnr`",
    "segment": "`segment`",
    "closed": "`closed`",
    "cross_fade": "`settings`",
    "held_out": "`holdout`",
    "first_frame": "`frames`",
    "frame.selection": "`selection` or `settings`",
    "effects": "`effects`",
    "detect_per_frame": "`effects`",
    "corrections": "`effects`",
    "corrected": "`effects`",
    "sound": "`audio`",
    "frame": "`settings` or `ablate`",
    "keyframe": "`settings`",
}
"""What asked for a setting that differs, by the beginning of its name in the header; the first that fits."""


_GROUPS = {"frame": FrameSettings(), "keyframe": KeyframeSettings()}
_FORMER = ("catch_up", "cuts", "zstd_level")
"""Settings of earlier releases, beside those in groups."""

IsSuch = Callable[[StreamHeader, int], bool]
"""Whether a truncated stream may be replaced, by its header and its number of whole frames."""


@dataclass(frozen=True)
class Interrupted:
    """The whole frames of a stream, of which ``size`` bytes are to be kept; ``ended``: the stream was finished.

    ``metrics``: whether each frame's PSNR is behind it; None where only the last frame is there, behind which all is
    written again.
    """

    path: Path
    header: StreamHeader
    header_payload: bytes
    entries: tuple[IndexEntry, ...]
    size: int
    ended: bool
    metrics: bool | None = None

    def packets(self) -> Iterator[Packet]:
        """The frames' packets, in order."""
        with self.path.open("rb") as file:
            for entry in self.entries:
                yield read_packet_at(file, entry)

    def check(self, wanted: StreamHeader, frames: int) -> None:
        """Raises UsageError unless it is the beginning of an encode with this header and so many frames."""
        if problem := difference_of_headers(self.header_payload, wanted.to_bytes()):
            self._refuse(problem)
        if len(self.entries) > frames:
            self._refuse(f"already holds {len(self.entries)} frames, this encode has {frames}")

    def check_metrics(self, wanted: bool) -> None:
        """Raises UsageError where the frames that are kept have the figures that are not ``wanted``, or lack them."""
        if self.metrics not in (None, wanted):
            self._refuse(f"was begun {'with' if self.metrics else 'without'} `metrics`")

    def check_recordings(self, recorded: Mapping[str, str], first: int) -> None:
        """Raises UsageError when frame ``first``, with which this encode begins, has other pictures than the stream's.

        ``recorded``: their digests by camera.
        """
        if self.header.first_frame == first and (problem := difference(self.header, recorded)):
            self._refuse(f"was begun with {problem}", "give the same recordings")

    def check_keyframe(self, *, same: bool) -> None:
        """Raises UsageError when the stream does not begin with the keyframe that was given."""
        if not same:
            self._refuse("begins with another keyframe than that of `keyframe`")

    def _refuse(self, problem: str, remedy: str = "give the same options") -> NoReturn:
        raise UsageError(f"`resume`: {self.path} {problem}; {remedy}, or drop `resume` to start over")


def find_interrupted(output: Path, growing: Path) -> Interrupted | None:
    """The part that exists of the stream ``output``: in ``growing`` unless that is empty, else under its own name.

    None without a whole keyframe.

    What follows the last whole frame, an index or a packet cut short, is not kept.
    """
    for path in (growing, output):
        if path.is_file() and path.stat().st_size:
            return _read(path)
    return None


def is_expendable(is_such: IsSuch, part: Path) -> bool:
    """Whether the stream that a process left in ``part`` ends within its header, or ``is_such``."""
    with part.open("rb") as file:
        reader, header, frames = PacketReader(file), None, 0
        try:
            while (packet := reader.next()) is not None:
                if packet.kind == PacketKind.HEADER:
                    header = StreamHeader.from_bytes(packet.payload)
                frames += packet.kind in FRAME_KINDS
        except StreamError:
            return False  # It is no stream, or damaged, and may still be of use to somebody.
    return header is None or is_such(header, frames)


def check_resumable(settings: EncodeSettings) -> None:
    """Raises UsageError for settings that keep something from frame to frame that is not in the stream."""
    if "gate" in settings.frame.ablated:
        raise UsageError(
            "`resume`: `ablate` gate keeps training state that a stream does not hold; drop one of the two"
        )


def _read(path: Path) -> Interrupted | None:
    entries: list[IndexEntry] = []
    header, size, ended, kept, last = b"", 0, False, False, False
    with open_regular(path) as file:
        reader = PacketReader(file)
        try:
            while (packet := reader.next()) is not None:
                if packet.kind == PacketKind.HEADER:
                    header = packet.payload
                elif packet.kind in FRAME_KINDS:
                    entries.append(IndexEntry(packet.offset, packet.frame, packet.kind))
                    size = packet.offset + packet.size
                    kept |= last
                elif packet.kind == PacketKind.METRICS:
                    last = True
                elif packet.kind == PacketKind.END:
                    check_count(packet, len(entries))
                    ended = True
        except StreamError:
            pass  # A power cut can leave more than a short packet; it is encoded again from there.
    if not entries:
        return None
    metrics = kept if len(entries) > 1 else None
    return Interrupted(path, StreamHeader.from_bytes(header), header, tuple(entries), size, ended, metrics)


def difference_of_headers(was: bytes, now: bytes, other: str = "this encode has") -> str:
    """What differs first between the payloads of an earlier encode's header and of this one's; empty if nothing."""
    return "" if was == now else difference_of(json.loads(was), json.loads(now), other)


def difference_of(was: Mapping[str, Any], now: Mapping[str, Any], other: str = "this encode has") -> str:
    """The same of settings as plain values."""
    if was == now:
        return ""
    name, before, after = _difference(was, now)
    group, *inside = name.split(".")
    if name in _FORMER or (inside and group in _GROUPS and not hasattr(_GROUPS[group], inside[0])):
        return f"was begun by another release of decogs: this one has no setting {name}"
    asked = next((f" ({asked})" for start, asked in _PARAMETERS.items() if name.startswith(start)), "")
    return f"was begun with {name} {_short(before)}, {other} {_short(after)}{asked}"


def _difference(one: Any, other: Any, path: str = "") -> tuple[str, Any, Any]:
    """Where two JSON values that are not equal differ first, and how."""
    if isinstance(one, dict) and isinstance(other, dict):
        # Single values first: they say more than what follows from them.
        for name in sorted(
            {*one, *other}, key=lambda name: (_is_single(one, name) + _is_single(other, name) < 2, name)
        ):
            if one.get(name) != other.get(name):
                return _difference(one.get(name), other.get(name), f"{path}.{name}" if path else name)
    return path.removeprefix("settings."), one, other


def _is_single(document: dict[str, Any], name: str) -> bool:
    return not isinstance(document.get(name), (dict, list))


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
