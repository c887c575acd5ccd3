"""The sound of a stream alone, as a WAV file."""

from __future__ import annotations

import os
import wave
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from decogs.codec.packets.sound import RATE, frame_start
from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import Output, check_outputs, errors_named, files_read, staged_files
from decogs.formats.frames.ranges import Frames
from decogs.formats.system.callbacks import OnProgress, OnWarning

from ..frame_choice import open_chosen
from ..limits import DEFAULT_MAX_MEMORY
from ..sound.samples import mixed_sound

_LARGEST = (1 << 32) - 64
"""Bytes of samples; a WAV file counts them with 32 bits."""


@dataclass(frozen=True)
class SoundReport:
    """What was written: how many frames of how many tracks, together, and seconds."""

    frame_count: int
    track_count: int
    seconds: float


def decode_sound(
    stream: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    frames: Frames = None,
    strict: bool = False,
    max_memory: int = DEFAULT_MAX_MEMORY,
    on_frame: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> SoundReport:
    """Writes what is heard in a stream as a .wav file: all tracks together, stereo, 16 bits, 48 kHz.

    ``frames``, ``strict``, ``max_memory``, ``on_frame`` and ``on_warning`` are those of `decode`. Raises UsageError for
    a stream without sound, StreamError or OSError; nothing is then left under the output's name.
    """
    target = Path(output)
    check_outputs([Output("output", target)], files_read(stream=stream))
    with open_chosen(stream, frames, strict=strict, max_memory=max_memory, on_warning=on_warning) as (opened, chosen):
        header = opened.header
        if not header.sound or header.fps is None:
            raise UsageError(f"{stream}: has no sound; name a folder, a picture or a video to write its pictures")
        count = frame_start(chosen.stop, header.fps) - frame_start(chosen.start, header.fps)
        if 4 * count > _LARGEST:
            raise UsageError(f"{target}: {count / RATE:.0f} s are too long for a .wav file; choose fewer `frames`")
        with (
            staged_files(target.parent) as staging,
            errors_named(str(target)),
            (staging / target.name).open("wb") as file,
            wave.open(file, "wb") as written,
        ):
            written.setparams((2, 2, RATE, count, "NONE", ""))
            for done, piece in enumerate(mixed_sound(opened, chosen), start=1):
                written.writeframesraw(np.rint(piece.T * 32767).astype("<i2").tobytes())
                if on_frame is not None:
                    on_frame(done, len(chosen))
    return SoundReport(len(chosen), len(header.sound), count / RATE)
