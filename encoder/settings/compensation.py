"""Which cameras are corrected, and for what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from .checked import Checked, Within


@dataclass(frozen=True)
class CorrectionSettings(Checked):
    """The cameras whose drift is compensated, by name; each one is a little slower."""

    exposure: tuple[str, ...] = ()  # cameras whose exposure drifts
    white_balance: tuple[str, ...] = ()  # cameras whose white balance drifts
    shake: tuple[str, ...] = ()  # cameras that rotate about their centre
    lens: Mapping[str, Annotated[float, Within(-10, 10)]] = field(default_factory=dict)  # k1 that calibration lacks
    match_colours: bool = False  # constant differences between all cameras, too
