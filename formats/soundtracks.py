"""The sound of a video, on the clock of its pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import av
import numpy as np

from .splats import FloatArray
from .videos import opened_video

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
