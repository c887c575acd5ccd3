"""Lenses that the user knows: from a calibration.json, or from any rig, by the cameras' names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from decogs.decoder.cameras.lens import lens_of
from decogs.formats.cameras import Camera, DistortionModel, is_distorted
from decogs.formats.errors import UsageError
from decogs.formats.rigs import open_recordings
from decogs.formats.rigs.calibration import calibrated_camera
from decogs.formats.rigs.fields import Fields, read_json

from .footage import Footage
from .lenses import Lens
from .written import CALIBRATION

MISFIT = 0.02
"""Of a given focal length, as its share: what pictures have to contradict by. Focal lengths that differ by as little
between takes are the same lens, focused anew."""
CERTAIN = 3.0
"""Standard deviations by which a focal length is certainly another one."""
_NAMED = 4
"""Cameras that a message names."""
_ONE_SHAPE = 0.01
"""By which the sides of two pictures may differ in proportion, and the second is the first scaled."""


@dataclass(frozen=True)
class Given:
    """Lenses of all cameras, in their pictures' pixels, and the file that they are from."""

    path: Path
    lenses: tuple[Lens, ...]

    def contradicted(self, footage: Sequence[Footage], focals: Mapping[int, float]) -> UsageError:
        """The error for cameras of which pictures say another focal length, px, by their numbers."""
        reasons = []
        for number, focal in focals.items():
            others = [other for other in focals if other != number and self.fits(other, focal)]
            like = f", as given for {footage[others[0]].name}: are their videos exchanged?" if others else ""
            name, given = footage[number].name, self.lenses[number].focal[0]
            reasons.append(f"{name}: given {given:.1f} px, found {focal:.1f} px{like}")
        more = f"; and {len(reasons) - _NAMED} more" if len(reasons) > _NAMED else ""
        return UsageError(
            f"`intrinsics` {self.path}: pictures contradict focal lengths ({'; '.join(reasons[:_NAMED])}{more}); "
            "correct the file, or calibrate without it"
        )

    def fits(self, number: int, focal: float, deviation: float = 0.0) -> bool:
        """Whether a focal length that pictures say, with its standard deviation, as its share, is the one given."""
        return abs(focal / self.lenses[number].focal[0] - 1) <= max(MISFIT, CERTAIN * deviation)


def given_lenses(path: Path, footage: Sequence[Footage]) -> Given:
    """A lens for every camera; one that is the only one in the file is every camera's.

    Raises RigError for a file that cannot be read, UsageError for one that does not suit the videos.
    """
    if not path.exists():
        raise UsageError(f"`intrinsics` {path}: is not there; check the path")
    cameras = {camera.name: camera for camera in _cameras(path)}
    if len(cameras) == 1:
        cameras = dict.fromkeys((one.name for one in footage), *cameras.values())
    missing = [one.name for one in footage if one.name not in cameras]
    if missing:
        raise UsageError(
            f"`intrinsics` {path}: has no lens for {', '.join(missing)}, but for {', '.join(cameras)}; add them, "
            "give a file with one lens for all, or rename the videos"
        )
    return Given(path, tuple(_lens(_resized(cameras[one.name], one, path)) for one in footage))


def _cameras(path: Path) -> Sequence[Camera]:
    file = path / CALIBRATION if (path / CALIBRATION).is_file() else path
    if file.suffix == ".json" and file.name != "rig.json" and file.is_file():
        document = read_json(file)
        records = document.records("cameras") if "cameras" in document else []
        if records and all("focal" in record for record in records):
            shift = 0.0 if "0.5" in document.text("pixel_convention", "(0,0)") else 0.5
            return [_recorded(record, shift) for record in records]
    return open_recordings(path).cameras


def _recorded(record: Fields, shift: float) -> Camera:
    (fx, fy), (cx, cy) = map(float, record.array("focal", (2,))), map(float, record.array("centre", (2,)) + shift)
    camera = calibrated_camera(
        record.label("name"),
        (record.integer("width"), record.integer("height")),
        (fx, fy, cx, cy),
        np.eye(4),
        cast(DistortionModel, record.label("distortion_model", "none")),
        record.numbers("distortion") if "distortion" in record else (),
        record.where,
    )
    if is_distorted(camera):
        lens_of(camera)  # knows how many coefficients each model has
    return camera


def _resized(camera: Camera, footage: Footage, path: Path) -> Camera:
    width, height = footage.size
    sx, sy = width / camera.width, height / camera.height
    if abs(sx / sy - 1) > _ONE_SHAPE:
        raise UsageError(
            f"`intrinsics` {path}: {camera.name} is for {camera.width} x {camera.height} pixels, but {footage.name} "
            f"has {width} x {height}; give lenses for pictures of this shape"
        )
    fx, fy, cx, cy = camera.fx * sx, camera.fy * sy, camera.cx * sx, camera.cy * sy
    return replace(camera, width=width, height=height, fx=fx, fy=fy, cx=cx, cy=cy)


def _lens(camera: Camera) -> Lens:
    coefficients = camera.distortion or (0.0,) * 4
    return Lens(camera.distortion_model, (camera.fx, camera.fy), (camera.cx - 0.5, camera.cy - 0.5), coefficients)
