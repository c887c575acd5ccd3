"""Another trainer's Gaussians as the keyframe: in the rig's world, on a lattice, compensated, and gone on with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.codec.scene.lattice import dequantise
from decogs.decoder import export
from decogs.decoder.rasterise.reference import BLUR
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.input.imported_splats import is_splat_file, read_splat_source
from decogs.encoder.keyframe.import_splats import MAX_ROUNDING_LOSS_DB, with_compensation
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.splat_files.ply import Ply
from decogs.formats.splats import Splats, sigmoid
from encode_rig import encode_rig as encode

OURS = b"comment SplatRenderMode: mip\n"


@pytest.fixture(scope="module")
def exported(moving: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The moving stream's keyframe as decogs-export writes it, turned upright."""
    folder = tmp_path_factory.mktemp("exported")
    for name in ("scene.ply", "scene.spz"):
        export(moving.path, folder / name, frames=range(0, 1))
    return folder


@pytest.fixture
def begin(moving_rig: Path, tiny_settings: Any, tiny_rig: Any, tmp_path: Path) -> Any:
    def run(keyframe: Path, **options: Any) -> Any:
        warnings: list[str] = []
        options = {"frames": range(0, 1), "holdout": [tiny_rig.held_out], "threads": 1} | options
        rig, output = options.pop("rig", moving_rig), options.pop("output", tmp_path / "out.dgs")
        settings = options.pop("settings", tiny_settings)
        report = encode(rig, output, settings, keyframe=keyframe, on_warning=warnings.append, **options)
        return report, warnings

    return run


@pytest.mark.parametrize("name", ["scene.ply", "scene.spz"])
def test_an_exported_keyframe_comes_back(begin: Any, moving: Any, exported: Path, name: str) -> None:
    """Within the .1 dB that a lattice may cost; later frames are trained as after any keyframe."""
    report, warnings = begin(exported / name, frames=range(0, 2))
    was = moving.report.frames
    assert report.frames[0].training_psnr > was[0].training_psnr - MAX_ROUNDING_LOSS_DB
    assert report.frames[1].training_psnr > was[1].training_psnr - 5 * MAX_ROUNDING_LOSS_DB
    assert report.frames[1].kind == "delta"
    assert not any("antialiasing" in text or "does not match" in text for text in warnings)


@pytest.mark.parametrize("up", ["none", "-Z", "X"])
def test_the_world_stands_as_the_pictures_show(begin: Any, moving: Any, tmp_path: Path, up: Any) -> None:
    """As the rig has it, without a word; turned in a way that is none of ours, the footage check says so."""
    path = tmp_path / "scene.ply"
    export(moving.path, path, frames=range(0, 1), up=up)
    report, warnings = begin(path)
    if up == "none":
        assert report.frames[0].training_psnr > moving.report.frames[0].training_psnr - MAX_ROUNDING_LOSS_DB
        assert warnings == []
    else:
        assert any("does not match frame 0" in text for text in warnings)


def first_splats(path: Path) -> tuple[Splats, Any]:
    with open_stream(path) as stream:
        frame = next(stream.frames(0, 1))
        return dequantise(frame.state, stream.header.lattice), stream.header


def test_gaussians_off_the_lattice_get_one_that_costs_little(
    begin: Any, moving: Any, tmp_path: Path, tiny_settings: Any
) -> None:
    """Nothing was trained to be rounded: values lie anywhere, quaternions have any length."""
    splats, _ = first_splats(moving.path)
    random = np.random.default_rng(1)
    away = replace(
        splats,
        log_scales=(splats.log_scales + random.uniform(-0.09, 0.09, splats.log_scales.shape)).astype(np.float32),
        quaternions=(splats.quaternions * random.uniform(0.1, 9, (len(splats), 1))).astype(np.float32),
        sh=(splats.sh + random.uniform(-0.04, 0.04, splats.sh.shape)).astype(np.float32),
    )
    path, output = tmp_path / "scene.ply", tmp_path / "out.dgs"
    path.write_bytes(Ply(compensated=True).encode(away))
    report, warnings = begin(path)
    _, header = first_splats(output)
    assert warnings == []
    assert header.settings["keyframe"]["file"] == "scene.ply"
    assert header.lattice.log_scales < 0.18 * tiny_settings.lattice_scale * 1.01
    assert header.settings["lattice_scale"] <= tiny_settings.lattice_scale
    assert all(camera.near > 0 for camera in header.cameras)
    assert report.frames[0].training_psnr > 20


def test_steps_that_would_show_are_halved(
    begin: Any, moving: Any, exported: Path, tiny_settings: Any, tmp_path: Path
) -> None:
    """Sixteen times the steps that the keyframe was trained to: rounding to them alone costs decibels."""
    report, warnings = begin(exported / "scene.ply", settings=replace(tiny_settings, lattice_scale=16.0))
    _, header = first_splats(tmp_path / "out.dgs")
    scale = header.settings["lattice_scale"]
    assert scale in (0.5, 1.0, 2.0, 4.0, 8.0)
    assert header.lattice.log_scales == pytest.approx(0.18 * scale)
    was = moving.report.frames[0].training_psnr
    assert report.frames[0].training_psnr > was - MAX_ROUNDING_LOSS_DB - 0.02
    assert not any("the lattice costs" in text for text in warnings)


def test_strangers_without_compensation_are_made_up_for_and_told(begin: Any, exported: Path, tmp_path: Path) -> None:
    path = tmp_path / "stranger.ply"
    path.write_bytes((exported / "scene.ply").read_bytes().replace(OURS, b""))
    _, warnings = begin(path)
    assert sum("antialiasing" in text for text in warnings) == 1


def test_opacity_and_size_make_up_for_the_filter() -> None:
    """Round Gaussians on the axis: sigma squared of s pixels loses sqrt(det) = s / (s + .3)."""
    camera = Camera("a", 100, 100, 50.0, 50.0, 50.0, 50.0, np.eye(4))
    depth, variances, opacity = 5.0, np.array([0.1, 1.0, 30.0]), np.array([0.2, 0.5, 0.95])
    splats = Splats(
        np.tile(np.float32([0, 0, depth]), (3, 1)),
        np.tile(np.log(np.sqrt(variances) * depth / 50)[:, None], (1, 3)).astype(np.float32),
        np.tile(np.float32([3, 0, 0, 0]), (3, 1)),
        np.log(opacity / (1 - opacity)).astype(np.float32),
        np.zeros((3, 1, 3), np.float32),
    )
    found = with_compensation(splats, [camera, camera])
    loss = variances / (variances + BLUR)
    np.testing.assert_allclose(sigmoid(found.opacity_logits), opacity / loss, rtol=1e-4)
    np.testing.assert_allclose(found.log_scales, splats.log_scales, atol=1e-6)
    # What opacity alone cannot make up for: opacity times area is what it was with the filter.
    bright = replace(splats, opacity_logits=np.full(3, np.log(9), np.float32))
    found = with_compensation(bright, [camera])
    small = np.array([True, True, False])
    np.testing.assert_allclose(sigmoid(found.opacity_logits)[small], 0.99, rtol=1e-4)
    area = np.exp(2 * (found.log_scales - bright.log_scales)[:, 0]) * variances * sigmoid(found.opacity_logits)
    np.testing.assert_allclose(area, 0.9 * (variances + BLUR), rtol=1e-3)
    unseen = with_compensation(replace(splats, means=-splats.means), [camera])
    np.testing.assert_array_equal(unseen.opacity_logits, splats.opacity_logits)


def test_gaussians_that_cannot_be_are_left_out_and_told(begin: Any, moving: Any, tmp_path: Path) -> None:
    splats, _ = first_splats(moving.path)
    splats.means[5, 0], splats.sh[9, 0, 1], splats.means[7, 1] = np.nan, np.inf, 3e20
    path = tmp_path / "scene.ply"
    path.write_bytes(Ply(compensated=True).encode(splats))
    _, warnings = begin(path)
    assert [text.partition(": ")[2][:17] for text in warnings] == ["2 of its Gaussian", "1 of its Gaussian"]
    assert len(first_splats(tmp_path / "out.dgs")[0]) == len(splats) - 3


def test_more_than_the_memory_holds_is_refused(exported: Path) -> None:
    with pytest.raises(UsageError, match=r"^`keyframe` .*scene\.spz: holds \d+ Gaussians.*`max_memory`"):
        read_splat_source(exported / "scene.spz", 20_000)


def test_other_footage_is_told(begin: Any, exported: Path, moving_rig: Path, tiny_rig: Any, tmp_path: Path) -> None:
    rig = tiny_rig.poisoned(moving_rig, tmp_path / "rig", "cam03")
    _, warnings = begin(exported / "scene.ply", rig=rig)
    assert any("does not match frame 0 of camera cam03" in text for text in warnings)


def test_an_encode_that_was_cut_off_goes_on_to_the_same_bytes(
    begin: Any, exported: Path, tmp_path: Path, moving_rig: Path
) -> None:
    whole, part = tmp_path / "whole.dgs", tmp_path / "cut.dgs"
    begin(exported / "scene.ply", output=whole, frames=range(0, 3))
    begin(exported / "scene.ply", output=part, frames=range(0, 2))
    data = part.read_bytes()
    part.unlink()
    Path(f"{part}.part").write_bytes(data)
    with pytest.raises(UsageError, match="keyframe"):
        begin(exported / "scene.spz", output=part, frames=range(0, 3), resume=True)
    begin(exported / "scene.ply", output=part, frames=range(0, 3), resume=True)
    assert part.read_bytes() == whole.read_bytes()


def test_what_is_no_keyframe_is_one_line(begin: Any, tmp_path: Path, exported: Path) -> None:
    one = Ply(True).decode((exported / "scene.ply").read_bytes())
    heap = replace(one, means=np.zeros_like(one.means))
    for name, data, says in (
        ("a.ply", b"ply\n", "no end of its header"),
        ("b.spz", b"zzz", "is no .spz"),
        ("c.ply", Ply(True).encode(heap), "in one place"),
    ):
        path = tmp_path / name
        path.write_bytes(data)
        with pytest.raises(UsageError, match=says) as caught:
            begin(path)
        assert str(caught.value).startswith("`keyframe` ")
        assert "\n" not in str(caught.value)
    with pytest.raises(UsageError, match="is read, as `keyframe`"):
        begin(exported / "scene.ply", output=exported / "scene.ply")


@pytest.mark.parametrize("name", ["scene.sog", "scene.splat", "scene.GLB", "meta.json", "scene"])
def test_splats_of_another_format_are_told_from_a_damaged_stream(begin: Any, tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(b"PK\3\4" + bytes(60))
    with pytest.raises(UsageError, match=rf"`keyframe` .*{name}: Gaussians are read from \.ply and \.spz; export it"):
        begin(tmp_path / name)
    assert not is_splat_file(tmp_path / "damaged.dgs")


def test_a_stream_needs_no_ending(moving: Any, tmp_path: Path) -> None:
    (tmp_path / "take.part").write_bytes(Path(moving.path).read_bytes())
    assert not is_splat_file(tmp_path / "take.part")
    assert not is_splat_file(tmp_path / "is not there")


def test_a_world_too_large_for_a_stream_is_one_line(begin: Any, tmp_path: Path, exported: Path) -> None:
    """Positions of 1e37: what is wrong is said of the file, not of a header that nobody has seen."""
    one = Ply(True).decode((exported / "scene.ply").read_bytes())
    (tmp_path / "far.ply").write_bytes(Ply(True).encode(replace(one, means=one.means * np.float32(1e37))))
    with pytest.raises(UsageError, match=r"`keyframe` .*far\.ply: a stream cannot hold a scene of .* units"):
        begin(tmp_path / "far.ply")
    assert not list(tmp_path.glob("out*"))
