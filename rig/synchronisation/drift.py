"""Clocks that run apart: when each camera starts, asked again at the end of what all of them recorded.

What a camera's start differs by is what its clock has lost on the others meanwhile.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from decogs.formats.geometry.length_units import metres_of
from decogs.formats.rigs import Rig, in_step
from decogs.formats.rigs.timeline import RigIndex, RigTime, Timeline
from decogs.formats.sound.tracks import Sound, read_sound
from decogs.formats.videos.chapters import chapters_from
from decogs.formats.videos.reading import VideoSource

from ..parallel import Each
from .joint import StartEstimate
from .motion import starts_by_motion
from .small import MAX_FRAMES, small_camera, small_clip
from .sound import starts_by_sound

_NOTICED = 0.5
"""Frames that a clock must lose to be named: whole frames are then wrong at one end."""
_MIN_DEVIATIONS = 2.0
"""Standard errors that this must be, too."""
_MIN_VOTES = 0.7
"""As for starts (`starts.is_reliable`)."""


@dataclass(frozen=True)
class Ends:
    """What is compared of a take: at either end so many frames that are ``watched`` and seconds ``listened`` to.

    ``least``: seconds of the common span; before, clocks have not run apart: 200 in a million are .36 frames of 30 a
    second.
    """

    least: float = 60.0
    watched: int = MAX_FRAMES
    listened: float = 20.0


@dataclass(frozen=True)
class Drift:
    """By how many ``frames`` a camera's pictures come later ``between`` frames after the beginning; below 0: less."""

    frames: float
    between: int

    @property
    def scale(self) -> float:
        """What its time stamps must be multiplied by to be the others'."""
        return 1 + self.frames / self.between


def find_drifts(rig: Rig, starts: Mapping[str, RigTime], each: Each, ends: Ends) -> dict[str, Drift]:
    """The cameras whose clocks run apart from most others', of recordings whose ``starts`` are known.

    Empty where the common span is short, or nothing tells.
    """
    common = in_step(rig, starts)
    if common.timeline.rate is None or common.frame_count < max(ends.least * common.timeline.rate, 2 * ends.watched):
        return {}
    drifts: dict[str, Drift] = {}
    listened = round(ends.listened * common.timeline.rate)
    for way, window in ((_by_motion, ends.watched), (_by_sound, listened)):  # what sound says counts more
        between = common.frame_count - window
        begin, end = (way(common, range(at, at + window), each) for at in (0, between))
        drifts |= dict(_find_apart(common, begin, end, between))
    return {name: drift for name, drift in drifts.items() if abs(drift.frames) > _NOTICED}


def warnings_of(drifts: Mapping[str, Drift], timeline: Timeline) -> Iterator[str]:
    """A warning for each: by how much, and how to mend it."""
    for name, drift in drifts.items():
        seconds = float(timeline.seconds_of(drift.between))
        how, millionths = "slow" if drift.frames > 0 else "fast", abs(drift.scale - 1) * 1e6
        yield (
            f"camera {name}: its clock is {how} by {abs(drift.frames):.1f} frames in {seconds:.0f} s "
            f"({millionths:.0f} in a million); bring its pictures to the others' clock "
            f"(ffmpeg -itsscale {drift.scale:.6f} -i VIDEO -r {timeline.rate} ...), or use a shorter take"
        )


def _find_apart(rig: Rig, begin: StartEstimate, end: StartEstimate, between: int) -> Iterator[tuple[str, Drift]]:
    """What is known of each camera; 0 frames where that is less than may be chance."""
    apart = end.starts - begin.starts
    errors = np.hypot(begin.errors, end.errors)
    is_reliable = (
        np.isfinite(apart) & np.isfinite(errors) & (np.minimum(begin.pair_agreement, end.pair_agreement) >= _MIN_VOTES)
    )
    if is_reliable.sum() > 2:
        apart = apart - np.median(apart[is_reliable])
        for row in np.flatnonzero(is_reliable).tolist():
            sure = abs(apart[row]) > _MIN_DEVIATIONS * errors[row]
            yield rig.cameras[row].name, Drift(float(apart[row]) if sure else 0.0, between)


def _by_motion(rig: Rig, frames: range, each: Each) -> StartEstimate:
    small = [small_camera(camera) for camera in rig.cameras]
    clips = [small_clip(source, frames, to) for source, to in zip(rig.sources, small, strict=True)]
    return starts_by_motion(small, clips, each)


def _by_sound(rig: Rig, frames: range, each: Each) -> StartEstimate:
    sounds = list(each(lambda camera: _sound(rig, camera.name, frames), rig.cameras))
    heard = starts_by_sound(rig.cameras, sounds, metres_of(rig.length_unit))
    rate = float(rig.timeline.rate or 1)
    # Sound takes as long to arrive at both ends, so that only the onsets' own error counts.
    return StartEstimate(heard.starts * rate, np.zeros(len(sounds)), heard.pair_agreement)


def _sound(rig: Rig, camera: str, frames: range) -> Sound | None:
    """What a camera heard meanwhile, from the first of these frames on."""
    video, clock = rig.recording(camera), rig.timeline.clock(camera)
    if not isinstance(video, VideoSource) or video.fps is None:
        return None
    begin, end = (clock.recorded_index(RigIndex(at)) for at in (frames.start, frames.stop))
    chapters, first = chapters_from(video, begin)
    return read_sound(chapters[0].path, (end - begin) / video.fps, first / video.fps)
