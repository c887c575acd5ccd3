"""How certain focal lengths are that structure from motion gives: their covariance from the adjustment.

Cameras that all look at one place leave their focal lengths nearly open (Sturm's critical motions), the more so the
fewer they are and the more a lens may bend; the reprojection error does not show it. Triggs et al., "Bundle Adjustment:
A Modern Synthesis", section 9: the covariance of cameras is the inverse of their normal equations, reduced by the
points, times the residuals' variance. How far the axes are off the middle is what makes the residuals likeliest.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from decogs.formats.rigs.colmap import lens_parameters

from .features import F64, I64

_CENTRE, _MAX_CENTRE = 0.003, 0.05
"""Standard deviation of where a lens's axis meets the picture, from its middle, in widths, at least and at most. Those
of a dome and of a kitchen are off by .003 and .0045, which residuals of few cameras do not show."""
_LEAST_PIVOT = 1e-6
"""Of the normal equations' Cholesky factor, whose diagonal would be 1 if no unknown hung together with others: below,
they have no inverse in float64."""


@dataclass(frozen=True)
class _Sights:
    """What one picture sees: points' rows (N,), residuals (N, 2), and derivatives by pose, lens and point."""

    points: I64
    residuals: F64
    by_pose: F64
    by_lens: F64
    by_point: F64


Freedom = Literal["focal", "lens", "centre"]
"""What of a lens the adjustment chose: its focal length; its bends, too; its principal point, too."""


def focal_deviations(model: Any, freedom: Freedom, centre: float = _CENTRE) -> dict[int, float]:
    """Standard deviation of each image's focal length, as its share, by the image's number in a pycolmap model.

    With ``lens``, the principal point, which was held in the middle, may be off it by ``centre`` widths at least.
    Infinite where the points leave the lenses open, and for images without points.
    """
    unknown = dict.fromkeys(sorted(model.reg_image_ids()), float(np.inf))
    images = [image for image in unknown if model.images[image].num_points3D]
    if len(images) < 2:
        return unknown
    rows = {point: row for row, point in enumerate(sorted(model.points3D))}
    places = np.array([model.points3D[point].xyz for point in rows]).reshape(-1, 3)
    lenses = {image: model.cameras[model.images[image].camera_id] for image in images}
    sights = {image: _sights(model.images[image], lenses[image], rows, places, freedom) for image in images}
    columns, count = _columns(model, images, {image: sights[image].by_lens.shape[2] for image in images})
    kept = np.setdiff1d(np.arange(count), _gauge(model, images, columns))
    freedoms = 2 * sum(len(one.points) for one in sights.values()) - 3 * len(places) - len(kept)
    if freedoms <= 0:
        return unknown
    variance = sum(float((one.residuals**2).sum()) for one in sights.values()) / freedoms
    try:
        normal = _reduced(sights, columns, count, len(places)) / variance
        if freedom == "lens":
            widths = {at: lenses[image].width for image in images for at in columns[image][-2:].tolist()}
            centres, across = np.array(list(widths)), np.array(list(widths.values()), np.float64)
            normal[centres, centres] += (_off_middle(normal, kept, centres, across, centre) * across) ** -2.0
        scale = 1 / np.sqrt(np.maximum(normal.diagonal()[kept], 1e-30))
        root = np.linalg.cholesky(normal[np.ix_(kept, kept)] * scale * scale[:, None])
    except np.linalg.LinAlgError:
        return unknown
    if root.diagonal().min() < _LEAST_PIVOT:
        return unknown
    deviations = np.zeros(count)
    deviations[kept] = scale * np.sqrt((np.linalg.inv(root) ** 2).sum(axis=0))
    # What matches have in common does not average out over the images of a shared lens.
    sharing = Counter(lens.camera_id for lens in lenses.values())
    return unknown | {
        image: float(deviations[columns[image][6]] / lens.mean_focal_length() * np.sqrt(sharing[lens.camera_id]))
        for image, lens in lenses.items()
    }


def _sights(image: Any, lens: Any, rows: Mapping[int, int], places: F64, freedom: Freedom) -> _Sights:
    seen = [point for point in image.points2D if point.has_point3D()]
    points = np.array([rows[point.point3D_id] for point in seen], np.int64)
    (fx, fy, cx, cy), kind, distortion = lens_parameters(lens.model_name, tuple(map(float, lens.params)))
    pose = image.cam_from_world().matrix()
    rotation, matrix = pose[:, :3], np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    parts = cv2.Rodrigues(rotation)[0], pose[:, 3:]
    coefficients = np.array([*distortion, 0.0, 0.0, 0.0, 0.0][: max(4, len(distortion))])
    if kind == "fisheye":
        pixels, jacobian = cv2.fisheye.projectPoints(places[points].reshape(-1, 1, 3), *parts, matrix, coefficients)
        focal, centre, bends, by_rotation, by_translation, _ = np.split(jacobian, [2, 4, 8, 11, 14], axis=1)
    else:
        pixels, jacobian = cv2.projectPoints(places[points], *parts, matrix, coefficients)
        by_rotation, by_translation, focal, centre, bends = np.split(jacobian[:, :14], [3, 6, 8, 10], axis=1)
    if lens.model_name.startswith("SIMPLE"):
        focal, bends = focal.sum(axis=1, keepdims=True), bends[:, : int(lens.model_name == "SIMPLE_RADIAL")]
    by_lens = np.asarray(focal if freedom == "focal" else np.concatenate([focal, bends, centre], axis=1), np.float64)
    shape = (len(points), 2, -1)
    by_translation = by_translation.reshape(shape)
    return _Sights(
        points,
        pixels.reshape(-1, 2) - np.array([point.xy for point in seen]),
        np.concatenate([by_rotation.reshape(shape), by_translation], axis=2),
        by_lens.reshape(shape),
        by_translation @ rotation,
    )


def _columns(model: Any, images: list[int], freedoms: Mapping[int, int]) -> tuple[dict[int, I64], int]:
    """Which unknowns are each image's: six of its pose, then its lens's, which it may share; and how many in all."""
    lenses: dict[int, I64] = {}
    columns, count = {}, 0
    for image in images:
        lens = model.images[image].camera_id
        pose, count = np.arange(count, count + 6), count + 6
        if lens not in lenses:
            lenses[lens], count = np.arange(count, count + freedoms[image]), count + freedoms[image]
        columns[image] = np.concatenate([pose, lenses[lens]])
    return columns, count


def _gauge(model: Any, images: list[int], columns: Mapping[int, I64]) -> I64:
    """Unknowns that stay: the first pose, and of the second what its distance from the first shows most."""
    first, second = (model.images[image] for image in images[:2])
    apart = second.cam_from_world().rotation.matrix() @ (second.projection_center() - first.projection_center())
    return np.append(columns[images[0]][:6], columns[images[1]][3 + int(np.abs(apart).argmax())])


def _reduced(sights: Mapping[int, _Sights], columns: Mapping[int, I64], count: int, points: int) -> F64:
    """Normal equations of poses and lenses with the points solved for (Schur complement), (count + 1, count + 1).

    The last row and column are the residuals'.
    """
    count += 1
    normal, by_point, across = np.zeros((count, count)), np.zeros((points, 3, 3)), np.zeros((points, count, 3))
    for image, one in sights.items():
        derivatives = np.concatenate([one.by_pose, one.by_lens, one.residuals[:, :, None]], axis=2)
        flat, own = derivatives.reshape(-1, derivatives.shape[2]), np.append(columns[image], count - 1)
        normal[np.ix_(own, own)] += flat.T @ flat
        np.add.at(by_point, one.points, np.einsum("nij,nik->njk", one.by_point, one.by_point))
        np.add.at(across, (one.points[:, None], own), np.einsum("nij,nik->njk", derivatives, one.by_point))
    solved = np.matmul(across, np.linalg.inv(by_point))
    return np.asarray(normal - np.tensordot(solved, across, axes=((0, 2), (0, 2))))


def _off_middle(normal: F64, kept: I64, centres: I64, widths: F64, least: float) -> float:
    """How far lenses' ``centres`` are off the middle of pictures of these ``widths``: a standard deviation, in widths.

    With the other unknowns solved for, the residuals' gradient by the centres has the variance of their information
    and, where they are off, its square times the deviation's. The likeliest one is taken (empirical Bayes).
    """
    others, remaining = np.setdiff1d(kept, centres), np.append(centres, len(normal) - 1)
    scale = 1 / np.sqrt(np.maximum(normal.diagonal()[others], 1e-30))
    coupling = normal[np.ix_(others, remaining)] * scale[:, None]
    left = normal[np.ix_(remaining, remaining)] - coupling.T @ np.linalg.solve(
        normal[np.ix_(others, others)] * scale * scale[:, None], coupling
    )
    information, directions = np.linalg.eigh(left[:-1, :-1] * widths * widths[:, None])
    information = np.maximum(information, _LEAST_PIVOT * information[-1])  # a turn makes up for what all share
    gradient = directions.T @ (left[:-1, -1] * widths)
    deviations = np.geomspace(least, _MAX_CENTRE, 60)
    variances = information + (deviations[:, None] * information) ** 2
    return float(deviations[(np.log(variances) + gradient**2 / variances).sum(axis=1).argmin()])
