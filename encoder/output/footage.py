"""Whether a scene that an earlier encode made is of these pictures: other footage would be continued unnoticed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray
from decogs.rig.parallel import side_by_side
from decogs.rig.pictures.ingest import View

_POOR_MSE = 10 ** (-20 / 10)
"""Mean square error of 20 dB: what is better than that is no other footage, however plain the pictures are."""
_MIN_CORRELATION = 0.25
"""Correlation of a rendering with a picture: nothing in common has about none, a scene that is hardly trained most."""
_MAX_MSE_RATIO, _LOW_MSE = 10 ** (6 / 10), 10 ** (-25 / 10)
"""Mean square error that has grown by 6 dB, and to 25 dB. From the first frame to a later one of the same footage it
grew by .4 dB at most in `workbench`; with a neighbour's pictures instead by 8 to 16, to 21 dB or less."""


@dataclass(frozen=True)
class Match:
    """How well a rendering matches a camera's picture: mean square error, and whether they have nothing in common."""

    camera: str
    error: float
    is_strange: bool

    def is_of_other_footage(self, first: float) -> bool:
        """Whether this is no picture of the scene; ``first``: the error in the stream's first frame."""
        return self.is_strange or self.error > max(_MAX_MSE_RATIO * first, _LOW_MSE)


def matches(
    views: Sequence[View], pictures: Sequence[FloatArray], rendered: Sequence[FloatArray], *, threads: int = 1
) -> list[Match]:
    """Compares the cameras' pictures (3, H, W) with the scene ``rendered`` through their views."""
    with side_by_side(threads) as each:
        return list(each(_match, views, pictures, rendered))


def _match(view: View, picture: FloatArray, rendered: FloatArray) -> Match:
    recorded = np.ones(picture.shape[1:], bool) if view.valid is None else view.valid > 0
    if not recorded.any():
        return Match(view.camera.name, 0.0, is_strange=False)
    target, drawn = (values[:, recorded].astype(np.float64) for values in (picture, np.clip(rendered, 0, 1)))
    error = float(np.mean((drawn - target) ** 2))
    return Match(
        view.camera.name, error, is_strange=error > _POOR_MSE and _correlation(drawn, target) < _MIN_CORRELATION
    )


def _correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    """Of two pictures (3, P) without each channel's mean; 0 where one of them is plain."""
    a, b = (values - values.mean(axis=1, keepdims=True) for values in (a, b))
    size = float(np.sqrt((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / size if size else 0.0


def warning_of(source: str, frame: int, cameras: Sequence[str]) -> str:
    """One line for the user; ``source``: where the scene comes from."""
    more = f" and {len(cameras) - 1} more cameras" if len(cameras) > 1 else ""
    return (
        f"{source}: the scene does not match frame {frame} of camera {cameras[0]}{more}; "
        "was it encoded from other footage?"
    )
