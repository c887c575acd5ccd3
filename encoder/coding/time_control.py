"""Time per frame: how it is asked for, and the control that keeps later frames to it on average.

Chosen: wall-clock seconds of everything that an encode does for a frame, from its decoded pictures until it is ready
for the next one's; what masks, selection and writing leave is for training, which meets a deadline
(`training.schedule`). What frames take beyond their deadlines, writing above all, is learned; what was saved and
overspent is carried over. A frame whose time would not do for the least training is held, and the next one has its time
as well: few steps in every frame lose what moves, and each frame begins with the errors of the last. As for
bytes (`rate_control`), the clip's length is not known to it. Rejected: processor seconds (a rig that records waits for
no processor); the keyframe in the budget (the number of frames that are to pay for it is unknown).
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from decogs.formats.errors import UsageError

from ..methods import require_sparse
from ..settings.encode import EncodeSettings

TIME_TOLERANCE = 0.05
"""By which share of the budget the mean of a clip may be above it; a miss is reported beyond it."""

_SECONDS_HORIZON = 6
"""Frames over which what was saved or overspent is made up for."""
_ALLOWANCE_RANGE = (0.5, 2.0)
"""A single frame's time, in budgets: what was saved in a still scene is not thrown at the first frame that moves."""
_MAX_HELD = 7
"""Frames held in a row, a quarter of a second: a longer freeze shows nothing of what happens; a miss is reported."""
_MAX_OWED = 2.0
"""Budgets that frames may have overspent before one is held for that alone."""
_OVERHEAD_KEPT = 0.7
"""Share of the estimate of what a frame takes beyond its deadline that a new frame does not change."""
_AFTER_TRAINING = ("write", "commit")
_UNCOUNTED = "measure"
_FIXED = "trains a fixed number of steps"
_MIN_SECONDS, _MAX_SECONDS = 1e-4, 1e6
"""Bounds of a frame's time: a clock's resolution, and twelve days."""


def with_time_budget(settings: EncodeSettings, seconds: float) -> EncodeSettings:
    """The same settings held to so many seconds, the mean of the frames after the first.

    Raises UsageError beyond what a clock can tell, and for a dense method, whose schedule is fixed.
    """
    if not _MIN_SECONDS <= seconds <= _MAX_SECONDS:
        raise UsageError(f"`time_budget` {seconds:g}: give from {_MIN_SECONDS:g} to {_MAX_SECONDS:g} seconds a frame")
    require_sparse(settings, "`time_budget`", _FIXED)
    return replace(settings, time_budget=seconds)


def with_target_psnr(settings: EncodeSettings, target: float) -> EncodeSettings:
    """The same settings with the training of every frame ended once it has so many dB (`schedule.TargetWatch`).

    Raises UsageError for what is no PSNR, and for a dense method, whose schedule is fixed.
    """
    if not (math.isfinite(target) and 0 < target <= 100):
        raise UsageError(f"`target_psnr` {target:g}: give decibels above 0 and at most 100, such as 30")
    require_sparse(settings, "`target_psnr`", _FIXED)
    return replace(settings, target_psnr=target)


def counted_seconds(seconds: Mapping[str, float]) -> float:
    """A frame's seconds by stage, added, without the measuring."""
    return sum(value for stage, value in seconds.items() if stage != _UNCOUNTED)


def over_time(frames: Sequence[Mapping[str, float]], budget: float) -> float:
    """By which share the mean of these frames' seconds is above the budget; 0 when it is not, or there are none."""
    if not frames:
        return 0.0
    return max(0.0, sum(map(counted_seconds, frames)) / (len(frames) * budget) - 1)


@dataclass(frozen=True)
class TimeControl:
    """Deadlines for the training of later frames, so that a clip's frames take ``budget`` seconds on average.

    ``saved``: seconds that frames so far have left; ``kept``: those of the ``held`` frames since the last trained one.
    ``beyond``: what frames take beyond their deadlines, ``after`` what the last one took after training; None before
    the first.
    """

    budget: float
    saved: float = 0.0
    kept: float = 0.0
    held: int = 0
    beyond: float | None = None
    after: float | None = None

    def holds(self, seconds: Mapping[str, float], least: float) -> bool:
        """Whether the next frame is better held, its time kept for the frame after it.

        ``seconds``: what the frame has taken so far, by stage; ``least``: what training takes at least, in seconds.
        """
        if self.held >= _MAX_HELD:
            return False
        there = max(self.budget + self.kept, self._allowance())
        return self._owes_much() or there < counted_seconds(seconds) + least + (self.after or 0.0)

    def deadline(self, seconds: Mapping[str, float]) -> float:
        """When the next frame's training is to be over, in seconds of ``time.perf_counter``.

        ``seconds``: what the frame has taken so far, by stage.
        """
        return time.perf_counter() + self._planned() - counted_seconds(seconds)

    def record_time(self, seconds: Mapping[str, float], *, held: bool = False) -> TimeControl:
        """The control after a frame; ``held``: that was held for the sake of the next one."""
        spared = self.budget - counted_seconds(seconds)
        if held and self._owes_much():
            return replace(self, held=self.held + 1, saved=self.saved + spared)
        if held:
            return replace(self, held=self.held + 1, kept=self.kept + spared)
        done = replace(self, saved=self.saved + (self.kept + spared), held=0, kept=0.0)
        if "training" not in seconds:
            return done
        after = sum(seconds.get(stage, 0.0) for stage in _AFTER_TRAINING)
        past = after if self.beyond is None else self.beyond
        # Training that ended before its deadline says only what comes after it.
        beyond = max(after, counted_seconds(seconds) - self._planned())
        return replace(done, after=after, beyond=_OVERHEAD_KEPT * past + (1 - _OVERHEAD_KEPT) * beyond)

    def _owes_much(self) -> bool:
        return self.saved < -_MAX_OWED * self.budget

    def _planned(self) -> float:
        """Seconds for the next frame up to its deadline."""
        return self._allowance() - (self.beyond or 0.0)

    def _allowance(self) -> float:
        """Seconds for the next frame: its own budget, what held frames kept for it, and a share of what was saved."""
        low, high = _ALLOWANCE_RANGE
        own = min(max(self.budget + self.saved / _SECONDS_HORIZON, low * self.budget), high * self.budget)
        return own + self.kept
