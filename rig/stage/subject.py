"""A subject without its background: the hull of its mattes, outside of which nothing stands."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.resizing import recorded_pixels, resized_plane
from decogs.decoder.subject.hull import BoolArray, Hull, hull_of_mattes, matte_view
from decogs.formats.splats import FloatArray, Splats, empty_splats

from ..pictures.ingest import RigFrame, View

_SOLID_ALPHA = 0.9
"""Of a pixel that shows nothing but the subject."""


@dataclass(frozen=True)
class SubjectAlone:
    """A stage of which only the subject is kept, in the ``hull`` of its mattes.

    ``solid``: of each view of the hull, the pixels (H, W) that show nothing but the subject.
    """

    hull: Hull
    solid: Sequence[BoolArray] = ()

    is_closed = True

    def in_frame(self, views: Sequence[View], frame: RigFrame, used: Sequence[int]) -> SubjectAlone:
        """The same with the hull of a later frame, from the ``used`` ones of its mattes."""
        return subject_alone([views[i] for i in used], [frame.alpha[i] for i in used])

    def backdrop(self, sh_degree: int) -> Splats:
        """No Gaussian."""
        return empty_splats(sh_degree)

    def free(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) outside the hull."""
        return ~self.hull.holds(xyz)

    def on_backdrop(self, xyz: NDArray[np.floating]) -> BoolArray:
        """No point (P, 3)."""
        return np.zeros(len(xyz), bool)

    def may_show(self, xyz: NDArray[np.floating]) -> BoolArray:
        """Points (P, 3) in the hull."""
        return self.hull.holds(xyz)

    def reach(self, xyz: NDArray[np.floating]) -> None:
        """The same steps everywhere."""


def subject_alone(views: Sequence[View], alphas: Sequence[FloatArray]) -> SubjectAlone:
    """The hull of mattes (H, W), one for each of the ``views``."""

    each = list(zip(views, alphas, strict=True))
    hull = hull_of_mattes([matte_view(view.pinhole, alpha, view.valid) for view, alpha in each])
    solid = [
        (resized_plane(alpha, seen.camera) >= _SOLID_ALPHA) & recorded_pixels(view.valid, seen.camera)
        for (view, alpha), seen in zip(each, hull.views, strict=True)
    ]
    return SubjectAlone(hull, solid)
