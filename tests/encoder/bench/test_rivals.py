"""Rival ways to keep frames: what they write comes back, within the steps their formats have."""

from __future__ import annotations

import gzip
import stat
import struct
import sys
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from decogs.encoder.bench.rivals import splat4d
from decogs.encoder.bench.rivals.float_arrays import FloatArrays, FloatDeltas
from decogs.encoder.bench.rivals.ply import Ply
from decogs.encoder.bench.rivals.sequences import Coder, FilePerFrame, FrameFormat, SceneFrame, WithoutDirections
from decogs.encoder.bench.rivals.splat import RECORD, Splat
from decogs.encoder.bench.rivals.splat4d import Splat4d, of_one_length
from decogs.encoder.bench.rivals.spz import Spz
from decogs.formats.errors import UsageError
from decogs.formats.splats import Splats, join_splats, take_splats


def some_splats(count: int, coefficients: int, seed: int = 0) -> Splats:
    random = np.random.default_rng(seed)
    values = (
        random.normal(size=(count, 3)),
        random.uniform(-8, 1, (count, 3)),
        random.normal(size=(count, 4)),
        random.uniform(-5, 5, count),
        random.uniform(-0.9, 0.9, (count, coefficients, 3)),
    )
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def a_sequence() -> list[SceneFrame]:
    """Some move, one goes, two come, and in the last frame nothing changes."""
    first = some_splats(6, 4)
    moved = Splats(*(array.copy() for array in astuple(first)))
    moved.means[[1, 4]] += 0.25
    moved.sh[4, 2] += 0.5
    stays = [0, 1, 2, 4, 5]
    second = join_splats(take_splats(moved, np.array(stays)), some_splats(2, 4, seed=1))
    ids = np.array([*(10 + row for row in stays), 20, 21])
    return [SceneFrame(np.arange(10, 16), first), SceneFrame(ids, second), SceneFrame(ids, second)]


def assert_equal(found: Splats, expected: Splats) -> None:
    for a, b in zip(astuple(found), astuple(expected), strict=True):
        np.testing.assert_array_equal(a, b)


def unit(quaternions: np.ndarray) -> np.ndarray:
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


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


@pytest.mark.parametrize("file_format", [Spz(), Spz(14, 8, 8), Splat()], ids=repr)
def test_files_per_frame_are_counted_as_they_lie_on_disk(file_format: FrameFormat, tmp_path: Path) -> None:
    frames = a_sequence()
    coder = FilePerFrame(file_format)
    sizes = coder.write(lambda: iter(frames), tmp_path)
    lengths = [len(file_format.encode(frame.splats)) for frame in frames]
    assert (sizes.first, sizes.total) == (lengths[0], sum(lengths))
    assert [len(found) for found in coder.read(tmp_path)] == [6, 7, 7]


def test_ply_has_inrias_columns() -> None:
    splats = some_splats(2, 4)
    header, _, body = Ply().encode(splats).partition(b"end_header\n")
    names = [line.split()[-1] for line in header.decode().splitlines() if line.startswith("property float")]
    rows = np.frombuffer(body, "<f4").reshape(2, len(names))
    assert header.startswith(b"ply\nformat binary_little_endian 1.0\nelement vertex 2\n")
    assert len(names) == 17 + 9
    by_name = dict(zip(names, rows.T, strict=True))
    np.testing.assert_array_equal(by_name["f_rest_0"], splats.sh[:, 1, 0])
    np.testing.assert_array_equal(by_name["f_rest_1"], splats.sh[:, 2, 0], "red first, then green")
    np.testing.assert_array_equal(by_name["f_rest_3"], splats.sh[:, 1, 1])
    np.testing.assert_array_equal(by_name["rot_0"], splats.quaternions[:, 0])
    np.testing.assert_array_equal(by_name["scale_2"], splats.log_scales[:, 2])
    np.testing.assert_array_equal(by_name["nx"], 0)


HALF = 2.0**-0.5
SPZ_SPLATS = Splats(
    np.array([[1.0, -0.5, 2.0**-12]], np.float32),
    np.array([[-10.0, -5.0, -4.03]], np.float32),
    # Twice a turn of 90 degrees around -z: w and z are equally large, and the first of x, y, z, w leads.
    np.array([[2.0, 0.0, 0.0, -2.0]], np.float32),
    np.array([0.0], np.float32),
    np.array([[[0.0, 1.0, -9.0], [0.5, -0.5, 0.25], [0.03, 0.0, 0.0], [0.0, 0.0, 2.0]]], np.float32),
)
SPZ_BYTES = b"".join(
    (
        # NGSP, version 3, one Gaussian, degree 1, 12 fraction bits, no flags.
        struct.pack("<4sIIBBBB", b"NGSP", 3, 1, 1, 12, 0, 0),
        # 1 = 4096, -0.5 = -2048, 2^-12 = 1, 24 bits each.
        bytes([0x00, 0x10, 0x00, 0x00, 0xF8, 0xFF, 0x01, 0x00, 0x00]),
        # Opacity 0.5 = 127.5, to the even one.
        bytes([128]),
        # 127.5 to the even one; 1 * 0.15 * 255 + 127.5 = 165.75; below 0.
        bytes([128, 166, 0]),
        # (x + 10) * 16: 0; 80; 95.52.
        bytes([0, 80, 96]),
        # Largest: z (number 2), made positive; x = y = 0: sign 0, magnitude 0; but for the sign of the others, w turns
        # negative: sign 1, magnitude 511 of 1/sqrt(2). 2 << 30 | 1 << 9 | 511.
        struct.pack("<I", 2 << 30 | 1 << 9 | 511),
        # x * 128 + 128 to the nearest multiple of 8: 192, 64, 160; 131.84 = 132 goes up to 136; 128; above 255.
        bytes([192, 64, 160, 136, 128, 128, 128, 128, 255]),
    )
)


def test_spz_writes_the_bytes_of_its_description() -> None:
    assert gzip.decompress(Spz().encode(SPZ_SPLATS)) == SPZ_BYTES


def test_spz_reads_the_bytes_of_its_description() -> None:
    found = Spz().decode(gzip.compress(SPZ_BYTES))
    np.testing.assert_array_equal(found.means, SPZ_SPLATS.means)
    np.testing.assert_array_equal(found.log_scales, np.float32([[-10, -5, -4]]))
    np.testing.assert_allclose(found.quaternions, [[-HALF, 0, 0, HALF]], atol=1e-7)
    np.testing.assert_allclose(found.opacity_logits, [np.log(128 / 127)], rtol=1e-4)
    colour = [0.5 / 255 / 0.15, (166 / 255 - 0.5) / 0.15, -0.5 / 0.15]
    np.testing.assert_allclose(found.sh[0, 0], colour, rtol=1e-5)
    np.testing.assert_array_equal(found.sh[0, 1:], np.float32([[0.5, -0.5, 0.25], [0.0625, 0, 0], [0, 0, 127 / 128]]))


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize(("fraction_bits", "sh1_bits", "sh_rest_bits"), [(12, 5, 4), (14, 8, 8), (8, 3, 3)])
def test_spz_stays_within_half_a_step(coefficients: int, fraction_bits: int, sh1_bits: int, sh_rest_bits: int) -> None:
    splats = some_splats(500, coefficients)
    spz = Spz(fraction_bits, sh1_bits, sh_rest_bits)
    found = spz.decode(spz.encode(splats))
    rounding = 1e-6
    assert np.abs(found.means - splats.means).max() <= 0.5**fraction_bits / 2 + rounding
    assert np.abs(found.log_scales - splats.log_scales).max() <= 1 / 32 + rounding
    # A component's step is 1/sqrt(2)/511; the fourth follows from three and is at least a half.
    turned = np.abs((unit(found.quaternions) * unit(splats.quaternions)).sum(axis=1))
    assert np.degrees(2 * np.arccos(np.minimum(turned, 1))).max() < 0.3
    assert np.abs(found.sh[:, 0] - splats.sh[:, 0]).max() <= 1 / 255 / 0.15 / 2 + rounding
    bits = np.where(np.arange(coefficients - 1) < 3, sh1_bits, sh_rest_bits)[:, None]
    # Half a bucket, on top of half a 128th; the topmost bucket ends below 1.
    bound = (2.0 ** (8 - bits) / 2 + 0.5) / 128 + rounding
    assert (np.abs(found.sh[:, 1:] - splats.sh[:, 1:]) <= bound).all()


def test_spz_puts_what_lies_outside_at_the_end() -> None:
    far = Splats(np.float32([[1e6, -1e6, 0]]), *astuple(SPZ_SPLATS)[1:])
    found = Spz().decode(Spz().encode(far))
    np.testing.assert_allclose(found.means, [[2048, -2048, 0]], rtol=1e-6)


def test_fewer_bits_of_spz_are_fewer_bytes() -> None:
    splats = some_splats(500, 4)
    sizes = [len(Spz(*bits).encode(splats)) for bits in ((14, 8, 8), (12, 5, 4), (10, 4, 3), (8, 3, 3))]
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == 4


def test_splat_keeps_places_and_sizes_and_drops_directions() -> None:
    splats = some_splats(500, 4)
    data = Splat().encode(splats)
    assert len(data) == 500 * 32
    found = Splat().decode(data)
    np.testing.assert_array_equal(found.means, splats.means)
    np.testing.assert_allclose(found.log_scales, splats.log_scales, atol=1e-6)
    assert found.sh.shape == (500, 1, 3)
    # A level of 255 of display colour, which is 0.282 of the coefficient.
    assert np.abs(found.sh[:, 0] - splats.sh[:, 0]).max() <= 0.5 / 255 / 0.2820948 + 1e-6
    turned = np.abs((unit(found.quaternions) * unit(splats.quaternions)).sum(axis=1))
    # Half a step of 1/128 in each of four components.
    assert np.degrees(2 * np.arccos(np.minimum(turned, 1))).max() < 2
    opacities = [1 / (1 + np.exp(-s.opacity_logits)) for s in (found, splats)]
    assert np.abs(opacities[0] - opacities[1]).max() <= 0.5 / 255 + 1e-6


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
if kind == "encode":
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
    assert (sizes.first, sizes.total) == (8 * RECORD.itemsize, 3 * 8 * RECORD.itemsize)
    for found, frame in zip(coder.read(folder), frames, strict=True):
        shown = found.opacity_logits > -10
        np.testing.assert_array_equal(found.means[shown], frame.splats.means)


def test_splat4d_tells_why_it_failed(fake_command: Path, tmp_path: Path) -> None:
    fake_command.write_text("#!/bin/sh\necho 'Error: out of splats' >&2\nexit 1\n")
    with pytest.raises(UsageError, match="splat4d encode: Error: out of splats"):
        Splat4d(2, 4, 1, 2.5).write(lambda: iter(a_sequence()), tmp_path)


def test_splat4d_may_not_be_installed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(splat4d.sysconfig, "get_path", lambda name: str(tmp_path))
    assert Splat4d(2, 4, 0, 2).missing() == "not installed"


@pytest.mark.skipif(Splat4d(2, 4, 0, 2).missing() is not None, reason="needs the PyPI package splats4d")
def test_the_real_splat4d_keeps_its_bounds(tmp_path: Path) -> None:
    frames = a_sequence()
    coder = Splat4d(2, 4, 0, 2)
    sizes = coder.write(lambda: iter(frames), tmp_path)
    assert 0 < sizes.first < sizes.total
    for found, frame in zip(coder.read(tmp_path), frames, strict=True):
        assert len(found) == 8, "in an order of its own"
        nearest = np.linalg.norm(found.means[None] - frame.splats.means[:, None], axis=2).min(axis=1)
        assert nearest.max() <= np.sqrt(3) * 0.002 * 1.001
