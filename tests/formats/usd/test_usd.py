"""The USD writer: units and time, extents, cameras, what is sampled and what is not, and never half a file."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdValidation

from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.errors import UsageError
from decogs.formats.geometry.similarity import Similarity
from decogs.formats.geometry.up_direction import AXES, turn_between
from decogs.formats.usd.prims import UsdSplats, splat_extent
from decogs.formats.usd.writing import UsdWriter


def some_splats(count: int, seed: int = 0) -> UsdSplats:
    rng = np.random.default_rng(seed)
    rotations = rng.normal(size=(count, 4))
    rotations /= np.linalg.norm(rotations, axis=1, keepdims=True)
    arrays = (
        rng.normal(size=(count, 3)),
        rotations,
        rng.uniform(0.01, 0.5, (count, 3)),
        rng.uniform(size=(count, 3)),
        rng.uniform(size=count),
    )
    return UsdSplats(*(array.astype(np.float32) for array in arrays))


def some_camera(name: str = "cam00", **changes: Any) -> Camera:
    rotation = np.array(Gf.Matrix3d(Gf.Rotation(Gf.Vec3d(1, 2, 0.5), 40.0))).T
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = rotation, (0.3, -0.2, 4.0)
    values: dict[str, Any] = {"width": 352, "height": 264, "fx": 300.0, "fy": 310.0, "cx": 170.5, "cy": 140.0}
    return Camera(name, world_to_camera=world_to_camera, **(values | changes))


def write(path: Path, frames: list[UsdSplats], *, cameras: tuple[Camera, ...] = (), **options: Any) -> Usd.Stage:
    ids = np.arange(len(frames[0].positions), dtype=np.int64) + 7
    with UsdWriter(path, fps=25.0, frames=(0, len(frames) - 1), **options) as usd:
        usd.add_cameras(cameras)
        usd.add_group("Splats", ids)
        for index, splats in enumerate(frames):
            usd.write_frame("Splats", index, splats)
    return Usd.Stage.Open(str(path))


def validation_errors(stage: Usd.Stage) -> list[str]:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    return [error.GetMessage() for error in UsdValidation.ValidationContext(validators).Validate(stage)]


@pytest.mark.parametrize("suffix", [".usdc", ".usda", ".usd", ".usdz"])
def test_every_suffix_is_valid_and_carries_units_and_time(tmp_path: Path, suffix: str) -> None:
    stage = write(
        tmp_path / f"a{suffix}", [some_splats(5), some_splats(5, 1)], cameras=(some_camera(),), documentation="CC BY"
    )
    assert validation_errors(stage) == []
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, 1)
    assert stage.GetTimeCodesPerSecond() == stage.GetFramesPerSecond() == 25
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetDefaultPrim().GetPath() == "/World"
    assert stage.GetRootLayer().documentation == "CC BY"
    assert [item.name for item in tmp_path.iterdir()] == [f"a{suffix}"]


def test_validation_does_find_faults(tmp_path: Path) -> None:
    """The check used above must be able to fail: a stage without units and default prim is reported."""
    stage = Usd.Stage.CreateNew(str(tmp_path / "bare.usda"))
    UsdGeom.Xform.Define(stage, "/World")
    assert validation_errors(stage) != []


def test_the_root_turns_and_scales_all_and_no_array_does(tmp_path: Path) -> None:
    splats = some_splats(4)
    by = Similarity(turn_between(AXES["Z"], AXES["Y"]), 0.5)
    stage = write(tmp_path / "z.usdc", [splats], root=by, cameras=(some_camera(),))
    assert validation_errors(stage) == []
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    instancer = stage.GetPrimAtPath("/World/Splats")
    positions = UsdGeom.PointInstancer(instancer).GetPositionsAttr().Get()
    np.testing.assert_array_equal(np.array(positions), splats.positions)
    for path in ("Splats", "SplatsPoints"):
        placed = UsdGeom.Xformable(stage.GetPrimAtPath(f"/World/{path}")).ComputeLocalToWorldTransform(0)
        np.testing.assert_allclose(placed.Transform(Gf.Vec3d(1, 2, 3)), [0.5, 1.5, -1], atol=1e-12)
    there = UsdGeom.Xformable(stage.GetPrimAtPath("/World/Cameras/cam00")).ComputeLocalToWorldTransform(0)
    place = there.Transform(Gf.Vec3d(0))
    np.testing.assert_allclose(place, 0.5 * by.rotation @ camera_centre(some_camera()), atol=1e-12)


def test_extent_equals_what_usd_computes(tmp_path: Path) -> None:
    """Tolerance: USD computes with the half-precision orientations, relative error 2^-10, of boxes a few units wide."""
    stage = write(tmp_path / "a.usdc", [some_splats(50), some_splats(50, 1)], prototype_radius=2.0)
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Splats"))
    for frame in (0, 1):
        computed = np.array(instancer.ComputeExtentAtTime(frame, frame))
        np.testing.assert_allclose(np.array(instancer.GetExtentAttr().Get(frame)), computed, atol=5e-3)
        points = np.array(UsdGeom.Points(stage.GetPrimAtPath("/World/SplatsPoints")).GetPointsAttr().Get(frame))
        stated = np.array(UsdGeom.Points(stage.GetPrimAtPath("/World/SplatsPoints")).GetExtentAttr().Get(frame))
        np.testing.assert_array_equal(stated, [points.min(axis=0), points.max(axis=0)])


def test_extent_of_an_axis_aligned_splat_is_its_box() -> None:
    one = UsdSplats(*(np.array(v, np.float32) for v in ([[1, 2, 3]], [[1, 0, 0, 0]], [[1, 2, 4]], [[0, 0, 0]], [1])))
    np.testing.assert_array_equal(splat_extent(one, 0.5), [[0.5, 1, 1], [1.5, 3, 5]])


def test_only_what_changes_has_samples_and_interpolation_holds_still_before_a_change(tmp_path: Path) -> None:
    """Positions change at frame 3 only: samples at 2 (old) and 3 (new), and half way between them the mean."""
    first = some_splats(6)
    moved = UsdSplats(first.positions + np.float32(1), *list(vars(first).values())[1:])
    stage = write(tmp_path / "a.usdc", [first, first, first, moved, moved])
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Splats"))
    positions = instancer.GetPositionsAttr()
    assert positions.GetTimeSamples() == [2, 3]
    sampled = {a.GetName() for a in instancer.GetPrim().GetAttributes() if a.GetNumTimeSamples()}
    assert sampled == {"positions", "extent"}
    np.testing.assert_array_equal(np.array(positions.Get()), first.positions)
    np.testing.assert_array_equal(np.array(positions.Get(1.5)), first.positions)
    np.testing.assert_allclose(np.array(positions.Get(2.5)), first.positions + 0.5, atol=1e-6)
    np.testing.assert_array_equal(np.array(positions.Get(4)), moved.positions)


def test_points_carry_only_what_blender_reads(tmp_path: Path) -> None:
    """A half, double or int64 primvar would end Blender's import of every later one."""
    stage = write(tmp_path / "a.usdc", [some_splats(6)])
    points = stage.GetPrimAtPath("/World/SplatsPoints")
    kinds = {p.GetName(): str(p.GetTypeName()) for p in UsdGeom.PrimvarsAPI(points).GetAuthoredPrimvars()}
    assert kinds == {
        "primvars:displayColor": "color3f[]",
        "primvars:displayOpacity": "float[]",
        "primvars:splatId": "int[]",
    }
    assert UsdGeom.Points(points).GetPurposeAttr().Get() == "render"
    assert list(UsdGeom.Points(points).GetWidthsAttr().Get()) == [0.0] * 6


def test_ids_beyond_int32_stay_exact_and_drop_the_short_copy(tmp_path: Path) -> None:
    ids = np.array([3, 2**40], np.int64)
    with UsdWriter(tmp_path / "a.usdc", fps=30, frames=(0, 0)) as usd:
        usd.add_group("Splats", ids)
        usd.write_frame("Splats", 0, some_splats(2))
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    prim = stage.GetPrimAtPath("/World/Splats")
    assert list(UsdGeom.PointInstancer(prim).GetIdsAttr().Get()) == ids.tolist()
    assert not UsdGeom.PrimvarsAPI(prim).HasPrimvar("splatId")


def test_rows_that_are_not_alive_are_invisible_and_transparent(tmp_path: Path) -> None:
    splats = some_splats(3)
    with UsdWriter(tmp_path / "a.usdc", fps=30, frames=(0, 2)) as usd:
        usd.add_group("Splats", np.array([10, 11, 12], np.int64))
        for frame, alive in enumerate(([True, True, False], [True, True, True], [False, False, False])):
            usd.write_frame("Splats", frame, splats, np.array(alive))
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert validation_errors(stage) == []
    invisible = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Splats")).GetInvisibleIdsAttr()
    assert [list(invisible.Get(frame)) for frame in (0, 1, 1.9, 2)] == [[12], [], [], [10, 11, 12]]
    opacity = UsdGeom.PrimvarsAPI(stage.GetPrimAtPath("/World/SplatsPoints")).GetPrimvar("displayOpacity")
    np.testing.assert_array_equal(np.array(opacity.Get(0)), splats.opacities * [1, 1, 0])
    np.testing.assert_array_equal(np.array(opacity.Get(1)), splats.opacities)
    np.testing.assert_array_equal(np.array(opacity.Get(2)), np.zeros(3))


def test_a_usd_camera_shows_a_point_where_ours_does(tmp_path: Path) -> None:
    """Through GfCamera's frustum, independent of our formula. Tolerance: float32 apertures and focal length, relative
    error 6e-8 of up to 352 px through a short chain; 1e-3 px is ten times that."""
    camera = some_camera()
    stage = write(tmp_path / "a.usdc", [some_splats(2)], cameras=(camera,))
    frustum = UsdGeom.Camera(stage.GetPrimAtPath("/World/Cameras/cam00")).GetCamera(0).frustum
    matrix = frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()
    for point in np.random.default_rng(2).uniform(-1, 1, (20, 3)):
        x, y, z = (camera.world_to_camera @ [*point, 1.0])[:3]
        ours = (camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy)
        ndc = matrix.Transform(Gf.Vec3d(*point))
        theirs = ((ndc[0] + 1) / 2 * camera.width, (1 - ndc[1]) / 2 * camera.height)
        np.testing.assert_allclose(theirs, ours, atol=1e-3)


@pytest.mark.parametrize(("near", "clipped"), [(0.0, 0.01), (0.75, 0.75)])
def test_a_usd_camera_starts_to_see_at_the_near_plane(tmp_path: Path, near: float, clipped: float) -> None:
    stage = write(tmp_path / "a.usda", [some_splats(1)], cameras=(some_camera(near=near),))

    seen = UsdGeom.Camera(stage.GetPrimAtPath("/World/Cameras/cam00")).GetClippingRangeAttr().Get()

    assert tuple(seen) == pytest.approx((clipped, 10_000.0))


def test_camera_names_become_valid_and_unique_and_are_kept(tmp_path: Path) -> None:
    names = ("0", "1", "a b", "a_b", "cam00")
    cameras = tuple(some_camera(name, distortion_model="opencv", distortion=(0.1, 0.0, 0.0, 0.0)) for name in names)
    stage = write(tmp_path / "a.usdc", [some_splats(2)], cameras=cameras)
    assert validation_errors(stage) == []
    prims = stage.GetPrimAtPath("/World/Cameras").GetChildren()
    assert [prim.GetName() for prim in prims] == ["cam0", "cam1", "a_b", "a_b_2", "cam00"]
    kept = [prim.GetCustomDataByKey("decogs") for prim in prims]
    assert tuple(data["name"] for data in kept) == names
    assert (kept[0]["width"], kept[0]["distortionModel"], list(kept[0]["distortion"])) == (
        352,
        "opencv",
        [0.1, 0, 0, 0],
    )


def test_long_files_are_flushed_on_the_way_and_read_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("decogs.formats.usd.writing._FLUSH_BYTES", 1)
    frames = [some_splats(20, seed) for seed in range(6)]
    stage = write(tmp_path / "a.usdc", frames)
    positions = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Splats")).GetPositionsAttr()
    for index, splats in enumerate(frames):
        np.testing.assert_array_equal(np.array(positions.Get(index)), splats.positions)


def test_a_failed_export_leaves_the_old_file_and_nothing_else(tmp_path: Path) -> None:
    target = tmp_path / "a.usdc"
    target.write_bytes(b"the old file")

    def fail() -> None:
        with UsdWriter(target, fps=30, frames=(0, 0)) as usd:
            usd.add_group("Splats", np.array([1, 2], np.int64))
            usd.write_frame("Splats", 0, some_splats(2))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert target.read_bytes() == b"the old file"
    assert [item.name for item in tmp_path.iterdir()] == ["a.usdc"]


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("a.obj", {}, "choose one of these endings"),
        ("a", {}, "choose one of these endings"),
        ("missing/a.usdc", {}, "folder does not exist"),
        ("a.usdc", {"fps": 0.0}, "positive rate"),
        ("a.usdc", {"fps": float("nan")}, "positive rate"),
        ("a.usdc", {"prototype_radius": -1.0}, "positive number"),
    ],
)
def test_requests_that_cannot_be_met(tmp_path: Path, name: str, options: dict[str, Any], says: str) -> None:
    with pytest.raises(UsageError, match=says) as caught:
        UsdWriter(tmp_path / name, **({"fps": 30.0, "frames": (0, 1)} | options))
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_one_line(tmp_path: Path) -> None:
    name = "x" * 250 + ".usdc"
    with pytest.raises(UsageError, match="cannot be written") as caught:
        UsdWriter(tmp_path / name, fps=30, frames=(0, 1))
    assert "\n" not in str(caught.value)


def test_crate_is_of_a_version_that_older_readers_open(tmp_path: Path) -> None:
    """Blender 5.0 stops at 0.13; plain arrays and samples need no more than 0.8."""
    write(tmp_path / "a.usdc", [some_splats(3), some_splats(3, 1)])
    head = (tmp_path / "a.usdc").read_bytes()[:11]
    assert head[:8] == b"PXR-USDC"
    assert tuple(head[8:11]) <= (0, 8, 0)
    assert Sdf.Layer.FindOrOpen(str(tmp_path / "a.usdc")).GetFileFormat().formatId == "usdc"


PROGRAM = """
import os, signal, sys, threading, time
from pathlib import Path
from decogs.formats.usd.writing import UsdWriter

def ended(number, frame):
    raise SystemExit(7)

signal.signal(signal.SIGTERM, ended)
{when}
try:
    UsdWriter(Path(sys.argv[1]), fps=25, frames=(0, 1))
finally:
    print(sorted(name for name in sys.modules if name in ("pxr.Sdf", "pxr.UsdGeom")))
"""


@pytest.mark.parametrize(
    "when",
    [
        # While a module of OpenUSD looks for its texts, in C++, which prints and forgets what is raised there.
        "class Told:\n"
        "    def find_spec(self, name, *_):\n"
        "        if name == 'pxr.Sdf.__DOC': os.kill(os.getpid(), signal.SIGTERM)\n"
        "sys.meta_path.insert(0, Told())",
        # While the new file is given its first metadata.
        "from pxr import UsdGeom\n"
        "def told(*_): os.kill(os.getpid(), signal.SIGTERM); time.sleep(5)\n"
        "UsdGeom.SetStageUpAxis = told",
    ],
    ids=["while it is loaded", "while the file is made"],
)
def test_a_signal_ends_it_whenever_it_comes_and_leaves_nothing(tmp_path: Path, when: str) -> None:
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(when=when), str(tmp_path / "x.usda")], capture_output=True, check=False
    )
    assert (ended.returncode, ended.stderr) == (7, b"")
    assert ended.stdout == b"['pxr.Sdf', 'pxr.UsdGeom']\n"
    assert list(tmp_path.iterdir()) == []
