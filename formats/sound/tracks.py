"""The sound of a video, on the clock of its pictures; samples of any file that has sound."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

import av
import numpy as np

from ..errors import UsageError
from ..files.regular_files import Unchanged, open_regular
from ..splats import FloatArray
from ..videos.reading import ANY_TEXT, opened_video, pictures_of

if TYPE_CHECKING:
    from av.audio.frame import AudioFrame
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

    A gap in a track is not filled: what follows would be read too early, and matches no other camera.
    """
    with opened_video(path) as (container, stream):
        tracks = {track.index: _Heard() for track in _microphones(container)}
        shown: float | None = None
        try:
            for packet in container.demux(stream, *(container.streams[index] for index in tracks)):
                if packet.stream is stream:
                    if packet.pts is not None and packet.time_base and not packet.is_discard:
                        at = float(packet.pts * packet.time_base)
                        shown = at if shown is None else min(shown, at)
                    continue
                for frame in packet.decode():
                    if isinstance(frame, av.AudioFrame) and not (begin and _is_before(frame.time, shown, begin)):
                        tracks[packet.stream.index].take(frame)
                if any(track.count > seconds * RATE for track in tracks.values()):
                    break
        except av.FFmpegError:
            return None
    heard = [
        (track.begun, np.concatenate(track.parts))
        for track in tracks.values()
        if track.begun is not None and track.count
    ]
    if shown is None or not heard:
        return None
    first = min(begun for begun, _ in heard)
    pieces = [(round((begun - first) * RATE), samples) for begun, samples in heard if begun - first <= seconds]
    samples = np.zeros(max(offset + len(own) for offset, own in pieces), np.float32)
    for offset, own in pieces:
        samples[offset : offset + len(own)] += own / len(pieces)
    return Sound(samples, first - shown - begin)


class _Heard:
    """What was read of one track: ``parts`` at RATE, ``count`` samples in all, the first at ``begun`` seconds."""

    def __init__(self) -> None:
        self.parts: list[FloatArray] = []
        self.begun: float | None = None
        self.count = 0
        self._resampler = av.AudioResampler(format="flt", layout="mono", rate=RATE)

    def take(self, frame: AudioFrame) -> None:
        if self.begun is None:
            self.begun = float(frame.time or 0)
        for part in self._resampler.resample(frame):
            self.parts.append(part.to_ndarray()[0])
            self.count += len(self.parts[-1])


def _is_before(time: float | None, shown: float | None, begin: float) -> bool:
    """Whether a time is less than ``begin`` seconds after the first picture's; one that is not known is."""
    return time is None or shown is None or time - shown < begin


FULL_RATE = 48_000
"""Samples per second of sound that is heard."""
_JITTER = 72
"""Samples of `FULL_RATE` by which a time stamp may be off: 1.5 ms, since Matroska rounds to 1."""
_FORMATS = "aac,ac3,aiff,amr,asf,au,avi,caf,dts,eac3,flac,matroska,mov,mp3,mpeg,mpegts,mxf,ogg,tta,w64,wav,wv"
"""FFmpeg's readers of files that hold sound themselves; a list of other files is none."""


_MOST_MICROPHONES = 16
"""Of a file, which is open once for each of them."""


def sound_channels(path: Path) -> int | None:
    """1 or 2, as the sound of a file is to be kept; None where it has none. Raises UsageError for unreadable ones."""
    with _opened_sound(path) as (container, tracks, _):
        if not tracks or (len(tracks) == 1 and next(container.decode(tracks[0]), None) is None):
            return None
        return 2 if len(tracks) > 1 else min(tracks[0].codec_context.channels, 2) or 2


def sound_title(path: Path) -> str:
    """The file's name as a text that any program can hold."""
    return path.name.encode("utf-8", "replace").decode()


def read_samples(path: Path, channels: int, *, begin: float = 0.0, picture: int | None = None) -> Iterator[FloatArray]:
    """The sound of a file (channels, N), at `FULL_RATE`, in pieces of at most a second; gaps are silence.

    It begins ``begin`` seconds after the track's first sample or, where that is given, after the time stamp ``picture``
    of the video. Several microphones lie left and right in turn, as recorders have them. Raises UsageError for what
    cannot be read, or has no sound.
    """
    with _opened_sound(path) as (container, tracks, _):
        if not tracks:
            raise UsageError(f"{path}: has no sound; name a file that has, or leave out `audio`")
        zero = None if picture is None else float(picture * (pictures_of(path, container).time_base or 0))
        if len(tracks) > 1 and zero is None:
            zero = float((tracks[0].start_time or 0) * (tracks[0].time_base or 0))
        indices = [track.index for track in tracks]
    if len(indices) == 1:
        yield from _samples_of(path, indices[0], channels, begin, zero)
        return
    for piece in _side_by_side([_samples_of(path, index, 1, begin, zero) for index in indices]):
        yield np.stack([piece[side::channels].mean(axis=0) for side in range(channels)])


def _samples_of(path: Path, index: int, channels: int, begin: float, zero: float | None) -> Iterator[FloatArray]:
    """One track of a file, from ``begin`` seconds after the time ``zero`` on, None for its first sample's."""
    with _opened_sound(path) as (container, _, unchanged):
        resampler = av.AudioResampler(format="fltp", layout=("mono", "stereo")[channels - 1], rate=FULL_RATE)
        at = round(begin * FULL_RATE)
        tolerance = 0
        for frame in chain(container.decode(container.streams[index]), [None]):  # which has what the resampler holds
            unchanged.check()
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


def _side_by_side(voices: Sequence[Iterator[FloatArray]]) -> Iterator[FloatArray]:
    """Tracks (1, N) in pieces of any length as pieces (tracks, N); silence where one has ended."""
    waiting = [np.zeros((1, 0), np.float32)] * len(voices)
    while True:
        waiting = [rest if rest.shape[1] else next(voice, rest) for rest, voice in zip(waiting, voices, strict=True)]
        count = min((rest.shape[1] for rest in waiting if rest.shape[1]), default=0)
        if not count:
            return
        here = [rest[:, :count] for rest in waiting]
        yield np.concatenate([np.pad(part, ((0, 0), (0, count - part.shape[1]))) for part in here])
        waiting = [rest[:, count:] for rest in waiting]


def _silence(channels: int, count: int) -> Iterator[FloatArray]:
    for start in range(0, count, FULL_RATE):
        yield np.zeros((channels, min(FULL_RATE, count - start)), np.float32)


def _microphones(container: InputContainer) -> list[AudioStream]:
    """The tracks that are heard: the first that can be decoded; all that are mono like it, as cameras record them.

    Of other languages are none.
    """
    decodable = [track for track in container.streams.audio if track.codec_context is not None]
    if not decodable or decodable[0].codec_context.channels != 1:
        return decodable[:1]
    language = decodable[0].language
    alike = [track for track in decodable if track.codec_context.channels == 1 and track.language == language]
    return alike[:_MOST_MICROPHONES]


@contextmanager
def _opened_sound(path: Path) -> Iterator[tuple[InputContainer, list[AudioStream], Unchanged]]:
    """A file, its tracks of sound that are heard, and whether it still is what it was. Raises UsageError."""
    try:
        # A file that is open already cannot be "concat:a.wav" or an address in FFmpeg's own language.
        only = {"protocol_whitelist": "file", "format_whitelist": _FORMATS}
        with open_regular(path) as file, av.open(file, container_options=only, **ANY_TEXT) as container:
            yield container, _microphones(container), Unchanged(file, path)
    except (av.FFmpegError, OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"{path}: cannot be read as audio ({reason}); choose another file") from None
