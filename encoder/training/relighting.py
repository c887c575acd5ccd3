"""Colours after a change of light: every Gaussian gets the gain that the pictures show where it is drawn.

Adam moves a colour by at most its rate a step, so that few steps cannot follow a light that makes colours several times
brighter. The gain of a Gaussian is the sum of the pictures' colours over that of the renderings', both weighed with its
rendering weight. It scales the whole colour, as light does; training goes on from there.

Figure, `workbench` at 88x66, all light times 4, `live`: 23.5 dB, steps alone 13.7, a new keyframe 22.8; times
1/4: 41.2, 37.3 and 40.8 dB. Rejected: leaving clipped pixels out of both sums (times 8: 21.5 dB, else 23.6); a keyframe
(as good, 82 to 136 kB in place of 37 to 124).
"""

from __future__ import annotations

import numpy as np

from decogs.formats.splats import SH_C0, FloatArray

from ..backends import FixedView
from .frame_training import FrameTraining
from .working_set import WorkingSet

_ROUNDS = 3
"""Rounds of gains: Gaussians of different gains overlap. Eight are no better once trained."""
_MAX_GAIN = 16.0
"""Largest gain of a round, and the inverse of the least."""
_DARKEST = 0.01
"""Least colour before the rounds of a brighter light: no gain makes black brighter, and it has no gradient."""
_LEAST_SUM = 1e-3
"""Pixels of white that are added to both sums: what hardly shows keeps its colour."""


def relight(training: FrameTraining, work: WorkingSet) -> bool:
    """Scales the colours under training so that renderings get the pictures' light; whether that is brighter."""
    training.draw(training.used, work, work.optimiser)
    brighter = sum(float(errors.sum()) for errors in training.errors(training.used)) < 0
    if brighter:
        sh = work.values.sh.copy()
        sh[:, 0] = np.maximum(sh[:, 0], np.float32((_DARKEST - 0.5) / SH_C0))
        work.optimiser.put(sh=sh)
    for _ in range(_ROUNDS):
        recorded, rendered = np.full((2, len(work.rows), 3), _LEAST_SUM, np.float32)
        training.draw(training.used, work, work.optimiser)
        for index in training.used:
            view, focus = training.context.static_views[index], training.focus(index)
            recorded += _weighed(view, training.frame.pictures[index] * focus)
            rendered += _weighed(view, np.clip(view.rgb, 0, 1) * focus)
        gain = np.clip(recorded / rendered, 1 / _MAX_GAIN, _MAX_GAIN)
        sh = work.values.sh * gain[:, None]
        # The colour is a half more than its harmonics.
        sh[:, 0] += (gain - 1) * np.float32(0.5 / SH_C0)
        work.optimiser.put(sh=sh)
    return brighter


def _weighed(view: FixedView, picture: FloatArray) -> FloatArray:
    """The sums (M, 3) of a ``picture`` (3, H, W), weighed with the rendering weight of each Gaussian that was drawn."""
    return np.asarray(view.backward(np.ascontiguousarray(picture)).host().sh[:, 0] / np.float32(SH_C0))
