"""Whether a scene that an earlier encode made is of these pictures: other footage would be gone on with unnoticed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from decogs.formats.splats import FloatArray

from .ingest import View

_POOR = 10 ** (-20 / 10)
"""Mean square error of 20 dB: what is better than that is no other footage, however plain the pictures are."""
_UNLIKE = 1.5
"""Of a picture's variance: two that have nothing in common miss each other by about twice as much, a scene that is
hardly trained by once."""


def strange_cameras(views: Sequence[View], pictures: Sequence[FloatArray], shown: Sequence[FloatArray]) -> list[str]:
    """Cameras whose pictures (3, H, W) ``shown`` misses clearly: by more than one plain colour would, and 20 dB."""
    found = []
    for view, picture, rendered in zip(views, pictures, shown, strict=True):
        recorded = np.ones(picture.shape[1:], bool) if view.valid is None else view.valid > 0
        target = picture[:, recorded].astype(np.float64)
        missed = float(np.mean((np.clip(rendered[:, recorded], 0, 1) - target) ** 2)) if recorded.any() else 0.0
        if missed > max(_POOR, _UNLIKE * float(np.mean(target.var(axis=1)))):
            found.append(view.camera.name)
    return found


def warning_of(source: str, frame: int, cameras: Sequence[str]) -> str:
    """One line for the user; ``source``: where the scene comes from."""
    more = f" and {len(cameras) - 1} more cameras" if len(cameras) > 1 else ""
    return (
        f"{source}: its scene shows nothing of what {cameras[0]}{more} recorded in frame {frame}; "
        "is it of other footage than the rig's?"
    )
