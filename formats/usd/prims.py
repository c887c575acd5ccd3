"""Gaussians over time as prims of USD: point instancers that today's DCCs draw, and splats that renderers of splats do.

A group is the same Gaussians, row by row, in either flavour or in both. ``usd.writing`` says what is in a
file, and why.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..geometry.rotations import rotation_rows
from ..splats import FloatArray

Flavour = Literal["instancer", "splat", "both"]
FLAVOURS: tuple[Flavour, ...] = ("instancer", "splat", "both")

_SPLAT_SIGMAS = 3.0
"""Half side of a splat's box in standard deviations: where the kernel of 3DGS ends."""

COMPENSATION = (
    "opacity * sqrt(det(C) / det(C + 0.3 I)), C the projected covariance in square pixels, C + 0.3 I what is drawn"
)
"""How the decoder dims what is smaller than a pixel (Mip-Splatting), in words for whoever opens a file."""

_A_MOMENT = 2.0**-10
"""Of a frame: shorter than any shutter's samples are apart, and exact in a time code of any length."""

_NOWHERE = np.repeat(np.array([[1], [-1]], np.float32) * np.finfo(np.float32).max, 3, axis=1)
"""The box of nothing, as OpenUSD has it: its corners the wrong way round, as far apart as can be."""

_DISPLAY_SRGB = "srgb_rec709_display"
"""The colour that SH give is coded, and blended so. OpenUSD's own list has scene-referred names only; this one is the
Color Interop Forum's, and what Omniverse reads and 3DGRUT writes."""


@dataclass(frozen=True)
class UsdSplats:
    """What a group shows at one frame, float32, one row per Gaussian; all rows of the group, alive or not.

    positions (N, 3) and scales (N, 3) (standard deviations) in world units; rotations (N, 4) unit quaternions wxyz;
    colours (N, 3) linear; opacities (N,) 0 to 1. sh (N, (degree + 1)**2, 3), as stored, for splats; None where only
    instancers are asked for. velocities (N, 3) in world units a second, at every frame of a group or at none.
    """

    positions: FloatArray
    rotations: FloatArray
    scales: FloatArray
    colours: FloatArray
    opacities: FloatArray
    sh: FloatArray | None = None
    velocities: FloatArray | None = None


def just_before(frame: float) -> float:
    """The time at which the rows of a segment end that the next one, from ``frame`` on, has others for."""
    return frame - _A_MOMENT


def splat_extent(splats: UsdSplats, radius: float) -> FloatArray:
    """Box around the instances, (2, 3): each the box around a cube of half side ``radius``, as UsdGeom computes it.

    A group without rows has USD's box of nothing.
    """
    if len(splats.positions) == 0:
        return _NOWHERE
    rotation = np.array(rotation_rows(*splats.rotations.T))
    half = radius * np.einsum("ijn,nj->ni", np.abs(rotation), splats.scales)
    return np.stack([(splats.positions - half).min(axis=0), (splats.positions + half).max(axis=0)]).astype(np.float32)


class _Track:
    """One attribute over time: a default from the first value, samples from the first change on, none that repeats.

    ``exact``: a value that rests between two changes is written at each time of the rest. Readers interpolate
    between two equal samples, too, and need not get the same bits from it.
    """

    def __init__(self, attribute: Any, convert: Callable[[NDArray[Any]], Any], *, exact: bool = False) -> None:
        self._attribute = attribute
        self._convert = convert
        self._exact = exact
        self._value: NDArray[Any] | None = None
        self._seen: list[float] = []
        self._sampled = False

    def push(self, time: float, value: NDArray[Any], until: float | None = None) -> int:
        """The value at ``time`` (times in rising order), and ``until`` then; returns the bytes handed to USD."""
        before = self._value
        if before is not None and (before is value or np.array_equal(before, value)):
            self._see(time if until is None else until)
            return 0
        written = self._convert(value)
        bytes_out = value.nbytes
        if before is None:
            self._attribute.Set(written)
        else:
            held = self._convert(before) if self._seen else None
            for earlier in self._seen:
                self._attribute.Set(held, earlier)
            bytes_out += before.nbytes if self._seen else 0
            self._attribute.Set(written, time)
            self._sampled = True
        self._value, self._seen = value, [time] if before is None else []
        if until is not None:
            self._attribute.Set(written, until)
            self._seen, self._sampled = [], True
        return bytes_out

    def _see(self, time: float) -> None:
        """The value is still there at ``time``; before a sample, or without ``exact``, the last such time is enough."""
        self._seen = [*self._seen, time] if self._exact and self._sampled else [time]

    def set_default(self, value: NDArray[Any]) -> None:
        """Another default than the first value."""
        self._attribute.Set(self._convert(value))


class _Pair:
    """Two attributes with samples at the same times: readers heed velocities only where positions have samples, too.

    To a track it is an attribute of USD.
    """

    def __init__(self, first: Any, second: Any) -> None:
        self._both = first, second

    def Set(self, values: tuple[Any, Any], *time: float) -> None:
        for attribute, value in zip(self._both, values, strict=True):
            attribute.Set(value, *time)


Values = dict[str, NDArray[Any]]


class Prims(ABC):
    """What a group is in one flavour, and its attributes that may change.

    It is there if the group ever has rows, and has its first ones before that, too, hidden: validators take prims
    without rows for broken, and look at the default and at the earliest sample.
    """

    def __init__(self) -> None:
        self._tracks: dict[str, _Track] = {}
        self._awaited_since: float | None = None

    def push(
        self, time: float, ids: NDArray[np.int64], splats: UsdSplats, alive: NDArray[np.bool_], until: float | None
    ) -> int:
        """The group at ``time``; returns the bytes handed to USD, an upper bound of what the file grows by."""
        if not self._tracks and len(ids) == 0:
            self._awaited_since = time if self._awaited_since is None else self._awaited_since
            return 0
        values = self._values(ids, splats, alive)
        if self._tracks:
            return self._push(time, values, until)
        self._tracks = self._define(splats)
        if self._awaited_since is None:
            return self._push(time, values, until)
        hidden = self._values(ids, splats, np.zeros(len(ids), np.bool_))
        size = sum(self._push(earlier, hidden, None) for earlier in (self._awaited_since, just_before(time)))
        size += self._push(time, values, until)
        for key, track in self._tracks.items():
            track.set_default(values[key])
        return size

    def _push(self, time: float, values: Values, until: float | None) -> int:
        # Boxes always have two corners, between which readers interpolate.
        return sum(
            track.push(time, values[key], until if key.endswith("extent") else None)
            for key, track in self._tracks.items()
        )

    @abstractmethod
    def _define(self, splats: UsdSplats) -> dict[str, _Track]:
        """The prims with all that never changes, and the attributes that may."""

    @abstractmethod
    def _values(self, ids: NDArray[np.int64], splats: UsdSplats, alive: NDArray[np.bool_]) -> Values:
        """What these attributes are to be, by the same names."""


class InstancerPrims(Prims):
    """One instancer with its points.

    ``stand_in``: the instancer is what is shown instead of splats while working.
    """

    def __init__(self, stage: Any, name: str, prototype_radius: float, *, short_ids: bool, stand_in: bool) -> None:
        super().__init__()
        self._stage = stage
        self._path = f"/World/{name}"
        self._radius = prototype_radius
        self._short_ids = short_ids
        self._stand_in = stand_in

    def _define(self, splats: UsdSplats) -> dict[str, _Track]:
        from pxr import Gf, Sdf, UsdGeom, Vt

        instancer = UsdGeom.PointInstancer.Define(self._stage, self._path)
        if self._stand_in:
            instancer.CreatePurposeAttr(UsdGeom.Tokens.proxy)
        prototype = UsdGeom.Sphere.Define(self._stage, f"{self._path}/Splat")
        prototype.CreateRadiusAttr(self._radius)
        prototype.CreateExtentAttr([Gf.Vec3f(-self._radius), Gf.Vec3f(self._radius)])
        instancer.CreatePrototypesRel().SetTargets([prototype.GetPath()])
        points = UsdGeom.Points.Define(self._stage, f"{self._path}Points")
        points.CreatePurposeAttr(UsdGeom.Tokens.render)
        widths = points.CreateWidthsAttr()
        points.SetWidthsInterpolation(UsdGeom.Tokens.vertex)

        colour, opacity = Sdf.ValueTypeNames.Color3fArray, Sdf.ValueTypeNames.FloatArray
        vectors, floats, integers = Vt.Vec3fArray.FromNumpy, Vt.FloatArray.FromNumpy, Vt.Int64Array.FromNumpy
        numbers = Vt.IntArray.FromNumpy
        tracks = {
            "ids": _Track(instancer.CreateIdsAttr(), integers),
            "prototypes": _Track(instancer.CreateProtoIndicesAttr(), numbers),
            "widths": _Track(widths, floats),
            "positions": _positions(instancer, moving=splats.velocities is not None),
            "rotations": _Track(instancer.CreateOrientationsAttr(), _quath_array),
            "scales": _Track(instancer.CreateScalesAttr(), vectors),
            "colours": _Track(_primvar(instancer, "displayColor", colour), vectors),
            "opacities": _Track(_primvar(instancer, "displayOpacity", opacity), floats),
            "invisible": _Track(instancer.CreateInvisibleIdsAttr(), integers),
            "extent": _Track(instancer.CreateExtentAttr(), vectors),
            "points": _Track(points.CreatePointsAttr(), vectors),
            "points_colours": _Track(_primvar(points, "displayColor", colour), vectors),
            "points_opacities": _Track(_primvar(points, "displayOpacity", opacity), floats),
            "points_extent": _Track(points.CreateExtentAttr(), vectors),
        }
        if self._short_ids:
            for key, prim in (("short_ids", instancer), ("points_short_ids", points)):
                tracks[key] = _Track(_primvar(prim, "splatId", Sdf.ValueTypeNames.IntArray), numbers)
        return tracks

    def _values(self, ids: NDArray[np.int64], splats: UsdSplats, alive: NDArray[np.bool_]) -> Values:
        count, short_ids = len(ids), ids.astype(np.int32)
        return {
            "ids": ids,
            "short_ids": short_ids,
            "points_short_ids": short_ids,
            "prototypes": np.zeros(count, np.int32),
            "widths": np.zeros(count, np.float32),
            "positions": splats.positions if splats.velocities is None else _with_velocities(splats, alive),
            "rotations": splats.rotations,
            "scales": splats.scales,
            "colours": splats.colours,
            "opacities": splats.opacities,
            "invisible": ids[~alive],
            "extent": _extent_of(splats, alive, self._radius),
            "points": splats.positions,
            "points_colours": splats.colours,
            "points_opacities": _shown_opacities(splats, alive),
            "points_extent": _box(splats.positions),
        }


class SplatPrims(Prims):
    """One ParticleField3DGaussianSplat. A row that is not alive has opacity 0."""

    def __init__(self, stage: Any, name: str, *, short_ids: bool, stand_in_of: str | None) -> None:
        super().__init__()
        self._stage = stage
        self._path = f"/World/{name}Splats"
        self._short_ids = short_ids
        self._stand_in_of = stand_in_of

    def _define(self, splats: UsdSplats) -> dict[str, _Track]:
        from pxr import Sdf, Usd, UsdGeom, UsdVol, Vt

        coefficients = _sh_of(splats).shape[1]
        field = UsdVol.ParticleField3DGaussianSplat.Define(self._stage, self._path)
        prim = field.GetPrim()
        # The order and the projection that the decoder has, which are the schema's defaults, too.
        field.CreateSortingModeHintAttr(UsdVol.Tokens.zDepth)
        field.CreateProjectionModeHintAttr(UsdVol.Tokens.perspective)
        Usd.ColorSpaceAPI.Apply(prim).CreateColorSpaceNameAttr(_DISPLAY_SRGB)
        field.CreateRadianceSphericalHarmonicsDegreeAttr(round(coefficients**0.5) - 1)
        sh = field.CreateRadianceSphericalHarmonicsCoefficientsAttr()
        # Not in the schema, and wanted by Omniverse's validator.
        sh.SetMetadata("elementSize", coefficients)
        sh.SetMetadata("interpolation", UsdGeom.Tokens.vertex)
        # The schema has no word for it; the .ply and .glb of this house and of others have this one.
        prim.SetCustomDataByKey("decogs", {"SplatRenderMode": "mip", "opacityCompensation": COMPENSATION})
        if self._stand_in_of is not None:
            field.CreatePurposeAttr(UsdGeom.Tokens.render)
            field.SetProxyPrim(self._stage.GetPrimAtPath(self._stand_in_of))
        vectors, floats = Vt.Vec3fArray.FromNumpy, Vt.FloatArray.FromNumpy
        tracks = {
            "positions": _Track(field.CreatePositionsAttr(), vectors, exact=True),
            "rotations": _Track(field.CreateOrientationsAttr(), _quatf_array, exact=True),
            "scales": _Track(field.CreateScalesAttr(), vectors, exact=True),
            "opacities": _Track(field.CreateOpacitiesAttr(), floats, exact=True),
            "sh": _Track(sh, vectors, exact=True),
            "extent": _Track(field.CreateExtentAttr(), vectors),
        }
        if self._short_ids:
            ids = _primvar(field, "splatId", Sdf.ValueTypeNames.IntArray)
            tracks["short_ids"] = _Track(ids, Vt.IntArray.FromNumpy)
        return tracks

    def _values(self, ids: NDArray[np.int64], splats: UsdSplats, alive: NDArray[np.bool_]) -> Values:
        return {
            "positions": splats.positions,
            "rotations": splats.rotations,
            "scales": splats.scales,
            "opacities": _shown_opacities(splats, alive),
            "sh": _sh_of(splats).reshape(-1, 3),
            "short_ids": ids.astype(np.int32),
            "extent": _extent_of(splats, alive, _SPLAT_SIGMAS),
        }


def _sh_of(splats: UsdSplats) -> FloatArray:
    if splats.sh is None:
        raise ValueError("splats without `sh` cannot be written as splat prims")
    return splats.sh


def _positions(instancer: Any, *, moving: bool) -> _Track:
    """Where instances are and, in the same track, how fast they move."""
    from pxr import Vt

    vectors = Vt.Vec3fArray.FromNumpy
    if not moving:
        return _Track(instancer.CreatePositionsAttr(), vectors)
    pair = _Pair(instancer.CreatePositionsAttr(), instancer.CreateVelocitiesAttr())
    return _Track(pair, lambda both: tuple(vectors(np.ascontiguousarray(part)) for part in (both[:, :3], both[:, 3:])))


def _with_velocities(splats: UsdSplats, alive: NDArray[np.bool_]) -> FloatArray:
    """Positions and velocities side by side, (N, 6); a row that is not alive does not move."""
    assert splats.velocities is not None
    return np.concatenate([splats.positions, np.where(alive[:, None], splats.velocities, np.float32(0))], axis=1)


def _primvar(prim: Any, key: str, kind: Any) -> Any:
    from pxr import UsdGeom

    return UsdGeom.PrimvarsAPI(prim).CreatePrimvar(key, kind, UsdGeom.Tokens.vertex).GetAttr()


def _shown_opacities(splats: UsdSplats, alive: NDArray[np.bool_]) -> FloatArray:
    return splats.opacities if alive.all() else np.where(alive, splats.opacities, np.float32(0))


def _extent_of(splats: UsdSplats, alive: NDArray[np.bool_], radius: float) -> FloatArray:
    if alive.all():
        return splat_extent(splats, radius)
    values = {name: value[alive] for name, value in vars(splats).items() if name not in ("sh", "velocities")}
    return splat_extent(UsdSplats(**values), radius)


def _box(positions: FloatArray) -> FloatArray:
    """The box around points, (2, 3)."""
    return np.stack([positions.min(axis=0), positions.max(axis=0)]) if len(positions) else _NOWHERE


def _quath_array(rotations: NDArray[Any]) -> Any:
    """Quaternions (N, 4) wxyz as half precision; pxr takes rows with the real part last."""
    from pxr import Vt

    return Vt.QuathArray.FromNumpy(np.ascontiguousarray(np.roll(rotations, -1, axis=1).astype(np.float16)))


def _quatf_array(rotations: NDArray[Any]) -> Any:
    """Quaternions (N, 4) wxyz in single precision; pxr takes rows with the real part last."""
    from pxr import Vt

    return Vt.QuatfArray.FromNumpy(np.ascontiguousarray(np.roll(rotations, -1, axis=1)))
