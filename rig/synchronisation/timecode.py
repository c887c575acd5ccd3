"""When each camera starts, by the timecode in its video."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np

from decogs.formats.frames.rates import exact_rate
from decogs.formats.rigs import Rig
from decogs.formats.rigs.rig import more
from decogs.formats.videos.reading import VideoSource
from decogs.formats.videos.timecodes import Timecode, read_timecode

from .joint import StartEstimate

_ERROR = 0.25
"""Numbers of timecode: clocks that are set alike count whole ones, and cameras expose anywhere within one."""
_MOST_NUMBERS = 30
"""In a second of timecode by SMPTE ST 12-1; recorders of more frames may count these, or every frame."""


@dataclass(frozen=True)
class _Stamp:
    """A camera's timecode, and how many numbers a second of it has; 0 where that is not sure."""

    camera: str
    timecode: Timecode
    fps: float
    per_second: int

    @property
    def count(self) -> int | None:
        """The numbers since midnight; None where they cannot be told."""
        return self.timecode.count(self.per_second) if self.per_second else None

    @property
    def number(self) -> Fraction:
        """Seconds from one number to the next."""
        return round(self.fps) / (self.per_second * exact_rate(self.fps))

    @property
    def day(self) -> Fraction:
        """Seconds after which it begins anew."""
        return self.timecode.day(self.per_second) * self.number


def starts_by_timecode(
    rig: Rig, read: Callable[[Path], Timecode | None] = read_timecode
) -> tuple[StartEstimate, tuple[str, ...]]:
    """The starts of a rig's recordings, NaN for those without timecode, and what the user should know of it.

    Timecodes that all begin an hour were written by an editor, and say nothing. Those that leave numbers out and those
    that do not run apart: the kind that most cameras have is taken. No timecode is taken whose rate is not sure.
    """
    stamps = list(_stamps(rig, read))
    warnings = list(_unsure(stamps))
    usable = [stamp for stamp in stamps if stamp.count is not None]
    if all(stamp.timecode.is_full_hour for stamp in stamps):
        usable = []
    dropping = [stamp for stamp in usable if stamp.timecode.is_drop_frame]
    plain = [stamp for stamp in usable if not stamp.timecode.is_drop_frame]
    if dropping and plain:
        usable = max(dropping, plain, key=len) if len(dropping) != len(plain) else []
        warnings.append(_mixed(dropping, plain, usable))
    starts = np.full(len(rig.cameras), np.nan)
    errors = starts.copy()
    names = [camera.name for camera in rig.cameras]
    for stamp, seconds in zip(usable, _seconds(usable), strict=True):
        row = names.index(stamp.camera)
        starts[row] = rig.timeline.time_of(seconds)
        errors[row] = _ERROR * rig.timeline.time_of(stamp.number)
    return StartEstimate(starts, errors, np.isfinite(starts).astype(np.float64)), tuple(warnings)


def _stamps(rig: Rig, read: Callable[[Path], Timecode | None]) -> Iterator[_Stamp]:
    """The timecodes of the cameras that have one; what counts every frame of one camera does so in all of its rate."""
    stamps = []
    for camera, source in zip(rig.cameras, rig.sources, strict=True):
        timecode = read(source.path) if isinstance(source, VideoSource) else None
        if timecode is not None and source.fps is not None and source.frame_count > 1:
            stamps.append((camera.name, timecode, source.fps))
    for name, timecode, fps in stamps:
        nominal = round(fps)
        alike = [other.frames for _, other, rate in stamps if other.per_second is None and round(rate) == nominal]
        counts_all = nominal <= _MOST_NUMBERS or max(alike, default=0) >= nominal / 2
        yield _Stamp(name, timecode, fps, timecode.per_second or (nominal if counts_all else 0))


def _seconds(stamps: Sequence[_Stamp]) -> list[Fraction]:
    """When each began, in seconds; those after midnight after those before."""
    times = [(stamp.count or 0) * stamp.number for stamp in stamps]
    last = max(times, default=Fraction(0))
    return [
        time + stamp.day if last - time > stamp.day / 2 else time for stamp, time in zip(stamps, times, strict=True)
    ]


def _unsure(stamps: Sequence[_Stamp]) -> Iterator[str]:
    unsure = [stamp for stamp in stamps if not stamp.per_second]
    if unsure:
        first = unsure[0]
        yield (
            f"camera {first.camera}{more(unsure)}: nothing says whether the timecode {first.timecode.text} counts "
            f"every frame of {first.fps:.4g} a second or every second one; it is not used"
        )
    odd = [stamp for stamp in stamps if stamp.per_second and stamp.count is None]
    if odd:
        first = odd[0]
        yield (
            f"camera {first.camera}{more(odd)}: the timecode {first.timecode.text} is none of {first.per_second} "
            "frames a second; it is not used"
        )


def _mixed(dropping: Sequence[_Stamp], plain: Sequence[_Stamp], used: Sequence[_Stamp]) -> str:
    unused = [stamp for stamp in (*dropping, *plain) if stamp not in used]
    return (
        f"camera {dropping[0].camera}{more(dropping)} counts drop-frame timecode, camera "
        f"{plain[0].camera}{more(plain)} does not, so that they run apart by 3.6 s an hour; that of "
        f"{unused[0].camera}{more(unused)} is not used: set all cameras to one kind"
    )
