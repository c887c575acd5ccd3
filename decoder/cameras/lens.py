"""Lens distortion, both ways: undistorted pictures for training, re-distorted renders for a rig camera's own view.

The rasteriser knows pinhole cameras only. A picture of a distorted camera is undistorted before training sees it
(``Undistortion``); a view of a distorted camera is rendered through a pinhole wide enough to see everything its lens
sees and resampled to the camera's own pixels (``Redistortion``), so that it can be laid over the original video.

Models, in normalised coordinates (x/z, y/z), with r the undistorted radius: "opencv" (Brown-Conrady with tangential
and rational terms) and "fisheye" (Kannala-Brandt), with the coefficients in OpenCV's order. OpenCV bends; straightening
is done here, because OpenCV's own misses directions that these lenses see (DESIGN.md has figures). OpenCV counts pixels
from the centre of the first one, this project from its corner: only here is half a pixel taken off and put back.

Both models fold: beyond some radius the polynomial turns back and far directions would appear a second time inside the
picture. Directions past that radius are outside the lens's reach, not mapped.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from decogs.formats.cameras import Camera, DistortionModel, as_pinhole, is_distorted, is_wide, ray_slopes, scale_camera
from decogs.formats.errors import UsageError

F64 = NDArray[np.float64]
Maps = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_]]
PictureArray = TypeVar("PictureArray", bound=NDArray[Any])

WIDEST = 3
"""A re-distorted view is rendered at most this many times as wide and as high as the camera's own picture."""

LARGEST_AREA, LARGEST_WIDE_AREA = 2.5, 3.5
"""Pixels of a training picture, in those of the camera's own: barrel lenses need some 1.2 to 2, fisheyes up to 9. One
that is drawn in faces (``rasterise.faces``) takes less time a pixel."""

_REMAP_LIMIT = (1 << 15) - 2
"""Side of the largest picture that ``cv2.remap`` takes."""

_MARGIN = 2
"""Pixels rendered beyond the outermost sample: the footprint of cubic interpolation."""

_ROWS = 16
"""Rows mapped at a time: the temporaries stay in the cache, which is several times faster than whole pictures."""


class Lens(Protocol):
    """One lens model with its coefficients, in normalised coordinates."""

    reach: float
    """Radius of the farthest undistorted direction: past it the model turns back."""

    trusted: float
    """Radius up to which an undistorted direction is as sure as its pixel, and training takes it."""

    def undistort(self, x: F64, y: F64) -> tuple[F64, F64]:
        """The undistorted direction of a distorted point; NaN where the lens puts no direction."""
        ...


class BrownConradyLens:
    """OpenCV's standard model: radial (k1 k2 k3, rational k4 k5 k6) and tangential (p1 p2)."""

    def __init__(self, coefficients: tuple[float, ...]) -> None:
        k1, k2, p1, p2, k3, k4, k5, k6 = (*coefficients, *([0.0] * (8 - len(coefficients))))
        self._tangential = p1, p2
        self._numerator = Polynomial([1.0, k1, k2, k3]).trim()
        self._denominator = Polynomial([1.0, k4, k5, k6]).trim()
        self._slopes = self._numerator.deriv(), self._denominator.deriv()
        self.reach, self.trusted = self._radius_of_slope(0.0), self._radius_of_slope(_LEAST_SLOPE)

    def _radius_of_slope(self, slope: float) -> float:
        """Smallest radius at which the distorted radius grows no faster (or has a pole), ignoring tangential terms.

        With s = r^2 and r_d = r N(s) / D(s), dr_d/dr D^2 is (N + 2 s N') D - 2 s N D'; at 0 is the fold.
        """
        n, d, two_s = self._numerator, self._denominator, Polynomial([0.0, 2.0])
        n_slope, d_slope = self._slopes
        return math.sqrt(_first_positive_root((n + two_s * n_slope) * d - two_s * n * d_slope - slope * d * d, d))

    def _radial(self, s: F64) -> tuple[F64, F64]:
        """Radial factor R(s) and its derivative by s = r^2."""
        n_slope, d_slope = self._slopes
        below = self._denominator(s)
        value = self._numerator(s) / below
        return value, (n_slope(s) - value * d_slope(s)) / below

    def undistort(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Newton's method with the exact (symmetric) Jacobian, from the distorted point itself.

        The radial function is concave for barrel and convex for pincushion lenses; from this start Newton then walks
        monotonically to the first root, which is the one on this side of the fold.
        """
        p1, p2 = self._tangential
        u, v = x, y
        for steps_left in reversed(range(_NEWTON_STEPS + 1)):
            s, uv2 = u * u + v * v, 2 * u * v
            radial, slope = self._radial(s)
            error_u = u * radial + p1 * uv2 + p2 * (s + 2 * u * u) - x
            error_v = v * radial + p1 * (s + 2 * v * v) + p2 * uv2 - y
            missed_by = np.abs(error_u) + np.abs(error_v)
            if not steps_left or not np.any(missed_by > _CONVERGED):
                break
            uu = radial + 2 * u * u * slope + 2 * p1 * v + 6 * p2 * u
            vv = radial + 2 * v * v * slope + 6 * p1 * v + 2 * p2 * u
            off = uv2 * slope + 2 * p1 * u + 2 * p2 * v
            determinant = uu * vv - off * off
            u = u - (vv * error_u - off * error_v) / determinant
            v = v - (uu * error_v - off * error_u) / determinant
        converged = (missed_by < _SAME) & (s < self.reach**2)
        return np.where(converged, u, np.nan), np.where(converged, v, np.nan)


class FisheyeLens:
    """OpenCV's fisheye model: distorted radius = polynomial of the angle to the optical axis (k1 k2 k3 k4)."""

    def __init__(self, coefficients: tuple[float, ...]) -> None:
        k1, k2, k3, k4 = coefficients
        self._factor = Polynomial([1.0, k1, k2, k3, k4]).trim()
        self._slope = Polynomial([1.0, 3 * k1, 5 * k2, 7 * k3, 9 * k4]).trim()
        # A pinhole cannot see 90 degrees off its axis, whatever the lens can.
        self._widest_angle = min(math.sqrt(_first_positive_root(self._slope)), np.pi / 2 - 1e-3)
        self.reach = self.trusted = math.tan(self._widest_angle)

    def undistort(self, x: F64, y: F64) -> tuple[F64, F64]:
        """Newton's method on the angle alone; the direction around the axis does not change."""
        bent = np.hypot(x, y)
        angle = np.minimum(bent, self._widest_angle)
        for steps_left in reversed(range(_NEWTON_STEPS + 1)):
            square = angle * angle
            error = angle * self._factor(square) - bent
            if not steps_left or not np.any(np.abs(error) > _CONVERGED):
                break
            angle = np.clip(angle - error / self._slope(square), 0.0, self._widest_angle)
        factor = np.divide(np.tan(angle), bent, out=np.ones_like(bent), where=bent > 0)
        factor[~(np.abs(error) < _SAME)] = np.nan
        return x * factor, y * factor


_LEAST_SLOPE = 0.2
"""How fast a distorted radius grows, at least, with that of its direction, for it to be trusted: an error of the lens's
coefficients shifts directions by its inverse. Fisheyes are fitted in angles and are trusted."""

_CONVERGED = 1e-12
"""Newton stops this close to the distorted point: 1e-9 pixels at a focal length of 1000."""

_NEWTON_STEPS = 15
"""Enough right at the fold, where a step only halves the error: 1e-5 of the radius, 1e-10 of its image."""

_SAME = 1e-6
"""A direction is found when the lens puts it back this close: 0.001 pixels at a focal length of 1000."""


def with_k1(camera: Camera, k1: float) -> Camera:
    """The camera with ``k1`` added to its lens's own, also to a fisheye's, whose k1 means almost the same.

    A ray at t = tan a is put at t (1 + k1 t^2), and so turned by k1 t^3 cos^2 a = k1 a^3 (1 + a^4 / 15 + ...), where a
    fisheye has k1 a^3: a hundredth less at 35 degrees from the axis, a tenth at 60.
    """
    model: DistortionModel = "fisheye" if camera.distortion_model == "fisheye" else "opencv"
    first, *others = camera.distortion or (0.0, 0.0, 0.0, 0.0)
    return replace(camera, distortion_model=model, distortion=(first + k1, *others))


def lens_of(camera: Camera) -> Lens:
    """The lens of a distorted camera; raises UsageError when its coefficients do not fit its model."""
    model, coefficients = camera.distortion_model, tuple(float(c) for c in camera.distortion)
    counts = {"opencv": (4, 5, 8), "fisheye": (4,)}
    if len(coefficients) not in counts.get(model, ()) or not np.all(np.isfinite(coefficients)):
        raise UsageError(
            f"camera {camera.name!r}: {len(coefficients)} distortion coefficients {list(coefficients)} are no "
            f"{model!r} lens; give 4, 5 or 8 finite ones for 'opencv', 4 for 'fisheye'"
        )
    return FisheyeLens(coefficients) if model == "fisheye" else BrownConradyLens(coefficients)


def distort_pixels(camera: Camera, pixels: F64) -> F64:
    """Where points of the pinhole picture lie in the distorted one: (..., 2) to (..., 2) float64 pixels.

    Both pictures share size and intrinsics (``as_pinhole(camera)``); pixel centres at .5. NaN past the lens's reach.
    """
    if not is_distorted(camera) or not pixels.size:
        return np.array(pixels, dtype=np.float64)
    lens = lens_of(camera)
    x, y = ray_slopes(camera, pixels[..., 0], pixels[..., 1])
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 1, 3)
    in_place = np.zeros(3)  # the rays are in the camera's own axes already
    bent, _ = _opencv_model(camera).projectPoints(
        rays, in_place, in_place, _opencv_matrix(camera), np.array(camera.distortion, np.float64)
    )
    return np.where((x * x + y * y < lens.reach**2)[..., None], bent.reshape(pixels.shape) + 0.5, np.nan)


def undistort_pixels(camera: Camera, pixels: F64) -> F64:
    """Where points of the distorted picture lie in the pinhole one: (..., 2) to (..., 2); see ``distort_pixels``."""
    if not is_distorted(camera):
        return np.array(pixels, dtype=np.float64)
    return np.stack(_straightened(camera, lens_of(camera), pixels[..., 0], pixels[..., 1]), axis=-1)


class Undistortion:
    """Takes a rig camera's pictures to a pinhole camera's, for training; the maps are computed once per camera.

    ``pinhole`` is ``training_pinhole(camera)`` unless another pinhole of the same pose is given. ``valid`` (H, W) bool
    marks the pixels of the pinhole picture that were recorded; training must leave out the others, the blank ones.
    """

    def __init__(self, camera: Camera, pinhole: Camera | None = None) -> None:
        self.camera = camera
        self.pinhole = training_pinhole(camera) if pinhole is None else pinhole
        self._maps: Maps | None = None
        if is_distorted(camera) or pinhole is not None:
            self._maps = _undistortion_maps(camera, self.pinhole)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which pixels (H, W) of the pinhole picture were recorded."""
        if self._maps is None:
            return np.ones((self.pinhole.height, self.pinhole.width), dtype=np.bool_)
        return self._maps[2]

    def apply(self, picture: PictureArray) -> PictureArray:
        """The picture as the pinhole camera would have taken it, same dtype; 0 where nothing was recorded.

        An undistorted camera's picture comes back as it is, not copied.
        """
        return picture if self._maps is None else _resampled(picture, self._maps, 0)


def undistort(picture: PictureArray, camera: Camera) -> tuple[PictureArray, NDArray[np.bool_]]:
    """One picture of ``camera`` as its ``training_pinhole`` would have taken it, and which of its pixels were recorded.

    For more than one picture of a camera keep an ``Undistortion``: its maps cost as much as several pictures.
    """
    plan = Undistortion(camera)
    return plan.apply(picture), plan.valid


class Redistortion:
    """Takes renders of a wide pinhole camera to a rig camera's own size and geometry, its lens distortion re-applied.

    Render ``render_camera``, then ``apply``. The pinhole has the camera's pose and focal lengths (so that splats keep
    the size in pixels they were trained at), its pixel grid shifted by whole pixels, and just the size that the lens
    needs, at most ``WIDEST`` times the camera's in each direction; what a stronger lens sees beyond stays background.
    An undistorted camera is rendered as it is: ``apply`` returns its argument itself.
    """

    def __init__(self, camera: Camera) -> None:
        self.camera = camera
        if not is_distorted(camera):
            self.render_camera, self._maps = as_pinhole(camera), None
            return
        lens_of(camera)
        plan = _redistortion(
            camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.distortion_model,
            tuple(camera.distortion),
        )  # fmt: skip
        self.render_camera = _shifted(camera, plan.window)
        self._maps = plan.maps

    @property
    def is_identity(self) -> bool:
        """Whether ``apply`` returns its argument itself."""
        return self._maps is None

    @property
    def covered(self) -> NDArray[np.bool_]:
        """(H, W): pixels of the camera's picture that the render reaches; False where its calibrated lens folds."""
        if self._maps is None:
            return np.ones((self.camera.height, self.camera.width), dtype=np.bool_)
        return self._maps[2]

    def apply(self, image: PictureArray, *, outside: Any = 0.0, nearest: bool = False) -> PictureArray:
        """(h, w) or (h, w, C) of ``render_camera`` to (H, W) or (H, W, C) of ``camera``; same dtype.

        ``outside`` (a number, or one per channel) fills pixels that no rendered pixel reaches. ``nearest`` for values
        that must not be mixed across an edge, such as depth.
        """
        return image if self._maps is None else _resampled(image, self._maps, outside, nearest=nearest)


def covering_pinhole(camera: Camera) -> Camera:
    """A pinhole with the camera's pose and focal lengths that sees all of its distorted picture (to ``WIDEST``)."""
    return Redistortion(camera).render_camera


def training_pinhole(camera: Camera) -> Camera:
    """The pinhole through which training sees the camera: it covers all that was recorded (to ``WIDEST``).

    What its lens is not ``trusted`` to show is left out. It has the camera's focal lengths, so that the middle keeps
    its detail, unless it is then over ``LARGEST_AREA`` times as large as the camera's picture: it is scaled down to
    that, or ``LARGEST_WIDE_AREA``. An undistorted camera's is its own.
    """
    if not is_distorted(camera):
        return as_pinhole(camera)
    covering = _trusted_part(covering_pinhole(camera), lens_of(camera).trusted)
    most = (LARGEST_WIDE_AREA if is_wide(covering) else LARGEST_AREA) * camera.width * camera.height
    return scale_camera(covering, min(1.0, (most / (covering.width * covering.height)) ** 0.5))


def _trusted_part(pinhole: Camera, radius: float) -> Camera:
    """The whole pixels of the pinhole around its directions up to a ``radius``."""
    across, down = radius * pinhole.fx, radius * pinhole.fy
    left, top = (math.floor(max(0.0, first)) for first in (pinhole.cx - across, pinhole.cy - down))
    right = math.ceil(min(float(pinhole.width), pinhole.cx + across))
    bottom = math.ceil(min(float(pinhole.height), pinhole.cy + down))
    return _shifted(pinhole, _Window(left, top, right, bottom))


class _Window(NamedTuple):
    """Whole pixels of the pinhole's image plane, in the coordinates of ``as_pinhole(camera)``: half-open ranges."""

    left: int
    top: int
    right: int
    bottom: int


class _Plan(NamedTuple):
    window: _Window
    maps: Maps


@lru_cache(maxsize=4)
def _redistortion(
    width: int, height: int, fx: float, fy: float, cx: float, cy: float, model: Any, distortion: tuple[float, ...]
) -> _Plan:
    """Window to render and maps into it, cached by intrinsics (poses do not matter): a preview asks every frame."""
    camera = Camera("", width, height, fx, fy, cx, cy, np.eye(4), model, distortion)
    lens = lens_of(camera)
    u, v = np.empty((height, width)), np.empty((height, width))
    for first in range(0, height, _ROWS):
        rows = slice(first, min(first + _ROWS, height))
        centres = np.meshgrid(np.arange(width) + 0.5, np.arange(rows.start, rows.stop) + 0.5)
        u[rows], v[rows] = _straightened(camera, lens, *centres)
    (left, right), (top, bottom) = _range(u, width), _range(v, height)
    u -= left + 0.5
    v -= top + 0.5
    inside = _within(u, v, right - left, bottom - top)
    u[~inside] = v[~inside] = 0.0
    return _Plan(_Window(left, top, right, bottom), (u.astype(np.float32), v.astype(np.float32), inside))


def _range(positions: F64, size: int) -> tuple[int, int]:
    """Whole pixels that hold every finite position with its interpolation margin, at most WIDEST pictures wide."""
    finite = positions[np.isfinite(positions)]
    if not finite.size:
        return 0, size
    spare = min((WIDEST - 1) * size, _REMAP_LIMIT - size) // 2
    first = max(float(np.floor(finite.min())) - _MARGIN, -spare)
    last = min(float(np.ceil(finite.max())) + _MARGIN, size + spare)
    return (int(first), int(last)) if first < last else (0, size)


def _shifted(camera: Camera, window: _Window) -> Camera:
    return replace(
        as_pinhole(camera),
        width=window.right - window.left,
        height=window.bottom - window.top,
        cx=camera.cx - window.left,
        cy=camera.cy - window.top,
    )


def _undistortion_maps(camera: Camera, pinhole: Camera) -> Maps:
    """Where each pixel of ``pinhole`` was recorded by ``camera``."""
    import cv2

    distorted = is_distorted(camera)
    trusted = lens_of(camera).trusted if distorted else math.inf
    u, v = _opencv_model(camera).initUndistortRectifyMap(
        _opencv_matrix(camera),
        np.array(camera.distortion, np.float64) if distorted else np.zeros(4),
        np.eye(3),
        _opencv_matrix(pinhole),
        (pinhole.width, pinhole.height),
        cv2.CV_32FC1,
    )
    x, y = ray_slopes(pinhole, np.arange(pinhole.width) + 0.5, np.arange(pinhole.height) + 0.5)
    inside = _within(u, v, camera.width, camera.height) & (x * x + (y * y)[:, None] < trusted**2)
    u[~inside] = v[~inside] = 0.0
    return u, v, inside


def _opencv_model(camera: Camera) -> Any:
    """The part of OpenCV that has the functions of the camera's model."""
    import cv2

    return cv2.fisheye if camera.distortion_model == "fisheye" else cv2


def _opencv_matrix(camera: Camera) -> F64:
    """The intrinsics, for pixels counted from the centre of the first one."""
    return np.array([[camera.fx, 0.0, camera.cx - 0.5], [0.0, camera.fy, camera.cy - 0.5], [0.0, 0.0, 1.0]])


def _straightened(camera: Camera, lens: Lens, u: F64, v: F64) -> tuple[F64, F64]:
    """Pixels of the pinhole picture that see what the distorted one has at u, v; NaN where the lens puts nothing."""
    with np.errstate(all="ignore"):
        x, y = lens.undistort(*ray_slopes(camera, u, v))
        return x * camera.fx + camera.cx, y * camera.fy + camera.cy


def _within(u: NDArray[Any], v: NDArray[Any], width: int, height: int) -> NDArray[np.bool_]:
    """Whether positions, from the centre of the first pixel, are inside the picture (False for NaN)."""
    with np.errstate(invalid="ignore"):
        return np.asarray((u >= -0.5) & (u <= width - 0.5) & (v >= -0.5) & (v <= height - 0.5))


def _resampled(image: PictureArray, maps: Maps, outside: Any, *, nearest: bool = False) -> PictureArray:
    """Cubic interpolation: sharper than linear by decibels, four times as fast as Lanczos and less ringing (tests)."""
    import cv2

    u, v, inside = maps
    how = cv2.INTER_NEAREST if nearest else cv2.INTER_CUBIC
    result: Any = cv2.remap(image, u, v, interpolation=how, borderMode=cv2.BORDER_REPLICATE)
    if not inside.all():
        result[~inside] = outside
    return result  # type: ignore[no-any-return]


def _first_positive_root(*polynomials: Polynomial) -> float:
    """Smallest real root above zero of any of them; infinite when there is none."""
    roots = np.concatenate([p.trim().roots() for p in polynomials])
    real = roots.real[(np.abs(roots.imag) <= 1e-9 * np.abs(roots.real)) & (roots.real > 0)]
    return float(real.min()) if real.size else float("inf")
