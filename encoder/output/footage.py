"""Whether a scene that an earlier encode made is of these pictures: other footage would be continued unnoticed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import FloatArray

from ..input.ingest import View
from ..parallel import side_by_side

_POOR = 10 ** (-20 / 10)
"""Mean square error of 20 dB: what is better than that is no other footage, however plain the pictures are."""
_RELATED = 0.25
"""Correlation of a rendering with a picture: nothing in common has about none, a scene that is hardly trained most."""


def strange_cameras(
    views: Sequence[View], pictures: Sequence[FloatArray], shown: Sequence[FloatArray], *, threads: int = 1
) -> list[str]:
    """Cameras whose pictures (3, H, W) ``shown`` has nothing to do with, and misses by less than 20 dB."""
    with side_by_side(threads) as each:
        strange = list(each(_is_strange, views, pictures, shown))
    return [view.camera.name for view, is_strange in zip(views, strange, strict=True) if is_strange]


def _is_strange(view: View, picture: FloatArray, rendered: FloatArray) -> bool:
    recorded = np.ones(picture.shape[1:], bool) if view.valid is None else view.valid > 0
    if not recorded.any():
        return False
    target, drawn = (values[:, recorded].astype(np.float64) for values in (picture, np.clip(rendered, 0, 1)))
    return bool(np.mean((drawn - target) ** 2) > _POOR and _correlation(drawn, target) < _RELATED)


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
