"""Time control: deadlines that keep later frames to a time budget on average.

Chosen: wall-clock seconds of everything that an encode does for a frame, from its decoded pictures until it is ready
for the next one's; what masks, selection and writing leave is for training, which meets a deadline
(`training.schedule`). What frames take beyond their deadlines, writing above all, is learned; what was saved and
overspent is carried over. A frame whose time does not suffice for the least training is deferred: it is a skip, and the
next frame has its time as well. A few steps in every frame lose what moves, and each frame starts from the errors of
the last. As for bytes (`rate_control`), the clip's length is not known to it. Rejected: processor seconds (a rig that
records waits for no processor); the keyframe in the budget (the number of frames that are to pay for it is unknown).
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from decogs.formats.errors import UsageError

from ..methods import require_sparse
from ..settings.encode import EncodeSettings
from ..training.schedule import UNKNOWN_PACE, Pace

TIME_TOLERANCE = 0.05
"""By which share of the budget the mean of a clip may be above it; a miss is reported beyond it."""

_SECONDS_HORIZON_FRAMES = 6
"""Frames over which saved or overspent time is balanced."""
_ALLOWANCE_RANGE = (0.5, 2.0)
"""Bounds of a single frame's time, in budgets: savings of a still scene are not spent on the first frame that moves."""
_MAX_DEFERRED_FRAMES = 7
"""In a row, a quarter of a second. Beyond it a frame is trained all the same, and a missed budget reported."""
_MAX_OVERSPENT_BUDGETS = 2.0
"""Overspent time, in budgets of a frame, above which a frame is deferred for that alone."""
_OVERHEAD_KEPT = 0.7
"""Weight of the old estimate of a frame's seconds beyond its deadline against the newest frame's."""
_STAGES_AFTER_TRAINING = ("write", "commit")
_UNCOUNTED_STAGE = "measure"
_FIXED_SCHEDULE = "trains a fixed number of steps"
_MIN_SECONDS, _MAX_SECONDS = 1e-4, 1e6
"""Bounds of a frame's time: a clock's resolution, and twelve days."""


def with_time_budget(settings: EncodeSettings, seconds: float) -> EncodeSettings:
    """The settings with a time budget: mean seconds of the frames after the first.

    Raises UsageError beyond a clock's resolution, and for a dense method, whose schedule is fixed.
    """
    if not _MIN_SECONDS <= seconds <= _MAX_SECONDS:
        raise UsageError(f"`time_budget` {seconds:g}: give from {_MIN_SECONDS:g} to {_MAX_SECONDS:g} seconds a frame")
    require_sparse(settings, "`time_budget`", _FIXED_SCHEDULE)
    return replace(settings, time_budget=seconds)


def with_target_psnr(settings: EncodeSettings, target: float) -> EncodeSettings:
    """The same settings with the training of every frame ended once it has so many dB (`schedule.TargetWatch`).

    Raises UsageError for what is no PSNR, and for a dense method, whose schedule is fixed.
    """
    if not (math.isfinite(target) and 0 < target <= 100):
        raise UsageError(f"`target_psnr` {target:g}: give decibels above 0 and at most 100, such as 30")
    require_sparse(settings, "`target_psnr`", _FIXED_SCHEDULE)
    return replace(settings, target_psnr=target)


def counted_seconds(seconds: Mapping[str, float]) -> float:
    """A frame's seconds by stage, added, without the measuring."""
    return sum(value for stage, value in seconds.items() if stage != _UNCOUNTED_STAGE)


def over_time(frames: Sequence[Mapping[str, float]], budget: float) -> float:
    """By which share the mean of these frames' seconds is above the budget; 0 when it is not, or there are none."""
    if not frames:
        return 0.0
    return max(0.0, sum(map(counted_seconds, frames)) / (len(frames) * budget) - 1)


@dataclass(frozen=True)
class TimeControl:
    """Deadlines for the training of later frames, so that a clip's frames take ``budget`` seconds on average.

    ``saved``: unused seconds of the frames so far; ``kept``: those of the ``deferred`` frames since the last trained
    one. ``beyond``: seconds of a frame beyond its deadline; ``after``: of the last one after training; None before the
    first. ``pace``: of training.
    """

    budget: float
    saved: float = 0.0
    kept: float = 0.0
    deferred: int = 0
    beyond: float | None = None
    after: float | None = None
    pace: Pace = UNKNOWN_PACE

    def defers(self, seconds: Mapping[str, float], least: float) -> bool:
        """Whether to defer the next frame: to keep its time for the frame after it.

        ``seconds``: what the frame has taken so far, by stage; ``least``: what training takes at least, in seconds.
        """
        if self.deferred >= _MAX_DEFERRED_FRAMES:
            return False
        available = max(self.budget + self.kept, self._allowance())
        return self._has_overspent() or available < counted_seconds(seconds) + least + (self.after or 0.0)

    def deadline(self, seconds: Mapping[str, float]) -> float:
        """When the next frame's training is to be over, in seconds of ``time.perf_counter``.

        ``seconds``: what the frame has taken so far, by stage.
        """
        return time.perf_counter() + self._planned() - counted_seconds(seconds)

    def record_time(
        self, seconds: Mapping[str, float], *, deferred: bool = False, pace: Pace | None = None
    ) -> TimeControl:
        """The control after a frame; ``deferred``: it left its time to the next one; ``pace``: training's, if new."""
        if pace is not None:
            return replace(self, pace=pace).record_time(seconds, deferred=deferred)
        spared = self.budget - counted_seconds(seconds)
        if deferred and self._has_overspent():
            return replace(self, deferred=self.deferred + 1, saved=self.saved + spared)
        if deferred:
            return replace(self, deferred=self.deferred + 1, kept=self.kept + spared)
        done = replace(self, saved=self.saved + (self.kept + spared), deferred=0, kept=0.0)
        if "training" not in seconds:
            return done
        after = sum(seconds.get(stage, 0.0) for stage in _STAGES_AFTER_TRAINING)
        past = after if self.beyond is None else self.beyond
        # Of training that ended before its deadline, only what came after it counts.
        beyond = max(after, counted_seconds(seconds) - self._planned())
        return replace(done, after=after, beyond=_OVERHEAD_KEPT * past + (1 - _OVERHEAD_KEPT) * beyond)

    def _has_overspent(self) -> bool:
        return self.saved < -_MAX_OVERSPENT_BUDGETS * self.budget

    def _planned(self) -> float:
        """Seconds for the next frame up to its deadline."""
        return self._allowance() - (self.beyond or 0.0)

    def _allowance(self) -> float:
        """Seconds for the next frame: its own budget, those of deferred frames before it, a share of what was saved."""
        low, high = _ALLOWANCE_RANGE
        own = min(max(self.budget + self.saved / _SECONDS_HORIZON_FRAMES, low * self.budget), high * self.budget)
        return own + self.kept
