"""How lamps that flicker change a camera's picture: a wave over its rows, in light (SPEC.md, "Corrections")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from decogs.codec.packets.corrections import LAMP_STEP, PHASE_TURNS, Correction, LampWave
from decogs.formats.splats import FloatArray

F64 = NDArray[np.float64]
Shares = NDArray[np.float32] | NDArray[np.float64]

MOST_LAMP_LIGHT = 8.0
"""Largest factor on a colour's odds, and the inverse of the least."""


def lamp_light(correction: Correction, across: Shares, down: Shares) -> FloatArray:
    """Factors (..., 3) on the odds at points of the recorded picture.

    ``across``, ``down``: shares of its width and height from its top left corner, which broadcast together.
    """
    assert correction.lamp is not None
    phase = 2 * np.pi * PHASE_TURNS * correction.lamp_phase
    first, second = lamp_waves(correction.lamp, across, down)
    wave = LAMP_STEP * correction.lamp_amplitude * (np.cos(phase) * first + np.sin(phase) * second)
    return np.asarray(np.clip(1 + wave, 1 / MOST_LAMP_LIGHT, MOST_LAMP_LIGHT), np.float32)


def lamp_waves(lamp: LampWave, across: Shares, down: Shares) -> tuple[F64, F64]:
    """The lamps' wave (..., 3) at phase 0 and a quarter of a turn later, between which that at any phase lies."""
    rows = np.broadcast_to(down.astype(np.float64), np.broadcast_shapes(across.shape, down.shape))
    turn = 2 * np.pi * lamp.turns * rows[..., None]
    sine, cosine = (_between(cells, across, down) for cells in lamp.maps)
    first = sine * np.sin(turn) + cosine * np.cos(turn)
    second = sine * np.cos(turn) - cosine * np.sin(turn)
    return np.asarray(first), np.asarray(second)


def _between(cells: F64, across: Shares, down: Shares) -> F64:
    """Values of ``cells`` (rows, columns, 3) at points between their middles, linear; beyond the outermost as there."""
    rows, columns = cells.shape[:2]
    if rows == columns == 1:
        return np.asarray(cells[0, 0])
    x, y = (np.clip(share * count - 0.5, 0, count - 1) for share, count in ((across, columns), (down, rows)))
    left, top = (np.minimum(at.astype(np.int64), max(count - 2, 0)) for at, count in ((x, columns), (y, rows)))
    right, below = np.minimum(left + 1, columns - 1), np.minimum(top + 1, rows - 1)
    u, v = (x - left)[..., None], (y - top)[..., None]
    upper = (1 - u) * cells[top, left] + u * cells[top, right]
    lower = (1 - u) * cells[below, left] + u * cells[below, right]
    return np.asarray((1 - v) * upper + v * lower)
