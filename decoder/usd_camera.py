"""Reads a camera of a USD file, still or moving: what Blender and Houdini write, and what ``decogs-export`` does.

A picture is made for every whole time code of the stage's range (of the camera's samples where the stage has none), at
the stage's time codes per second; time code 0 is the stream's beginning. A camera that does not move is one camera for
all frames. The picture has the size of the rig's first camera's width and the camera's own aspect, unless the camera is
of an export of ours, which knows it.

Axes: cameras of an export of ours are taken relative to its /World. In another file, a stage with z up is turned as
DCCs turn a y-up export when they import it, (x, y, z) to (x, z, -y), and lengths are in metres (metersPerUnit), of
which a stream whose rig states its unit knows how many that is.

Source: UsdGeomCamera; looks along -z, y up; focal length, apertures and offsets share a unit.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import MAX_SIDE, Camera
from decogs.formats.errors import UsageError
from decogs.formats.openusd import load_openusd

from .camera_fields import pose_of
from .camera_path import CameraPath, ToFilm

MAX_PICTURES = 1 << 17
_NAME = "camera"
_Y_FROM_Z_UP = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])


def usd_camera_path(path: Path, name: str | None, film: ToFilm) -> CameraPath:
    """The camera called ``name`` (its prim's name or path), or the only one there; raises UsageError for no such."""
    load_openusd()
    from pxr import Tf, Usd, UsdGeom

    if not path.is_file():
        raise UsageError(f"{path}: cannot be read; name a USD file with a camera")
    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException:
        raise UsageError(f"{path}: is no USD file that OpenUSD can read") from None
    cameras = [UsdGeom.Camera(prim) for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
    camera = _chosen(path, name, cameras)
    where = f"{path}:{camera.GetPath()}"
    if camera.GetProjectionAttr().Get() == UsdGeom.Tokens.orthographic:
        raise UsageError(f"{where}: is orthographic; only perspective cameras are rendered")
    codes = _time_codes(stage, camera, where)
    if codes is None:
        return CameraPath((_camera(stage, camera, Usd.TimeCode.EarliestTime(), film, where),), source=where)
    rate = stage.GetTimeCodesPerSecond()
    shown = tuple(_camera(stage, camera, Usd.TimeCode(code), film, where) for code in codes)
    sizes = {(one.width, one.height) for one in shown}
    if len(sizes) > 1:
        raise UsageError(f"{where}: its apertures change their aspect; a film has one size")
    return CameraPath(shown, tuple(film.frame_at(code / rate) for code in codes), rate, where)


def _chosen(path: Path, name: str | None, cameras: list[Any]) -> Any:
    names = ", ".join(str(camera.GetPath()) for camera in cameras[:40]) + (", ..." if len(cameras) > 40 else "")
    if not cameras:
        raise UsageError(f"{path}: has no camera")
    if name is None:
        if len(cameras) > 1:
            raise UsageError(f"{path}: has {len(cameras)} cameras, {names}; name one, as {path}:{cameras[0].GetPath()}")
        return cameras[0]
    for camera in cameras:
        # Blender has a transform of the object's name, and the camera below it.
        if name in (str(camera.GetPath()), camera.GetPrim().GetName(), camera.GetPrim().GetParent().GetName()):
            return camera
    raise UsageError(f"{path}: has no camera {name!r}; it has {names}")


def _time_codes(stage: Any, camera: Any, where: str) -> range | None:
    """The time codes of the pictures; None for a camera that does not change."""
    from pxr import UsdGeom

    attributes = [
        camera.GetFocalLengthAttr(), camera.GetHorizontalApertureAttr(), camera.GetVerticalApertureAttr(),
        camera.GetHorizontalApertureOffsetAttr(), camera.GetVerticalApertureOffsetAttr(),
    ]  # fmt: skip
    prim = camera.GetPrim()
    while prim and not prim.IsPseudoRoot():
        attributes += [op.GetAttr() for op in UsdGeom.Xformable(prim).GetOrderedXformOps()] if _moves(prim) else []
        prim = prim.GetParent()
    samples = [code for attribute in attributes if attribute.ValueMightBeTimeVarying()
               for code in attribute.GetTimeSamples()]  # fmt: skip
    if not samples:
        return None
    first, last = (
        (stage.GetStartTimeCode(), stage.GetEndTimeCode())
        if stage.HasAuthoredTimeCodeRange()
        else (min(samples), max(samples))
    )
    if not (math.isfinite(first) and math.isfinite(last) and 0 <= last - first < MAX_PICTURES):
        raise UsageError(f"{where}: its time codes run from {first:g} to {last:g}; at most {MAX_PICTURES} are rendered")
    if not stage.GetTimeCodesPerSecond() > 0:
        raise UsageError(f"{where}: has {stage.GetTimeCodesPerSecond():g} time codes per second")
    return range(math.ceil(first), math.floor(last) + 1)


def _moves(prim: Any) -> bool:
    from pxr import UsdGeom

    return bool(prim.IsA(UsdGeom.Xformable))


def _camera(stage: Any, camera: Any, code: Any, film: ToFilm, where: str) -> Camera:
    focal = float(camera.GetFocalLengthAttr().Get(code))
    across, down = (
        float(attribute.Get(code))
        for attribute in (camera.GetHorizontalApertureAttr(), camera.GetVerticalApertureAttr())
    )
    right, up = (
        float(attribute.Get(code) or 0)
        for attribute in (camera.GetHorizontalApertureOffsetAttr(), camera.GetVerticalApertureOffsetAttr())
    )
    values = (focal, across, down, right, up)
    if not (all(map(math.isfinite, values)) and focal > 0 and across > 0 and down > 0):
        raise UsageError(f"{where}: focal length and apertures must be above 0")
    width, height = _size(camera, film, down / across)
    if not 1 <= height <= MAX_SIDE:
        raise UsageError(f"{where}: its apertures make a picture of {width}x{height}; correct them")
    rotation, position, units = _pose(stage, camera, code, where, film.metres)
    clipping = camera.GetClippingRangeAttr()
    clipped = clipping.Get(code) if clipping.HasAuthoredValue() else None
    near = 0.0 if clipped is None else float(clipped[0]) * units
    return Camera(
        _NAME, width, height, focal / across * width, focal / down * height,
        (0.5 - right / across) * width, (0.5 + up / down) * height, pose_of(rotation.T, position),
        near=near if 0 < near < math.inf else 0.0,
    )  # fmt: skip


def _size(camera: Any, film: ToFilm, aspect: float) -> tuple[int, int]:
    own = camera.GetPrim().GetCustomDataByKey("decogs")
    if isinstance(own, dict):
        sides = [side for side in (own.get("width"), own.get("height")) if isinstance(side, int)]
        if len(sides) == 2 and all(1 <= side <= MAX_SIDE for side in sides):
            return sides[0], sides[1]
    width = film.cameras[0].width
    return width, round(width * aspect) if width * aspect < 2 * MAX_SIDE else 2 * MAX_SIDE


def _pose(
    stage: Any, camera: Any, code: Any, where: str, metres: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
    """Camera-to-world rotation, OpenCV axes, and position, in the stream's world, of whose unit are ``metres``.

    Also the length of the scene's unit in that world.
    """
    from pxr import UsdGeom

    cache = UsdGeom.XformCache(code)
    to_stage = np.array(cache.GetLocalToWorldTransform(camera.GetPrim())).T
    world = stage.GetPrimAtPath("/World")
    is_ours = bool(world) and any(stage.GetPrimAtPath(f"/World/{group}") for group in ("Static", "Dynamic"))
    turn, unit = np.eye(3), 1.0
    if is_ours:
        to_world = _inverse(np.array(cache.GetLocalToWorldTransform(world)).T, where)
        unit = float(np.cbrt(abs(np.linalg.det(to_world[:3, :3]))))
        to_stage = np.diag([1 / unit] * 3 + [1.0]) @ to_world @ to_stage
    else:
        turn = _Y_FROM_Z_UP if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.z else turn
        unit = UsdGeom.GetStageMetersPerUnit(stage) if UsdGeom.StageHasAuthoredMetersPerUnit(stage) else unit
        unit /= metres
    _inverse(to_stage, where)
    left, _, right = np.linalg.svd(to_stage[:3, :3])
    if np.linalg.det(left @ right) < 0:
        raise UsageError(f"{where}: its transform mirrors the picture; take the negative scale out")
    axes = turn @ (left @ right) @ np.diag([1.0, -1.0, -1.0])
    return axes, turn @ to_stage[:3, 3] * unit, unit


def _inverse(transform: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    """Of a transform (4, 4); raises UsageError where there is none."""
    if not np.isfinite(transform).all() or abs(np.linalg.det(transform[:3, :3])) < 1e-18:
        raise UsageError(f"{where}: its transform has no inverse")
    return np.asarray(np.linalg.inv(transform))
