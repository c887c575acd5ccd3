"""Exported frames read back per stable id: what the decoder shows is what the USD file holds."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdValidation

from decogs.decoder.exporting import usd as usd_export
from decogs.decoder.exporting.usd import ExportFrame, export_usd, take_census, usd_splats
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.splats import SH_C0, Splats, take_splats
from usd_takes import a_long_take, living_scene, moved, replay, some_splats


@pytest.fixture(scope="module", params=[8, 6, 3, 2, 1], ids="segments of {}".format)
def exported(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[list[ExportFrame], Usd.Stage]:
    frames = living_scene()
    path = tmp_path_factory.mktemp("usd") / "scene.usdc"
    camera = Camera("cam00", 64, 48, 50.0, 50.0, 32.0, 24.0, np.eye(4))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(usd_export, "SEGMENT", request.param)
        report = export_usd(replay(frames), path, fps=30, cameras=[camera], documentation="licence: CC0")
    assert (report.frame_count, report.file_bytes) == (7, path.stat().st_size)
    return frames, Usd.Stage.Open(str(path))


def instancers(stage: Usd.Stage) -> list[UsdGeom.PointInstancer]:
    order = ("Static", "Resting", "Dynamic")
    prims = [prim for prim in stage.GetPrimAtPath("/World").GetChildren() if prim.IsA(UsdGeom.PointInstancer)]
    prims.sort(key=lambda prim: order.index(prim.GetName().rstrip("0123456789")))
    return [UsdGeom.PointInstancer(prim) for prim in prims]


def visible(stage: Usd.Stage, frame: float) -> dict[int, tuple[NDArray[np.float64], ...]]:
    """Everything the stage shows at a time, by id: position, scale, rotation wxyz, colour, opacity."""
    shown = {}
    for instancer in instancers(stage):
        mask = np.array(instancer.ComputeMaskAtTime(frame) or [True] * len(instancer.GetIdsAttr().Get(frame)))
        primvars = UsdGeom.PrimvarsAPI(instancer)
        orientations = instancer.GetOrientationsAttr().Get(frame)
        rows = zip(
            instancer.GetIdsAttr().Get(frame),
            np.array(instancer.GetPositionsAttr().Get(frame)),
            np.array(instancer.GetScalesAttr().Get(frame)),
            np.array([[q.GetReal(), *q.GetImaginary()] for q in orientations]),
            np.array(primvars.GetPrimvar("displayColor").Get(frame)),
            np.array(primvars.GetPrimvar("displayOpacity").Get(frame)),
            mask,
            strict=True,
        )
        shown.update({identity: tuple(values) for identity, *values, alive in rows if alive})
    return shown


def test_file_is_valid_and_spans_the_frames(exported: tuple[list[ExportFrame], Usd.Stage]) -> None:
    _, stage = exported
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert [e.GetMessage() for e in UsdValidation.ValidationContext(validators).Validate(stage)] == []
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (3, 9)
    assert stage.GetPrimAtPath("/World/Cameras/cam00").GetTypeName() == "Camera"
    assert stage.GetRootLayer().documentation == "licence: CC0"


def test_every_frame_reads_back_by_id(exported: tuple[list[ExportFrame], Usd.Stage]) -> None:
    """Positions, scales and opacities are float32, as decoded: equal. Orientations are half precision: rounding to 11
    significant bits moves a component of a unit quaternion by at most 2^-12, and USD, which computes with halves where
    a time lies between two equal samples, by 2^-10; colours come from the definition in float64, rounded to float32
    (relative 2^-24; 1e-6 leaves room for the power function)."""
    frames, stage = exported
    for frame in frames:
        shown = visible(stage, frame.index)
        assert sorted(shown) == sorted(frame.ids.tolist())
        splats = frame.splats
        scales = np.exp(splats.log_scales)
        unit = splats.quaternions.astype(np.float64)
        unit /= np.linalg.norm(unit, axis=1, keepdims=True)
        for row, identity in enumerate(frame.ids.tolist()):
            position, scale, rotation, colour, opacity = shown[identity]
            np.testing.assert_array_equal(position, splats.means[row])
            np.testing.assert_array_equal(scale, scales[row])
            unit = splats.quaternions[row].astype(np.float64) / np.linalg.norm(
                splats.quaternions[row].astype(np.float64)
            )
            np.testing.assert_allclose(rotation, unit, atol=2.0**-10)
            coded = np.clip(0.5 + SH_C0 * splats.sh[row, 0].astype(np.float64), 0, 1)
            linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
            np.testing.assert_allclose(colour, linear, rtol=1e-6, atol=1e-7)
            np.testing.assert_allclose(opacity, 1 / (1 + np.exp(-float(splats.opacity_logits[row]))), rtol=1e-6)


def test_static_is_what_never_changes_and_has_no_time_sample(exported: tuple[list[ExportFrame], Usd.Stage]) -> None:
    _, stage = exported
    static, dynamic = instancers(stage)[0], instancers(stage)[-1]
    changing = {*range(0, 24, 3), 60, 200, 201, 202}
    assert set(static.GetIdsAttr().Get()) == set(range(0, 120, 3)) - changing
    if len(instancers(stage)) == 2:
        assert set(dynamic.GetIdsAttr().Get()) == changing
        assert dynamic.GetIdsAttr().GetNumTimeSamples() == 0
    for name in ("Static", "StaticPoints"):
        attributes = stage.GetPrimAtPath(f"/World/{name}").GetAttributes()
        assert [a.GetName() for a in attributes if a.GetNumTimeSamples()] == []
    assert dynamic.GetPositionsAttr().GetNumTimeSamples() > 1


def test_the_points_beside_match_the_instances_row_by_row(exported: tuple[list[ExportFrame], Usd.Stage]) -> None:
    frames, stage = exported
    for instancer in instancers(stage):
        points = stage.GetPrimAtPath(f"{instancer.GetPath()}Points")
        primvars = UsdGeom.PrimvarsAPI(points)
        for frame in frames:
            ids = np.array(instancer.GetIdsAttr().Get(frame.index))
            np.testing.assert_array_equal(np.array(primvars.GetPrimvar("splatId").Get(frame.index)), ids)
            assert len(UsdGeom.Points(points).GetWidthsAttr().Get(frame.index)) == len(ids)
            assert len(instancer.GetProtoIndicesAttr().Get(frame.index)) == len(ids)
            alive = ~np.isin(ids, instancer.GetInvisibleIdsAttr().Get(frame.index))
            assert np.isin(ids[alive], frame.ids).all()
            positions = np.array(UsdGeom.Points(points).GetPointsAttr().Get(frame.index))
            np.testing.assert_array_equal(positions, np.array(instancer.GetPositionsAttr().Get(frame.index)))
            opacity = np.array(primvars.GetPrimvar("displayOpacity").Get(frame.index))
            there = np.array(UsdGeom.PrimvarsAPI(instancer).GetPrimvar("displayOpacity").Get(frame.index))
            np.testing.assert_array_equal(opacity, np.where(alive, there, 0))


def test_nothing_moves_between_frames_that_are_equal(exported: tuple[list[ExportFrame], Usd.Stage]) -> None:
    """Frames 4 and 5 are the same: half way between them too."""
    frames, stage = exported
    at_4, between = (visible(stage, time) for time in (4, 4.5))
    for identity, (position, scale, rotation, colour, opacity) in at_4.items():
        now = between[identity]
        for value, other in zip((position, scale, colour, opacity), (now[0], now[1], now[3], now[4]), strict=True):
            np.testing.assert_allclose(value, other, rtol=2.0**-23)
        np.testing.assert_allclose(now[2], rotation, atol=2.0**-10)
    assert sorted(between) == sorted(frames[1].ids.tolist())


def test_half_way_between_frames_everything_is_half_way(exported: tuple[list[ExportFrame], Usd.Stage]) -> None:
    """Over the ends of segments as well, where rows change: those end 1/1024 of a frame early, and by so much of the
    way a value may be off. Whoever is not in the next frame stays until then."""
    frames, stage = exported
    for before, after in itertools.pairwise(frames):
        now = visible(stage, before.index + 0.5)
        assert sorted(now) == sorted(before.ids.tolist())
        follows = dict(zip(after.ids.tolist(), after.splats.means, strict=True))
        for identity, here in zip(before.ids.tolist(), before.splats.means, strict=True):
            there = follows.get(identity, here)
            bound = np.abs(there - here).max() / 1024 + 1e-6
            np.testing.assert_allclose(now[identity][0], (here.astype(float) + there) / 2, atol=bound)


def instances(stage: Usd.Stage, time: float) -> dict[int, NDArray[np.float64]]:
    """Where OpenUSD itself puts each visible instance at a time, by id, in the world's units."""
    places = {}
    for instancer in instancers(stage):
        # Of masks and of prototypes it wants none, so that rows and ids pair.
        all_rows = UsdGeom.PointInstancer.IgnoreMask
        matrices = instancer.ComputeInstanceTransformsAtTime(
            time, time, UsdGeom.PointInstancer.ExcludeProtoXform, all_rows
        )
        ids = instancer.GetIdsAttr().Get(time)
        shown = instancer.ComputeMaskAtTime(time) or [True] * len(ids)
        rows = zip(ids, matrices, shown, strict=True)
        places.update({identity: np.array(matrix.ExtractTranslation()) for identity, matrix, seen in rows if seen})
    return places


@pytest.mark.parametrize("take", ["short", pytest.param("long", marks=pytest.mark.slow)])
def test_velocities_lead_to_the_next_frame(tmp_path: Path, take: str) -> None:
    """A second, in units of the world: times 25 what lies between a frame and the next, 0 for who is not in both.

    OpenUSD goes by them: half way between frames, an instance that is in both is half way. Tolerance: float32.
    """
    frames = living_scene() if take == "short" else a_long_take(20, everywhere=True)
    export_usd(replay(frames), tmp_path / "a.usdc", fps=25, velocities=True)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    assert (
        UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators()).Validate(stage)
        == []
    )
    moved = 0
    for frame, following in zip(frames, [*frames[1:], None], strict=True):
        here = dict(zip(frame.ids.tolist(), frame.splats.means, strict=True))
        there = {} if following is None else dict(zip(following.ids.tolist(), following.splats.means, strict=True))
        for instancer in instancers(stage):
            velocities = instancer.GetVelocitiesAttr().Get(frame.index)
            if velocities is None:
                assert instancer.GetPath().name != "Dynamic"
                continue
            ids = instancer.GetIdsAttr().Get(frame.index)
            for identity, velocity in zip(ids, np.array(velocities), strict=True):
                both = identity in here and identity in there
                expected = 25 * (there[identity].astype(float) - here[identity]) if both else np.zeros(3)
                np.testing.assert_allclose(velocity, expected, rtol=1e-5, atol=1e-6)
                moved += bool(np.any(velocity))
        half = instances(stage, frame.index + 0.5)
        for identity in here.keys() & there.keys():
            middle = (here[identity].astype(float) + there[identity]) / 2
            np.testing.assert_allclose(half[identity], middle, rtol=1e-5, atol=1e-5)
    assert moved > 10


def test_a_file_without_velocities_has_no_attribute_for_them(exported: tuple[list[ExportFrame], Usd.Stage]) -> None:
    _, stage = exported
    assert not any(instancer.GetVelocitiesAttr().IsAuthored() for instancer in instancers(stage))


@pytest.mark.parametrize(
    ("everywhere", "frames", "most"),
    [(False, (10, 80), 8.2), (True, (10, 80), 8.2), pytest.param(True, (80, 160), 2.1, marks=pytest.mark.slow)],
)
def test_a_file_grows_with_the_take_and_not_with_its_square(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, everywhere: bool, frames: tuple[int, int], most: float
) -> None:
    """Even where motion comes past everything, and what has moved rests again."""
    take = a_long_take(frames[1], everywhere=everywhere)

    def growth() -> float:
        short, long = (export_usd(replay(take[:length]), tmp_path / "a.usdc", fps=30).file_bytes for length in frames)
        return long / short

    assert growth() <= most
    monkeypatch.setattr(usd_export, "SEGMENT", 1000)
    assert growth() > 1.3 * most, "or this take says nothing"


def test_rows_that_rest_are_written_once_a_segment(tmp_path: Path) -> None:
    """And once for as many segments as they rest for: that of 2, of 4, as long as the take is longer."""
    take = a_long_take(6 * usd_export.SEGMENT, everywhere=True)
    export_usd(replay(take), tmp_path / "a.usdc", fps=30)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    shortest = usd_export.SEGMENT
    for name, length in (("Resting", shortest), (f"Resting{2 * shortest}", 2 * shortest), ("Resting16", 16)):
        resting = UsdGeom.PointInstancer(stage.GetPrimAtPath(f"/World/{name}"))
        starts = list(range(0, len(take), length))
        assert resting.GetPositionsAttr().GetTimeSamples() == starts
        rows = [len(resting.GetIdsAttr().Get(time)) for time in range(len(take))]
        assert all(rows[before] != rows[after] for before, after in itertools.pairwise(starts)), (
            "or readers interpolate"
        )
        for start in starts:
            assert len(set(rows[start : start + length])) == 1
            here, late = (np.array(resting.GetOrientationsAttr().Get(start + t)) for t in (0, length - 0.01))
            np.testing.assert_array_equal(here, late)
    assert not stage.GetPrimAtPath(f"/World/Resting{8 * shortest}"), "the take is shorter"
    for frame in take:
        assert sorted(visible(stage, frame.index)) == sorted(frame.ids.tolist())
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert [e.GetMessage() for e in UsdValidation.ValidationContext(validators).Validate(stage)] == []


def test_longer_segments_write_less(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take = a_long_take(80, everywhere=True)
    nested = export_usd(replay(take), tmp_path / "a.usdc", fps=30).file_bytes
    monkeypatch.setattr(usd_export, "NEST", 1000)
    assert nested < 0.85 * export_usd(replay(take), tmp_path / "a.usdc", fps=30).file_bytes


def test_the_extents_are_those_that_usd_computes(exported: tuple[list[ExportFrame], Usd.Stage]) -> None:
    """Through the plug-in that validators ask, which wants as many widths as points. Tolerance: half precision of the
    orientations, 2^-11 of boxes some units wide."""
    frames, stage = exported
    for prim in stage.GetPrimAtPath("/World").GetChildren():
        if not prim.IsA(UsdGeom.Boundable):
            continue
        for frame in frames:
            stated = UsdGeom.Boundable(prim).GetExtentAttr().Get(frame.index)
            if "Points" in prim.GetName():
                rows = len(UsdGeom.Points(prim).GetPointsAttr().Get(frame.index))
                computed = UsdGeom.Boundable.ComputeExtentFromPlugins(UsdGeom.Boundable(prim), frame.index)
            else:
                rows = np.isin(UsdGeom.PointInstancer(prim).GetIdsAttr().Get(frame.index), frame.ids).sum()
                computed = UsdGeom.PointInstancer(prim).ComputeExtentAtTime(frame.index, frame.index)
            if rows:
                np.testing.assert_allclose(np.array(stated), np.array(computed), atol=5e-3)


def test_a_still_scene_has_no_dynamic_prim(tmp_path: Path) -> None:
    first = living_scene()[0]
    frames = [ExportFrame(index, first.ids, first.splats) for index in range(4)]
    report = export_usd(replay(frames), tmp_path / "still.usdc", fps=24)
    assert (report.static_count, report.dynamic_count) == (40, 0)
    stage = Usd.Stage.Open(str(tmp_path / "still.usdc"))
    assert [prim.GetName() for prim in stage.GetPrimAtPath("/World").GetChildren()] == ["Static", "StaticPoints"]
    assert stage.GetEndTimeCode() == 3


def test_a_scene_that_changes_whole_has_no_static_prim(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    frames = [ExportFrame(index, np.arange(5, dtype=np.int64), some_splats(rng, 5)) for index in range(2)]
    assert export_usd(replay(frames), tmp_path / "all.usda", fps=24).static_count == 0
    stage = Usd.Stage.Open(str(tmp_path / "all.usda"))
    assert [prim.GetName() for prim in stage.GetPrimAtPath("/World").GetChildren()] == ["Dynamic", "DynamicPoints"]


def test_a_frame_without_splats(tmp_path: Path) -> None:
    first = living_scene()[0]
    nobody = ExportFrame(4, first.ids[:0], take_splats(first.splats, np.zeros(0, np.intp)))
    export_usd(replay([first, nobody, ExportFrame(5, first.ids, first.splats)]), tmp_path / "gap.usdc", fps=24)
    stage = Usd.Stage.Open(str(tmp_path / "gap.usdc"))
    mask = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Dynamic")).ComputeMaskAtTime
    assert list(mask(4)) == [False] * 40
    assert [list(mask(time)) for time in (3, 5)] == [[], []]  # USD's way to say that every instance is visible


def test_view_dependence_alone_is_no_change() -> None:
    """USD's display colour has none, so a splat whose higher SH changed stays static."""
    first = living_scene()[0]
    sh = first.splats.sh.copy()
    sh[:, 1:] += 1
    splats = Splats(*list(vars(first.splats).values())[:4], sh)
    assert len(take_census([first, ExportFrame(4, first.ids, splats)]).dynamic_ids) == 0


def test_a_quaternion_of_norm_zero_is_no_rotation() -> None:
    rng = np.random.default_rng(0)
    splats = some_splats(rng, 2)
    splats.quaternions[0] = 0
    np.testing.assert_array_equal(usd_splats(splats).rotations[0], [1, 0, 0, 0])


def test_extreme_opacities_stay_finite() -> None:
    splats = some_splats(np.random.default_rng(0), 3)
    splats.opacity_logits[:] = (-200, 0, 200)
    np.testing.assert_allclose(usd_splats(splats).opacities, [0, 0.5, 1], atol=1e-30)


def test_no_frames_is_a_clear_error_and_no_file(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="no frame to export"):
        export_usd(replay([]), tmp_path / "a.usdc", fps=30)
    assert list(tmp_path.iterdir()) == []


def test_a_wrong_name_is_refused_before_any_frame_is_decoded(tmp_path: Path) -> None:
    def decode() -> Iterator[ExportFrame]:
        pytest.fail("a frame was asked for")

    with pytest.raises(UsageError, match="endings"):
        export_usd(decode, tmp_path / "a.obj", fps=30)


def test_indices_that_do_not_rise_and_ids_that_repeat_are_refused() -> None:
    first = living_scene()[0]
    with pytest.raises(ValueError, match="must rise"):
        take_census([first, first])
    with pytest.raises(ValueError, match="id twice"):
        take_census([ExportFrame(0, np.zeros(40, np.int64), first.splats)])


def test_a_single_gaussian_that_rests_is_written_as_one(tmp_path: Path) -> None:
    """Number 4 moves in the second segment only, 1 to 3 in every frame."""
    rng, take = np.random.default_rng(1), []
    ids, splats = np.arange(5, dtype=np.int64), some_splats(rng, 5)
    for index in range(7):
        take.append(ExportFrame(index, ids, splats))
        splats = moved(splats, np.array([1, 2, 3] if index < usd_export.SEGMENT + 1 else [1, 2, 3, 4]), rng)
    export_usd(replay(take), tmp_path / "a.usdc", fps=30)
    stage = Usd.Stage.Open(str(tmp_path / "a.usdc"))
    resting = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/Resting"))
    assert list(resting.GetIdsAttr().Get(0)) == [4]
