"""Videos with timecode and sound, and claps to hear in them."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
import numpy as np


def write_video(
    path: Path, pictures: np.ndarray, sound: np.ndarray | None = None, *, timecode: str = "", fps: int = 30
) -> None:
    """``sound``: samples at 48 kHz; the first is as old as the first picture."""
    with av.open(str(path), "w") as file:
        track = file.add_stream("mpeg4", rate=fps, options={"b": "4000000"})
        track.width, track.height, track.pix_fmt = pictures.shape[2], pictures.shape[1], "yuv420p"
        if timecode:
            track.metadata["timecode"] = timecode
        voice = None
        if sound is not None:
            voice = file.add_stream("aac", rate=48000)
            voice.layout = "mono"
        for levels in pictures:
            file.mux(track.encode(av.VideoFrame.from_ndarray(levels, format="rgb24")))
        file.mux(track.encode())
        if voice is not None and sound is not None:
            for begin in range(0, len(sound), 1024):
                frame = av.AudioFrame.from_ndarray(sound[None, begin : begin + 1024], format="fltp", layout="mono")
                frame.sample_rate, frame.pts, frame.time_base = 48000, begin, Fraction(1, 48000)
                file.mux(voice.encode(frame))
            file.mux(voice.encode())


def claps(seconds: float, times: list[float], rng: np.random.Generator, *, rate: int, gain: float = 1.0) -> np.ndarray:
    """Noise, and bursts that die down, at ``times`` seconds; each microphone hears another waveform."""
    clock = np.arange(int(seconds * rate)) / rate
    heard = rng.normal(0, 0.004, len(clock))
    for time in times:
        after = clock - time
        heard += np.where(after >= 0, 0.4 * np.exp(-np.maximum(after, 0) / 0.03), 0) * rng.normal(0, 1, len(clock))
    return np.clip(gain * heard, -1, 1).astype(np.float32)
