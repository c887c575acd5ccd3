"""What cameras did to their pictures in a frame: the corrections block before a payload (SPEC.md, "Corrections").

The scene is kept in its own colours and the cameras in their calibrated poses; a frame says of each camera that the
header names how its picture differs from that. Integers only: floats appear when a picture is shown.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.formats.stream.cursor import Cursor

COLOUR_STEP = 2.0**-12
"""Natural logarithm of the odds v / (1 - v) of a colour value, per unit of ``exposure``, ``red`` and ``blue``."""

ANGLE_STEP = 2.0**-18
"""Radians per unit of ``yaw``, ``pitch`` and ``roll``."""

FALLOFF_STEP = 2.0**-12
"""Of a lens's fall-off k per unit of ``falloff``; light is divided by (1 + k t^2)^2 at the tangent t of the angle to
the camera's axis."""

PHASE_TURNS = 2.0**-16
"""Turns of a lamp's pulse per unit of ``lamp_phase``: its 16 bits are one turn."""

LAMP_STEP = 2.0**-12
"""Share of a colour's odds per unit of a lamp's ``sine`` and ``cosine``, and how much of these there is per unit of
``lamp_amplitude``."""

ALWAYS_LIT = 1 << 12
"""The ``lamp_amplitude`` of lamps' whole strength: that of a camera of whose lamps no frame tells, at phase 0."""

LARGEST = (1 << 15) - 1
"""Largest magnitude of a number that the encoder writes; a block may hold one below it, the last of 16 bits."""

EFFECT_FIELDS = {
    "exposure_drift": ("exposure",),
    "white_balance_drift": ("red", "blue"),
    "camera_shake": ("yaw", "pitch", "roll"),
    "lamp_flicker": ("lamp_phase", "lamp_amplitude"),
}
"""The numbers of each effect, in the order of the block."""


@dataclass(frozen=True)
class CorrectedCameras:
    """Which cameras a stream's frames correct, by effect: their names, in the order of the block."""

    exposure_drift: tuple[str, ...] = ()
    white_balance_drift: tuple[str, ...] = ()
    camera_shake: tuple[str, ...] = ()
    lamp_flicker: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects that correct any camera."""
        return tuple(effect for effect in EFFECT_FIELDS if getattr(self, effect))

    def of(self, name: str) -> tuple[str, ...]:
        """The effects that correct the camera of this name."""
        return tuple(effect for effect in EFFECT_FIELDS if name in getattr(self, effect))

    @property
    def block_bytes(self) -> int:
        """Size of the block that every frame begins with."""
        return 2 * sum(len(fields) * len(getattr(self, effect)) for effect, fields in EFFECT_FIELDS.items())


@dataclass(frozen=True)
class LampWave:
    """How lamps on alternating current change a camera's picture: a wave in time and over the rows.

    ``hertz``: their pulses in a second. ``readout``: seconds from the first row's exposure to the last's, below 0 where
    the last comes first. ``sine``, ``cosine``: how strong the wave and the one a quarter of a turn before it are, in
    LAMP_STEP, at the middles of ``columns`` x ``rows`` cells of the picture: row by row, red, green and blue of each.
    """

    hertz: float
    readout: float
    columns: int
    rows: int
    sine: tuple[int, ...]
    cosine: tuple[int, ...]

    @property
    def turns(self) -> float:
        """Of the wave from the first row to the last."""
        return self.hertz * self.readout

    @property
    def maps(self) -> NDArray[np.float64]:
        """``sine`` and ``cosine`` as shares of the odds, (2, rows, columns, 3)."""
        return np.array([self.sine, self.cosine]).reshape(2, self.rows, self.columns, 3) * LAMP_STEP


@dataclass(frozen=True)
class Correction:
    """How one camera's picture of one frame differs from what the scene shows; all integers, 0 for no difference.

    ``exposure``, in all channels, and ``red`` and ``blue``, in theirs, add to the logarithm of a colour's odds, in
    COLOUR_STEP. ``yaw``, ``pitch``, ``roll`` turn the camera about its own y, x and z axes, in ANGLE_STEP. ``falloff``
    darkens the picture's border, in FALLOFF_STEP; it is the same in every frame, as ``lamp`` is: a wave over the
    picture, by ``lamp_phase`` in PHASE_TURNS and ``lamp_amplitude`` in LAMP_STEP, ALWAYS_LIT where no frame tells it.
    """

    exposure: int = 0
    red: int = 0
    blue: int = 0
    yaw: int = 0
    pitch: int = 0
    roll: int = 0
    falloff: int = 0
    lamp_phase: int = 0
    lamp_amplitude: int = 0
    lamp: LampWave | None = None

    @property
    def odds_gain(self) -> tuple[float, float, float]:
        """Factors on the odds of red, green and blue, from the scene's colour to the recorded one."""
        shifts = (self.exposure + self.red, self.exposure, self.exposure + self.blue)
        red, green, blue = (math.exp(shift * COLOUR_STEP) for shift in shifts)
        return red, green, blue

    @property
    def rotation(self) -> NDArray[np.float64]:
        """(3, 3): takes directions in the camera as it stood to those in the calibrated camera."""
        return turn(self.yaw * ANGLE_STEP, self.pitch * ANGLE_STEP, self.roll * ANGLE_STEP)

    @property
    def is_turned(self) -> bool:
        """Whether the picture is turned at all."""
        return bool(self.yaw or self.pitch or self.roll)

    @property
    def has_gain(self) -> bool:
        """Whether exposure or white balance is changed at all."""
        return bool(self.exposure or self.red or self.blue)

    @property
    def is_coloured(self) -> bool:
        """Whether colours are changed at all, of the whole picture, at its border or by lamps."""
        return bool(self.has_gain or self.falloff or self.has_wave)

    @property
    def has_wave(self) -> bool:
        """Whether lamps change the picture at all."""
        return self.lamp is not None and self.lamp_amplitude != 0


Corrections = Mapping[str, Correction]
"""A frame's corrections by camera."""


def whole_steps(value: float, step: float) -> int:
    """The nearest number of steps that the block can hold."""
    return max(-LARGEST, min(LARGEST, round(value / step)))


def phase_steps(turns: float) -> int:
    """The nearest unit of ``lamp_phase``, of the turn's part."""
    return (round(turns / PHASE_TURNS) + LARGEST + 1) % (2 * LARGEST + 2) - LARGEST - 1


def with_colours(correction: Correction, colours: Correction) -> Correction:
    """The correction of a camera whose ``colours`` differ from the scene's in every frame."""
    names = ("exposure", "red", "blue", "falloff", "lamp_phase", "lamp_amplitude")
    added = {name: getattr(correction, name) + getattr(colours, name) for name in names}
    return replace(correction, lamp=colours.lamp or correction.lamp, **added)


def with_lamps(colours: Corrections, lamps: Mapping[str, LampWave]) -> Corrections:
    """Cameras' constant ``colours`` with exactly these ``lamps`` of which frames tell."""
    told = lamps_of(colours)
    own = {name: replace(each, lamp=None) if name in told else each for name, each in colours.items()}
    kept = {name: each for name, each in own.items() if name not in told or each.has_gain or each.falloff}
    lit = {name: replace(kept.get(name, Correction()), lamp=lamp) for name, lamp in lamps.items()}
    return {**kept, **lit}


def lamps_of(colours: Corrections) -> dict[str, LampWave]:
    """By camera, the lamps of which frames tell."""
    return {name: each.lamp for name, each in colours.items() if each.lamp is not None and not each.lamp_amplitude}


def turn(yaw: float, pitch: float, roll: float) -> NDArray[np.float64]:
    """Ry(yaw) Rx(pitch) Rz(roll), radians; (3, 3), written out so that no BLAS decides the last bits."""
    (cy, sy), (cp, sp), (cr, sr) = ((math.cos(angle), math.sin(angle)) for angle in (yaw, pitch, roll))
    return np.array(
        [
            [cy * cr + sy * sp * sr, sy * sp * cr - cy * sr, sy * cp],
            [cp * sr, cp * cr, -sp],
            [cy * sp * sr - sy * cr, sy * sr + cy * sp * cr, cy * cp],
        ]
    )


def write_corrections(corrections: Corrections, corrected: CorrectedCameras) -> bytes:
    """The block of a frame; cameras that ``corrections`` lacks get zeros. Raises ValueError for a number too large."""
    numbers = [
        getattr(corrections.get(name, Correction()), field)
        for effect, fields in EFFECT_FIELDS.items()
        for name in getattr(corrected, effect)
        for field in fields
    ]
    if not all(-LARGEST - 1 <= number <= LARGEST for number in numbers):
        raise ValueError(f"a correction is beyond {LARGEST} steps")
    return struct.pack(f"<{len(numbers)}h", *numbers)


def read_corrections(cursor: Cursor, corrected: CorrectedCameras) -> Corrections:
    """The block that a frame's payload begins with; raises StreamError "bad-payload" when the payload is shorter."""
    size = corrected.block_bytes
    numbers = iter(struct.unpack(f"<{size // 2}h", cursor.take(size)))
    corrections: dict[str, Correction] = {}
    for effect, fields in EFFECT_FIELDS.items():
        for name in getattr(corrected, effect):
            coded = {field: next(numbers) for field in fields}
            corrections[name] = replace(corrections.get(name, Correction()), **coded)
    return corrections
