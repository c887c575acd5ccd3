"""The sound of a video, on the clock of its pictures; samples of any file that has sound."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import av
import numpy as np

from .errors import UsageError
from .splats import FloatArray
from .videos import ANY_TEXT, opened_video, pictures_of

if TYPE_CHECKING:
    from av.audio.stream import AudioStream
    from av.container import InputContainer

RATE = 16000
"""Samples per second that are read: more than onsets of speech and claps need."""


@dataclass(frozen=True)
class Sound:
    """Samples (N,), the mean of all channels; the first one was taken ``delay`` seconds after the first picture."""

    samples: FloatArray = field(repr=False)
    delay: float


def read_sound(path: Path, seconds: float, begin: float = 0.0) -> Sound | None:
    """So many seconds of a video's sound, from ``begin`` seconds after its first picture on, which `Sound.delay` counts
    from; None where it has none that can be decoded. Raises RigError.

    A gap in the track is not filled: what follows would be read too early, and matches no other camera.
    """
    with opened_video(path) as (container, stream):
        tracks = [track for track in container.streams.audio if track.codec_context is not None]
        if not tracks:
            return None
        resampler = av.AudioResampler(format="flt", layout="mono", rate=RATE)
        parts: list[FloatArray] = []
        begun = shown = None
        count = 0
        try:
            for packet in container.demux(tracks[0], stream):
                if packet.stream is stream:
                    if packet.pts is not None and packet.time_base and not packet.is_discard:
                        at = float(packet.pts * packet.time_base)
                        shown = at if shown is None else min(shown, at)
                    continue
                for frame in packet.decode():
                    if isinstance(frame, av.AudioFrame) and not (begin and _is_before(frame.time, shown, begin)):
                        begun = frame.time if begun is None else begun
                        parts += [part.to_ndarray()[0] for part in resampler.resample(frame)]
                        count += len(parts[-1]) if parts else 0
                if count > seconds * RATE:
                    break
        except av.FFmpegError:
            return None
    if begun is None or shown is None or not parts:
        return None
    return Sound(np.concatenate(parts).astype(np.float32), float(begun) - shown - begin)


def _is_before(time: float | None, shown: float | None, begin: float) -> bool:
    """Whether a time is less than ``begin`` seconds after the first picture's; one that is not known is."""
    return time is None or shown is None or time - shown < begin


FULL_RATE = 48_000
"""Samples per second of sound that is heard."""
_JITTER = 72
"""Samples of `FULL_RATE` by which a time stamp may be off: 1.5 ms, since Matroska rounds to 1."""
_FORMATS = "aac,aiff,avi,caf,flac,matroska,mov,mp3,mpeg,mpegts,mxf,ogg,w64,wav"
"""FFmpeg's readers of files that hold sound themselves; a list of other files is none."""


def sound_channels(path: Path) -> int | None:
    """1 or 2, as the sound of a file is to be kept; None where it has none. Raises UsageError for unreadable ones."""
    with _opened_sound(path) as (_, track):
        return None if track is None else min(track.codec_context.channels, 2) or 2


def sound_title(path: Path) -> str:
    """The file's name as a text that any program can hold."""
    return path.name.encode("utf-8", "replace").decode()


def read_samples(path: Path, channels: int, *, begin: float = 0.0, picture: int | None = None) -> Iterator[FloatArray]:
    """The sound of a file (channels, N), at `FULL_RATE`, in pieces of at most a second; gaps are silence.

    It begins ``begin`` seconds after the track's first sample or, where that is given, after the time stamp ``picture``
    of the video. Raises UsageError for what cannot be read, or has no sound.
    """
    with _opened_sound(path) as (container, track):
        if track is None:
            raise UsageError(f"{path}: has no sound; name a file that has, or leave out `audio`")
        zero = None if picture is None else float(picture * (pictures_of(path, container).time_base or 0))
        resampler = av.AudioResampler(format="fltp", layout=("mono", "stereo")[channels - 1], rate=FULL_RATE)
        at = round(begin * FULL_RATE)
        tolerance = 0
        for frame in chain(container.decode(track), [None]):  # which has what the resampler holds back
            for part in resampler.resample(frame):
                time = float(part.pts * part.time_base) if part.pts is not None and part.time_base else None
                zero = time or 0.0 if zero is None else zero
                samples = part.to_ndarray()
                if not np.isfinite(samples).all():
                    raise UsageError(f"{path}: cannot be read as audio (samples are no numbers); choose another file")
                missing = 0 if time is None else round((time - zero) * FULL_RATE) - at
                if abs(missing) > tolerance:
                    yield from _silence(channels, missing)
                    samples = samples[:, max(0, -missing) :]
                    at += max(0, missing)
                if samples.shape[1]:
                    tolerance, at = _JITTER, at + samples.shape[1]
                    yield samples


def exactly(samples: Iterable[FloatArray], channels: int, count: int) -> Iterator[FloatArray]:
    """The first ``count`` samples (channels, N) of pieces; silence where these have fewer."""
    left = count
    for piece in samples:
        if left <= 0:
            return
        yield piece[:, :left]
        left -= piece.shape[1]
    yield from _silence(channels, left)


def _silence(channels: int, count: int) -> Iterator[FloatArray]:
    for start in range(0, count, FULL_RATE):
        yield np.zeros((channels, min(FULL_RATE, count - start)), np.float32)


@contextmanager
def _opened_sound(path: Path) -> Iterator[tuple[InputContainer, AudioStream | None]]:
    """A file and its first track of sound that can be decoded. Raises UsageError."""
    try:
        # FFmpeg would take "concat:a.wav" or an address for what it is in its own language.
        only = {"protocol_whitelist": "file", "format_whitelist": _FORMATS}
        with av.open(f"file:{path}", container_options=only, **ANY_TEXT) as container:
            tracks = (track for track in container.streams.audio if track.codec_context is not None)
            yield container, next(tracks, None)
    except (av.FFmpegError, ValueError) as error:
        said = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"{path}: cannot be read as audio ({said}); choose another file") from None
