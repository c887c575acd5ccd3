"""Where mattes come from, as an encode is asked for them."""

from __future__ import annotations

import os
from dataclasses import dataclass

from decogs.formats.errors import UsageError

PathLike = str | os.PathLike[str]


@dataclass(frozen=True)
class MatteChoice:
    """Where the mattes of a subject come from; without any of the first three, from the pictures' own alpha.

    Raises UsageError for two ways at once. ``masks`` with ``background_plate``: the plate only unmixes edges.
    """

    masks: PathLike | None = None  # folder of white-on-black pictures or videos by camera: black must stay empty
    background_plate: PathLike | None = None  # folder with a clean picture of each camera
    key: str | None = None  # "green", "blue" or the screen's colour as "R,G,B"
    ignore: PathLike | None = None  # folder with a picture of each camera: what is black there teaches nothing
    own_masks: bool = True  # alpha in the rig's pictures counts, and masks that the calibration names

    def __post_init__(self) -> None:
        if self.key is not None and (self.masks is not None or self.background_plate is not None):
            other = "masks" if self.masks is not None else "background_plate"
            raise UsageError(f"`key`: it does not go with `{other}`; drop one of the two")
