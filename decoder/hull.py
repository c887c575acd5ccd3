"""The hull of what stands in front of the backdrop: where no view shows the backdrop instead.

Source: visual hull (Laurentini 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, in_picture, project

from .views import BoolArray

_MARGIN_PIXELS = 2
"""Of the subjects' outlines, which poses and compression blur."""


@dataclass(frozen=True)
class SubjectView:
    """A view's camera, and its pixels (H, W) that may show something in front of the backdrop."""

    camera: Camera
    subject: BoolArray


def with_margin(subject: BoolArray) -> BoolArray:
    """The pixels (H, W) of a subject and those beside its outline."""
    size = (2 * _MARGIN_PIXELS + 1,) * 2
    return cv2.dilate(subject.view(np.uint8), cv2.getStructuringElement(cv2.MORPH_ELLIPSE, size)).view(np.bool_)


@dataclass(frozen=True)
class Hull:
    """Where something may stand: no view shows the backdrop there, and ``least`` views look there."""

    views: Sequence[SubjectView]
    least: int = 1

    @property
    def share(self) -> float:
        """Share of the pictures that shows something in front of the backdrop."""
        return float(np.mean([each.subject.mean() for each in self.views]))

    def holds(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) at which enough views look, of which none shows the backdrop."""
        held, looking = np.ones(len(xyz), bool), np.zeros(len(xyz), int)
        for each in self.views:
            u, v, depth = project(each.camera, xyz)
            here = in_picture(each.camera, u, v, depth)
            rows = np.flatnonzero(here)
            looking += here
            held[rows] &= each.subject[v[rows].astype(np.int64), u[rows].astype(np.int64)]
        return held & (looking >= self.least)
