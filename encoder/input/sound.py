"""Where a stream's sound comes from: a camera of the rig, in step with its pictures, or a file of its own."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from decogs.codec.packets.sound import SLOWEST, SoundTrack
from decogs.decoder.sound.coding import coded
from decogs.decoder.sound.packets import FrameSound
from decogs.formats.errors import UsageError
from decogs.formats.rigs import FrameSource, Rig
from decogs.formats.rigs.timeline import RigIndex
from decogs.formats.sound.tracks import FULL_RATE, RATE, exactly, read_samples, read_sound, sound_channels, sound_title
from decogs.formats.splats import FloatArray
from decogs.formats.videos.chapters import chapters_from
from decogs.formats.videos.reading import VideoSource

AUTO, NONE = "auto", "none"
_SECONDS_COMPARED = 30.0
_WINDOW = RATE // 50
_SILENCE = 1e-9
"""Energy of 16 bits' last place."""
_CLIPPED = 1e-3
"""Share of samples at full level."""
_SAME_RATE = 5e-4
"""Relative; beyond it sound is a frame off within a minute."""


@dataclass(frozen=True)
class SoundPiece:
    """What `read_samples` takes, and how many samples are played: all for None, silence where the file has fewer."""

    path: Path
    begin: float = 0.0
    picture: int | None = None
    count: int | None = None

    def samples(self, channels: int) -> Iterator[FloatArray]:
        """The samples (channels, N) at `FULL_RATE`, in pieces."""
        samples = read_samples(self.path, channels, begin=self.begin, picture=self.picture)
        return samples if self.count is None else exactly(samples, channels, self.count)


@dataclass(frozen=True)
class SoundSource:
    """Sound for a stream of ``fps`` frames a second: what is played of files, one after the other, and its track."""

    pieces: tuple[SoundPiece, ...]
    track: SoundTrack
    fps: float

    def packets(self) -> Iterator[FrameSound]:
        """The packets of each frame from 0 on, endlessly. Raises UsageError where a file cannot be read."""
        samples = chain.from_iterable(piece.samples(self.track.channels) for piece in self.pieces)
        return coded(samples, self.track.channels, self.fps)


def sound_source(
    audio: str | os.PathLike[str] | None, rig: Rig, first: int, warn: Callable[[str], None]
) -> SoundSource | None:
    """The sound that ``audio`` names, for a stream that begins with the rig's frame ``first``; None for none.

    ``audio``: a camera's name, a file, which begins with the rig's first frame, or AUTO: of the cameras, the one whose
    sound stands out most against its noise. Raises UsageError for what has no sound, or cannot be in step.
    """
    if audio is None or str(audio) == NONE:
        return None
    if rig.fps is None or rig.fps < SLOWEST:
        rate = "no frame rate" if rig.fps is None else f"{rig.fps:g} frames per second"
        raise UsageError(f"`audio` {audio}: {rig.path} has {rate}, and sound needs at least {SLOWEST:g}")
    cameras = {camera.name: rig.recording(camera.name) for camera in rig.cameras}
    if str(audio) == AUTO:
        best = _clearest(cameras)
        if best is None:
            warn(f"{rig.path}: no camera has sound; the stream has none")
            return None
        audio = best
    if str(audio) in cameras:
        return _of_camera(str(audio), rig, rig.fps, RigIndex(first))
    path = Path(audio)
    if not path.is_file():
        raise UsageError(f"`audio` {audio}: is no file, and no camera of {', '.join(list(cameras)[:40])}")
    channels = sound_channels(path)
    if channels is None:
        raise UsageError(f"`audio` {audio}: has no sound; name a file that has, or a camera")
    return SoundSource((SoundPiece(path, first / rig.fps),), SoundTrack(channels, sound_title(path)), rig.fps)


def _of_camera(name: str, rig: Rig, fps: float, first: RigIndex) -> SoundSource:
    video, clock = rig.recording(name), rig.timeline.clock(name)
    channels = sound_channels(video.path) if isinstance(video, VideoSource) else None
    if not isinstance(video, VideoSource) or channels is None:
        raise UsageError(f"`audio` {name}: this camera has no sound; name another one, or a file")
    if video.fps is not None and abs(video.fps / clock.step - fps) > _SAME_RATE * fps:
        raise UsageError(
            f"`audio` {name}: it recorded {video.fps / clock.step:g} frames per second, which the rig plays at "
            f"{fps:g}; give a file of that speed"
        )
    pieces = tuple(_pieces(*chapters_from(video, clock.recorded_index(first)), video.fps or fps))
    return SoundSource(pieces, SoundTrack(channels, name), fps)


def _pieces(chapters: Sequence[VideoSource], frame: int, rate: float) -> Iterator[SoundPiece]:
    """The sound of a recording from a frame of its first chapter on, each chapter's as long as its pictures."""
    for chapter in chapters:
        picture = None if chapter.times is None else int(chapter.times[frame])
        begin = frame / rate if picture is None else 0.0
        is_last = chapter is chapters[-1]
        count = None if is_last else round((chapter.frame_count - frame) * FULL_RATE / rate)
        yield SoundPiece(chapter.path, begin, picture, count)
        frame = 0


def _clearest(recordings: Mapping[str, FrameSource]) -> str | None:
    """The camera whose sound is highest above its quiet moments; one that clips comes after all others."""
    clearness = {}
    for name, video in recordings.items():
        sound = read_sound(video.path, _SECONDS_COMPARED) if isinstance(video, VideoSource) else None
        if sound is not None and len(sound.samples) >= 2 * _WINDOW:
            whole = sound.samples[: len(sound.samples) // _WINDOW * _WINDOW].astype(np.float64).reshape(-1, _WINDOW)
            energies = (whole**2).mean(axis=1)
            if energies.max() <= _SILENCE:
                continue
            is_clipped = bool((np.abs(whole) >= 1).mean() > _CLIPPED)
            clearness[name] = (not is_clipped, float(energies.mean() / max(np.percentile(energies, 10), _SILENCE)))
    return max(clearness, key=lambda name: clearness[name], default=None)
