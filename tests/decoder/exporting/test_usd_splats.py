"""Splat prims: every frame holds the decoder's own values, and every array the length that readers ask for."""

from __future__ import annotations

import itertools
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdValidation, UsdVol

from decogs.decoder import export, open_stream
from decogs.decoder.commands import export_main
from decogs.decoder.exporting import usd as usd_export
from decogs.decoder.exporting.usd import ExportFrame, export_usd
from decogs.formats.errors import UsageError
from decogs.formats.splat_files.quantised import unit_rotations
from decogs.formats.splats import Splats, join_splats, sigmoid, take_splats
from usd_takes import a_long_take, living_scene, replay, some_splats

KIND = "ParticleField3DGaussianSplat"
VALIDATOR = os.environ.get("DECOGS_ASSET_VALIDATOR", "")
ARRAYS = ("positions", "orientations", "scales", "opacities")
SH = "radiance:sphericalHarmonicsCoefficients"


def splat_prims(stage: Usd.Stage) -> list[Any]:
    return [UsdVol.ParticleField3DGaussianSplat(prim) for prim in stage.Traverse() if prim.GetTypeName() == KIND]


def shown(stage: Usd.Stage, time: float) -> dict[int, tuple[NDArray[np.float32], ...]]:
    """What is seen at a time, by id: position, rotation wxyz, scale, opacity, SH. Opacity 0 is not seen."""
    seen = {}
    for field in splat_prims(stage):
        ids = UsdGeom.PrimvarsAPI(field).GetPrimvar("splatId").Get(time)
        rotations = [(q.GetReal(), *q.GetImaginary()) for q in field.GetOrientationsAttr().Get(time)]
        opacities = np.array(field.GetOpacitiesAttr().Get(time), np.float32)
        sh = np.array(field.GetRadianceSphericalHarmonicsCoefficientsAttr().Get(time), np.float32)
        rows = zip(
            ids,
            np.array(field.GetPositionsAttr().Get(time), np.float32).reshape(-1, 3),
            np.array(rotations, np.float32).reshape(-1, 4),
            np.array(field.GetScalesAttr().Get(time), np.float32).reshape(-1, 3),
            opacities,
            sh.reshape(len(ids), -1, 3) if len(ids) else [],
            strict=True,
        )
        for identity, *values in rows:
            assert values[3] == 0 or identity not in seen, "an id is seen twice"
            if values[3] > 0:
                seen[identity] = tuple(values)
    return seen


def check_frame(stage: Usd.Stage, time: float, ids: NDArray[np.int64], splats: Splats) -> None:
    """Bit for bit, all of it."""
    seen = shown(stage, time)
    assert sorted(seen) == sorted(ids.tolist())
    rows = [seen[identity] for identity in ids.tolist()]
    expected = (
        splats.means,
        unit_rotations(splats),
        np.exp(splats.log_scales),
        sigmoid(splats.opacity_logits),
        splats.sh,
    )
    for column, values in enumerate(expected):
        assert values.dtype == np.float32
        np.testing.assert_array_equal(np.array([row[column] for row in rows]), values)


def every_time(stage: Usd.Stage) -> list[float]:
    """Each sample's time of any attribute of any splat prim, and the times in the middle."""
    times = sorted(
        {time for field in splat_prims(stage) for a in field.GetPrim().GetAttributes() for time in a.GetTimeSamples()}
    )
    return sorted([*times, *((before + after) / 2 for before, after in itertools.pairwise(times))])


def check_lengths(stage: Usd.Stage) -> None:
    """As Blender's reader in development asks (its io/usd/intern/usd_reader_particlefield.cc): equal lengths of four
    arrays, (degree + 1) squared coefficients for each position, one degree for all times; or it shows nothing."""
    for field in splat_prims(stage):
        prim = field.GetPrim()
        degree = field.GetRadianceSphericalHarmonicsDegreeAttr()
        assert degree.GetNumTimeSamples() == 0
        for time in [Usd.TimeCode.Default(), *every_time(stage)]:
            lengths = {len(prim.GetAttribute(name).Get(time)) for name in ARRAYS}
            assert len(lengths) == 1, (prim.GetPath(), time, lengths)
            (count,) = lengths
            assert len(prim.GetAttribute(SH).Get(time)) == count * (degree.Get() + 1) ** 2
            assert len(UsdGeom.PrimvarsAPI(prim).GetPrimvar("splatId").Get(time)) == count


def errors_of(stage: Usd.Stage) -> list[str]:
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    return [error.GetMessage() for error in UsdValidation.ValidationContext(validators).Validate(stage)]


def write(path: Path, frames: list[ExportFrame], **options: Any) -> Usd.Stage:
    export_usd(replay(frames), path, **{"fps": 30, "flavour": "splat"} | options)
    return Usd.Stage.Open(str(path))


@pytest.mark.parametrize("segment", [8, 3, 2, 1])
@pytest.mark.parametrize("flavour", ["splat", "both"])
def test_every_frame_has_the_decoders_bits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, segment: int, flavour: str
) -> None:
    monkeypatch.setattr(usd_export, "SEGMENT", segment)
    frames = living_scene()
    stage = write(tmp_path / "a.usdc", frames, flavour=flavour)
    assert errors_of(stage) == []
    check_lengths(stage)
    for frame in frames:
        check_frame(stage, frame.index, frame.ids, frame.splats)


@pytest.mark.parametrize("everywhere", [False, True])
def test_a_long_take_has_them_in_frames_asked_for_at_random(tmp_path: Path, everywhere: bool) -> None:
    frames = a_long_take(21, everywhere=everywhere)
    stage = write(tmp_path / "a.usdc", frames)
    check_lengths(stage)
    for index in np.random.default_rng(7).permutation(len(frames))[:9]:
        check_frame(stage, frames[index].index, frames[index].ids, frames[index].splats)


@pytest.mark.parametrize("degree", [0, 2, 3])
def test_all_view_dependence_is_there(tmp_path: Path, degree: int) -> None:
    rng = np.random.default_rng(degree)
    ids = np.arange(6, dtype=np.int64)
    frames = [ExportFrame(index, ids, some_splats(rng, 6, degree)) for index in range(3)]
    stage = write(tmp_path / "a.usdc", frames)
    (field,) = splat_prims(stage)
    assert field.GetRadianceSphericalHarmonicsDegreeAttr().Get() == degree
    check_lengths(stage)
    for frame in frames:
        check_frame(stage, frame.index, frame.ids, frame.splats)


def test_view_dependence_that_changes_alone_is_a_change(tmp_path: Path) -> None:
    first = living_scene()[0]
    sh = first.splats.sh.copy()
    sh[:5, 1:] += 1
    later = ExportFrame(4, first.ids, Splats(*list(vars(first.splats).values())[:4], sh))
    assert export_usd(replay([first, later]), tmp_path / "a.usdc", fps=30, flavour="splat").dynamic_count == 5
    assert export_usd(replay([first, later]), tmp_path / "b.usdc", fps=30).dynamic_count == 0
    check_frame(Usd.Stage.Open(str(tmp_path / "a.usdc")), 4, later.ids, later.splats)


def test_a_value_that_rests_for_some_frames_is_not_interpolated_from_its_ends(tmp_path: Path) -> None:
    """USD computes (1 - a) x + a x between two equal samples, which is not always x."""
    rng = np.random.default_rng(2)
    ids, values = np.arange(200, dtype=np.int64), [some_splats(rng, 200) for _ in range(3)]
    frames = [ExportFrame(index, ids, values[0 if index == 0 else 1 if index < 7 else 2]) for index in range(8)]
    stage = write(tmp_path / "a.usdc", frames)
    for frame in frames:
        check_frame(stage, frame.index, frame.ids, frame.splats)


def test_who_appears_later_is_there_before_and_hidden(tmp_path: Path) -> None:
    """Ten frames in which nothing moves, then one Gaussian: the group of the movers has no rows before."""
    first = living_scene()[0]
    frames = [ExportFrame(index, first.ids, first.splats) for index in range(10)]
    more = np.append(first.ids, 999)
    rng = np.random.default_rng(3)
    frames += [
        ExportFrame(10, more, join_splats(first.splats, some_splats(rng, 1))),
        ExportFrame(11, first.ids, first.splats),
    ]
    stage = write(tmp_path / "a.usdc", frames)
    field = UsdVol.ParticleField3DGaussianSplat(stage.GetPrimAtPath("/World/DynamicSplats"))
    assert len(field.GetPositionsAttr().Get()) == 1
    assert list(field.GetOpacitiesAttr().Get(3)) == [0]
    assert list(field.GetOpacitiesAttr().Get(9)) == [0]
    assert not stage.GetPrimAtPath("/World/RestingSplats"), "it never has rows"
    check_lengths(stage)
    for frame in frames:
        check_frame(stage, frame.index, frame.ids, frame.splats)


def test_what_the_prims_say_beside_their_arrays(tmp_path: Path) -> None:
    stage = write(tmp_path / "a.usda", living_scene(), flavour="both")
    assert {"StaticSplats", "DynamicSplats"} <= {field.GetPrim().GetName() for field in splat_prims(stage)}
    for field in splat_prims(stage):
        prim = field.GetPrim()
        assert prim.GetCustomDataByKey("decogs")["SplatRenderMode"] == "mip"
        assert "det(C + 0.3 I)" in prim.GetCustomDataByKey("decogs")["opacityCompensation"]
        assert Usd.ColorSpaceAPI(prim).GetColorSpaceNameAttr().Get() == "srgb_rec709_display"
        assert field.GetSortingModeHintAttr().Get() == "zDepth"
        assert field.GetProjectionModeHintAttr().Get() == "perspective"
        assert prim.GetAttribute(SH).GetMetadata("elementSize") == 4
        assert UsdGeom.Imageable(prim).ComputePurpose() == "render"
        stand_in, purpose = field.ComputeProxyPrim()
        assert stand_in.GetName() == prim.GetName().removesuffix("Splats")
        assert purpose == prim
        assert UsdGeom.Imageable(stand_in).ComputePurpose() == "proxy"
    alone = write(tmp_path / "b.usda", living_scene())
    assert len(splat_prims(alone)) == len(alone.GetPrimAtPath("/World").GetChildren())
    assert {UsdGeom.Imageable(field).ComputePurpose() for field in splat_prims(alone)} == {"default"}


def test_a_box_holds_three_sigma_of_all_that_is_seen(tmp_path: Path) -> None:
    """Corners of every splat's box in float64, by the rotation matrix of the unit quaternion."""
    frames = living_scene()
    stage = write(tmp_path / "a.usdc", frames)
    for frame in frames:
        boxes = np.array([field.GetExtentAttr().Get(frame.index) for field in splat_prims(stage)])
        low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
        w, x, y, z = unit_rotations(frame.splats).T.astype(float)
        first = np.array([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]).T
        reach = 3 * np.linalg.norm(first * np.exp(frame.splats.log_scales), axis=1)
        assert (frame.splats.means[:, 0] - reach >= low[0] - 1e-5).all()
        assert (frame.splats.means[:, 0] + reach <= high[0] + 1e-5).all()


def test_a_frame_without_splats(tmp_path: Path) -> None:
    first = living_scene()[0]
    nobody = ExportFrame(4, first.ids[:0], take_splats(first.splats, np.zeros(0, np.intp)))
    stage = write(tmp_path / "a.usdc", [first, nobody, ExportFrame(5, first.ids, first.splats)])
    assert shown(stage, 4) == {}
    assert len(shown(stage, 5)) == 40


@pytest.mark.parametrize("suffix", [".usdc", ".usd", ".usda", ".usdz"])
@pytest.mark.parametrize("kind", ["splat", "both", "instancer"])
def test_the_command_writes_what_is_asked_for(small_stream: Any, tmp_path: Path, suffix: str, kind: str) -> None:
    path = tmp_path / f"a{suffix}"
    assert export_main([str(small_stream.path), "-o", str(path), "--prim", kind, "--first-frame", "5"]) == 0
    stage = Usd.Stage.Open(str(path))
    assert errors_of(stage) == []
    kinds = {str(prim.GetTypeName()) for prim in stage.Traverse()}
    assert (KIND in kinds, "PointInstancer" in kinds) == (kind != "instancer", kind != "splat")
    check_lengths(stage)
    if kind != "instancer":
        with open_stream(small_stream.path) as stream:
            for index in (6, 0, 3):
                (frame,) = stream.frames(index, index + 1)
                check_frame(stage, 5 + index, frame.state.ids, frame.splats)


def test_a_prim_of_what_is_not_usd_and_one_that_there_is_not(small_stream: Any, tmp_path: Path, capsys: Any) -> None:
    assert export_main([str(small_stream.path), "-o", str(tmp_path / "a.ply"), "--prim", "splat"]) == 2
    assert re.search("--prim splat: the output is a .ply; name a .usdc", capsys.readouterr().err)
    with pytest.raises(UsageError, match="`prim` mesh: no such kind of prim"):
        export(small_stream.path, tmp_path / "a.usdc", prim="mesh")  # type: ignore[arg-type]
    for arguments in (["-o", str(tmp_path / "a.ply")], ["-o", str(tmp_path / "a.usdc"), "--prim", "splat"]):
        assert export_main([str(small_stream.path), *arguments, "--velocities"]) == 2
        assert "no place for them" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["scene.dgs"]


_VALIDATE = """
import json, logging, sys
logging.disable(logging.CRITICAL)
import omni.asset_validator as validator
engine = validator.ValidationEngine(init_rules=True)
engine.enable_rule(validator.GaussianSplatSchemaChecker)
issues = engine.validate(sys.argv[1]).issues()
print(json.dumps([[i.severity.name, i.rule and i.rule.__name__, i.message] for i in issues]))
"""


def omniverse_issues(path: Path) -> list[list[str]]:
    environment = os.environ | {"PYTHONPATH": VALIDATOR}
    command = [sys.executable, "-c", _VALIDATE, str(path)]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True, cwd=path.parent)
    found: list[list[str]] = json.loads(done.stdout.splitlines()[-1])
    return found


@pytest.mark.skipif(
    not VALIDATOR,
    reason="omniverse-asset-validator: pip install --target FOLDER --no-deps it, and name FOLDER in "
    "DECOGS_ASSET_VALIDATOR",
)
@pytest.mark.parametrize("kind", ["splat", "both", "instancer"])
def test_omniverse_asset_validator_finds_no_error(small_stream: Any, tmp_path: Path, kind: Any) -> None:
    """Its warning on repeated values stays: indexed primvars are what importers of instancers fail at."""
    export(small_stream.path, tmp_path / "a.usdc", prim=kind)
    take = replay(a_long_take(20, everywhere=True))
    export_usd(take, tmp_path / "b.usdc", fps=30, flavour=kind, velocities=kind != "splat")
    for name in ("a.usdc", "b.usdc"):
        left = {(severity, rule) for severity, rule, _ in omniverse_issues(tmp_path / name)}
        assert left <= ({("WARNING", "IndexedPrimvarChecker")} if kind != "splat" else set())
    stage = Usd.Stage.Open(str(tmp_path / "b.usdc"))
    if kind != "instancer":
        opacities = splat_prims(stage)[0].GetOpacitiesAttr()
        opacities.Set([2.0] * len(opacities.Get()))
        stage.Export(str(tmp_path / "wrong.usdc"))
        assert any(rule == "GaussianSplatSchemaChecker" for _, rule, _ in omniverse_issues(tmp_path / "wrong.usdc"))
