"""The frames of a stream that the user chose, and the warnings about the stream they come from."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from decogs.formats.errors import UsageError
from decogs.formats.frames.ranges import Frames, frame_slice
from decogs.formats.system.callbacks import OnWarning

from .reading.damage import OnDamage
from .reading.frame import DecodedFrame
from .reading.stream import Stream, open_stream

if TYPE_CHECKING:
    from .subject.subject import AnyStream


@contextmanager
def open_chosen(
    path: str | os.PathLike[str],
    frames: Frames,
    *,
    strict: bool,
    max_memory: int,
    on_warning: OnWarning | None,
    layer: str | int | None = None,
) -> Iterator[tuple[Stream, range]]:
    """A stream, opened, and which of its frames were asked for; ``on_warning`` is called for damage.

    ``frames``: a slice by Python's rules, or a range; None for all. Raises UsageError when the stream has none of them.
    """
    on_damage = damage_to(on_warning)
    with open_stream(path, strict=strict, max_memory=max_memory, on_damage=on_damage, layer=layer) as stream:
        _warn_of_tail(stream, on_warning)
        yield stream, chosen_frames(stream, frames)


def damage_to(on_warning: OnWarning | None) -> OnDamage:
    """Calls ``on_warning``, if there is one, with one line for each damage."""
    return lambda damage: None if on_warning is None else on_warning(str(damage))


def coming_frames(frames: Frames) -> slice:
    """The frames asked for of a stream whose end is not known; raises UsageError where they count from there."""
    wanted = frame_slice(frames)
    start, stop = wanted.start or 0, wanted.stop
    if wanted.step not in (None, 1) or start < 0 or (stop is not None and stop <= start):
        raise UsageError("`frames` of a stream that still grows: give consecutive ones that count from its start")
    most = sys.maxsize  # what islice takes; no stream has so many
    return slice(min(start, most), None if stop is None else min(stop, most))


def chosen_frames(stream: AnyStream, frames: Frames) -> range:
    """The frames asked for as a range of this stream's, by Python's slicing rules; raises UsageError when none is."""
    what = "it has no frame" if not stream.frame_count else f"it has frames 0:{stream.frame_count}"
    return _chosen(frames, stream.frame_count, f"{stream.path}: nothing to decode, {what}")


def chosen_pictures(source: str, count: int, frames: Frames) -> range:
    """The pictures asked for of a camera path that has ``count`` and times of its own."""
    return _chosen(frames, count, f"{source}: nothing to decode, it has pictures 0:{count}")


def frames_in_any_order(stream: AnyStream, wanted: Iterable[int]) -> Iterator[DecodedFrame]:
    """The frames asked for, one by one. A later one is reached by decoding on, an earlier one from its keyframe."""
    frame: DecodedFrame | None = None
    for index in wanted:
        if frame is None or index < frame.index:
            coming = stream.frames(index)
            frame = next(coming)
        while frame.index < index:
            frame = next(coming)
        yield frame


def _chosen(frames: Frames, count: int, nothing: str) -> range:
    wanted = frame_slice(frames)
    if wanted.step not in (None, 1):
        raise UsageError("frames are decoded one after the other; a step is not possible")
    start, stop, _ = wanted.indices(count)
    if start >= stop:
        raise UsageError(f"{nothing}; choose other `frames`")
    return range(start, stop)


def _warn_of_tail(stream: Stream, on_warning: OnWarning | None) -> None:
    if stream.unfinished_bytes and on_warning is not None:
        on_warning(
            f"{stream.path}: stops {stream.unfinished_bytes} bytes into a packet; "
            f"its {stream.frame_count} complete frames are read"
        )
