"""Rival ways to keep frames: what they write comes back, within the steps their formats have."""

from __future__ import annotations

import importlib.util
import stat
import sys
import sysconfig
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from decogs.bench.rivals.float_arrays import FloatArrays, FloatDeltas
from decogs.bench.rivals.fourdgs import FourDGS
from decogs.bench.rivals.sequences import Coder, FilePerFrame, FrameFormat, SceneFrame, Sizes, WithoutDirections
from decogs.bench.rivals.splat4d import Splat4d, of_one_length
from decogs.formats.errors import UsageError
from decogs.formats.splat_files.ply import Ply
from decogs.formats.splat_files.quantised import opacities, unit_rotations
from decogs.formats.splat_files.splat import RECORD, Splat
from decogs.formats.splat_files.spz import Spz
from decogs.formats.splats import SH_C0, Splats, join_splats, take_splats
from random_splats import random_splats


def a_sequence() -> list[SceneFrame]:
    """Some move, one goes, two come, and in the last frame nothing changes."""
    first = random_splats(6, 4)
    moved = Splats(*(array.copy() for array in astuple(first)))
    moved.means[[1, 4]] += 0.25
    moved.sh[4, 2] += 0.5
    stays = [0, 1, 2, 4, 5]
    second = join_splats(take_splats(moved, np.array(stays)), random_splats(2, 4, seed=1))
    ids = np.array([*(10 + row for row in stays), 20, 21])
    return [SceneFrame(np.arange(10, 16), first), SceneFrame(ids, second), SceneFrame(ids, second)]


def assert_equal(found: Splats, expected: Splats) -> None:
    for a, b in zip(astuple(found), astuple(expected), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("coder", [FilePerFrame(FloatArrays()), FilePerFrame(Ply()), FloatDeltas()], ids=repr)
def test_lossless_rivals_bring_back_every_bit(coder: Coder, tmp_path: Path) -> None:
    frames = a_sequence()
    sizes = coder.write(lambda: iter(frames), tmp_path)
    for found, frame in zip(coder.read(tmp_path), frames, strict=True):
        assert_equal(found, frame.splats)
    on_disk = sorted(path.stat().st_size for path in tmp_path.iterdir())
    assert (sum(on_disk), len(on_disk)) == (sizes.total, 3)
    assert sizes.first in on_disk


def test_float_deltas_hold_what_changes_only(tmp_path: Path) -> None:
    frames = a_sequence()
    FloatDeltas().write(lambda: iter(frames), tmp_path)
    first, second, third = (path.stat().st_size for path in sorted(tmp_path.iterdir()))
    # Two rows changed and two came of the seven; random floats do not compress.
    assert second < 0.75 * first
    assert third < 40, "three counts and a zstd frame around them"


@pytest.mark.parametrize("file_format", [Spz(), Spz(14, 8, 8), Spz(version=4), Splat()], ids=repr)
def test_files_per_frame_are_counted_as_they_lie_on_disk(file_format: FrameFormat, tmp_path: Path) -> None:
    frames = a_sequence()
    coder = FilePerFrame(file_format)
    sizes = coder.write(lambda: iter(frames), tmp_path)
    lengths = [len(file_format.encode(frame.splats)) for frame in frames]
    assert (sizes.first, sizes.total) == (lengths[0], sum(lengths))
    assert [len(found) for found in coder.read(tmp_path)] == [6, 7, 7]


def test_without_directions_only_degree_0_is_kept(tmp_path: Path) -> None:
    frames = a_sequence()
    coder = WithoutDirections(FilePerFrame(FloatArrays()))
    coder.write(lambda: iter(frames), tmp_path)
    for found, frame in zip(coder.read(tmp_path), frames, strict=True):
        np.testing.assert_array_equal(found.sh, frame.splats.sh[:, :1])
        np.testing.assert_array_equal(found.means, frame.splats.means)


def test_a_fixed_set_of_gaussians_hides_who_is_not_there() -> None:
    frames = a_sequence()
    tables = [table.copy() for table in of_one_length(lambda: iter(frames))]
    assert [len(table) for table in tables] == [8, 8, 8], "six at first, and two come"
    there = np.array([[1, 1, 1, 1, 1, 1, 0, 0], [1, 1, 1, 0, 1, 1, 1, 1], [1, 1, 1, 0, 1, 1, 1, 1]], bool)
    for table, shown, frame in zip(tables, there, frames, strict=True):
        assert not table["opacity"][~shown].any()
        assert table[shown].tobytes() == Splat().encode(frame.splats)
    # Who is not there stays where it was last, or will be first.
    assert tables[1]["mean"][3].tolist() == tables[0]["mean"][3].tolist()
    assert tables[0]["mean"][6].tolist() == tables[1]["mean"][6].tolist()


FAKE_SPLAT4D = f"""#!{sys.executable}
import pathlib, sys
kind, arguments = sys.argv[1], sys.argv[2:]
value = lambda name: pathlib.Path(arguments[arguments.index(name) + 1])
if kind == "info":
    print('{{"n": 8, "t": 3, "fps": 20, "gops": [{{"offset": 100, "len": 60}}, {{"offset": 160, "len": 9}}]}}')
elif kind == "encode":
    assert "--pos-mm=2" in arguments and "--rot-steps=1" in arguments and "--scale-pct=2.5" in arguments
    value("-o").write_bytes(b"".join(path.read_bytes() for path in sorted(value("-i").iterdir())))
else:
    whole = pathlib.Path(arguments[0]).read_bytes()
    size, k = 8 * 32, int(str(value("--frame")))
    value("-o").write_bytes(whole[k * size : (k + 1) * size])
"""


@pytest.fixture
def fake_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A ``splat4d`` that keeps .splat files one behind the other."""
    command = tmp_path / "bin" / "splat4d"
    command.parent.mkdir()
    command.write_text(FAKE_SPLAT4D)
    command.chmod(command.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", str(command.parent))
    return command


def test_splat4d_is_given_the_sequence_and_asked_for_each_frame(fake_command: Path, tmp_path: Path) -> None:
    frames = a_sequence()
    folder = tmp_path / "scratch"
    folder.mkdir()
    coder = Splat4d(2, 4, 1, 2.5)
    assert coder.missing() is None
    sizes = coder.write(lambda: iter(frames), folder)
    assert sizes == Sizes(8 * RECORD.itemsize, 3 * 8 * RECORD.itemsize, 160)
    for found, frame in zip(coder.read(folder), frames, strict=True):
        np.testing.assert_array_equal(found.means, frame.splats.means)


def test_splat4d_tells_why_it_failed(fake_command: Path, tmp_path: Path) -> None:
    fake_command.write_text("#!/bin/sh\necho 'Error: out of splats' >&2\nexit 1\n")
    with pytest.raises(UsageError, match="splat4d encode: Error: out of splats"):
        Splat4d(2, 4, 1, 2.5).write(lambda: iter(a_sequence()), tmp_path)


def test_splat4d_may_not_be_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(sysconfig, "get_path", lambda name: str(tmp_path))
    assert Splat4d(2, 4, 0, 2).missing() == "not installed"


@pytest.mark.skipif(Splat4d(2, 4, 0, 2).missing() is not None, reason="needs the PyPI package splats4d")
def test_the_real_splat4d_keeps_its_bounds(tmp_path: Path) -> None:
    frames = a_sequence()
    coder = Splat4d(2, 4, 0, 2)
    sizes = coder.write(lambda: iter(frames), tmp_path)
    assert 0 < sizes.first < sizes.total == sizes.wait, "three frames are one group"
    for found, frame in zip(coder.read(tmp_path), frames, strict=True):
        assert len(found) == len(frame.splats), "in an order of its own"
        nearest = np.linalg.norm(found.means[None] - frame.splats.means[:, None], axis=2).min(axis=1)
        assert nearest.max() <= np.sqrt(3) * 0.002 * 1.001


def test_fourdgs_may_not_be_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert FourDGS("fine").missing() == "not installed"


@pytest.mark.skipif(FourDGS("fine").missing() is not None, reason="needs the PyPI package fourdgs")
@pytest.mark.parametrize("coder", [FourDGS("fine"), FourDGS("coarse", 2, None)], ids=repr)
def test_the_real_fourdgs_keeps_its_bounds(coder: FourDGS, tmp_path: Path) -> None:
    frames = a_sequence()
    sizes = coder.write(lambda: iter(frames), tmp_path)
    (file,) = tmp_path.iterdir()
    assert 0 < sizes.first < sizes.total == file.stat().st_size
    share, levels, size = {"fine": (0.02, 0.5, 0.005), "coarse": (0.2, 3, 0.06)}[coder.profile]
    scales = np.exp(np.concatenate([frame.splats.log_scales for frame in frames]))
    for found, frame in zip(coder.read(tmp_path), frames, strict=True):
        kept = frame.splats
        assert np.abs(found.means - kept.means).max() <= share * np.median(scales) * 1.001  # float32
        assert np.abs(found.log_scales - kept.log_scales).max() <= np.log1p(size) + 1e-6
        colours = [np.clip(SH_C0 * splats.sh[:, 0] + 0.5, 0, 1) for splats in (found, kept)]
        assert 255 * np.abs(colours[0] - colours[1]).max() <= levels + 1e-3
        turned = np.abs((unit_rotations(found) * unit_rotations(kept)).sum(axis=1))
        assert turned.min() > 0.999
        assert 255 * np.abs(opacities(found) - opacities(kept)).max() <= levels + 1e-3
