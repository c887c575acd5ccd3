"""Lenses as OpenCV computes with them: projection with its derivatives, and one camera's lens from views of a board.

OpenCV counts pixels from the centre of the first one, this project from its corner: half a pixel is taken off and put
back here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, DistortionModel

from .boards import BoardView
from .features import F64

F32 = NDArray[np.float32]

_KINDS: tuple[tuple[DistortionModel, bool], ...] = (
    ("none", False),
    ("opencv", False),
    ("opencv", True),
    ("fisheye", True),
)
"""From the simplest on, and whether the principal point is free (with two focal lengths)."""
_CLEARLY_LESS = 0.95
"""A lens with more coefficients has to fit views that it was not fitted to better by so much."""
_FISHEYE_FLAGS = sum(
    getattr(cv2, f"CALIB_{name}", getattr(cv2.fisheye, f"CALIB_{name}", 0))
    for name in ("RECOMPUTE_EXTRINSIC", "FIX_SKEW")
)
"""OpenCV 5 has moved them."""
MIN_VIEWS = 3
"""Views of a board that give a focal length: two of one tilt give none, and one may be wrong."""
_LEAST_TILT = 5.0
"""Degrees that the board is tilted in some view. By less, the covariance means nothing: a focal length that is eight
times too long fits as well, and looks certain."""
_MAX_VIEWS = 60
"""That a camera's lens is fitted to; its time grows by their square."""


@dataclass(frozen=True)
class Lens:
    """Intrinsics in OpenCV's pixels: focal lengths, principal point, distortion coefficients (4,), zeros for "none"."""

    kind: DistortionModel
    focal: tuple[float, float]
    centre: tuple[float, float]
    distortion: tuple[float, ...]

    @property
    def matrix(self) -> F64:
        """The camera matrix (3, 3)."""
        return np.array([[self.focal[0], 0, self.centre[0]], [0, self.focal[1], self.centre[1]], [0, 0, 1.0]])

    def project(self, rotation: F64, translation: F64, points: F64) -> tuple[F64, F64]:
        """Pixels (N, 2) of points (N, 3), and derivatives (N, 2, 6) by rotation vector and translation."""
        pose = rotation.reshape(3, 1), translation.reshape(3, 1)
        coefficients = np.array(self.distortion)
        if self.kind == "fisheye":
            pixels, jacobian = cv2.fisheye.projectPoints(points.reshape(-1, 1, 3), *pose, self.matrix, coefficients)
            jacobian = jacobian[:, 8:14]  # before: focal lengths, centre, coefficients; after: skew
        else:
            pixels, jacobian = cv2.projectPoints(points, *pose, self.matrix, coefficients)
            jacobian = jacobian[:, :6]
        derivatives = np.asarray(jacobian, np.float64).reshape(len(points), 2, 6)
        return np.asarray(pixels, np.float64).reshape(-1, 2), derivatives

    def pose(self, points: F64, pixels: F64) -> tuple[F64, F64] | None:
        """Rotation vector and translation (3,) of a flat board from its points (N, 3) in one picture; or None."""
        image = pixels.reshape(-1, 1, 2)
        if self.kind == "fisheye":
            rays = cv2.fisheye.undistortPoints(image, self.matrix, np.array(self.distortion))
        else:
            rays = cv2.undistortPoints(image, self.matrix, np.array(self.distortion))
        if not np.isfinite(rays).all() or np.abs(rays).max() > 1e3:
            return None
        is_solved, rotation, translation = cv2.solvePnP(points, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
        if not is_solved:
            return None
        rotation, translation = cv2.solvePnPRefineLM(points, rays, np.eye(3), None, rotation, translation)
        return np.asarray(rotation, np.float64).ravel(), np.asarray(translation, np.float64).ravel()

    def camera(self, name: str, size: tuple[int, int], pose: F64) -> Camera:
        """As a camera of this project, with a world-to-camera pose (4, 4)."""
        distortion = () if self.kind == "none" else self.distortion
        centre = self.centre[0] + 0.5, self.centre[1] + 0.5
        return Camera(name, *size, *self.focal, *centre, pose, self.kind, distortion)


def lens_from_board(views: Sequence[BoardView], corners: F64, size: tuple[int, int]) -> Lens | None:
    """A camera's lens from views of a board; None where they are too few or all alike.

    Every other view is left out of the fit, or each in turn of a few, and the kind taken that fits these best with only
    the board's pose found for them; more coefficients have to be clearly better. The lens is then fitted to all. Three
    views: no distortion.
    """
    chosen = _spread(views)
    if len(chosen) < MIN_VIEWS:
        return None
    if len(chosen) == MIN_VIEWS:
        return _fitted(_KINDS[0], chosen, corners, size)
    best, least = _KINDS[0], np.inf
    for kind in _KINDS:
        error = _held_out_error(kind, chosen, corners, size)
        if error < _CLEARLY_LESS * least:
            best, least = kind, error
    return _fitted(best, chosen, corners, size)


def _held_out_error(
    kind: tuple[DistortionModel, bool], views: Sequence[BoardView], corners: F64, size: tuple[int, int]
) -> float:
    """Root mean square error, px, of views that a lens of this kind is not fitted to."""
    if len(views) < 2 * MIN_VIEWS:
        parts = [([*views[:k], *views[k + 1 :]], [views[k]]) for k in range(len(views))]
    else:
        parts = [(list(views[::2]), list(views[1::2]))]
    lenses = [(_fitted(kind, fitted, corners, size), held_out) for fitted, held_out in parts]
    errors = [np.inf if lens is None else board_error(lens, held_out, corners) for lens, held_out in lenses]
    return float(np.sqrt(np.mean(np.square(errors))))


def focal_that_fits(lens: Lens, views: Sequence[BoardView], corners: F64) -> tuple[float, float]:
    """The focal length, px, of an otherwise given lens with the least error, px, over views of a board; and that error.

    Between half and twice the given one.
    """

    def error(scale: float) -> float:
        return board_error(replace(lens, focal=(scale * lens.focal[0], scale * lens.focal[1])), views, corners)

    scale = min(np.geomspace(0.5, 2, 29), key=error)
    scale = min(scale * np.geomspace(0.95, 1.05, 21), key=error)
    return float(scale * lens.focal[0]), error(scale)


def focal_deviation(views: Sequence[BoardView], corners: F64, size: tuple[int, int]) -> float:
    """Standard deviation of the focal length that views of a board give, as its share, with the principal point free.

    From the covariance of the fit (`cv2.calibrateCameraExtended`); infinite where there is no fit, or no view
    is tilted.
    """
    points, pixels = _board_points(_spread(views), corners)
    start = np.array([[1.0, 0, (size[0] - 1) / 2], [0, 1, (size[1] - 1) / 2], [0, 0, 1]])  # its ratio counts
    flags = cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_ASPECT_RATIO
    try:
        _, matrix, _, rotations, _, deviations, *_ = cv2.calibrateCameraExtended(
            points, pixels, size, start, np.zeros(4), flags=flags
        )
    except cv2.error:
        return float(np.inf)
    if max(np.degrees(np.arccos(abs(cv2.Rodrigues(rotation)[0][2, 2]))) for rotation in rotations) < _LEAST_TILT:
        return float(np.inf)
    share = float(deviations[:2].max() / matrix[0, 0])
    return share if np.isfinite(share) and share > 0 else float(np.inf)


def _board_points(views: Sequence[BoardView], corners: F64) -> tuple[list[F32], list[F32]]:
    """Points on the board and pixels of each view, as OpenCV takes them: in a row, or OpenCV 5 fits no fisheye."""
    points = [corners[view.numbers].astype(np.float32).reshape(1, -1, 3) for view in views]
    return points, [(view.pixels - 0.5).astype(np.float32).reshape(1, -1, 2) for view in views]


def _spread(views: Sequence[BoardView]) -> list[BoardView]:
    """At most so many views, evenly over the take."""
    indices = np.linspace(0, len(views) - 1, min(len(views), _MAX_VIEWS)).round().astype(int)
    return [views[index] for index in indices]


def _fitted(
    choice: tuple[DistortionModel, bool], views: Sequence[BoardView], corners: F64, size: tuple[int, int]
) -> Lens | None:
    kind, free = choice
    points, pixels = _board_points(views, corners)
    try:
        if kind == "fisheye":
            flags = _FISHEYE_FLAGS
            _, matrix, distortion, _, _ = cv2.fisheye.calibrate(
                points, pixels, size, np.eye(3), np.zeros(4), flags=flags
            )
        else:
            flags = cv2.CALIB_FIX_K3
            if kind == "none":
                flags |= cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2
            if not free:
                flags |= cv2.CALIB_FIX_PRINCIPAL_POINT | cv2.CALIB_FIX_ASPECT_RATIO | cv2.CALIB_ZERO_TANGENT_DIST
            start = np.array([[1.0, 0, (size[0] - 1) / 2], [0, 1, (size[1] - 1) / 2], [0, 0, 1]])  # its ratio counts
            _, matrix, distortion, _, _ = cv2.calibrateCamera(points, pixels, size, start, None, flags=flags)
    except cv2.error:
        return None
    if not (np.isfinite(matrix).all() and np.isfinite(distortion).all() and matrix[0, 0] > 0):
        return None
    centre = float(matrix[0, 2]), float(matrix[1, 2])
    return Lens(kind, (float(matrix[0, 0]), float(matrix[1, 1])), centre, tuple(distortion.ravel()[:4].tolist()))


def board_error(lens: Lens, views: Sequence[BoardView], corners: F64) -> float:
    """Root mean square distance, px, of views from a lens, with the board's pose found for each."""
    squares = []
    for view in views:
        points, pixels = corners[view.numbers], view.pixels - 0.5
        pose = lens.pose(points, pixels)
        if pose is None:
            return float(np.inf)
        squares.append(((lens.project(*pose, points)[0] - pixels) ** 2).sum(axis=1))
    return float(np.sqrt(np.concatenate(squares).mean()))
