"""Which cameras are corrected, and for what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class CorrectionSettings:
    """The cameras whose faults are taken out of their pictures, by name; every one named is a little slower.

    ``exposure``, ``white_balance``: cameras in which these drift. ``shake``: cameras that turn about their centre.
    ``lens``: what the calibration does not know of a lens, as OpenCV's k1, by camera.
    ``match_colours``: whether constant differences of exposure and white balance between all cameras are taken out.
    """

    exposure: tuple[str, ...] = ()
    white_balance: tuple[str, ...] = ()
    shake: tuple[str, ...] = ()
    lens: Mapping[str, float] = field(default_factory=dict)
    match_colours: bool = False
