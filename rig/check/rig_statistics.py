"""Statistics of a rig: small pictures of the training cameras, and the measurements that effects share.

One pass over the frames; held-out cameras are never opened. Pictures are small and 8-bit, so that a clip fits into
MAX_BYTES. Of a longer clip every n-th frame is analysed; the others are skipped.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.lens import Undistortion
from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.errors import RigError, UsageError
from decogs.formats.pictures.reading import Picture
from decogs.formats.rigs import Rig, read_frames
from decogs.formats.system.callbacks import OnProgress

from ..parallel import Ahead, Each, side_by_side
from ..pictures.ingest import RigFrame, View, check_held_out, display_referred
from ..pictures.noise import picture_noise
from ..stage.stage import BackdropStage, PlainStage, find_stage
from .lamps import Lamps, find_lamps, hides_lamps, without_lamps
from .light import Light, Mismatch, light_at, light_overall, mismatch, own_light, shared_points
from .matches import Matches, find_matches
from .moving import moves_through
from .recordings import BANDS, Recordings, detail, find_lost
from .registration import CameraPath, camera_path

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
T = TypeVar("T")

MAX_PIXELS = 352 * 264
"""Size of analysed pictures, in pixels; smaller ones stay as they are."""

MAX_BYTES = 256 << 20
"""Memory for the pictures of all cameras; a clip that needs more is thinned to every n-th frame."""

MAX_NOISE_FRAMES = 8
"""Frames whose noise is measured: a sensor's noise lasts, and one picture gives it to a few per cent."""


@dataclass(frozen=True)
class RigStatistics:
    """Pictures of a rig's training cameras and the measurements on them.

    ``cameras`` at the analysed size (lens included), ``scales`` that size over the rig's. ``frames``: the rig's
    numbers of the analysed frames, every ``step``-th. ``pictures``: per camera (F, H, W, 3) uint8, display-referred.
    ``noise`` (cameras, F): standard deviation of the difference of successive pictures over sqrt 2, in 8-bit levels of
    full-size pixels. ``recordings``: which pictures are lost; ``details`` (cameras, BANDS): of the first pictures, at
    full size. ``moving``: whether a camera moves through the scene. ``backdrop``: the plain stage or room of the first
    frame, seen in these pictures; None where there is neither. ``damage``: why the first picture that cannot be read is
    none, by camera. ``readouts``: seconds from the first row to the last, as the rig's files or lamps tell, NaN where
    unknown. ``rate``: frames of the rig in a second; None where unknown. ``lamps``: those that flicker in a camera's
    recording, None where it tells nothing; where they surely do, ``pictures`` are in their mean light.
    """

    cameras: tuple[Camera, ...]
    scales: tuple[float, ...]
    frames: tuple[int, ...]
    step: int
    pictures: tuple[U8, ...]
    noise: F64
    light: Light
    mismatch: Mismatch
    paths: tuple[CameraPath, ...]
    matches: Matches
    recordings: Recordings
    details: F64
    moving: tuple[bool, ...]
    backdrop: BackdropStage | None = None
    damage: Mapping[str, str] = field(default_factory=dict)
    readouts: tuple[float, ...] = ()
    rate: float | None = None
    lamps: tuple[Lamps | None, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the analysed cameras, in the rig's order."""
        return tuple(camera.name for camera in self.cameras)

    @property
    def stage(self) -> PlainStage | None:
        """The plain stage, whose floor and walls show how cameras differ."""
        return self.backdrop if isinstance(self.backdrop, PlainStage) else None


def gather_statistics(
    rig: Rig,
    *,
    holdout: Sequence[str] = (),
    frames: range | None = None,
    threads: int = 0,
    on_step: OnProgress = lambda done, total: None,
    max_bytes: int = MAX_BYTES,
) -> RigStatistics:
    """Measures the frames (default: all) of every camera except the held-out ones.

    The result does not depend on ``threads`` (0: all processors). ``on_step`` is called with steps done and in all.
    Raises UsageError for cameras or frames the rig does not have, RigError for a first frame that cannot be read. A
    later picture that cannot be read is left out.
    """
    cameras, scales = _small_cameras(rig, holdout)
    span = range(rig.frame_count) if frames is None else frames
    rate = None if rig.timeline.rate is None else float(rig.timeline.rate)
    chosen = _thin(span, cameras, max_bytes, rate)
    steps = _Steps(len(chosen) + 2 * len(cameras), on_step)
    names, unread = [camera.name for camera in cameras], np.zeros((len(cameras), len(chosen)), bool)
    damage: dict[str, str] = {}

    def lose(index: int, name: str, error: RigError) -> None:
        if index == chosen[0]:
            raise error
        unread[names.index(name), chosen.index(index)] = True
        damage.setdefault(name, str(error))

    with side_by_side(threads) as each:
        read = read_frames(rig, chosen[0], chosen[-1] + 1, step=chosen.step, names=names, on_lost=lose)
        recorded = _repeated(read, unread)
        pictures, noise, details = _read(recorded if threads == 1 else Ahead(recorded), cameras, chosen, each, steps)
        lamps = list(each(lambda own: find_lamps(own, chosen, rate), pictures))
        pictures = list(
            each(lambda own, camera, found: _steady(own, chosen, rate, camera, found), pictures, cameras, lamps)
        )
        matches = find_matches(cameras, [own[0] for own in pictures], each)
        backdrop = _backdrop(cameras, [own[0] for own in pictures])
        points = shared_points(cameras, matches, backdrop if isinstance(backdrop, PlainStage) else None)
        pixels = [points.pixels_of(row) for row in range(len(cameras))]
        lights = [steps.count(of_camera) for of_camera in each(light_at, pictures, pixels)]
        light = own_light(points, lights, list(each(light_overall, pictures)))
        paths = [steps.count(path) for path in each(camera_path, pictures)]
        recordings = find_lost(pictures, chosen.step, unread)
        moving = tuple(each(moves_through, cameras, pictures, paths))
    return RigStatistics(
        cameras,
        scales,
        tuple(chosen),
        chosen.step,
        tuple(pictures),
        _of_resting(recordings.without_lost(noise), paths),
        light,
        mismatch(points, lights),
        tuple(paths),
        matches,
        recordings,
        details,
        moving,
        backdrop,
        damage,
        _readouts(rig, cameras, lamps),
        rate,
        tuple(lamps),
    )


def _steady(pictures: U8, frames: Sequence[int], rate: float | None, camera: Camera, lamps: Lamps | None) -> U8:
    """The pictures in the mean light of lamps that surely flicker; the very object where none do."""
    if lamps is None or rate is None or not lamps.is_sure:
        return pictures
    return without_lamps(pictures, frames, rate, camera, lamps)


def _readouts(rig: Rig, cameras: Sequence[Camera], lamps: Sequence[Lamps | None]) -> tuple[float, ...]:
    """Seconds by camera, as the rig's files tell, or lamps that surely flicker; NaN of others."""
    told = {name: float(rig.timeline.seconds_of(readout)) for name, readout in rig.timeline.readouts.items()}
    seen = (each.wave.readout if each is not None and each.is_sure else float("nan") for each in lamps)
    return tuple(told.get(camera.name, readout) for camera, readout in zip(cameras, seen, strict=True))


def _repeated(
    frames: Iterable[tuple[int, list[Picture]]], unread: NDArray[np.bool_]
) -> Iterator[tuple[int, list[Picture]]]:
    """The frames with the pictures before in place of those ``unread`` (cameras, F)."""
    before: list[Picture] = []
    for column, (index, pictures) in enumerate(frames):
        before = [before[row] if unread[row, column] else now for row, now in enumerate(pictures)]
        yield index, before


def _backdrop(cameras: Sequence[Camera], pictures: Sequence[U8]) -> BackdropStage | None:
    """The plain stage or room in the first ``pictures`` (H, W, 3) of the cameras."""
    plans = [Undistortion(camera) for camera in cameras]
    views = [View(plan.camera, plan.pinhole, plan.valid.astype(np.float32)) for plan in plans]
    straight = [display_referred(plan.apply(own)) for plan, own in zip(plans, pictures, strict=True)]
    stage = find_stage(views, RigFrame(0, [picture.transpose(2, 0, 1) for picture in straight], []))
    return stage if isinstance(stage, BackdropStage) else None


class _Steps:
    """Counts steps done, for a progress bar."""

    def __init__(self, total: int, on_step: OnProgress) -> None:
        self._done, self._total, self._on_step = 0, total, on_step

    def count(self, result: T) -> T:
        self._done += 1
        self._on_step(self._done, self._total)
        return result


def _small_cameras(rig: Rig, holdout: Sequence[str]) -> tuple[tuple[Camera, ...], tuple[float, ...]]:
    check_held_out(rig, holdout)
    kept = [camera for camera in rig.cameras if camera.name not in holdout]
    if not kept:
        raise UsageError(f"{rig.path}: every camera is held out; leave at least one")
    scales = tuple(min(1.0, math.sqrt(MAX_PIXELS / (camera.width * camera.height))) for camera in kept)
    return tuple(scale_camera(camera, scale) for camera, scale in zip(kept, scales, strict=True)), scales


def _thin(span: range, cameras: Sequence[Camera], max_bytes: int, rate: float | None) -> range:
    """Every n-th frame, two at least, so that the pictures of all cameras fit and lamps' bands wander in them."""
    frame_bytes = sum(camera.width * camera.height * 3 for camera in cameras)
    most = max(2, max_bytes // frame_bytes)
    step = math.ceil(len(span) / most)
    while rate is not None and hides_lamps(step, rate):
        step += 1
    return span[:: min(step, max(1, len(span) - 1))]


def _read(
    frames: Iterable[tuple[int, list[Picture]]], cameras: Sequence[Camera], chosen: range, each: Each, steps: _Steps
) -> tuple[list[U8], F64, F64]:
    """Small pictures of every camera, the noise (cameras, F), and the details of the first pictures."""
    pictures = [np.empty((len(chosen), camera.height, camera.width, 3), np.uint8) for camera in cameras]
    noise = np.full((len(cameras), len(chosen)), np.nan)
    before: list[F32] = []
    details = np.zeros((len(cameras), BANDS))
    noisy = _noise_columns(len(chosen))
    for column, (_, now) in enumerate(frames):
        for row, small in enumerate(each(_small, now, cameras)):
            pictures[row][column] = small
        if column == 0:
            details = np.array(list(each(detail, now)))
        sparse = list(each(_sparse, now)) if {column, column + 1} & noisy else []
        if column in noisy:
            noise[:, column] = list(each(picture_noise, before, sparse))
        before = sparse
        steps.count(None)
    return pictures, noise, details


def _noise_columns(frames: int) -> set[int]:
    """The frames whose noise is measured against the frame before, evenly spread over the clip."""
    return {int(column) for column in np.linspace(1, frames - 1, min(frames - 1, MAX_NOISE_FRAMES)).round()}


def _small(picture: Picture, camera: Camera) -> U8:
    levels = picture if picture.dtype == np.uint8 else np.rint(display_referred(picture) * 255).astype(np.uint8)
    if levels.shape[:2] != (camera.height, camera.width):
        # As floats: the same levels after rounding, in two thirds of the time that OpenCV takes for bytes.
        size = camera.width, camera.height
        resized = cv2.resize(levels.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        return np.asarray(cv2.convertScaleAbs(resized), np.uint8)
    return np.asarray(levels, np.uint8)


def _sparse(picture: Picture) -> F32:
    """Pixels on a grid, as they are: averaging them would hide the camera's noise."""
    stride = max(1, round(math.sqrt(picture.shape[0] * picture.shape[1] / MAX_PIXELS)))
    return display_referred(np.ascontiguousarray(picture[::stride, ::stride].transpose(2, 0, 1)))


def _of_resting(noise: F64, paths: Sequence[CameraPath]) -> F64:
    """The noise without that of shaking cameras, whose pictures differ by more than noise."""
    shakes = np.array([path.shakes for path in paths])
    return np.asarray(np.where(shakes[:, None], np.nan, noise))


def typical_noise(noise: F64) -> F64:
    """Each camera's median over the frames (cameras,); where it is undetermined, the median of all; 0 when none is."""
    finite = noise[np.isfinite(noise)]
    overall = float(np.median(finite)) if finite.size else 0.0
    rows = [row[np.isfinite(row)] for row in noise]
    return np.array([float(np.median(row)) if row.size else overall for row in rows])
