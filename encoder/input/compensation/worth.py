"""Whether a correction pays: what the training pictures gain by it, against leaving it out.

A correction that is right brings a camera's picture nearer to what the trained scene shows, since that agrees with the
other cameras. One that takes the scene's own light out of a picture takes it away from the scene. So after every frame
both pictures, with the correction and with that of the first frame instead, are compared with the scene, apart on
pixels that changed and on those that did not.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

F64 = NDArray[np.float64]

_MOST_PIXELS = 40_000
_LARGEST = 25 / 255
"""Error beyond which all count alike: what training has not followed says nothing of a correction."""
_MEMORY = 0.9
"""Share of what was known that counts a frame later: some ten frames decide."""
_FRAMES = 2
"""Frames that must have been seen: the first one is trained on what is then left out."""
_BLOCK = 8
"""Pixels across of what counts as one observation: what training has not followed is wrong over whole patches."""
_SURE = 4.0
"""Deviations of the mean of these by which it must be a loss."""
_TOLERANCE = 0.01
"""Share of the error by which it must be one, too: less is the scene's own error, seen in very many pixels."""


@dataclass
class Worth:
    """What one correction of one camera gained in the frames so far, by blocks: on unchanged and on changed pixels.

    Arrays (2,): sums of the ``gained`` squared error, of its ``squares`` and of the ``error`` without the correction,
    over so many ``blocks``.
    """

    gained: F64 = field(default_factory=lambda: np.zeros(2))
    squares: F64 = field(default_factory=lambda: np.zeros(2))
    error: F64 = field(default_factory=lambda: np.zeros(2))
    blocks: F64 = field(default_factory=lambda: np.zeros(2))
    frames: int = 0

    def saw(self, corrected: FloatArray, left: FloatArray, shown: FloatArray, changed: NDArray[np.bool_]) -> None:
        """Takes a frame's picture with the correction, the one without, and the scene, all (3, H, W).

        ``changed`` (H, W): where the picture changed.
        """
        mine, others = (
            np.square(np.minimum(np.abs(picture - shown), _LARGEST), dtype=np.float64).sum(axis=0)
            for picture in (corrected, left)
        )
        for place, where in enumerate((~changed, changed)):
            there = _block_sums(where.astype(np.float64)) > 0
            gains = _block_sums(np.where(where, others - mine, 0))[there]
            sums = (gains.sum(), np.square(gains).sum(), float(others[where].sum()), len(gains))
            for known, seen in zip((self.gained, self.squares, self.error, self.blocks), sums, strict=True):
                known[place] = _MEMORY * known[place] + seen
        self.frames += 1

    @property
    def pays(self) -> bool:
        """Whether it made neither kind of pixels worse, as far as they tell."""
        surely = self.gained < -_SURE * np.sqrt(self.squares)
        clearly = self.gained < -_TOLERANCE * self.error
        return self.frames < _FRAMES or not bool((surely & clearly).any())


def _block_sums(values: F64) -> F64:
    """Sums of ``values`` (H, W) over blocks, in any order; what is left over at the edges is dropped."""
    rows, columns = (size // _BLOCK for size in values.shape)
    whole = values[: rows * _BLOCK, : columns * _BLOCK]
    return np.asarray(whole.reshape(rows, _BLOCK, columns, _BLOCK).sum(axis=(1, 3)).ravel())


def on_grid(picture: NDArray[Any]) -> NDArray[Any]:
    """The picture (..., H, W) on a regular grid of its pixels, many enough to tell."""
    step = max(1, round(np.sqrt(picture.shape[-2] * picture.shape[-1] / _MOST_PIXELS)))
    return picture[..., ::step, ::step]
