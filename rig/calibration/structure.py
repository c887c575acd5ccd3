"""Cameras by structure from motion (pycolmap), from matches of their features.

Several ways are tried: incremental and global mapping, with and without distortion; then the best one's lenses with
more freedom, as far as points determine it. Which is best say matches that none was fitted to. Given lenses stay, and
are held against free ones. Everything runs on one thread from one seed, so that
the same pictures give the same bits on one machine.
"""

from __future__ import annotations

import signal
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.rigs.colmap import lens_parameters
from decogs.formats.system.extras import install

from .certainty import focal_deviations
from .features import Features
from .given import CERTAIN, Given
from .held_out import PairMatches, Score, score
from .lenses import Lens

_FIRST_FOCAL = 1.2
"""Times the picture's longer side: COLMAP's guess of a focal length."""
_MAX_ERROR_PIXELS = 2.0
"""Of a match from its epipolar line, of a point from its picture; COLMAP's 4 are for larger, unmasked pictures."""
_MIN_INLIERS = 15
_MIN_INLIER_SHARE = 0.4
"""Of a pair's matches; wrong pairs, whose features look alike, have a quarter to a half."""
_MAX_FOCAL_DEVIATION = 0.02
"""Largest standard deviation of a focal length, as its share, with which a lens counts as determined: few cameras that
look at one place do not determine a free principal point, and leave 10 % and more."""
_MIN_ANGLE = 1.5
"""Degrees between the rays to a point."""
_MAPPED_LENSES = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL")
_LENSES = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "OPENCV", "OPENCV_FISHEYE")


@dataclass(frozen=True)
class Mapped:
    """Cameras found, by their number, with the reconstruction they are from and their score; ``way`` in words.

    ``focal_errors``: how far each focal length may be off, as its share. ``misfits``: the focal lengths, px, that
    pictures say where they contradict those given.
    """

    cameras: Mapping[int, Camera]
    model: Any
    score: Score
    way: str
    focal_errors: Mapping[int, float] = field(default_factory=dict)
    misfits: Mapping[int, float] = field(default_factory=dict)

    @property
    def focal_deviation(self) -> float:
        """The cameras' median standard deviation of the focal length, as its share."""
        return float(np.median(list(self.focal_errors.values()))) / CERTAIN


@dataclass(frozen=True)
class Matched:
    """What structure from motion starts from, of each camera and pair; whether cameras of one size share a lens.

    ``given``: lenses, which stay.
    """

    names: Sequence[str]
    sizes: Sequence[tuple[int, int]]
    features: Sequence[Features]
    pairs: Sequence[PairMatches]
    shared: bool
    given: Given | None = None

    def without(self, number: int) -> Matched:
        """As if a camera's pictures had nothing in common with the others'."""
        return replace(self, pairs=[pair for pair in self.pairs if number not in (pair.first, pair.second)])

    def scored(self, model: Any, way: str) -> Mapped:
        """The model's cameras and their score."""
        cameras = {
            number: _camera(self.names[number], model.cameras[image.camera_id], image)
            for number, image in ((number - 1, model.images[number]) for number in sorted(model.images))
            if image.has_pose
        }
        return Mapped(cameras, model, score(cameras, self.features, self.pairs), way)


def require_pycolmap() -> Any:
    """The module; raises UsageError where it is not installed."""
    on_termination = signal.getsignal(signal.SIGTERM)
    try:
        import pycolmap
    except ImportError:
        raise UsageError(
            f"without a board, cameras are placed by pycolmap, which is not installed: {install('calibrate')}"
        ) from None
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, on_termination)  # pycolmap's prints a stack trace and leaves everything lying
    pycolmap.logging.minloglevel = pycolmap.logging.Level.FATAL.value
    return pycolmap


def map_cameras(matched: Matched, seed: int, on_step: Callable[[], None]) -> Mapped | None:
    """The best placement found; None where no way places two cameras."""
    candidates: list[Mapped] = []
    for lens in _MAPPED_LENSES[: 1 if matched.given else None]:
        with tempfile.TemporaryDirectory() as folder:
            database = Path(folder) / "database.db"
            _write_database(database, matched, lens, seed)
            for way, run in (("incremental", _incremental), ("global", _global)):
                models = run(database, Path(folder), seed, matched.given is None)
                candidates += [matched.scored(model, f"{way} mapping") for model in models]
                on_step()
    if not candidates:
        return None
    best = min(candidates, key=lambda mapped: mapped.score.cost)
    return _refined(best, matched) if matched.given is None else _with_lenses_of(matched.given, best, matched)


def _write_database(path: Path, matched: Matched, lens: str, seed: int) -> None:
    pycolmap = require_pycolmap()
    options = pycolmap.TwoViewGeometryOptions()
    options.min_num_inliers, options.min_inlier_ratio = _MIN_INLIERS, _MIN_INLIER_SHARE
    options.ransac.max_error, options.ransac.random_seed = _MAX_ERROR_PIXELS, seed
    database = pycolmap.Database.open(str(path))
    numbers: dict[object, int] = {}
    lenses = []
    for number, size in enumerate(matched.sizes):
        key: object = size if matched.shared else number
        if matched.given is None:
            camera = pycolmap.Camera.create_from_model_name(0, lens, _FIRST_FOCAL * max(size), *size)
        else:
            camera = _given_camera(matched.given.lenses[number], size)
        if key not in numbers:
            numbers[key] = database.write_camera(camera)
        image = pycolmap.Image()
        image.name, image.camera_id = f"{number:06d}", numbers[key]
        database.write_image(image)
        database.write_keypoints(number + 1, matched.features[number].pixels.astype(np.float32))
        lenses.append(camera)
    for pair in matched.pairs:
        if len(pair.fitted) < _MIN_INLIERS:
            continue
        sides = [(lenses[number], matched.features[number].pixels) for number in (pair.first, pair.second)]
        rows = pair.fitted.astype(np.uint32)
        geometry = pycolmap.estimate_two_view_geometry(*sides[0], *sides[1], rows, options)
        database.write_matches(pair.first + 1, pair.second + 1, rows)
        database.write_two_view_geometry(pair.first + 1, pair.second + 1, geometry)
    database.close()


def _incremental(database: Path, folder: Path, seed: int, free_lenses: bool) -> list[Any]:
    pycolmap = require_pycolmap()
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed, options.extract_colors = 1, seed, False
    options.min_model_size = 3
    options.ba_refine_focal_length = options.ba_refine_extra_params = free_lenses
    options.mapper.init_min_num_inliers, options.mapper.abs_pose_min_num_inliers = 50, _MIN_INLIERS
    options.mapper.filter_max_reproj_error = _MAX_ERROR_PIXELS
    pycolmap.set_random_seed(seed)
    return list(pycolmap.incremental_mapping(str(database), str(folder), str(folder / "incremental"), options).values())


def _global(database: Path, folder: Path, seed: int, free_lenses: bool) -> list[Any]:
    pycolmap = require_pycolmap()
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads, options.random_seed = 1, seed
    adjustment = options.mapper.bundle_adjustment
    adjustment.refine_focal_length = adjustment.refine_extra_params = free_lenses
    pycolmap.set_random_seed(seed)
    return list(pycolmap.global_mapping(str(database), str(folder), str(folder / "global"), options).values())


def _refined(mapped: Mapped, matched: Matched) -> Mapped:
    """The simplest of several lens models that is as good as any on what is held out, among those that are determined.

    A focal length may be off by what its covariance says, and by what lenses that are as good would make of it.
    """
    held, freed = ([_with_lens(mapped, matched, lens, free) for lens in _LENSES] for free in (False, True))
    determined = [one for one in (*held, *freed) if one.focal_deviation <= _MAX_FOCAL_DEVIATION] or held[:1]
    best = determined[0]
    for one in determined[1:]:
        best = one if one.score.is_clearly_better(best.score) else best
    possible = [
        *determined,
        *(one for one in held if _MAX_FOCAL_DEVIATION < one.focal_deviation <= 2 * _MAX_FOCAL_DEVIATION),
    ]
    as_good = [one.cameras for one in possible if not best.score.is_clearly_better(one.score)]
    errors = {
        number: max([error, *(abs(other[number].fx / best.cameras[number].fx - 1) for other in as_good)])
        for number, error in best.focal_errors.items()
    }
    return replace(best, focal_errors=errors)


def _with_lens(mapped: Mapped, matched: Matched, lens: str, free_centre: bool) -> Mapped:
    """The same cameras adjusted with a lens model, and how far their focal lengths may be off by their covariance."""
    model = mapped.model.__class__(mapped.model)
    for camera in model.cameras.values():
        _change_lens(camera, lens)
    _adjust(model, focal=True, bends=True, centre=free_centre)
    words = f"{mapped.way}, lens {lens.lower()}" + (", principal point free" if free_centre else "")
    deviations = focal_deviations(model, "centre" if free_centre else "lens")
    errors = {image - 1: CERTAIN * deviation for image, deviation in deviations.items()}
    return replace(matched.scored(model, words), focal_errors=errors)


def _with_lenses_of(lenses: Given, mapped: Mapped, matched: Matched) -> Mapped:
    """The same cameras adjusted with their lenses as given, and the focal lengths that would fit clearly otherwise."""
    given, freed = (mapped.model.__class__(mapped.model) for _ in range(2))
    _adjust(given, focal=False, bends=False, centre=False)
    _adjust(freed, focal=True, bends=False, centre=False)
    deviations = focal_deviations(freed, "focal")
    fixed, free = matched.scored(given, f"{mapped.way}, lenses given"), matched.scored(freed, "")
    misfits = {
        number: camera.fx
        for number, camera in free.cameras.items()
        if not lenses.fits(number, camera.fx, deviations[number + 1])
    }
    return replace(fixed, misfits=misfits)


def _adjust(model: Any, *, focal: bool, bends: bool, centre: bool) -> None:
    """Bundle adjustment with this of the lenses free, which leaves out what is far off, twice.

    The second time a residual counts by its ratio to the median one. A feature on an edge matches anywhere along the
    edge. Its residual is too small to be left out, and neighbours err alike: with equal weights such points bend the
    focal lengths of few cameras.
    """
    pycolmap = require_pycolmap()
    options = pycolmap.BundleAdjustmentOptions()
    options.print_summary = False
    options.refine_focal_length, options.refine_extra_params, options.refine_principal_point = focal, bends, centre
    options.ceres.solver_options.num_threads = 1
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.reg_image_ids():
        config.add_image(image)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    losses = pycolmap.LossFunctionType
    for options.ceres.loss_function_type in (losses.SOFT_L1, losses.CAUCHY):
        pycolmap.create_default_bundle_adjuster(options, config, model).solve()
        pycolmap.ObservationManager(model).filter_all_points3D(_MAX_ERROR_PIXELS, _MIN_ANGLE)
        options.ceres.loss_function_scale = _usual_residual(model)


def _usual_residual(model: Any) -> float:
    """The median distance of a point from where a picture shows it, pixels."""
    distances = [
        np.linalg.norm(
            model.images[seen.image_id].project_point(point.xyz)
            - model.images[seen.image_id].points2D[seen.point2D_idx].xy
        )
        for point in model.points3D.values()
        for seen in point.track.elements
    ]
    return float(np.median(distances)) if distances else 1.0


def _given_camera(lens: Lens, size: tuple[int, int]) -> Any:
    pycolmap = require_pycolmap()
    model = {"none": "PINHOLE", "opencv": "OPENCV", "fisheye": "OPENCV_FISHEYE"}[lens.kind]
    bends = () if lens.kind == "none" else lens.distortion
    if len(bends) > 4:
        model, bends = "FULL_OPENCV", (*bends, 0.0, 0.0, 0.0)[:8]
    parameters = [*lens.focal, lens.centre[0] + 0.5, lens.centre[1] + 0.5, *bends]
    camera = pycolmap.Camera.create_from_model_name(0, model, lens.focal[0], *size)
    camera.params, camera.has_prior_focal_length = parameters, True
    return camera


def _change_lens(camera: Any, lens: str) -> None:
    """Another lens model with the same focal length and principal point."""
    focal, centre = camera.mean_focal_length(), (camera.principal_point_x, camera.principal_point_y)
    radial = camera.params[3] if camera.model_name == "SIMPLE_RADIAL" else 0.0
    start = {
        "SIMPLE_PINHOLE": [focal, *centre],
        "SIMPLE_RADIAL": [focal, *centre, radial],
        "OPENCV": [focal, focal, *centre, radial, 0, 0, 0],
        "OPENCV_FISHEYE": [focal, focal, *centre, 0, 0, 0, 0],
    }
    camera.model, camera.params = getattr(require_pycolmap().CameraModelId, lens), start[lens]


def _camera(name: str, lens: Any, image: Any) -> Camera:
    (fx, fy, cx, cy), kind, distortion = lens_parameters(lens.model_name, tuple(map(float, lens.params)))
    pose = np.eye(4)
    pose[:3] = image.cam_from_world().matrix()
    if not any(distortion) and kind != "fisheye":
        kind, distortion = "none", ()
    return Camera(name, lens.width, lens.height, fx, fy, cx, cy, pose, kind, distortion)
