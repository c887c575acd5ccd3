"""When each camera starts, by the timecode in its video."""

from __future__ import annotations

import numpy as np

from decogs.formats.rigs import Rig
from decogs.formats.rigs.sources import FrameSource
from decogs.formats.timecodes import day_of_frames, frames_since_midnight, is_full_hour, read_timecode
from decogs.formats.videos import VideoSource

from .joint import Joint

_ERROR = 0.25
"""Frames: clocks that are set alike count whole frames, and cameras expose anywhere within one."""


def starts_by_timecode(rig: Rig, rate: float | None) -> Joint:
    """The starts of a rig's recordings in frames of ``rate``; NaN for those without timecode.

    Timecodes that all begin an hour were written by an editor, and say nothing.
    """
    texts = [read_timecode(source.path) if isinstance(source, VideoSource) else None for source in rig.sources]
    stated = [text for text in texts if text is not None]
    starts = np.full(len(texts), np.nan)
    if rate is not None and not all(map(is_full_hour, stated)):
        starts = np.array([_start(source, text, rate) for source, text in zip(rig.sources, texts, strict=True)])
        day = day_of_frames(rate)
        if np.isfinite(starts).any() and np.nanmax(starts) - np.nanmin(starts) > day / 2:
            starts = np.where(starts < day / 2, starts + day, starts)
    known = np.isfinite(starts)
    return Joint(starts, np.where(known, _ERROR, np.nan), known.astype(np.float64))


def _start(source: FrameSource, text: str | None, rate: float) -> float:
    """The start in frames of ``rate``, by a timecode that counts the video's own; NaN where it is none."""
    if text is None or source.fps is None:
        return np.nan
    frames = frames_since_midnight(text, source.fps)
    return np.nan if frames is None else frames * rate / source.fps
