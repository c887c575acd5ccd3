"""Benefit of a correction: how much nearer the training pictures are to the trained scene with it than without.

A right correction brings a camera's picture nearer to the trained scene, which agrees with the other cameras. A wrong
one removes the scene's own light from a picture, and so from the scene. After every frame, two pictures are compared
with the scene: with the correction, and with the first frame's instead. Changed and unchanged pixels count separately.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

F64 = NDArray[np.float64]

_GRID_PIXELS = 40_000
_MAX_ERROR = 25 / 255
"""Error beyond which all count alike: pixels that training has not followed give no evidence."""
_SUMS_DECAY = 0.9
"""Share of earlier sums that remains a frame later: some ten frames decide."""
_MIN_FRAMES = 2
"""Frames needed for a decision: the first one is trained without the alternative."""
_BLOCK_PIXELS = 8
"""Pixels across of one observation: where training has not followed, whole patches are wrong."""
_MIN_DEVIATIONS = 4.0
"""Standard deviations of the mean by which a loss counts."""
_ERROR_TOLERANCE = 0.01
"""Share of the error by which a loss counts: a smaller one is the scene's own error over very many pixels."""


@dataclass(frozen=True)
class Benefit:
    """Gain of one correction of one camera over the frames so far, in blocks, on unchanged and on changed pixels.

    Arrays (2,): sums of the ``gained`` squared error, of its ``squares`` and of the ``error`` without the correction,
    over so many ``blocks``.
    """

    gained: F64 = field(default_factory=lambda: np.zeros(2))
    squares: F64 = field(default_factory=lambda: np.zeros(2))
    error: F64 = field(default_factory=lambda: np.zeros(2))
    blocks: F64 = field(default_factory=lambda: np.zeros(2))
    frames: int = 0

    def update(
        self, corrected: FloatArray, left: FloatArray, rendered: FloatArray, changed: NDArray[np.bool_]
    ) -> Benefit:
        """With a frame's picture with the correction, the one without, and the scene, all (3, H, W).

        ``changed`` (H, W): where the picture changed.
        """
        mine, others = (
            np.square(np.minimum(np.abs(picture - rendered), _MAX_ERROR), dtype=np.float64).sum(axis=0)
            for picture in (corrected, left)
        )
        sums = []
        for where in (~changed, changed):
            occupied = _block_sums(where.astype(np.float64)) > 0
            gains = _block_sums(np.where(where, others - mine, 0))[occupied]
            sums.append((gains.sum(), np.square(gains).sum(), float(others[where].sum()), len(gains)))
        sums_before = (self.gained, self.squares, self.error, self.blocks)
        seen = (_SUMS_DECAY * old + new for old, new in zip(sums_before, np.transpose(sums), strict=True))
        gained, squares, error, blocks = seen
        return Benefit(gained, squares, error, blocks, self.frames + 1)

    @property
    def pays(self) -> bool:
        """Whether it made neither kind of pixels significantly worse."""
        surely = self.gained < -_MIN_DEVIATIONS * np.sqrt(self.squares)
        clearly = self.gained < -_ERROR_TOLERANCE * self.error
        return self.frames < _MIN_FRAMES or not bool((surely & clearly).any())


def _block_sums(values: F64) -> F64:
    """Sums of ``values`` (H, W) over blocks, in any order; what is left over at the edges is dropped."""
    rows, columns = (size // _BLOCK_PIXELS for size in values.shape)
    whole = values[: rows * _BLOCK_PIXELS, : columns * _BLOCK_PIXELS]
    return np.asarray(whole.reshape(rows, _BLOCK_PIXELS, columns, _BLOCK_PIXELS).sum(axis=(1, 3)).ravel())


def on_grid(picture: NDArray[Any], pixels: int = _GRID_PIXELS) -> NDArray[Any]:
    """The picture (..., H, W) on a regular grid of about so many of its ``pixels``."""
    step = max(1, round(np.sqrt(picture.shape[-2] * picture.shape[-1] / pixels)))
    return picture[..., ::step, ::step]
