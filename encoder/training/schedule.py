"""How long one frame trains: to the end of its schedule, to a deadline, or until it looks as good as asked for.

Chosen for a deadline: the schedule is run through in strides. After every step the frame's own median time per step
says how many more fit, and what is left of the schedule is spread over them, so that densification, the judging of
changes and the fall of the rates come where they always do, only sooner. Rates grow with the root of the strides, at
most threefold: few steps must still get as far as things move. A frame needs no knowledge of others for it,
and a machine that slows down in its middle is followed. Rejected: cutting the schedule off at the deadline, which
leaves changes unjudged and rates high (DESIGN.md has both measured); a number of steps from the last frame's speed
(frames differ by how much of the picture moves).

Chosen for iterations: as many times the usual number as the scene misses more of the region of interest than usual,
measured before the frame's first step. A thing that enters needs twice the steps of one that moves on. Rejected:
deciding it when emerging things are sought (what was sown too early stays behind as a trail: DESIGN.md has both), or
from the frame before (a frame could not be trained again alone).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import median

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

from ..settings.frame import IterationSettings

OnLoss = Callable[[str, int, float], None]
"""Called with the stage, the iteration within it (from 0) and the loss of the view that it drew."""

LEAST_STEPS = 12
"""Steps that a stage runs however late it is: fewer follow nothing, and cost hardly less than these."""

_CLEARLY = np.float32(25 / 255)
"""By how much a colour is off that is clearly missed: the paper's tau, here of the rendering."""

_SEARCH_SHARE = 0.1
"""Of the time for training, what the search for emerging things may take on average when time is short."""
LEAST_SEARCH = 1 / 16
"""Share of a whole search below which nothing is found."""
_LEAST_SEARCHED = 8
"""Views in which a search is of use: a point must be missed in four of them."""


@dataclass(frozen=True)
class StoppingRule:
    """Conditions that end a frame's training early, and an observer of its steps; all None: the whole schedule.

    ``deadline``: when training is to be over, in seconds of ``time.perf_counter``; the result then depends on the
    machine. ``target_psnr``: what suffices (`TargetWatch`), in dB; higher is slower. ``on_loss``: called for every
    step.
    """

    deadline: float | None = None
    target_psnr: float | None = None
    on_loss: OnLoss | None = None

    def deadline_before(self, steps: int, later: int) -> float | None:
        """The deadline of a stage of ``steps`` that begins now and leaves time for ``later`` ones; None without one."""
        if self.deadline is None:
            return None
        now = time.perf_counter()
        return now + (self.deadline - now) * steps / max(1, steps + later)


WHOLE = StoppingRule()
"""The whole schedule, unwatched."""


def iteration_factor(settings: IterationSettings, errors: Sequence[FloatArray]) -> float:
    """How many times the usual iterations a frame runs.

    ``errors``: of some views in their regions of interest, (3, pixels) each, colours 0 to 1.
    """
    pixels = sum(each.shape[1] for each in errors)
    if not (settings.usual_miss and pixels):
        return 1.0
    missed = sum(int((np.abs(each).max(axis=0) > _CLEARLY).sum()) for each in errors)
    return float(np.clip(missed / pixels / settings.usual_miss, settings.min_factor, settings.max_factor))


class StepSchedule:
    """Where a stage is in its schedule of ``iterations``: its steps are ``factor`` times as many, or fewer in time.

    Without a ``deadline`` ``position`` is the number of steps done, divided by the factor.
    """

    def __init__(self, iterations: int, deadline: float | None = None, *, factor: float = 1.0) -> None:
        self._iterations, self._deadline, self._own_stride = iterations, deadline, 1 / factor
        self._before, self.position = -1.0, 0.0
        self._last_stride = self._own_stride
        self._seconds: list[float] = []
        self._began = time.perf_counter()

    @property
    def is_over(self) -> bool:
        return self.position >= self._iterations

    @property
    def hurry(self) -> float:
        """How many times as far the last step went as one without a deadline; 1 at the beginning."""
        return self._last_stride / self._own_stride

    @property
    def steps_seconds(self) -> tuple[float, float]:
        """What a step takes, the median, and what all steps took; 0 without a deadline."""
        return (median(self._seconds), sum(self._seconds)) if self._seconds else (0.0, 0.0)

    def reaches(self, mark: int) -> bool:
        """Whether this step is the first one at or beyond that position."""
        return self._before < mark <= self.position

    def step(self) -> None:
        """Tells that a step was done."""
        self._before = self.position
        if self._deadline is not None:
            self._last_stride = self._stride(self._deadline)
        self.position += self._last_stride

    def put_off(self, seconds: float) -> None:
        """Gives the deadline back what something else than steps took; the frames after it pay for it."""
        if self._deadline is not None:
            self._deadline += seconds
            self._began += seconds

    def skip_to(self, mark: int) -> None:
        """Leaves out what lies between this step and that position, which the next step reaches."""
        self.position = max(self.position, mark - self._own_stride)

    def _stride(self, deadline: float) -> float:
        """What is left of the schedule for each of the steps that still fit, this one included."""
        now = time.perf_counter()
        self._seconds.append(now - self._began)
        self._began = now
        # The median: a single step that searched for what emerges says nothing of the next ones.
        fitting = round((deadline - now) / max(median(self._seconds), 1e-9))
        more = max(fitting, LEAST_STEPS - len(self._seconds), 0)
        left = self._iterations - self.position
        return max(self._own_stride, left / (1 + more))


class SearchTime:
    """When frames under a deadline search for what emerges, and how much of it.

    A whole search may take as long as all steps of several frames, which would then be short of them. So it takes no
    more than its share of training's time on average, with fewer rays in fewer views where that is too little.
    """

    def __init__(self) -> None:
        self._credit = 0.0
        self._whole: float | None = None

    def affords(self, left: float, guess: float) -> float:
        """The share, 0 to 1, of a whole search that a frame which has ``left`` seconds of training should make.

        ``guess``: what a whole one may take, in seconds, for as long as none was made.
        """
        whole = guess if self._whole is None else self._whole
        smallest = LEAST_SEARCH * whole
        if left > 0:
            self._credit = min(self._credit + _SEARCH_SHARE * left, max(left, smallest))
        if self._credit <= 0 or (self._whole is not None and self._credit < smallest):
            return 0.0
        return min(1.0, max(LEAST_SEARCH, self._credit / max(whole, 1e-9)))

    def took(self, seconds: float, share: float) -> None:
        """Tells how long such a share of a search took."""
        self._credit -= seconds
        self._whole = seconds / share if self._whole is None else (self._whole + seconds / share) / 2


def search_seconds(rays: int, views: int) -> float:
    """About what a whole search takes: every ray is held against every view, 20 microseconds each on a busy core."""
    return 2e-5 * rays * views


def search_of(share: float, views: int) -> tuple[int, float]:
    """In how many of ``views`` a share of a search is made, and with which share of its rays.

    Every ray is held against every view.
    """
    looked = max(min(_LEAST_SEARCHED, views), min(views, round(views * math.sqrt(share))))
    return looked, min(1.0, share * views / max(1, looked))


class TargetWatch:
    """Tells when what is drawn comes close enough to ``pictures`` (3, H, W) in ``regions`` (H, W), None all of it.

    Measured is the PSNR of the mean square error over the regions of all views together and their three channels,
    colours clipped to 0..1; every view counts as it was last drawn, so that it costs no drawing. Without any region
    nothing is ever close enough.
    """

    def __init__(
        self, target_psnr: float, pictures: Sequence[FloatArray], regions: Sequence[NDArray[np.bool_] | None]
    ) -> None:
        self._rows = [None if region is None else np.flatnonzero(region) for region in regions]
        self._targets = [_pixels(picture, rows) for picture, rows in zip(pictures, self._rows, strict=True)]
        values = sum(target.size for target in self._targets)
        self._most = values * 10.0 ** (-target_psnr / 10) if values else -1.0
        self.restart()

    def restart(self) -> None:
        """Forgets what was drawn so far."""
        self._squares = np.array([np.nan if target.size else 0.0 for target in self._targets])

    def saw(self, index: int, shown: FloatArray) -> bool:
        """Takes what view ``index`` was drawn like; whether all views, each as last drawn, are close enough."""
        difference = np.clip(_pixels(shown, self._rows[index]), 0, 1) - self._targets[index]
        self._squares[index] = float(np.square(difference).sum(dtype=np.float64))
        return bool(self._squares.sum() <= self._most)


def _pixels(picture: FloatArray, rows: NDArray[np.int64] | None) -> FloatArray:
    flat = picture.reshape(3, -1)
    return flat if rows is None else flat[:, rows]
