"""Colours of pictures that are coded otherwise than sRGB: converted, or named in a warning; against matrices here."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image, ImageCms

from decogs.formats.colours import profiles as colour_profiles
from decogs.formats.errors import RigError
from decogs.formats.pictures.reading import picture_facts, read_picture

PATCHES = np.array(
    [(200, 40, 40), (40, 180, 60), (50, 60, 210), (220, 200, 40), (30, 190, 200), (128, 128, 128), (20, 20, 20)],
    np.float64,
)
"""sRGB levels that every space here can state."""

REC709 = (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329)
P3 = (0.68, 0.32, 0.265, 0.69, 0.15, 0.06, 0.3127, 0.329)
ADOBE = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.329)
AP1 = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
XYZ = (1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1 / 3, 1 / 3)
D50 = (0.9642, 1.0, 0.8249)
BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def to_pcs(chromaticities: tuple[float, ...]) -> np.ndarray:
    """Linear RGB to XYZ, adapted to D50: an ICC profile's colorants in columns."""
    x, y = np.reshape(chromaticities, (4, 2)).T
    xyz = np.stack([x / y, np.ones(4), (1 - x - y) / y]) if y.min() > 0 else np.stack([x, y, 1 - x - y])
    white = np.array([x[3], y[3], 1 - x[3] - y[3]]) / y[3]
    matrix = xyz[:, :3] * np.linalg.solve(xyz[:, :3], white)
    return np.linalg.inv(BRADFORD) @ np.diag(BRADFORD @ D50 / (BRADFORD @ white)) @ BRADFORD @ matrix


def linear(levels: np.ndarray) -> np.ndarray:
    coded = levels / 255
    return np.where(coded <= 0.04045, coded / 12.92, ((coded + 0.055) / 1.055) ** 2.4)


def levels_of(light: np.ndarray) -> np.ndarray:
    light = np.clip(light, 0, 1)
    return 255 * np.where(light <= 0.0031308, light * 12.92, 1.055 * light ** (1 / 2.4) - 0.055)


def in_space(chromaticities: tuple[float, ...]) -> np.ndarray:
    """The patches as linear light of these primaries."""
    return linear(PATCHES) @ (np.linalg.inv(to_pcs(chromaticities)) @ to_pcs(REC709)).T


def icc(chromaticities: tuple[float, ...] | None, gamma: float, space: bytes = b"RGB ", curve: bytes = b"") -> bytes:
    """An ICC profile of version 2 of primaries and a power or ``curve``; of the power alone for grey."""

    def xyz(values: Any) -> bytes:
        return b"XYZ \0\0\0\0" + b"".join(struct.pack(">i", round(v * 65536)) for v in values)

    curve = curve or b"curv\0\0\0\0" + struct.pack(">IHxx", 1, round(gamma * 256))
    tags = {b"wtpt": xyz(D50)}
    if chromaticities is None:
        tags[b"kTRC"] = curve
    else:
        columns = to_pcs(chromaticities).T
        tags |= {name + b"XYZ": xyz(column) for name, column in zip((b"r", b"g", b"b"), columns, strict=True)}
        tags |= {name + b"TRC": curve for name in (b"r", b"g", b"b")}
    table, body, at = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for name, value in tags.items():
        table += name + struct.pack(">II", at + len(body), len(value))
        body += value
    head = struct.pack(">I4xI4s4s4s12x4s", at + len(body), 0x02100000, b"mntr", space, b"XYZ ", b"acsp")
    return head.ljust(68, b"\0") + xyz(D50)[8:] + bytes(48) + table + body


def chart(values: np.ndarray, dtype: type) -> np.ndarray:
    """Each patch 16 x 16, so that a JPEG keeps its colour."""
    return np.rint(np.repeat(np.repeat(values[None], 16, axis=0), 16, axis=1)).astype(dtype)


def colours(path: Path) -> np.ndarray:
    """Of the middle of the patches."""
    return read_picture(path)[8, 8::16].astype(np.float64)


def png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def write_png(path: Path, picture: np.ndarray, *chunks: tuple[bytes, bytes]) -> None:
    data = cv2.imencode(".png", picture[..., ::-1] if picture.ndim == 3 else picture)[1].tobytes()
    path.write_bytes(data[:33] + b"".join(png_chunk(*chunk) for chunk in chunks) + data[33:])


def iccp(profile: bytes) -> tuple[bytes, bytes]:
    return b"iCCP", b"x\0\0" + zlib.compress(profile)


def write_tiff(path: Path, picture: np.ndarray, profile: bytes) -> None:
    """OpenCV writes 16 bit, and no profile: one more tag, and the directory again at the end."""
    data = cv2.imencode(".tif", picture[..., ::-1], [cv2.IMWRITE_TIFF_COMPRESSION, 1])[1].tobytes()
    (at,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, at)
    entries = data[at + 2 : at + 2 + 12 * count]
    data += bytes(len(data) % 2)
    place = len(data) + 2 + 12 * (count + 1) + 4
    entries += struct.pack("<HHII", 34675, 7, len(profile), place)
    directory = struct.pack("<H", count + 1) + entries + bytes(4) + profile
    path.write_bytes(data[:4] + struct.pack("<I", len(data)) + data[8:] + directory)


def write(path: Path, light: np.ndarray, gamma: float, profile: bytes, bits: int) -> None:
    """Light of the profile's primaries, coded by its power, with the profile."""
    picture = chart(np.clip(light, 0, 1) ** (1 / gamma) * (2**bits - 1), np.uint8 if bits == 8 else np.uint16)
    if path.suffix == ".png":
        write_png(path, picture, iccp(profile))
    elif path.suffix == ".tif":
        write_tiff(path, picture, profile)
    else:
        Image.fromarray(picture).save(path, quality=100, subsampling=0, icc_profile=profile)


@pytest.mark.parametrize(("name", "bits"), [("a.png", 8), ("a.png", 16), ("a.tif", 8), ("a.tif", 16), ("a.jpg", 8)])
@pytest.mark.parametrize(("primaries", "gamma"), [(P3, 2.2), (ADOBE, 2.2), (P3, 1.0), (REC709, 1.0), (AP1, 1.0)])
def test_pictures_with_a_profile_are_converted(
    tmp_path: Path, name: str, bits: int, primaries: tuple[float, ...], gamma: float
) -> None:
    write(tmp_path / name, in_space(primaries), gamma, icc(primaries, gamma), bits)
    # 16 bit: half a level of rounding, and LittleCMS' own arithmetic. 8 bit of linear light are coarse: half a step
    # of the darkest channel here (20) is 3 levels, more where primaries differ. A level that a JPEG's coding moves is
    # up to 7 where a channel is near 0 in the other space.
    limit = 1.0 if bits == 16 else 2.0 if gamma > 1 else 6.0
    limit = 12.0 if name == "a.jpg" else limit
    assert np.abs(colours(tmp_path / name) - PATCHES).max() <= limit
    assert picture_facts(tmp_path / name).warnings == ()


@pytest.mark.parametrize("gamma", [1.0, 2.2])
@pytest.mark.parametrize("name", ["a.png", "a.jpg", "a.tif"])
def test_8_bit_are_converted_as_pillow_does(tmp_path: Path, name: str, gamma: float) -> None:
    every = np.random.default_rng(3).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    Image.fromarray(every).save(tmp_path / name, quality=95, subsampling=0, icc_profile=icc(P3, gamma))
    given = Image.open(tmp_path / name)
    profile = ImageCms.ImageCmsProfile(io.BytesIO(given.info["icc_profile"]))
    expected = ImageCms.profileToProfile(given, profile, ImageCms.createProfile("sRGB"))
    np.testing.assert_array_equal(read_picture(tmp_path / name), np.asarray(expected))


def test_16_bit_lie_between_their_neighbours_of_8_bit(tmp_path: Path) -> None:
    """At levels of 8 bit there is nothing to interpolate; the deep shadows of linear light have many between them."""
    every = np.random.default_rng(3).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    for name, picture in (("8.png", every), ("16.png", every.astype(np.uint16) * 257)):
        write_png(tmp_path / name, picture, iccp(icc(ADOBE, 2.2)))
    np.testing.assert_array_equal(read_picture(tmp_path / "16.png"), read_picture(tmp_path / "8.png"))
    ramp = np.repeat(np.arange(0, 2570, 10, dtype=np.uint16)[None, :, None], 3, axis=2)
    write_png(tmp_path / "ramp.png", ramp, iccp(icc(REC709, 1.0)))
    # A chord below the curve, at most 0.6 levels, between results that are rounded themselves.
    np.testing.assert_allclose(read_picture(tmp_path / "ramp.png"), levels_of(ramp / 65535), atol=1.6)


def test_grey_with_a_grey_profile(tmp_path: Path) -> None:
    grey = np.arange(256, dtype=np.uint8)[None]
    for name, profile in (("grey.png", icc(None, 1.0, b"GRAY")), ("rgb.png", icc(REC709, 1.0))):
        write_png(tmp_path / name, grey, iccp(profile))
        expected = np.repeat(levels_of(grey / 255)[..., None], 3, axis=2)
        np.testing.assert_allclose(read_picture(tmp_path / name), expected, atol=1)


def test_srgb_profiles_change_no_pixel(tmp_path: Path) -> None:
    every = np.random.default_rng(3).integers(0, 256, (40, 50, 3), dtype=np.uint8)
    table = np.rint(linear(np.linspace(0, 255, 20)) * 65535).astype(">u2")
    curve = b"curv\0\0\0\0" + struct.pack(">I", len(table)) + table.tobytes()
    for profile in (
        ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(),
        icc(REC709, 0, curve=curve),
    ):
        write_png(tmp_path / "a.png", every, iccp(profile))
        np.testing.assert_array_equal(read_picture(tmp_path / "a.png"), every)
        assert picture_facts(tmp_path / "a.png").warnings == ()


def test_a_long_profile_lies_in_several_segments_of_a_jpeg(tmp_path: Path) -> None:
    profile = icc(P3, 2.2)
    profile = struct.pack(">I", 150_000) + profile[4:].ljust(149_996, b"\0")
    write(tmp_path / "a.jpg", in_space(P3), 2.2, profile, 8)
    assert (tmp_path / "a.jpg").read_bytes().count(b"ICC_PROFILE\0") == 3
    assert np.abs(colours(tmp_path / "a.jpg") - PATCHES).max() <= 12  # as above; unconverted it would be 40


def unusable_profiles() -> dict[str, bytes]:
    good = icc(P3, 2.2)
    return {
        "garbage": b"hello, world" * 40,
        "cut": good[:300],
        "CMYK": good[:16] + b"CMYK" + good[20:],
        "empty": b"",
        "huge": good.ljust((4 << 20) + 1, b"\0"),
    }


@pytest.mark.parametrize("name", unusable_profiles())
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_a_profile_that_cannot_be_used_is_named(
    tmp_path: Path, name: str, suffix: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path, picture = tmp_path / f"a{suffix}", chart(PATCHES, np.uint8)
    profile = unusable_profiles()[name]
    write_png(path, picture, iccp(profile)) if suffix == ".png" else write_tiff(path, picture, profile)
    np.testing.assert_array_equal(read_picture(path), picture)
    (warning,) = picture_facts(path).warnings
    assert warning == (
        "its colours are tagged by an ICC profile that is damaged, or of neither RGB nor grey, and are taken for "
        "sRGB's; convert the pictures to sRGB for right ones"
    )
    assert capfd.readouterr() == ("", "")


def test_a_profile_is_not_unpacked_beyond_its_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """256 MB of zeros in a quarter of one."""
    packing = zlib.compressobj()
    packed = b"".join(packing.compress(bytes(1 << 24)) for _ in range(16)) + packing.flush()
    write_png(tmp_path / "a.png", chart(PATCHES, np.uint8), (b"iCCP", b"x\0\0" + packed))
    monkeypatch.setattr(colour_profiles, "conversion", None)  # it gets no profile
    import tracemalloc

    tracemalloc.start()
    try:
        assert "ICC profile that is damaged" in picture_facts(tmp_path / "a.png").warnings[0]
        # Four times the limit: the file, the profile, and what joins its parts.
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()


def chrm(*values: float) -> tuple[bytes, bytes]:
    return b"cHRM", struct.pack(">8I", *(round(v * 100_000) for v in values))


def gama(value: float) -> tuple[bytes, bytes]:
    return b"gAMA", struct.pack(">I", round(value * 100_000))


SRGB_CHRM = chrm(0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06)


@pytest.mark.parametrize(
    ("chunks", "coding"),
    [
        ([gama(1.0)], "gamma 1"),
        ([gama(1 / 1.8)], "gamma 1.8"),
        ([gama(1 / 2.2)], ""),
        ([gama(1 / 2.2), SRGB_CHRM], ""),
        ([gama(1 / 2.2), chrm(0.3127, 0.329, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06)], "primaries other than sRGB's"),
        ([gama(0), chrm(*[0] * 8)], "gamma 1e+05, primaries other than sRGB's"),
        ([(b"sRGB", b"\0"), gama(1.0)], ""),
        ([(b"cICP", bytes([12, 13, 0, 1]))], "Display P3"),
        ([(b"cICP", bytes([9, 16, 0, 1]))], "PQ, BT.2020"),
        ([(b"cICP", bytes([1, 13, 0, 1])), gama(1.0)], ""),
        ([(b"cICP", bytes([1, 8, 0, 1])), iccp(icc(P3, 2.2))], "linear light"),
    ],
)
def test_what_a_png_says_of_its_coding_is_named(tmp_path: Path, chunks: list[tuple[bytes, bytes]], coding: str) -> None:
    write_png(tmp_path / "a.png", chart(PATCHES, np.uint8), *chunks)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png"), chart(PATCHES, np.uint8))
    expected = f"its colours are tagged {coding}, and are taken for sRGB's; convert the pictures to sRGB for right ones"
    assert picture_facts(tmp_path / "a.png").warnings == ((expected,) if coding else ())


def adobe_exif() -> bytes:
    """EXIF data of a camera that is set to Adobe RGB: a directory in a directory in the first one."""
    entries = [(34665, 4, 1, 26), (40965, 4, 1, 44), (1, 2, 4, int.from_bytes(b"R03\0", "little"))]
    return b"Exif\0\0II*\0\x08\0\0\0" + b"".join(struct.pack("<HHHIII", 1, *entry, 0) for entry in entries)


def test_adobe_rgb_of_a_camera_is_named(tmp_path: Path) -> None:
    picture = Image.fromarray(chart(PATCHES, np.uint8))
    picture.save(tmp_path / "a.jpg", exif=adobe_exif())
    expected = "its colours are tagged Adobe RGB, and are taken for sRGB's; convert the pictures to sRGB for right ones"
    assert picture_facts(tmp_path / "a.jpg").warnings == (expected,)
    picture.save(tmp_path / "a.jpg", exif=adobe_exif(), icc_profile=icc(ADOBE, 2.2))
    assert picture_facts(tmp_path / "a.jpg").warnings == ()


# --- OpenEXR --------------------------------------------------------------------------------------------------------


def write_exr(path: Path, channels: Any, **header: object) -> None:
    full = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    OpenEXR.File(full, channels).write(str(path))


@pytest.mark.parametrize(
    "primaries", [P3, ADOBE, AP1, XYZ, (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767)]
)
def test_exr_of_other_primaries_is_converted(tmp_path: Path, primaries: tuple[float, ...]) -> None:
    light = chart_of_light(in_space_from_xyz(primaries))
    write_exr(tmp_path / "a.exr", {"RGB": light}, chromaticities=primaries)
    np.testing.assert_allclose(levels_of(read_picture(tmp_path / "a.exr")[0]), PATCHES, atol=0.05)
    assert picture_facts(tmp_path / "a.exr").warnings == ()


def in_space_from_xyz(chromaticities: tuple[float, ...]) -> np.ndarray:
    """As ``in_space``, from primaries in CIE XYZ that may have no y."""
    x, y = np.reshape(chromaticities, (4, 2)).T
    columns, white = np.stack([x, y, 1 - x - y])[:, :3], np.array([x[3], y[3], 1 - x[3] - y[3]]) / y[3]
    to_xyz = columns * np.linalg.solve(columns, white)
    adapted = np.linalg.inv(BRADFORD) @ np.diag(BRADFORD @ D50 / (BRADFORD @ white)) @ BRADFORD @ to_xyz
    return linear(PATCHES) @ (np.linalg.inv(adapted) @ to_pcs(REC709)).T


def chart_of_light(light: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(light[None].astype(np.float32))


def test_exr_of_rec_709_keeps_its_bits(tmp_path: Path) -> None:
    light = (np.random.default_rng(3).standard_normal((9, 14, 3)) * 100).astype(np.float32)
    write_exr(tmp_path / "a.exr", {"RGB": light}, chromaticities=(0.6401, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.3290))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr"), light)


@pytest.mark.parametrize(
    "wrong",
    [
        (0.0,) * 8,
        (0.64, 0.33, 0.64, 0.33, 0.15, 0.06, 0.3127, 0.329),
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.0),
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.9, 0.9),
        (0.64, 0.33, 0.3, 0.6, 0.15, 0.06, float("nan"), 0.329),
        (0.64, 0.33, 0.3, 0.6, 0.15, float("inf"), 0.3127, 0.329),
        (3e38, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329),
    ],
)
def test_chromaticities_that_span_no_colours_are_refused(tmp_path: Path, wrong: tuple[float, ...]) -> None:
    write_exr(tmp_path / "a.exr", {"RGB": np.ones((4, 5, 3), np.float32)}, chromaticities=wrong)
    for look in (read_picture, picture_facts):
        with pytest.raises(RigError, match=r"a\.exr: the chromaticities of its header span no colours; "):
            look(tmp_path / "a.exr")


def test_a_light_that_other_primaries_make_infinite_is_named(tmp_path: Path) -> None:
    light = np.ones((4, 5, 3), np.float32)
    light[2, 3, 0] = 3e38
    write_exr(tmp_path / "a.exr", {"RGB": light}, chromaticities=AP1)
    with pytest.raises(RigError, match=r"1 pixel\(s\) are NaN or infinite, the first at column 3, row 2"):
        read_picture(tmp_path / "a.exr")


def test_luminance_and_chroma_are_refused_by_name(tmp_path: Path) -> None:
    """They cannot be written by the binding with subsampled chroma; what is told is the names."""
    plane = np.ones((4, 6), np.float16)
    for names in (("Y", "RY", "BY"), ("Y", "BY"), ("X", "Y", "Z")):
        write_exr(tmp_path / "a.exr", dict.fromkeys(names, plane))
        with pytest.raises(
            RigError, match=r"a\.exr: luminance/chroma \(Y, RY, BY\) and XYZ EXR are not read; write it as plain"
        ):
            read_picture(tmp_path / "a.exr")


@pytest.mark.parametrize(("alpha", "said"), [(1.0, False), (0.5, True), (0.0, True)])
def test_alpha_below_1_is_said(tmp_path: Path, alpha: float, said: bool) -> None:
    light, opacity = np.full((4, 5), 0.25, np.float16), np.ones((4, 5), np.float16)
    opacity[1, 2] = alpha
    write_exr(tmp_path / "a.exr", {"R": light, "G": light, "B": light, "A": opacity})
    expected = ("has alpha below 1; where that is not used, its colours are premultiplied, which is over black",)
    assert picture_facts(tmp_path / "a.exr").warnings == (expected if said else ())
    assert (read_picture(tmp_path / "a.exr") == 0.25).all()


def test_a_colour_space_without_chromaticities_is_named(tmp_path: Path) -> None:
    light = np.ones((4, 5, 3), np.float32)
    for name, said in (("lin_ap1_scene", True), ("lin_rec709_scene", False)):
        write_exr(tmp_path / "a.exr", {"RGB": light}, colorInteropID=name)
        warnings = picture_facts(tmp_path / "a.exr").warnings
        assert [name in warning for warning in warnings] == [True] * said
