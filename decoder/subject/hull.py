"""The hull of a subject: where no view shows what is behind it instead.

Source: visual hull (Laurentini 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, in_picture, project, scale_camera
from decogs.formats.splats import FloatArray

from ..cameras.resizing import recorded_pixels, resized_plane

BoolArray = NDArray[np.bool_]

MOST_PIXELS = 250_000
"""Of a view; larger pictures are shrunk."""

_MARGIN_PIXELS = 2
"""Of the subjects' outlines, which poses and compression blur."""

_MIN_ALPHA = 0.02
"""Alpha from which a pixel may show the subject: mattes are coded with losses."""

_MIN_VIEWS = 3
"""Views that must look at a point: near a camera, a hull of few views reaches far beyond the subject."""


@dataclass(frozen=True)
class SubjectView:
    """A view's camera, and its pixels (H, W) that may show something in front of the backdrop.

    ``recorded`` (H, W): where it looks; None means everywhere. What it did not record may be anything.
    """

    camera: Camera
    subject: BoolArray
    recorded: BoolArray | None = None

    @property
    def share(self) -> float:
        """Of what it recorded, that may show something in front of the backdrop."""
        return float((self.subject if self.recorded is None else self.subject[self.recorded]).mean())


@dataclass(frozen=True)
class Hull:
    """Where something may stand: no view shows the backdrop there, and ``least`` views look there."""

    views: Sequence[SubjectView]
    least: int = 1

    @property
    def share(self) -> float:
        """Share of the pictures that shows something in front of the backdrop."""
        return float(np.mean([each.share for each in self.views]))

    def holds(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) at which enough views look, of which none shows the backdrop."""
        denied, looking = self._looked_at(xyz)
        return ~denied & (looking >= self.least)

    def denies(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) through which a view shows the backdrop."""
        return self._looked_at(xyz)[0]

    def _looked_at(self, xyz: NDArray[np.floating]) -> tuple[BoolArray, NDArray[np.int64]]:
        """The points through which a view shows the backdrop, and how many views look at each of the others."""
        denied, looking = np.zeros(len(xyz), bool), np.zeros(len(xyz), np.int64)
        rest = np.arange(len(xyz))
        for each in self.views:
            u, v, depth = project(each.camera, xyz[rest])
            inside = np.flatnonzero(in_picture(each.camera, u, v, depth))
            rows, pixels = rest[inside], (v[inside].astype(np.int64), u[inside].astype(np.int64))
            looking[rows] += 1 if each.recorded is None else each.recorded[pixels]
            denied[rows] = ~each.subject[pixels]
            rest = np.flatnonzero(~denied)  # one view is enough
        return denied, looking


def hull_of_mattes(views: Sequence[SubjectView]) -> Hull:
    """The hull of the views that ``matte_view`` makes."""
    return Hull(views, min(_MIN_VIEWS, len(views)))


def matte_view(pinhole: Camera, alpha: FloatArray, recorded: FloatArray | None) -> SubjectView:
    """The pixels that may show the subject, by its ``alpha`` and by how much of a pixel was ``recorded``, (H, W)."""
    camera = hull_camera(pinhole)
    shown = resized_plane(alpha, camera) > _MIN_ALPHA
    seen = recorded_pixels(recorded, camera)
    return SubjectView(camera, with_margin(shown | ~seen), None if recorded is None else seen)


def hull_camera(pinhole: Camera, most: int = MOST_PIXELS) -> Camera:
    """The camera with at most so many pixels."""
    return scale_camera(pinhole, min(1.0, (most / (pinhole.width * pinhole.height)) ** 0.5))


def with_margin(subject: BoolArray) -> BoolArray:
    """The pixels (H, W) of a subject and those beside its outline."""
    import cv2

    return cv2.dilate(subject.view(np.uint8), _margin()).view(np.bool_)


def without_margin(subject: BoolArray) -> BoolArray:
    """The pixels (H, W) of a subject that has a margin, with its gaps closed."""
    import cv2

    return cv2.erode(subject.view(np.uint8), _margin()).view(np.bool_)


def _margin() -> NDArray[np.uint8]:
    import cv2

    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _MARGIN_PIXELS + 1,) * 2)
    return np.asarray(kernel, np.uint8)
