"""Splats over time as USD: point instancers that today's DCCs draw, with points beside each; splat prims; or both.

Layout, every array in world units and in one fixed order per group::

    /World                   Xform, default prim, a component; turns the world's up to Y, and scales it to metres
    /World/<Group>           PointInstancer: positions, orientations, scales, ids, displayColor, displayOpacity
    /World/<Group>/Splat     its prototype, a Sphere of radius k: an instance is the ellipsoid at k sigma
    /World/<Group>Points     Points in the same order: displayColor, displayOpacity, splatId; widths 0
    /World/<Group>Splats     ParticleField3DGaussianSplat: positions, orientations, scales, opacities, SH, splatId
    /World/Cameras/<name>    one Camera for every camera of the rig

Choices, and why:

* *The root turns.* A file always has Y up and metres, which every program understands in the same way; what the world
  has is brought there by one transform on /World, and no array has other values for it: ``upAxis`` and
  ``metersPerUnit`` can state neither -Y nor a turned world, and programs differ in heeding units.
* *Groups.* Gaussians that never change go to one group without a single time sample, the others to a second one. Crate
  files do not compress float arrays, so this is what keeps a file proportional to motion.
* *Fixed order, invisible ids.* A group holds every Gaussian that lives at any frame of a segment, always in the same
  rows; one that is not alive is listed in ``invisibleIds``. Arrays whose length changes in every frame would be smaller
  where births and deaths dominate, but readers could not interpolate between frames (no motion blur), and every
  attribute, ids included, would need a sample whenever the count changes.
* *Segments.* Whoever writes may give a group other rows from a frame on (`UsdWriter.regroup`): all attributes have
  samples there, and just before it the rows until then are written as they are at that frame, so that interpolation is
  right up to there. Without, every row that ever changes would be written in every frame, and a file would grow with
  the square of the take.
* *Never without rows at first.* Validators look at an attribute's default and its earliest sample: a group that gets
  rows later has its first ones from the beginning, hidden; one that never does is not written.
* *Samples only where something changes.* An attribute's default is its first value. The first change writes the old
  value one frame earlier and then the new one, so that interpolation holds still until there.
* *Velocities* only on request, and always with samples at the times of positions, where alone OpenUSD heeds them. They
  take 12 bytes a moving row and frame, and lead to where interpolation leads.
* *Points beside the instancer.* Blender drops every primvar of an instancer and keeps those of points (float, int,
  color3f; a half, double or int64 primvar would end its import of the later ones): this prim carries colour and
  opacity there. Its purpose is "render" and its width 0: imported by default, never drawn over the instances. A row
  that is not alive has opacity 0.
* *Splat prims* hold what the decoder has, in single precision and with all of its SH, since a file of them is for
  programs that draw Gaussians. Every array of a group has its length at every time, as readers demand, so a row that is
  not alive stays with opacity 0, and fades from one frame to the next where readers interpolate. At each frame the
  values are the decoder's bits.
* *Both flavours* in one file: splats have the purpose "render" and name the instancers, of purpose "proxy", as what
  stands in for them: no importer lets one choose a variant, and two sets without a purpose are drawn twice.
* *No material.* Hydra renderers use displayColor and displayOpacity of each instance by themselves. A material that
  reads its opacity from displayOpacity makes everything invisible in Blender.
* *Colours* are linear, as displayColor asks: the sRGB transfer function is undone for the view-independent colour. View
  dependence (SH degree 1 to 3) has no place in instancers and lens distortion none in USD; they are left out. Splat
  prims say that the colours of their SH are sRGB-coded.
* *Orientations* of instancers are half precision (quath) because Blender ignores the float attribute ``orientationsf``.

Source of the facts: OpenUSD 26.11 schemas, and imports into Blender 4.5 and 5.0.
"""

from __future__ import annotations

import glob
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera
from ..errors import UsageError, check_utf8
from ..geometry.similarity import NO_CHANGE, Similarity
from ..system.operating_systems import address_space
from .openusd import load_openusd
from .prims import Flavour, InstancerPrims, Prims, SplatPrims, UsdSplats

USD_SUFFIXES = (".usdc", ".usda", ".usd", ".usdz")

DEFAULT_PROTOTYPE_RADIUS = 1.5
"""Standard deviations at which an ellipsoid is drawn. A flat disc of sqrt(2) sigma carries as much opacity as the whole
Gaussian does; a little more closes the gaps between neighbours."""

_APERTURE = 0.36
"""Horizontal aperture of every camera in tenths of a world unit (a metre): a 36 mm picture, as film cameras have."""

_NEAR, _FAR = 0.01, 10_000.0
"""Clipping range of a camera in metres, for a near plane before the first: renderers need one above 0."""
_FLUSH_BYTES = 64 << 20
_INT32_MAX = 2**31 - 1
_PROBE_BYTES = 1 << 20
_A_TIME = time.mktime((1980, 1, 1, 12, 0, 0, 0, 1, 0))
"""The earliest day that an archive can state, by the clock that it states it in."""
_OF_USD = 2 * 10**9
"""Bytes of address space in which a stream of 84 kB is exported; in 1.2e9 OpenUSD ends the process."""


@dataclass
class _Group:
    """The stable ids of a group's rows, and the prims that show them."""

    ids: NDArray[np.int64]
    prims: tuple[Prims, ...]


class UsdWriter:
    """Writes one USD file, frame after frame, beside its final name, and gives it that name when it is complete.

    Use as a context manager: leaving it normally saves and renames, leaving it by an exception removes the file.
    Crate files are flushed as they grow, so that memory stays flat in the number of frames (.usda cannot be).

    ``frames`` is the first and last time code; ``fps`` becomes both frames and time codes per second. ``root`` brings
    the world to Y up and metres. A .usdz is packed from a crate file at the end. Raises UsageError for a name that is
    not USD's, for numbers out of range, and when the file cannot be written. ``flavour``: which prims show a group.
    ``asset``: name and version, for asset managers.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        fps: float,
        frames: tuple[int, int],
        root: Similarity = NO_CHANGE,
        prototype_radius: float = DEFAULT_PROTOTYPE_RADIUS,
        documentation: str = "",
        flavour: Flavour = "instancer",
        asset: tuple[str, str] | None = None,
    ) -> None:
        self.path = Path(path)
        check_usd_request(self.path, fps=fps, prototype_radius=prototype_radius)
        suffix = self.path.suffix.lower()
        self._packed = suffix == ".usdz"
        self._partial = self.path.with_name(
            f".{self.path.stem}.{os.getpid()}.partial{'.usdc' if self._packed else suffix}"
        )
        self._frames = frames
        self._radius = float(prototype_radius)
        self._flavour = flavour
        self._groups: dict[str, _Group] = {}
        self._unsaved = 0
        load_openusd()
        try:
            self._scale = root.scale
            self._stage = self._create(float(fps), root, documentation, asset)
        except BaseException:
            self._clear()
            raise

    def _create(self, fps: float, root: Similarity, documentation: str, asset: tuple[str, str] | None) -> Any:
        from pxr import Gf, Kind, Tf, Usd, UsdGeom

        try:
            stage = Usd.Stage.CreateNew(str(self._partial))
        except Tf.ErrorException as error:
            raise self._unwritable(error) from error
        UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.SetTimeCodesPerSecond(fps)
        stage.SetFramesPerSecond(fps)
        stage.SetStartTimeCode(self._frames[0])
        stage.SetEndTimeCode(self._frames[1])
        world = UsdGeom.Xform.Define(stage, "/World")
        model = Usd.ModelAPI(world)
        model.SetKind(Kind.Tokens.component)
        if asset is not None:
            model.SetAssetName(asset[0])
            model.SetAssetVersion(asset[1])
        if not root.is_identity:
            world.AddTransformOp().Set(Gf.Matrix4d(root.matrix.T.tolist()))
        stage.SetDefaultPrim(world.GetPrim())
        if documentation:
            stage.GetRootLayer().documentation = documentation
        return stage

    def add_cameras(self, cameras: Sequence[Camera]) -> list[str]:
        """The rig's cameras under /World/Cameras, as pinholes; returns their prim paths, in the given order.

        Names are made valid and unique; the original name, picture size and distortion ride along as custom data.
        """
        from pxr import Tf, UsdGeom

        if not cameras:
            return []
        UsdGeom.Scope.Define(self._stage, "/World/Cameras")
        paths: list[str] = []
        for camera in cameras:
            prefix = "cam" if camera.name[:1].isdigit() else ""
            base = f"/World/Cameras/{Tf.MakeValidIdentifier(prefix + camera.name)}"
            path, copy = base, 2
            while path in paths:
                path, copy = f"{base}_{copy}", copy + 1
            paths.append(path)
            _define_camera(self._stage, path, camera, self._scale)
        return paths

    def add_group(self, name: str, ids: NDArray[np.int64], *, largest_id: int | None = None) -> None:
        """Opens a group for these stable ids, (N,), all different and none negative: the prims of the flavour.

        ``largest_id``: of any that the group will have, when `regroup` gives it others.
        """
        ids = np.ascontiguousarray(ids, np.int64)
        largest = int(ids.max(initial=0)) if largest_id is None else largest_id
        short_ids, both = largest <= _INT32_MAX, self._flavour == "both"
        prims: list[Prims] = []
        if self._flavour != "splat":
            prims.append(InstancerPrims(self._stage, name, self._radius, short_ids=short_ids, stand_in=both))
        if self._flavour != "instancer":
            stand_in = f"/World/{name}" if both else None
            prims.append(SplatPrims(self._stage, name, short_ids=short_ids, stand_in_of=stand_in))
        self._groups[name] = _Group(ids, tuple(prims))

    def regroup(self, name: str, ids: NDArray[np.int64]) -> None:
        """Other stable ids for a group, from its next frame on; write the present ones `just_before` that first."""
        self._groups[name].ids = np.ascontiguousarray(ids, np.int64)

    def write_frame(
        self,
        name: str,
        time: float,
        splats: UsdSplats,
        alive: NDArray[np.bool_] | None = None,
        *,
        until: float | None = None,
    ) -> None:
        """The group's rows at ``time``, times in rising order; ``alive`` (N,) hides the rows that do not exist then.

        The first frame becomes the default value. ``until``: the time up to which nothing of the group will change; it
        then gets another number of rows, so that readers, which interpolate arrays of equal length only, hold it until
        there. The arrays are kept to compare with: do not change them afterwards.
        """
        group = self._groups[name]
        shown = np.ones(len(group.ids), np.bool_) if alive is None else alive
        self._unsaved += sum(prims.push(time, group.ids, splats, shown, until) for prims in group.prims)
        if self._unsaved >= _FLUSH_BYTES:
            self._save()

    def _save(self) -> None:
        from pxr import Tf

        try:
            self._stage.GetRootLayer().Save()
        except Tf.ErrorException as error:
            raise self._unwritable(error) from error
        self._unsaved = 0

    def _unwritable(self, error: Exception) -> UsageError:
        return UsageError(
            f"{self.path}: cannot be written ({_refusal(self._partial) or _reason(error)}); choose another place"
        )

    def __enter__(self) -> UsdWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self._save()
                self._close()
                os.replace(self._package() if self._packed else self._partial, self.path)
        except OSError as failure:
            raise UsageError(f"{self.path}: cannot be written ({failure.strerror})") from failure
        finally:
            self._close()
            self._clear()

    def _clear(self) -> None:
        # What OpenUSD itself was writing when it failed bears the same name with another ending.
        for left in self.path.parent.glob(f"{glob.escape(self._partial.stem)}.*"):
            left.unlink(missing_ok=True)

    def _package(self) -> Path:
        """The crate file in a .usdz of its own, still beside the final name."""
        from pxr import Tf, UsdUtils

        package = self._partial.with_suffix(".usdz")
        # The archive keeps the file's time, and the same export shall have the same bytes.
        os.utime(self._partial, (_A_TIME, _A_TIME))
        try:
            packed = UsdUtils.CreateNewUsdzPackage(str(self._partial), str(package), f"{self.path.stem}.usdc")
        except Tf.ErrorException as error:
            raise self._unwritable(error) from error
        if not packed:
            raise UsageError(f"{self.path}: OpenUSD could not pack the file; write .usdc instead")
        return package

    def _close(self) -> None:
        self._groups.clear()
        self._stage = None


def check_usd_request(path: Path, *, fps: float, prototype_radius: float) -> None:
    """Raises UsageError for a USD file that could not be written as asked; cheap, for use before long work."""
    check_utf8(path)
    _check_memory(path)
    if path.suffix.lower() not in USD_SUFFIXES:
        raise UsageError(f"{path}: USD is written as {', '.join(USD_SUFFIXES)}; choose one of these endings")
    if not path.parent.is_dir():
        raise UsageError(f"{path}: its folder does not exist; create it first")
    if path.is_dir():
        raise UsageError(f"{path}: is a folder; give the name of a file")
    if not (np.isfinite(fps) and fps > 0):
        raise UsageError(f"{path}: {fps} frames per second; USD needs a positive rate")
    if not (np.isfinite(prototype_radius) and prototype_radius > 0):
        raise UsageError(f"{path}: prototype radius {prototype_radius}; give a positive number of standard deviations")


def _check_memory(path: Path) -> None:
    """Raises UsageError where OpenUSD would end the process: it does not notice that the system gives it no memory."""
    allowed = address_space()
    if allowed is not None and allowed < _OF_USD:
        raise UsageError(
            f"{path}: this process may take {allowed / 1e9:.1f} GB of address space (ulimit -v), and OpenUSD needs "
            f"{_OF_USD / 1e9:.0f} GB; raise the limit"
        )


def _refusal(path: Path) -> str | None:
    """What the system says to more bytes in this file, which OpenUSD does not pass on; None if it takes them."""
    try:
        with path.open("ab") as file, tempfile.TemporaryFile(dir=path.parent) as other:
            for probe in (file, other):
                probe.write(bytes(_PROBE_BYTES))
                probe.flush()
                os.fsync(probe.fileno())
    except OSError as error:
        return error.strerror
    return None


def _reason(error: Exception) -> str:
    """The last line of what OpenUSD says, without its source location."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[-1].rpartition("' -- ")[2].strip("' ") if lines else type(error).__name__


def _define_camera(stage: Any, path: str, camera: Camera, scale: float) -> None:
    """One USD camera (looks along -z, y up) that shows what the pinhole of an OpenCV camera (along +z, y down) shows.

    Source: UsdGeomCamera, apertures and offsets in the same unit as the focal length; the window reaches from
    offset - aperture / 2 to offset + aperture / 2. Pixels need not be square: focal length follows fx, height fy. The
    clipping range is in the scene's units, of which a unit of the world is ``scale``.
    """
    from pxr import Gf, UsdGeom, Vt

    focal = _APERTURE * camera.fx / camera.width
    vertical = focal * camera.height / camera.fy
    camera_to_world = np.linalg.inv(camera.world_to_camera) @ np.diag([1.0, -1.0, -1.0, 1.0])
    prim = UsdGeom.Camera.Define(stage, path)
    prim.AddTransformOp().Set(Gf.Matrix4d(camera_to_world.T.tolist()))
    prim.CreateProjectionAttr(UsdGeom.Tokens.perspective)
    prim.CreateFocalLengthAttr(focal)
    prim.CreateHorizontalApertureAttr(_APERTURE)
    prim.CreateVerticalApertureAttr(vertical)
    prim.CreateHorizontalApertureOffsetAttr(_APERTURE * (0.5 - camera.cx / camera.width))
    prim.CreateVerticalApertureOffsetAttr(vertical * (camera.cy / camera.height - 0.5))
    prim.CreateClippingRangeAttr(Gf.Vec2f(max(camera.near * scale, _NEAR), _FAR))
    source = {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "distortionModel": camera.distortion_model,
    }
    if camera.distortion:
        source["distortion"] = Vt.DoubleArray(list(camera.distortion))
    prim.GetPrim().SetCustomDataByKey("decogs", source)
