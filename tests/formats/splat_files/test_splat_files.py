"""Files of Gaussians: their bytes by each format's own description, what comes back, and what a public tool reads."""

from __future__ import annotations

import gzip
import io
import json
import os
import re
import shutil
import struct
import subprocess
import zipfile
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import zstandard

from decogs.formats.errors import UsageError
from decogs.formats.geometry.rotations import rotation_matrices
from decogs.formats.geometry.similarity import Similarity, transformed_splats
from decogs.formats.geometry.up_direction import AXES, turn_between
from decogs.formats.splat_files import Extremes, SplatFormat, splat_formats
from decogs.formats.splat_files.glb import Glb
from decogs.formats.splat_files.ply import Ply
from decogs.formats.splat_files.sog import Sog
from decogs.formats.splat_files.splat import Splat
from decogs.formats.splat_files.spz import Spz
from decogs.formats.splats import Splats, empty_splats, take_splats
from random_splats import random_splats


def unit(quaternions: np.ndarray) -> np.ndarray:
    return quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def test_ply_has_inrias_columns() -> None:
    splats = random_splats(2, 4)
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
    splats = random_splats(500, coefficients)
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
    splats = random_splats(500, 4)
    sizes = [len(Spz(*bits).encode(splats)) for bits in ((14, 8, 8), (12, 5, 4), (10, 4, 3), (8, 3, 3))]
    assert sizes == sorted(sizes, reverse=True)
    assert len(set(sizes)) == 4


def test_splat_keeps_places_and_sizes_and_drops_directions() -> None:
    splats = random_splats(500, 4)
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


def test_every_format_is_found_by_its_ending() -> None:
    assert dict(splat_formats()) == {".glb": Glb, ".ply": Ply, ".sog": Sog, ".splat": Splat, ".spz": Spz}


def test_spz_4_is_a_header_two_sizes_a_stream_and_the_streams() -> None:
    """Every kind of value is what version 3 holds, by itself behind zstd; without SH there is no sixth stream."""
    for splats, streams in ((SPZ_SPLATS, 6), (Splats(*astuple(SPZ_SPLATS)[:4], SPZ_SPLATS.sh[:, :1]), 5)):
        data = Spz(version=4, compensated=True).encode(splats)
        header = struct.unpack_from("<4sIIBBBBI12s", data)
        assert header == (b"NGSP", 4, 1, splats.sh_degree, 12, 1, streams, 32, bytes(12))
        at, found = 32 + 16 * streams, []
        for small, large in (struct.unpack_from("<QQ", data, 32 + 16 * i) for i in range(streams)):
            found.append(zstandard.ZstdDecompressor().decompress(data[at : at + small]))
            assert len(found[-1]) == large
            at += small
        assert at == len(data)
        assert b"".join(found) == SPZ_BYTES[16 : 16 + sum(map(len, found))]


def test_spz_2_has_x_y_and_z_of_a_rotation() -> None:
    turns = np.float32([[-0.5, 0.5, -0.5, 0.5], [1, 0, 0, 0]])
    splats = replace(random_splats(2, 1), quaternions=turns)
    raw = gzip.decompress(Spz(version=2).encode(splats))
    # w is made positive; 127.5 * x + 127.5 is 63.75, 191.25 and 63.75, and for no rotation 127.5, to the even one.
    assert raw[-6:] == bytes([64, 191, 64, 128, 128, 128])
    found = Spz().decode(Spz(version=2).encode(splats))
    # Half a step of 1/127.5 in each of three components.
    np.testing.assert_allclose(found.quaternions * [[-1], [1]], turns, atol=0.013)


@pytest.mark.parametrize("version", [2, 3, 4])
def test_spz_states_antialiasing_in_its_flags(version: Any) -> None:
    data = [Spz(version=version, compensated=state).encode(SPZ_SPLATS) for state in (False, True)]
    raw = [part if version == 4 else gzip.decompress(part) for part in data]
    assert [part[14] for part in raw] == [0, 1]


@pytest.mark.parametrize(("farthest", "bits"), [(0.0, 14), (511.9, 14), (512.5, 13), (2047.9, 12), (8e6, 0)], ids=str)
def test_spz_has_as_many_fraction_bits_as_the_farthest_leaves(farthest: float, bits: int) -> None:
    form, left_out = Spz().fitted(Extremes(1, 1, farthest, 1))
    assert isinstance(form, Spz)
    assert (form.fraction_bits, form.sh1_bits, form.sh_rest_bits, left_out) == (bits, 8, 8, [])
    splats = replace(random_splats(1, 1), means=np.float32([[farthest, -farthest, 0]]))
    np.testing.assert_allclose(form.decode(form.encode(splats)).means, splats.means, atol=0.5**bits / 2 * 1.01)


@pytest.mark.parametrize(("log_scale", "held"), [(-9.9, True), (-10.1, False), (5.9, True), (6.0, False)])
def test_spz_holds_sizes_between_two_ends(log_scale: float, held: bool) -> None:
    splats = replace(SPZ_SPLATS, log_scales=np.full_like(SPZ_SPLATS.log_scales, log_scale))
    least, most = Spz.log_scales
    assert (least <= log_scale <= most) == held
    assert np.allclose(Spz().decode(Spz().encode(splats)).log_scales, log_scale, atol=1 / 32) == held


def test_spz_says_what_it_clamps_and_where_positions_are_coarse() -> None:
    said = Spz().fitted(Extremes(90, 100, 3.0, 0, clamped=7))[1]
    assert len(said) == 1
    assert re.search(r"sizes of 7 Gaussians of a frame with 100 .* 4.5e-05 to 379 units", said[0])
    assert re.search(r"steps of 6.1e-05 units", Spz().fitted(Extremes(1, 1, 3e-3, 0))[1][0])


def test_ply_states_the_compensation_in_a_comment_and_nothing_else_changes() -> None:
    splats = random_splats(3, 4)
    plain, stated = (Ply(compensated=state).encode(splats) for state in (False, True))
    assert stated.replace(b"comment SplatRenderMode: mip\n", b"") == plain != stated
    assert stated.startswith(b"ply\nformat binary_little_endian 1.0\ncomment ")


def read_glb(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The document and the arrays of the one primitive, by glTF 2.0 and nothing of ours."""
    magic, version, length, json_length, json_kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, length, json_kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + json_length])
    binary_length, binary_kind = struct.unpack_from("<I4s", data, 20 + json_length)
    assert (binary_kind, json_length % 4, binary_length % 4) == (b"BIN\0", 0, 0)
    binary = data[28 + json_length :]
    assert len(binary) == binary_length == document["buffers"][0]["byteLength"]
    arrays = {}
    for name, accessor in document["meshes"][0]["primitives"][0]["attributes"].items():
        facts = document["accessors"][accessor]
        view = document["bufferViews"][facts["bufferView"]]
        kind = {5126: "<f4", 5123: "<u2"}[facts["componentType"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[facts["type"]]
        assert view["byteOffset"] % 4 == 0
        assert view["byteLength"] == facts["count"] * width * np.dtype(kind).itemsize
        values = np.frombuffer(binary, kind, facts["count"] * width, view["byteOffset"])
        arrays[name] = values.reshape(facts["count"], width)
    return document, arrays


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_glb_has_the_extensions_attributes(coefficients: int) -> None:
    """Scales and opacities are activated in float32 and quaternions normalised: a few units in the last place."""
    splats = random_splats(7, coefficients)
    document, arrays = read_glb(Glb().encode(splats))
    prefix = "KHR_gaussian_splatting:"
    assert document["extensionsUsed"] == ["KHR_gaussian_splatting"]
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    assert primitive["extensions"]["KHR_gaussian_splatting"]["kernel"] == "ellipse"
    assert primitive["extensions"]["KHR_gaussian_splatting"]["colorSpace"] == "srgb_rec709_display"
    np.testing.assert_array_equal(arrays["POSITION"], splats.means)
    position = document["accessors"][primitive["attributes"]["POSITION"]]
    assert (position["min"], position["max"]) == (splats.means.min(0).tolist(), splats.means.max(0).tolist())
    np.testing.assert_allclose(arrays[f"{prefix}SCALE"], np.exp(splats.log_scales.astype(float)), rtol=1e-6)
    xyzw = unit(splats.quaternions.astype(float))[:, [1, 2, 3, 0]]
    np.testing.assert_allclose(arrays[f"{prefix}ROTATION"], xyzw, atol=1e-7)
    opacity = 1 / (1 + np.exp(-splats.opacity_logits.astype(float)))
    np.testing.assert_allclose(arrays[f"{prefix}OPACITY"][:, 0], opacity, rtol=1e-6)
    order = [(band, n) for band in range(4) for n in range(2 * band + 1)][:coefficients]
    for k, (band, n) in enumerate(order):
        np.testing.assert_array_equal(arrays[f"{prefix}SH_DEGREE_{band}_COEF_{n}"], splats.sh[:, k])
    assert len(arrays) == 5 + coefficients
    coded = np.clip(0.5 + 0.28209479177387814 * splats.sh[:, 0].astype(float), 0, 1)
    linear = np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)
    colour = np.concatenate([linear, opacity[:, None]], axis=1) * 65535
    assert np.abs(arrays["COLOR_0"] - colour).max() < 0.51, "half a step, and float32"


def test_glb_shows_mid_grey_as_such() -> None:
    """glTF 2.0, 3.9.2: vertex colours are linear; sRGB-coded .5 is linear .214."""
    splats = replace(random_splats(3, 1), sh=np.zeros((3, 1, 3), np.float32))
    document, arrays = read_glb(Glb().encode(splats))
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]]
    assert accessor["normalized"] is True
    np.testing.assert_allclose(arrays["COLOR_0"][:, :3] / 65535, 0.21404, atol=1e-5)


def test_glb_comes_back_and_states_the_compensation() -> None:
    splats = random_splats(50, 16)
    data = Glb(compensated=True).encode(splats)
    found = Glb().decode(data)
    np.testing.assert_array_equal(found.means, splats.means)
    np.testing.assert_array_equal(found.sh, splats.sh)
    np.testing.assert_allclose(found.log_scales, splats.log_scales, atol=1e-6)
    np.testing.assert_allclose(found.opacity_logits, splats.opacity_logits, atol=1e-4)
    np.testing.assert_allclose(found.quaternions, unit(splats.quaternions), atol=1e-6)
    document, _ = read_glb(data)
    assert document["meshes"][0]["primitives"][0]["extras"] == {"SplatRenderMode": "mip"}
    assert "extras" not in read_glb(Glb().encode(splats))[0]["meshes"][0]["primitives"][0]


def read_sog(data: bytes) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """``meta.json`` and the images as rows of RGBA, from the top left on."""
    images = {}
    with zipfile.ZipFile(io.BytesIO(data)) as bundle:
        assert all(entry.compress_type == zipfile.ZIP_STORED for entry in bundle.infolist())
        meta = json.loads(bundle.read("meta.json"))
        for name in bundle.namelist():
            if name.endswith(".webp"):
                webp = bundle.read(name)
                assert webp[12:16] == b"VP8L", "lossless, without a container that could hold lossy parts"
                image = cv2.imdecode(np.frombuffer(webp, np.uint8), cv2.IMREAD_UNCHANGED)
                order = [2, 1, 0, 3][: image.shape[2]]
                images[name.removesuffix(".webp")] = image[..., order].reshape(-1, image.shape[2])
    return meta, images


def test_sog_has_the_bytes_of_its_description() -> None:
    """Worked out by hand from the page "The SOG Format"."""
    splats = Splats(
        np.float32([[0, 0, 0], [1, 1, 1], [-3, 0.5, 1]]),
        np.float32([[-9, -5, -4], [-5, -5, -4], [-9, -9, -9]]),
        # 60 degrees about x: w .866, x .5; the same turn the other way round; y is the largest.
        np.float32([[3**0.5, 1, 0, 0], [-(3**0.5), -1, 0, 0], [0.1, 0.1, 0.98, -0.1]]),
        np.float32([0, 10, np.log(0.25 / 0.75)]),
        np.float32([[[0, 0.5, 1]], [[0, 0, 0]], [[1, 1, 1]]]),
    )
    meta, images = read_sog(Sog().encode(splats))
    assert (meta["version"], meta["count"]) == (2, 3)
    assert (meta["means"]["mins"], meta["means"]["maxs"]) == (
        pytest.approx([-np.log(4), 0, 0]),
        pytest.approx([np.log(2)] * 3),
    )
    assert meta["means"]["files"] == ["means_l.webp", "means_u.webp"]
    assert len(meta["scales"]["codebook"]) == len(meta["sh0"]["codebook"]) == 256
    # Morton order begins at the smallest x, y and z, and x has the lowest bits: the third, the first, the second.
    levels = images["means_l"][:3, :3] + 256 * images["means_u"][:3, :3].astype(int)
    first_y = round(np.log(1.5) / np.log(2) * 65535)
    first_x = round(np.log(4) / np.log(8) * 65535)
    order = {tuple(row): i for i, row in enumerate(levels.tolist())}
    rows = [order[first_x, 0, 0], order[65535, 65535, 65535], order[0, first_y, 65535]]
    sizes, colours = np.array(meta["scales"]["codebook"]), np.array(meta["sh0"]["codebook"])
    np.testing.assert_array_equal(sizes[images["scales"][rows, :3]], splats.log_scales)
    np.testing.assert_array_equal(colours[images["sh0"][rows, :3]], splats.sh[:, 0])
    # .5 is 127.5, to the even one.
    assert images["sh0"][rows, 3].tolist() == [128, 255, 64]
    # (.5 * sqrt(2) * .5 + .5) * 255 = 217.66; 0 is 127.5, to the even one; w leads: 252. (.1 * sqrt(.5) + .5) * 255.
    tenth = 0.1 / (0.98**2 + 0.03) ** 0.5 * 0.5**0.5 * 255
    assert images["quats"][rows].tolist() == [
        [218, 128, 128, 252],
        [218, 128, 128, 252],
        [round(127.5 + tenth), round(127.5 + tenth), round(127.5 - tenth), 254],
    ]
    assert not {"shN", "model", "antialias"} & set(meta)


def numbered_splats(count: int, coefficients: int) -> Splats:
    """Random ones whose whole x and y, below 300, number them, however a format sorts and rounds them."""
    number = np.random.default_rng(4).permutation(count)
    splats = random_splats(count, coefficients)
    return replace(splats, means=np.stack([number // 300, number % 300, splats.means[:, 2]], axis=1).astype(np.float32))


def by_number(splats: Splats) -> Splats:
    places = np.rint(splats.means[:, :2]).astype(int)
    order = np.argsort(places[:, 0] * 300 + places[:, 1])
    return take_splats(splats, order)


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
def test_sog_stays_within_half_a_step(coefficients: int) -> None:
    splats = numbered_splats(3000, coefficients)
    data = Sog(compensated=True).encode(splats)
    meta, images = read_sog(data)
    assert (meta["model"], meta["antialias"]) == ("antialiased", True)
    found, expected = by_number(Sog().decode(data)), by_number(splats)
    # Half a step of the logarithm of 1 + |x|, whose slope is 1 + |x|.
    step = (np.array(meta["means"]["maxs"]) - meta["means"]["mins"]) / 65535
    assert (np.abs(found.means - expected.means) <= 0.51 * step * (1 + np.abs(expected.means))).all()
    # 9 numbers in 256 values, 9000 uniform ones: half a step of 9 / 256 where they lie evenly, and some slack.
    assert np.abs(found.log_scales - expected.log_scales).max() < 1.5 * 9 / 256 / 2
    assert np.abs(found.sh - expected.sh).max() < 1.5 * 1.8 / 256 / 2
    opacity = [1 / (1 + np.exp(-s.opacity_logits)) for s in (found, expected)]
    assert np.abs(opacity[0] - opacity[1]).max() <= 0.5 / 255 + 1e-6
    turned = np.abs((unit(found.quaternions) * unit(expected.quaternions)).sum(axis=1))
    # A component's step is sqrt(2)/255; the fourth follows from three and is at least a half.
    assert np.degrees(2 * np.arccos(np.minimum(turned, 1))).max() < 1.1
    if coefficients > 1:
        assert (meta["shN"]["count"], meta["shN"]["bands"]) == (3000, round(coefficients**0.5) - 1)
        labels = images["shN_labels"][:3000].astype(int)
        assert (labels[:, 0] + 256 * labels[:, 1]).max() < 3000


def test_sog_is_the_same_each_time_and_takes_one_gaussian() -> None:
    splats = random_splats(700, 4)
    assert Sog().encode(splats) == Sog().encode(splats)
    one = take_splats(splats, np.array([5]))
    np.testing.assert_allclose(Sog().decode(Sog().encode(one)).means, one.means, rtol=1e-6)


def test_sogs_values_lie_where_the_numbers_do() -> None:
    """Of numbers in two clumps, 256 values leave less than equal steps would: by the ratio of what is covered."""
    random = np.random.default_rng(1)
    clumps = np.where(
        random.random((5000, 3)) < 0.5, random.normal(-9, 0.05, (5000, 3)), random.normal(1, 0.05, (5000, 3))
    )
    splats = replace(numbered_splats(5000, 1), log_scales=clumps.astype(np.float32))
    found = by_number(Sog().decode(Sog().encode(splats))).log_scales
    error = float(np.sqrt(np.mean((found - by_number(splats).log_scales) ** 2)))
    equal_steps = (clumps.max() - clumps.min()) / 256 / 12**0.5
    assert error < equal_steps / 10


def test_sog_has_a_palette_of_65536_sets_of_sh_for_more_gaussians() -> None:
    """Neighbours among coefficients share a set: the error is far below that of one set for all."""
    count = 70_000
    splats = numbered_splats(count, 4)
    directions = np.random.default_rng(2).normal(size=(count, 1, 1))
    smooth = (directions * np.linspace(-0.1, 0.2, 9).reshape(1, 3, 3)).astype(np.float32)
    splats = replace(splats, sh=np.concatenate([splats.sh[:, :1], smooth], axis=1))
    data = Sog().encode(splats)
    meta, images = read_sog(data)
    assert meta["shN"]["count"] == 65536
    labels = images["shN_labels"][:count].astype(int)
    assert len(np.unique(labels[:, 0] + 256 * labels[:, 1])) == 65536
    found, expected = by_number(Sog().decode(data)).sh[:, 1:], by_number(splats).sh[:, 1:]
    assert np.sqrt(np.mean((found - expected) ** 2)) < expected.std() / 50


@pytest.mark.parametrize(
    ("form", "extremes", "says"),
    [
        (Spz(), Extremes(1, 10_000_001, 1.0, 0), "10000001 Gaussians"),
        (Spz(version=2), Extremes(1, 10_000_001, 1.0, 0), "version 2"),
        (Spz(version=4), Extremes(1, 1, 1e7, 0), "1e[+]07 units from the origin"),
        (Spz(), Extremes(0, 5, 1.0, 0), "no Gaussians"),
        (Glb(), Extremes(0, 5, 1.0, 0), "no Gaussians"),
        (Sog(), Extremes(0, 5, 1.0, 0), "no Gaussians"),
        (Glb(), Extremes(1, 20_000_000, 1.0, 3), r"4\.9 GB"),
    ],
    ids=str,
)
def test_what_a_format_cannot_hold_is_said(form: SplatFormat, extremes: Extremes, says: str) -> None:
    with pytest.raises(UsageError, match=says) as caught:
        form.fitted(extremes)
    assert "\n" not in str(caught.value)


def test_what_a_format_can_hold_passes() -> None:
    assert Spz(version=4).fitted(Extremes(1, 10_000_001, 1.0, 3))[1] == []
    assert Glb().fitted(Extremes(1, 10_000_000, 1e9, 3))[1] == []
    assert Ply().decode(Ply().encode(empty_splats(2))).sh.shape == (0, 9, 3)
    assert Splat().fitted(Extremes(1, 1, 1.0, 0))[1] == []
    assert len(Splat(compensated=True).fitted(Extremes(1, 1, 1.0, 2))[1]) == 2


def shape_of(quaternions: np.ndarray, log_scales: np.ndarray) -> np.ndarray:
    """Covariances (N, 3, 3), the largest variance being 1; quaternions that turn an axis over have the same."""
    rotations = rotation_matrices(quaternions.astype(float))
    variances = np.exp(2 * (log_scales - log_scales.max(axis=1, keepdims=True)).astype(float))
    return np.einsum("nij,nj,nkj->nik", rotations, variances, rotations)


SPLAT_TRANSFORM = os.environ.get("SPLAT_TRANSFORM") or shutil.which("splat-transform")


@pytest.mark.skipif(
    SPLAT_TRANSFORM is None, reason="needs npm's @playcanvas/splat-transform on PATH or in SPLAT_TRANSFORM"
)
@pytest.mark.parametrize(
    "form", [Ply(True), Spz(14, 8, 8, 2), Spz(14, 8, 8, 3), Spz(14, 8, 8, 4, True), Splat(), Sog(True)], ids=repr
)
def test_splat_transform_reads_the_same_where_it_is_installed(form: SplatFormat, tmp_path: Path) -> None:
    """It writes what it read as .ply, in the axes of .ply: right, down, front, where .spz has right, up, back.

    With version 0.2.3 of its library for .spz it takes those for .ply's, whatever their own description says.
    Tolerances: float32 of another implementation's logarithms and divisions.
    """
    assert SPLAT_TRANSFORM is not None
    splats = random_splats(400, 1 if isinstance(form, Splat) else 16)
    source, target = tmp_path / f"a{form.suffix}", tmp_path / "read.ply"
    source.write_bytes(form.encode(splats))
    subprocess.run([SPLAT_TRANSFORM, str(source), str(target)], check=True, capture_output=True)
    data = target.read_bytes()
    header, _, body = data.partition(b"end_header\n")
    names = [line.split()[-1] for line in header.decode().splitlines() if line.startswith("property float")]
    columns = dict(zip(names, np.frombuffer(body, "<f4").reshape(-1, len(names)).T, strict=True))
    ours = form.decode(form.encode(splats))
    if form.up == "Y" and columns["y"] @ ours.means[:, 1] < 0:
        ours = transformed_splats(ours, Similarity(turn_between(AXES["Y"], AXES["-Y"])))
    assert len(columns["x"]) == 400
    means = np.stack([columns[name] for name in "xyz"], axis=1)
    theirs, mine = np.lexsort(means.T), np.lexsort(ours.means.T)  # .splat comes sorted

    def same(names: list[str], values: np.ndarray, atol: float) -> None:
        found = np.stack([columns[name] for name in names], axis=1)[theirs]
        np.testing.assert_allclose(found, values.reshape(400, -1)[mine], atol=atol)

    same(["x", "y", "z"], ours.means, 1e-6)
    same([f"f_dc_{c}" for c in range(3)], ours.sh[:, 0], 1e-5)
    same([f"scale_{c}" for c in range(3)], ours.log_scales, 1e-5)
    # SPZ's library keeps opacities 1/255 from both ends.
    columns["opacity"] = np.clip(columns["opacity"], -5, 5)
    same(["opacity"], np.clip(ours.opacity_logits, -5, 5), 1e-3)
    rest = ours.sh.shape[1] - 1
    if rest:
        same([f"f_rest_{k}" for k in range(3 * rest)], ours.sh[:, 1:].transpose(0, 2, 1), 1e-5)
    rotation = np.stack([columns[f"rot_{c}"] for c in range(4)], axis=1)[theirs]
    shapes = [
        shape_of(rotation, ours.log_scales[mine]),
        shape_of(ours.quaternions[mine], ours.log_scales[mine]),
    ]
    # It takes .splat's bytes for -1 to 1 in 255 steps, antimatter15's viewer for steps of 1/128: half a step each.
    np.testing.assert_allclose(*shapes, atol=0.03 if isinstance(form, Splat) else 1e-5)
