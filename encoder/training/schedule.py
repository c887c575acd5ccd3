"""Length of a frame's training: the whole schedule, up to a deadline, or up to a target quality.

Chosen for a deadline: larger strides through the schedule. After every step the frame's median time per step gives the
number of steps that still fit, and the rest of the schedule is divided among them. So densification, the revert of
insignificant changes and the decay of the rates keep their places in the schedule. Rates grow with the root of the
stride, at most threefold, because few steps must still cover the motion. A frame needs no data of other frames, and the
stride adapts to a machine that slows down. Rejected: ending the schedule at the deadline, which reverts no change and
leaves rates high (DESIGN.md has both measured); a number of steps from the last frame's speed (the moving share of the
picture differs between frames).

Chosen for iterations: the usual number times the ratio of the error in the region of interest, before the first step,
to its usual value. An entering object needs twice the steps of a moving one. Rejected: the decision at the search for
emerging objects (Gaussians seeded too early remain as a trail: DESIGN.md has both); the error of the frame before (a
frame could not be trained again alone).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from statistics import median

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

from ..settings.frame import FrameSettings, IterationSettings
from ..settings.optimiser import LearningRates

OnLoss = Callable[[str, int, float], None]
"""Called with the stage, the iteration within it (from 0) and the loss of the view that it drew."""

MIN_STEPS = 12
"""Least steps of a stage, however late it is: fewer have no effect and cost hardly less."""

MAX_STRETCH = 4.0
"""Largest ratio of a Gaussian's largest to its middle size that later frames may bring about. Over 800 frames a new
view loses .44 dB; without a limit .97, since needles grow that look wrong from elsewhere."""

LATE_DECAY = 0.2
"""What is left of a later frame's rates at the end of its steps, falling over their second half."""

_MAX_ITERATION_FACTOR, _MAX_ITERATIONS = 3.0, 400
"""Most iterations of a frame that misses much: in units of the usual number, since a cut would take minutes, and in
all. From one keyframe 600 are worse than 300 on three rigs: the few views that see what is new are fitted too well."""

_BRIGHTER_ITERATION_FACTOR, _BRIGHTER_ITERATIONS = 6.0, 750
"""The same where light is brighter by more than steps follow: at most half of a `standard` keyframe's. Where it is
darker, times 1/8, `workbench` takes a third more bytes with them and loses .3 dB."""

_STAGE_STEPS, _STAGE_ITERATION_FACTOR, _STAGE_ITERATIONS = 3.0, 6.0, 480
"""On a stage, where cameras see performers all around before what is known: times the square of the ratio of errors, at
most, and in all. With a third of it `grey` loses 1 dB where performers are, for 15 % fewer bytes."""

_MAX_RATE_GAIN = 3.0
"""Largest factor of the rates when a deadline leaves few steps, which must still cover the motion."""

_MISSED_ERROR = np.float32(25 / 255)
"""Colour error from which a pixel is clearly missed: the paper's tau, applied to the rendering."""

_SEARCH_TIME_FRACTION = 0.1
"""Mean share of training time for the search for emerging objects when time is short."""
MIN_SEARCH_SHARE = 1 / 16
"""Share of a whole search below which it finds nothing."""
_MIN_SEARCH_VIEWS = 8
"""Least views of a useful search: four views must miss a point."""


@dataclass(frozen=True)
class StoppingRule:
    """Conditions that end a frame's training early, and an observer of its steps; all None: the whole schedule.

    ``deadline``: end of training in seconds of ``time.perf_counter``; results then depend on the machine.
    ``target_psnr``: sufficient quality (`TargetWatch`), dB; higher is slower. ``on_loss``: callback for every step.
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


def missed_share(errors: Sequence[FloatArray]) -> float:
    """Share of pixels that are clearly missed; ``errors``: of some views, (3, pixels) each, colours 0 to 1."""
    pixels = sum(each.shape[1] for each in errors)
    missed = sum(int((np.abs(each).max(axis=0) > _MISSED_ERROR).sum()) for each in errors)
    return float(missed / max(pixels, 1))


def iteration_factor(
    settings: IterationSettings, usual: int, errors: Sequence[FloatArray], *, on_stage: bool = False
) -> float:
    """Factor of a frame's iterations, relative to the ``usual`` number.

    ``errors``: of some views in their regions of interest, (3, pixels) each, colours 0 to 1.
    """
    if not (settings.usual_miss and any(each.size for each in errors)):
        return 1.0
    factor, steps = _MAX_ITERATION_FACTOR, _MAX_ITERATIONS
    missed = missed_share(errors) / settings.usual_miss
    if on_stage:
        factor, steps, missed = _STAGE_ITERATION_FACTOR, _STAGE_ITERATIONS, _STAGE_STEPS * missed * missed
    most = max(1.0, min(factor, steps / max(usual, 1)))
    return float(np.clip(missed, settings.min_factor, most))


def brighter_iteration_factor(usual: int) -> float:
    """Factor of the iterations of a frame whose light is brighter by more than its ``usual`` number follows."""
    return max(1.0, min(_BRIGHTER_ITERATION_FACTOR, _BRIGHTER_ITERATIONS / max(usual, 1)))


class StepSchedule:
    """Position of a stage in its schedule of ``iterations``, run in ``factor`` times as many steps, fewer when late.

    Without a ``deadline``, ``position`` is the number of steps done, divided by the factor.
    """

    def __init__(self, iterations: int, deadline: float | None = None, *, factor: float = 1.0) -> None:
        self._iterations, self._deadline, self._own_stride = iterations, deadline, 1 / factor
        self._before, self.position = -1.0, 0.0
        self._last_stride = self._own_stride
        self._seconds: list[float] = []
        self._began = time.perf_counter()

    @property
    def is_over(self) -> bool:
        """Whether the schedule's end is reached."""
        return self.position >= self._iterations

    @property
    def relative_stride(self) -> float:
        """Last stride over that without a deadline; 1 at the beginning."""
        return self._last_stride / self._own_stride

    @property
    def is_truncated(self) -> bool:
        """Whether a deadline left only the least steps, too few to follow what moved."""
        return self._deadline is not None and len(self._seconds) <= MIN_STEPS and self.relative_stride > 1

    @property
    def steps_seconds(self) -> tuple[float, float]:
        """Median and total duration of the steps; 0 without a deadline."""
        return (median(self._seconds), sum(self._seconds)) if self._seconds else (0.0, 0.0)

    def reaches(self, mark: int) -> bool:
        """Whether this step is the first one at or beyond ``mark``."""
        return self._before < mark <= self.position

    def step(self) -> None:
        """Advances by one step."""
        self._before = self.position
        if self._deadline is not None:
            self._last_stride = self._stride(self._deadline)
        self.position += self._last_stride

    def extend_deadline(self, seconds: float) -> None:
        """Extends the deadline by time spent outside of steps, at the expense of later frames."""
        if self._deadline is not None:
            self._deadline += seconds
            self._began += seconds

    def skip_to(self, mark: int) -> None:
        """Skips the schedule up to ``mark``, which the next step reaches."""
        self.position = max(self.position, mark - self._own_stride)

    def _stride(self, deadline: float) -> float:
        """Rest of the schedule, divided by the steps that still fit, this one included."""
        now = time.perf_counter()
        self._seconds.append(now - self._began)
        self._began = now
        # The median ignores a single slow step with a search for emerging objects.
        fitting = round((deadline - now) / max(median(self._seconds), 1e-9))
        more = max(fitting, MIN_STEPS - len(self._seconds), 0)
        left = self._iterations - self.position
        return max(self._own_stride, left / (1 + more))


def rates_at(settings: FrameSettings, extent: float, schedule: StepSchedule) -> LearningRates:
    """Learning rates where the schedule stands, those of positions in world units.

    Over its second half they fall; where a deadline lengthens the strides, they grow.
    """
    late = LATE_DECAY ** max(0.0, 2 * schedule.position / settings.joint_iterations - 1)
    rates = replace(settings.rates, means=settings.rates.means * extent)
    return rates.scaled(late * min(schedule.relative_stride**0.5, _MAX_RATE_GAIN))


def seconds_at_least(spent: float, schedule: StepSchedule) -> float:
    """Seconds of a frame that took ``spent`` seconds, had it had the least steps only."""
    step, steps = schedule.steps_seconds
    return spent - steps + MIN_STEPS * step


@dataclass(frozen=True)
class SearchTime:
    """Time budget of the search for emerging objects in frames under a deadline.

    A whole search may take as long as all steps of several frames. So searches take at most a fixed share of training
    time on average; a small budget means fewer rays in fewer views. ``credit``: seconds that frames have left for it.
    ``whole``: those of a whole search; None before the first one.
    """

    credit: float = 0.0
    whole: float | None = None

    def save(self, left: float, guess: float) -> SearchTime:
        """With the share of a frame that has ``left`` seconds of training; ``guess``: a whole search's seconds."""
        if left <= 0:
            return self
        smallest = MIN_SEARCH_SHARE * (guess if self.whole is None else self.whole)
        return replace(self, credit=min(self.credit + _SEARCH_TIME_FRACTION * left, max(left, smallest)))

    def affordable_share(self, guess: float) -> float:
        """Share, 0 to 1, of a whole search that the credit allows; ``guess``: its seconds, before the first one."""
        whole = guess if self.whole is None else self.whole
        if self.credit <= 0 or (self.whole is not None and self.credit < MIN_SEARCH_SHARE * whole):
            return 0.0
        return min(1.0, max(MIN_SEARCH_SHARE, self.credit / max(whole, 1e-9)))

    def spend(self, seconds: float, share: float) -> SearchTime:
        """After a ``share`` of a search that took so many ``seconds``."""
        whole = seconds / share if self.whole is None else (self.whole + seconds / share) / 2
        return SearchTime(self.credit - seconds, whole)


@dataclass(frozen=True)
class Pace:
    """What training under deadlines has taken so far, in seconds; 0 while unknown.

    ``step``: median step of the last frame. ``least``: that frame, had it had the least steps only; a time budget
    defers frames that have less. ``search``: for emerging objects.
    """

    step: float = 0.0
    least: float = 0.0
    search: SearchTime = field(default_factory=SearchTime)


UNKNOWN_PACE = Pace()
"""Before the first frame with a deadline."""


def search_seconds(rays: int, views: int) -> float:
    """Estimated duration of a whole search: 20 microseconds per ray and view on a busy core."""
    return 2e-5 * rays * views


def search_of(share: float, views: int) -> tuple[int, float]:
    """Number of ``views`` and share of the rays for a ``share`` of a search.

    Every ray is compared with every view.
    """
    searched = max(min(_MIN_SEARCH_VIEWS, views), min(views, round(views * math.sqrt(share))))
    return searched, min(1.0, share * views / max(1, searched))


class TargetWatch:
    """Detects that renderings reach a target PSNR against ``pictures`` (3, H, W) in ``regions`` (H, W; None: all).

    The PSNR is that of the mean squared error over the regions of all views and their three channels, colours clipped
    to 0..1. Each view counts with its last rendering, so the check renders nothing. Without regions it never succeeds.
    """

    def __init__(
        self, target_psnr: float, pictures: Sequence[FloatArray], regions: Sequence[NDArray[np.bool_] | None]
    ) -> None:
        self._rows = [None if region is None else np.flatnonzero(region) for region in regions]
        self._targets = [_pixels(picture, rows) for picture, rows in zip(pictures, self._rows, strict=True)]
        values = sum(target.size for target in self._targets)
        self._max_squares = values * 10.0 ** (-target_psnr / 10) if values else -1.0
        self.restart()

    def restart(self) -> None:
        """Forgets all renderings so far."""
        self._squares = np.array([np.nan if target.size else 0.0 for target in self._targets])

    def update(self, index: int, rendered: FloatArray) -> bool:
        """Takes a rendering of view ``index``; whether the last ones of all views reach the target."""
        difference = np.clip(_pixels(rendered, self._rows[index]), 0, 1) - self._targets[index]
        self._squares[index] = float(np.square(difference).sum(dtype=np.float64))
        return bool(self._squares.sum() <= self._max_squares)


def _pixels(picture: FloatArray, rows: NDArray[np.int64] | None) -> FloatArray:
    flat = picture.reshape(3, -1)
    return flat if rows is None else flat[:, rows]
