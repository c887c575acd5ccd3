"""Which cameras are corrected, and for what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from .checked import Checked, Within


@dataclass(frozen=True)
class CorrectionSettings(Checked):
    """The cameras whose drift is compensated, by name. Each one is a little slower.

    ``exposure``, ``white_balance``: cameras in which these drift. ``shake``: cameras that rotate about their centre.
    ``lens``: distortion that the calibration lacks, as OpenCV's k1, by camera.
    ``match_colours``: whether constant differences of exposure and white balance between cameras are compensated.
    """

    exposure: tuple[str, ...] = ()
    white_balance: tuple[str, ...] = ()
    shake: tuple[str, ...] = ()
    lens: Mapping[str, Annotated[float, Within(-10, 10)]] = field(default_factory=dict)
    match_colours: bool = False
