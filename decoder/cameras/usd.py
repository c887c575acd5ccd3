"""Reads a camera of a USD file, still or moving: what Blender and Houdini write, and what ``decogs-export`` does.

A picture is made for every whole time code of the stage's range (of the camera's samples where the stage has none), at
the stage's time codes per second; time code 0 is the stream's beginning. A camera that does not move is one camera for
all frames. The picture has the size of the rig's first camera's width and the camera's own aspect, unless the camera is
of an export of ours, which knows it.

Axes: cameras of an export of ours are taken relative to its /World. In another file, a stage with z up is turned as
DCCs turn a y-up export when they import it, (x, y, z) to (x, z, -y), and lengths are in metres: metersPerUnit, or .01
without one, as OpenUSD has it. A stream whose rig states its unit knows how many metres that is.

Files are strangers': only the camera and what it stands in are composed, of one flat file (`formats.usd_layer`), and
only after that went well in another process (`formats.trial`).

Source: UsdGeomCamera; looks along -z, y up; focal length, apertures and offsets share a unit.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import MAX_SIDE, Camera
from decogs.formats.errors import UsageError
from decogs.formats.files.trial import try_apart
from decogs.formats.usd.layer import flat_layer
from decogs.formats.usd.openusd import load_openusd, quiet_openusd

from .fields import LARGEST, checked, of_entry, pose_of
from .path import FPS, MAX_PICTURES, CameraPath, ToFilm

_MAX_STEPS = 1000
"""Of transformation, from the camera to the world: each picture takes them all."""
_MAX_SAMPLES = 8 * MAX_PICTURES
_NAME = "camera"
_Y_FROM_Z_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
_FIELDS = (
    "focalLength", "horizontalAperture", "verticalAperture", "horizontalApertureOffset", "verticalApertureOffset",
)  # fmt: skip


def usd_camera_path(path: Path, name: str | None, film: ToFilm, max_memory: int) -> CameraPath:
    """The camera called ``name`` (its prim's name or path), or the only one there.

    Raises UsageError for no such camera, for a file that is not flat or might take more than ``max_memory`` bytes, and
    for what cannot be drawn.
    """
    if not path.is_file():
        raise UsageError(f"{path}: cannot be read; name a USD file with a camera")
    width = film.cameras[0].width
    load_openusd()  # Where it is not installed, that is what is said.
    try_apart(_read_for_trial, path, name, width, film.metres, max_memory, max_memory=max_memory)
    return _read(path, name, film, max_memory)


def _read_for_trial(path: Path, name: str | None, width: int, metres: float, max_memory: int) -> None:
    any_camera = Camera("", width, width, 1.0, 1.0, 0.0, 0.0, np.eye(4))
    _read(path, name, ToFilm((any_camera,), metres=metres), max_memory)


def _read(path: Path, name: str | None, film: ToFilm, max_memory: int) -> CameraPath:
    load_openusd()
    from pxr import Tf

    with quiet_openusd(), np.errstate(all="ignore"):
        try:
            layer = flat_layer(path, max_memory)
            chosen = _chosen(path, name, _cameras(layer))
        except (Tf.ErrorException, UnicodeDecodeError):
            raise UsageError(f"{path}: is a damaged USD file; export it again") from None
        where = f"{path}:{chosen}"
        try:
            return _path(layer, chosen, film, where)
        except (Tf.ErrorException, UnicodeDecodeError):
            raise UsageError(f"{where}: OpenUSD cannot make out its transform or lens; export it again") from None


def _cameras(layer: Any) -> list[Any]:
    """The paths of the cameras that a stage of this layer would have, in its order."""
    from pxr import Sdf

    paths, prims = [], list(reversed(layer.rootPrims))
    while prims:
        prim = prims.pop()
        if prim.specifier == Sdf.SpecifierDef and prim.active:
            paths += [prim.path] if prim.typeName == "Camera" else []
            prims += reversed(prim.nameChildren)
    return paths


def _chosen(path: Path, name: str | None, cameras: list[Any]) -> Any:
    names = ", ".join(map(str, cameras[:40])) + (", ..." if len(cameras) > 40 else "")
    if not cameras:
        raise UsageError(f"{path}: has no camera")
    if name is None:
        if len(cameras) > 1:
            raise UsageError(f"{path}: has {len(cameras)} cameras, {names}; name one, as {path}:{cameras[0]}")
        return cameras[0]
    for camera in cameras:
        # Blender has a transform of the object's name, and the camera below it.
        if name in (str(camera), camera.name, camera.GetParentPath().name):
            return camera
    raise UsageError(f"{path}: has no camera {name!r}; it has {names}")


def _path(layer: Any, chosen: Any, film: ToFilm, where: str) -> CameraPath:
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.OpenMasked(layer, Usd.StagePopulationMask([chosen]), Usd.Stage.LoadNone)
    camera = UsdGeom.Camera(stage.GetPrimAtPath(chosen))
    if camera.GetProjectionAttr().Get() == UsdGeom.Tokens.orthographic:
        raise UsageError(f"{where}: is orthographic; only perspective cameras are rendered")
    codes = _time_codes(stage, camera, where)
    rate = stage.GetTimeCodesPerSecond()
    times = [Usd.TimeCode.EarliestTime()] if codes is None else [Usd.TimeCode(code) for code in codes]
    turn, unit, transforms = _placed(layer, stage, camera, times, film.metres, where)
    rotations, positions = _poses(turn, unit, transforms, where)
    lens = _Lens(camera, film, unit, where)
    shown = tuple(map(lens.camera, times, rotations, positions))
    if len({(one.width, one.height) for one in shown}) > 1:
        raise UsageError(f"{where}: its apertures change their aspect; a film has one size")
    if codes is None:
        return CameraPath(shown, source=where)
    return CameraPath(shown, tuple(film.frame_at(code / rate) for code in codes), rate, where)


def _time_codes(stage: Any, camera: Any, where: str) -> range | None:
    """The time codes of the pictures; None for a camera that does not change."""
    from pxr import UsdGeom, Vt

    prim = camera.GetPrim()
    attributes = [prim.GetAttribute(name) for name in _FIELDS]
    steps = 0
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdGeom.Xformable):
            order = UsdGeom.Xformable(prim).GetXformOpOrderAttr().Get() or ()
            if order and not isinstance(order, Vt.TokenArray):
                raise UsageError(f"{where}: xformOpOrder of {prim.GetPath()} is no list of tokens; export it again")
            steps += len(order)
            if steps > _MAX_STEPS:
                raise UsageError(f"{where}: has more than {_MAX_STEPS} steps of transformation; bake them")
            attributes += [op.GetAttr() for op in UsdGeom.Xformable(prim).GetOrderedXformOps()]
        prim = prim.GetParent()
    if any(attribute.HasSpline() for attribute in attributes):
        raise UsageError(f"{where}: is animated by splines; bake them to time samples")
    changing = [attribute for attribute in attributes if attribute.ValueMightBeTimeVarying()]
    if sum(attribute.GetNumTimeSamples() for attribute in changing) > _MAX_SAMPLES:
        raise UsageError(f"{where}: has more than {_MAX_SAMPLES} time samples; export a shorter range")
    samples = [code for attribute in changing for code in attribute.GetTimeSamples()]
    if not samples:
        return None
    first, last = (
        (stage.GetStartTimeCode(), stage.GetEndTimeCode())
        if stage.HasAuthoredTimeCodeRange()
        else (min(samples), max(samples))
    )
    if not (max(abs(first), abs(last)) <= LARGEST and 0 <= last - first < MAX_PICTURES):
        raise UsageError(f"{where}: its time codes run from {first:g} to {last:g}; at most {MAX_PICTURES} are rendered")
    if not FPS[0] <= stage.GetTimeCodesPerSecond() <= FPS[1]:
        raise UsageError(f"{where}: has {stage.GetTimeCodesPerSecond():g} time codes per second")
    codes = range(math.ceil(first), math.floor(last) + 1)
    if not codes:
        raise UsageError(f"{where}: there is no whole time code from {first:g} to {last:g}; export a longer range")
    return codes


class _Lens:
    """What a camera's lens and picture are at a time; raises UsageError for what is none."""

    def __init__(self, camera: Any, film: ToFilm, unit: float, where: str) -> None:
        from pxr import Usd

        self._own, self._film, self._unit, self._where = _own_size(camera), film, unit, where
        attributes = [camera.GetPrim().GetAttribute(name) for name in _FIELDS]
        self._values: list[Callable[[Any], Any]] = [Usd.AttributeQuery(attribute).Get for attribute in attributes]
        clipping = camera.GetClippingRangeAttr()
        self._clipping = Usd.AttributeQuery(clipping).Get if clipping.HasAuthoredValue() else None

    def camera(self, code: Any, rotation: NDArray[np.float64], position: NDArray[np.float64]) -> Camera:
        """At a time code, with its camera-to-world rotation and position."""
        focal, across, down, right, up = (self._number(value(code)) for value in self._values)
        if not (focal > 0 and across > 0 and down > 0):
            raise UsageError(f"{self._where}: focal length and apertures must be above 0")
        width, height = self._own or self._size(down / across)
        if not 1 <= height <= MAX_SIDE:
            raise UsageError(f"{self._where}: its apertures make a picture of {width}x{height}; correct them")
        made = Camera(
            _NAME, width, height, focal / across * width, focal / down * height,
            (0.5 - right / across) * width, (0.5 + up / down) * height, pose_of(rotation.T, position),
            near=self._near(code),
        )  # fmt: skip
        return of_entry(checked, made, self._where)

    def _number(self, value: Any) -> float:
        if not isinstance(value, (int, float)) or not abs(value) <= LARGEST:
            raise UsageError(f"{self._where}: a focal length, aperture or offset is no finite number; export it again")
        return float(value)

    def _near(self, code: Any) -> float:
        """In the stream's units; 0 for what is no near plane."""
        from pxr import Gf

        clipped = None if self._clipping is None else self._clipping(code)
        if not isinstance(clipped, (Gf.Vec2f, Gf.Vec2d, Gf.Vec2h)):
            return 0.0
        near = float(clipped[0]) * self._unit
        return near if 0 < near <= LARGEST else 0.0

    def _size(self, aspect: float) -> tuple[int, int]:
        width = self._film.cameras[0].width
        return width, round(width * aspect) if width * aspect < 2 * MAX_SIDE else 2 * MAX_SIDE


def _own_size(camera: Any) -> tuple[int, int] | None:
    """That a camera of an export of ours states."""
    own = camera.GetPrim().GetCustomDataByKey("decogs")
    if isinstance(own, dict):
        sides = [side for side in (own.get("width"), own.get("height")) if isinstance(side, int)]
        if len(sides) == 2 and all(1 <= side <= MAX_SIDE for side in sides):
            return sides[0], sides[1]
    return None


def _placed(
    layer: Any, stage: Any, camera: Any, times: list[Any], metres: float, where: str
) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
    """The turn and the scene's unit in the stream's world, of whose unit are ``metres``, and the camera at each time.

    The camera as its transform to the world (T, 4, 4) of an export of ours, or to the stage.
    """
    from pxr import UsdGeom

    cache = UsdGeom.XformCache()

    def transforms(prim: Any) -> NDArray[np.float64]:
        matrices = np.empty((len(times), 4, 4))
        for row, code in enumerate(times):
            cache.SetTime(code)
            matrices[row] = cache.GetLocalToWorldTransform(prim)
        return np.asarray(matrices.transpose(0, 2, 1))

    to_stage = transforms(camera.GetPrim())
    if any(layer.GetPrimAtPath(f"/World/{group}") for group in ("Static", "Dynamic")):
        to_world = _inverse(transforms(stage.GetPrimAtPath("/World")), where)
        unit = float(np.cbrt(abs(np.linalg.det(to_world[0, :3, :3]))))
        return np.eye(3), unit, np.diag([1 / unit] * 3 + [1.0]) @ to_world @ to_stage
    z_is_up = UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z
    return _Y_FROM_Z_UP if z_is_up else np.eye(3), UsdGeom.GetStageMetersPerUnit(stage) / metres, to_stage


def _poses(
    turn: NDArray[np.float64], unit: float, transforms: NDArray[np.float64], where: str
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Camera-to-world rotations (T, 3, 3), OpenCV axes, and positions (T, 3), in the stream's world."""
    _inverse(transforms, where)
    left, _, right = np.linalg.svd(transforms[:, :3, :3])
    if (np.linalg.det(left @ right) < 0).any():
        raise UsageError(f"{where}: its transform mirrors the picture; take the negative scale out")
    axes = turn @ (left @ right) @ np.diag([1.0, -1.0, -1.0])
    return np.asarray(axes), np.asarray(transforms[:, :3, 3] @ turn.T * unit)


def _inverse(transforms: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    """Of transforms (T, 4, 4); raises UsageError where one has none."""
    affine = np.abs(transforms[:, 3] - [0, 0, 0, 1]).max() <= 1e-6
    if (
        not (affine and (np.abs(transforms) <= LARGEST).all())
        or (np.abs(np.linalg.det(transforms[:, :3, :3])) < 1e-18).any()
    ):
        raise UsageError(f"{where}: its transform is not affine, has no inverse, or numbers above {LARGEST:g}")
    return np.asarray(np.linalg.inv(transforms))
