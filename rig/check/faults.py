"""What can be wrong with a camera: the word for it, what it says to the user, and whether the camera then does harm."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from decogs.formats.frames.ranges import frames_text

GOOD, USABLE, HARMFUL = "good", "usable", "harmful"
"""What a camera is good for: nothing is wrong; something is, but views are better with it; they are better without."""

DEAD, FROZEN, DROPPED, DAMAGED = "dead", "frozen", "dropped", "damaged"
SWAPPED, TURNED, MISPLACED = "swapped", "turned", "misplaced"
LATE = "late"
"""Or early: its frames are not of the others' moments."""
BLURRED, NOISY, EXPOSURE = "blurred", "noisy", "exposure"
MOVING, NOISE = "moving", "noise"

REFUSED = {MOVING, NOISE}
"""With which an encode is refused."""
_HARMFUL = {DEAD, FROZEN, SWAPPED, TURNED, MISPLACED, LATE, BLURRED} | REFUSED

BLURRED_BELOW = 0.45
"""Sharpness, over the cameras' median, below which a camera is out of focus: a blur of 2 pixels leaves .15, sharp
cameras of one rig have .7 and more."""
_NOISY_TIMES, _NOISY_LEVELS = 3.0, 2.0
"""Noise over the cameras' median, and in levels, from which a camera is noisy."""
_ONLY_NOISE_LEVELS = 25.0
"""Noise of pictures that show nothing else, if no other camera's match: white noise has 50 to 74 levels."""
_NAMED_ROWS = 3
"""Rows of frames that a fault names; of more it says how many there are."""
_LATE_FRAMES = 0.5
"""Frames from which a camera is late or early."""
EXPOSED_STOPS = 0.8
"""Gain against the median camera, in stops, from which it counts: `panoptic_basketball`, whose cameras are of several
kinds, has up to .71, which an encode matches."""


@dataclass(frozen=True)
class Findings:
    """What is measured of a camera. ``lost``, ``hung`` and ``dropped``: numbers of its frames that show nothing, that
    repeat the one before in a row, and that are missing singly; ``unread``: that cannot be read, for this ``damage``.

    ``turned``: degrees; ``late``: frames; ``residual``: pixels; NaN where unknown. ``sharpness``: of its details, over
    the cameras' median; ``noise``: levels, ``usual_noise``: the cameras' median; ``stops``: its exposure against the
    median camera. ``swapped``: the camera whose pictures it has. ``matched``: whether another camera's pictures have
    what its own show.
    """

    camera: str
    lost: Sequence[int] = ()
    hung: Sequence[int] = ()
    dropped: Sequence[int] = ()
    unread: Sequence[int] = ()
    damage: str = ""
    swapped: str | None = None
    misplaced: bool = False
    turned: float = math.nan
    residual: float = math.nan
    late: float = math.nan
    sharpness: float = math.nan
    noise: float = math.nan
    usual_noise: float = math.nan
    stops: float = math.nan
    moving: bool = False
    matched: bool = True


@dataclass(frozen=True)
class Fault:
    """A fault of ``camera``: its ``word``, what it looks like, what to do, and the ``frames`` without a picture."""

    word: str
    camera: str
    looks: str
    remedy: str
    frames: Sequence[int] = ()

    def __str__(self) -> str:
        return f"camera {self.camera} {self.looks}; {self.remedy}"


def faults_of(findings: Findings) -> Iterator[Fault]:
    """What is wrong with a camera, worst first.

    One that shows nothing, or not its moment, is judged by nothing else of these; one with a wrong pose by its pictures
    alone.
    """

    left_out = f"or leave it out with --exclude {findings.camera}"

    def fault(word: str, looks: str, remedy: str) -> Fault:
        return Fault(word, findings.camera, looks, remedy)

    def missing(word: str, looks: str, frames: Sequence[int], remedy: str) -> Fault:
        return Fault(word, findings.camera, f"{looks} in {frames_text(frames, most=_NAMED_ROWS)}", remedy, frames)

    if findings.lost:
        yield missing(DEAD, "shows nothing", findings.lost, f"see to its cable and exposure, {left_out}")
        return
    if findings.noise >= _ONLY_NOISE_LEVELS and not findings.matched:
        yield fault(
            NOISE,
            f"shows noise of {findings.noise:.0f} levels and nothing that two cameras agree on",
            f"look at its recording, {left_out}",
        )
        return
    is_blurred = findings.sharpness < BLURRED_BELOW
    # What is out of focus has little noise of its own, too.
    if findings.hung and not is_blurred:
        yield missing(FROZEN, "repeats one picture", findings.hung, f"record it again, {left_out}")
    if findings.moving:
        yield fault(
            MOVING,
            "moves through the scene, which no turn of it explains",
            f"cameras must stand still: fix it, {left_out}",
        )
    if findings.swapped is not None:
        yield fault(SWAPPED, f"has the pictures of {findings.swapped}", "exchange the two files")
    elif findings.misplaced and not is_blurred:  # whose matches are off by more than a sharp camera's
        yield _misplaced(findings, left_out)
    elif abs(findings.late) >= _LATE_FRAMES and not (findings.hung or findings.moving):
        yield _late(findings)
    if findings.unread:
        yield missing(DAMAGED, "has no picture", findings.unread, findings.damage)
    if findings.dropped and not is_blurred:
        yield missing(DROPPED, "has no picture of its own", findings.dropped, "look at its recorder")
    if is_blurred:
        yield fault(
            BLURRED,
            f"is out of focus: its finest details have {findings.sharpness:.0%} of the others' strength",
            f"focus it, {left_out}",
        )
    if findings.noise >= max(_NOISY_LEVELS, _NOISY_TIMES * findings.usual_noise):
        yield fault(
            NOISY,
            f"has noise of {findings.noise:.1f} levels, the others {findings.usual_noise:.1f}",
            "give it more light",
        )
    if abs(findings.stops) >= EXPOSED_STOPS:
        how = "brighter" if findings.stops > 0 else "darker"
        yield fault(
            EXPOSURE,
            f"is {abs(findings.stops):.1f} stops {how} than the others",
            "set its exposure as theirs; an encode matches what is not clipped",
        )


def verdict_on(faults: Sequence[Fault]) -> str:
    """What a camera with these faults is good for."""
    if any(fault.word in _HARMFUL for fault in faults):
        return HARMFUL
    return USABLE if faults else GOOD


def _misplaced(findings: Findings, left_out: str) -> Fault:
    is_turned = math.isfinite(findings.turned)
    how = f"rotated by {findings.turned:.1f} degrees" if is_turned else f"misplaced by {findings.residual:.1f} pixels"
    return Fault(
        TURNED if is_turned else MISPLACED,
        findings.camera,
        f"appears {how} against its calibration: its matches do not fit the other cameras' poses",
        f"calibrate it again, {left_out}",
    )


def _late(findings: Findings) -> Fault:
    how, frames = "late" if findings.late > 0 else "early", f"{abs(findings.late):.3g}"
    return Fault(
        LATE,
        findings.camera,
        f"appears {frames} frame{'s' if frames != '1' else ''} {how} against the others",
        "find out when each camera started (decogs-sync), or encode with --sync auto",
    )
