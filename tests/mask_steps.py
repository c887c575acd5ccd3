"""The masks of a stream's frames, one after the other, as `decogs.encoder.frame` makes them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decogs.encoder.change.masks import FrameMask, MaskMemory
from decogs.encoder.settings.frame import MaskSettings

Pictures = Sequence[np.ndarray]


class MaskSteps:
    """``memory`` is that before the next frame; ``pictures`` are the first frame's."""

    def __init__(self, pictures: Pictures, settings: MaskSettings) -> None:
        self.memory, self.settings = MaskMemory.begin(pictures), settings

    def masks(self, pictures: Pictures) -> list[FrameMask]:
        changes = self.memory.pixel_changes(pictures, self.settings)
        return self.memory.masks(pictures, changes, self.settings)

    def trained(self, pictures: Pictures, masks: Sequence[FrameMask], *, moved: bool) -> None:
        self.memory = self.memory.trained(pictures, masks, moved=moved)

    def passed(self, pictures: Pictures) -> None:
        self.memory = self.memory.advance(pictures, [], self.settings)
