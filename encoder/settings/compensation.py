"""Which cameras are corrected, and for what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class CorrectionSettings:
    """The cameras whose faults are taken out of their pictures, by name; every one named is a little slower.

    ``exposure``, ``white_balance``: cameras in which these drift. ``shake``: cameras that turn about their centre.
    ``lens``: what the calibration does not know of a lens, as OpenCV's k1, by camera.
    """

    exposure: tuple[str, ...] = ()
    white_balance: tuple[str, ...] = ()
    shake: tuple[str, ...] = ()
    lens: Mapping[str, float] = field(default_factory=dict)
