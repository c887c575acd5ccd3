"""When each camera of a rig starts: by timecode first, then by sound, then by what moves.

Each way says what it can of which cameras; a later one is tied to the earlier by the cameras that both know.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera
from decogs.formats.geometry.length_units import metres_of
from decogs.formats.rigs import FrameSource, Rig
from decogs.formats.rigs.rig import usual
from decogs.formats.rigs.steps import steps_of
from decogs.formats.rigs.timeline import RigTime
from decogs.formats.sound.tracks import Sound, read_sound
from decogs.formats.system.callbacks import OnProgress
from decogs.formats.videos.reading import VideoSource

from ..parallel import Each, side_by_side
from .drift import Ends, find_drifts, warnings_of
from .joint import StartEstimate
from .motion import starts_by_motion
from .small import MAX_FRAMES, small_camera, small_clip, small_grey
from .sound import SECONDS, starts_by_sound
from .timecode import starts_by_timecode

F64 = NDArray[np.float64]

TIMECODE, AUDIO, MOTION = "timecode", "audio", "motion"
_MIN_VOTES = 0.7
"""Share of a camera's pairs that must agree. Figure, recordings played backwards, mirrored, or of nothing: .02 to .67;
as they were: .77 to 1."""
_MIN_CHANCE = 0.6
"""Least chance that the whole frame is right, by the standard error."""
_LATE_CHANCE = 0.9
"""The same, for a verdict on a camera. Figure: cameras out of step have .90 and more, cameras in step up to .86."""
_WHOLE = 0.4
"""Frames from whole ones that motion alone must find a camera to be believed: rigs in step show up to .36."""
_SCATTER = 0.65
"""Root mean square of the same, in standard errors: rigs in step show up to .58, those of which some cameras are half a
frame late .74 and more, unless all light flickers, though none of them may be found .4 off."""
_CONTRADICTED = 1.5
"""Frames between what two ways say of a camera from which one of them is wrong."""
_ENDS = Ends()


@dataclass(frozen=True)
class CameraStart:
    """When a camera's first picture was taken.

    ``offset``: in frames, of which only differences count; None: cannot say. ``confidence`` 0..1: how likely its whole
    frame is right. ``method``: TIMECODE, AUDIO or MOTION; None without an offset.
    """

    name: str
    offset: float | None
    confidence: float
    method: str | None


@dataclass(frozen=True)
class Synchrony:
    """The starts of all cameras, in frames of the rig, of which ``fps`` are a second as they were recorded (None where
    no rate is known), and what the user should know.
    """

    fps: float | None
    cameras: tuple[CameraStart, ...]
    warnings: tuple[str, ...] = ()

    @property
    def starts(self) -> dict[str, RigTime]:
        """By camera, those that are known."""
        return {camera.name: RigTime(camera.offset) for camera in self.cameras if camera.offset is not None}


def find_starts(
    rig: Rig, *, threads: int = 0, on_step: OnProgress = lambda done, total: None, ends: Ends = _ENDS
) -> Synchrony:
    """Finds when each camera of a rig's whole recordings starts; results do not depend on ``threads``.

    ``ends``: of the take, where clocks that run apart show.
    Raises RigError for what cannot be read, or for rates that have no common one.
    """
    cameras, total = rig.cameras, 2 * len(rig.cameras)
    names = [camera.name for camera in cameras]
    steps = steps_of(rig)
    with side_by_side(threads) as each:
        sounds = []
        for sound in each(_sound, rig.sources):
            sounds.append(sound)
            on_step(len(sounds), total)
        small = [small_camera(camera) for camera in cameras]
        clips = [
            small_clip(*own) for own in zip(rig.sources, map(_first_frames, rig.sources, steps), small, strict=True)
        ]
        moved = starts_by_motion(small, clips, each, lambda done: on_step(len(cameras) + done, total))
        estimates, warnings = _without_pictures(rig, sounds)
        together = merge_estimates(names, rig.timeline.rate, [*estimates, (MOTION, snap_to_trigger(moved))])
        drifts = find_drifts(rig, together.starts, each, ends) if together.starts else {}
    return replace(together, warnings=(*warnings, *together.warnings, *warnings_of(drifts, rig.timeline)))


def find_starts_without_poses(rig: Rig, *, threads: int = 0) -> Synchrony:
    """The same by timecode and sound alone, which need no poses. Raises RigError as `find_starts`."""
    steps_of(rig)
    with side_by_side(threads) as each:
        sounds = list(each(_sound, rig.sources))
    estimates, warnings = _without_pictures(rig, sounds)
    together = merge_estimates([camera.name for camera in rig.cameras], rig.timeline.rate, estimates)
    return replace(together, warnings=(*warnings, *together.warnings))


def _without_pictures(
    rig: Rig, sounds: Sequence[Sound | None]
) -> tuple[list[tuple[str, StartEstimate]], tuple[str, ...]]:
    """What timecode and sound say, and warnings; nothing of recordings without a rate."""
    if rig.timeline.rate is None:
        return [], ()
    by_timecode, warnings = starts_by_timecode(rig)
    heard, rate = starts_by_sound(rig.cameras, sounds, metres_of(rig.length_unit)), float(rig.timeline.rate)
    by_sound = StartEstimate(heard.starts * rate, heard.errors * rate, heard.pair_agreement)
    return [(TIMECODE, by_timecode), (AUDIO, by_sound)], warnings


def frames_late(cameras: Sequence[Camera], pictures: Sequence[NDArray[np.uint8]], each: Each) -> F64:
    """By how many frames (cameras,) each one's pictures are behind most others', by what moves; NaN: cannot say.

    A camera that starts early is behind. ``pictures``: of successive frames, (F, H, W, 3) each.
    """
    small = [small_camera(camera) for camera in cameras]
    clips = [(small_grey(picture, to) for picture in own) for own, to in zip(pictures, small, strict=True)]
    moved = starts_by_motion(small, clips, each)
    starts = np.where(_chances(moved) >= _LATE_CHANCE, snap_to_trigger(moved).starts, np.nan)
    finite = starts[np.isfinite(starts)]
    ordinary = finite[usual(np.round(finite).tolist())] if len(finite) else 0.0
    return ordinary - starts + 0.0  # not -0


def is_reliable(joint: StartEstimate) -> NDArray[np.bool_]:
    """Which starts (cameras,) are to be believed: their pairs agree, and the whole frame is likely right."""
    return np.isfinite(joint.starts) & (joint.pair_agreement >= _MIN_VOTES) & (_chances(joint) >= _MIN_CHANCE)


def snap_to_trigger(joint: StartEstimate) -> StartEstimate:
    """Starts by motion in whole frames, unless one is clearly between two: so cameras that share a trigger differ.

    Unknown ones become NaN.
    """
    starts = np.where(is_reliable(joint), joint.starts, np.nan)
    if np.isfinite(starts).any():
        phase = _phase(starts[np.isfinite(starts)])
        apart = starts - phase - np.round(starts - phase)
        starts = starts - phase
        if np.nanmax(np.abs(apart)) < _WHOLE and np.sqrt(np.nanmean((apart / joint.errors) ** 2)) < _SCATTER:
            starts = np.round(starts)
    return replace(joint, starts=starts)


def merge_estimates(
    names: Sequence[str], rate: Fraction | None, estimates: Sequence[tuple[str, StartEstimate]]
) -> Synchrony:
    """What the ways say together, the first ones first; the earliest camera starts at 0."""
    offsets, methods = np.full(len(names), np.nan), list[str | None]([None] * len(names))
    confidences = np.zeros(len(names))
    warnings: list[str] = []
    for method, joint in estimates:
        says = is_reliable(joint)
        both = says & np.isfinite(offsets)
        if says.sum() < 2 or (np.isfinite(offsets).any() and not both.any()):
            continue
        starts = joint.starts + (np.median((offsets - joint.starts)[both]) if both.any() else 0.0)
        new = says & ~both
        offsets[new], confidences[new] = starts[new], (joint.pair_agreement * _chances(joint))[new]
        warnings += _contradictions(names, methods, offsets, method, starts, both)
        methods = [method if is_new else before for before, is_new in zip(methods, new, strict=True)]
    if np.isfinite(offsets).any():
        offsets = offsets - np.nanmin(offsets)
    cameras = [
        CameraStart(name, round(float(offset), 3), round(float(confidence), 3), method)
        if math.isfinite(offset)
        else CameraStart(name, None, 0.0, None)
        for name, offset, confidence, method in zip(names, offsets, confidences, methods, strict=True)
    ]
    return Synchrony(None if rate is None else float(rate), tuple(cameras), tuple(warnings))


def _contradictions(
    names: Sequence[str], methods: Sequence[str | None], offsets: F64, method: str, starts: F64, both: NDArray[np.bool_]
) -> Iterator[str]:
    for row in np.flatnonzero(both & (np.abs(offsets - starts) > _CONTRADICTED)).tolist():
        yield (
            f"camera {names[row]}: by its {methods[row]} it starts {offsets[row] - starts[row]:+.1f} frames from where "
            f"it does by its {method}; the former is taken"
        )


def _chances(joint: StartEstimate) -> F64:
    """Of a start's being less than half a frame off; 0 where its error is not known."""
    errors = np.where(np.isfinite(joint.errors), np.maximum(joint.errors, 1e-6), np.inf)
    return np.array([math.erf(0.5 / (math.sqrt(2) * error)) for error in errors.tolist()])


def _phase(starts: F64) -> float:
    """The fraction of a frame that most starts are nearest to."""
    apart = starts[:, None] - starts[None]
    nearest = np.abs(apart - np.round(apart)).sum(axis=0)
    return float(np.modf(starts[int(np.argmin(nearest))])[0])


def _first_frames(source: FrameSource, step: int) -> range:
    return range(0, min(source.frame_count, MAX_FRAMES * step), step)


def _sound(source: FrameSource) -> Sound | None:
    return read_sound(source.path, SECONDS) if isinstance(source, VideoSource) else None
