"""Pictures: exact pixels out of every kind of file, and one clear error for every kind of damage."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from PIL import Image

from decogs.formats.errors import RigError
from decogs.formats.pictures.reading import picture_facts, read_alpha, read_picture

RNG = np.random.default_rng(7)
RGB = RNG.integers(0, 256, (12, 20, 3), dtype=np.uint8)


def write_exr(path: Path, pixels: np.ndarray, **header: object) -> None:
    full = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    OpenEXR.File(full, {"RGB": pixels}).write(str(path))


def picture_size(path: Path) -> tuple[int, int]:
    facts = picture_facts(path)
    return facts.width, facts.height


def png_bytes(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def test_png_is_read_exactly_as_rgb(tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    path.write_bytes(png_bytes(RGB[:, :, ::-1]))
    picture = read_picture(path)
    assert picture.dtype == np.uint8
    assert picture.flags.c_contiguous
    np.testing.assert_array_equal(picture, RGB)
    assert picture_size(path) == (20, 12)


def test_16_bit_png_is_rounded_to_the_nearest_8_bit_value(tmp_path: Path) -> None:
    deep = RNG.integers(0, 65536, (6, 5, 3), dtype=np.uint16)
    (tmp_path / "a.png").write_bytes(png_bytes(deep[:, :, ::-1]))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.png"), np.rint(deep / 257).astype(np.uint8))


def test_grey_is_repeated_and_alpha_dropped(tmp_path: Path) -> None:
    (tmp_path / "grey.png").write_bytes(png_bytes(RGB[:, :, 0]))
    np.testing.assert_array_equal(read_picture(tmp_path / "grey.png"), np.repeat(RGB[:, :, :1], 3, axis=2))
    with_alpha = np.dstack([RGB[:, :, ::-1], np.full((12, 20), 9, np.uint8)])
    (tmp_path / "alpha.png").write_bytes(png_bytes(with_alpha))
    np.testing.assert_array_equal(read_picture(tmp_path / "alpha.png"), RGB)


def test_jpeg_channels_are_in_order(tmp_path: Path) -> None:
    flat = np.full((16, 24, 3), (200, 100, 30), np.uint8)
    (tmp_path / "a.JPG").write_bytes(cv2.imencode(".jpg", flat[:, :, ::-1])[1].tobytes())
    # JPEG at its default quality keeps a flat colour within 3 steps.
    np.testing.assert_allclose(read_picture(tmp_path / "a.JPG").astype(int), flat, atol=3)
    assert picture_size(tmp_path / "a.JPG") == (24, 16)


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
def test_exr_values_are_exact(tmp_path: Path, dtype: type) -> None:
    pixels = (RNG.standard_normal((9, 14, 3)) * 100).astype(dtype)
    write_exr(tmp_path / "a.exr", pixels)
    picture = read_picture(tmp_path / "a.exr")
    assert picture.dtype == np.float32
    np.testing.assert_array_equal(picture, pixels.astype(np.float32))
    assert picture_size(tmp_path / "a.exr") == (14, 9)


def test_exr_is_put_into_its_display_window(tmp_path: Path) -> None:
    pixels = RNG.random((5, 6, 3)).astype(np.float32)
    # Data covers columns -1..4 and rows 2..6 of a display of 4 x 8.
    write_exr(
        tmp_path / "a.exr",
        pixels,
        dataWindow=(np.array([-1, 2], np.int32), np.array([4, 6], np.int32)),
        displayWindow=(np.array([0, 0], np.int32), np.array([3, 7], np.int32)),
    )
    expected = np.zeros((8, 4, 3), np.float32)
    expected[2:7] = pixels[:, 1:5]
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr"), expected)
    assert picture_size(tmp_path / "a.exr") == (4, 8)


def test_grey_exr_is_repeated(tmp_path: Path) -> None:
    grey = RNG.random((4, 5)).astype(np.float32)
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Y": grey}).write(str(tmp_path / "a.exr"))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr"), np.repeat(grey[:, :, None], 3, axis=2))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_non_finite_exr_pixel_is_named(tmp_path: Path, value: float) -> None:
    pixels = np.ones((6, 8, 3), np.float16)
    pixels[4, 3, 1] = value
    write_exr(tmp_path / "0002.exr", pixels)
    with pytest.raises(RigError, match=r"0002\.exr: 1 pixel\(s\) are NaN or infinite, the first at column 3, row 4"):
        read_picture(tmp_path / "0002.exr")


def test_exr_without_colour_names_its_channels(tmp_path: Path) -> None:
    header = {"compression": OpenEXR.NO_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"Z": np.ones((4, 5), np.float32)}).write(str(tmp_path / "a.exr"))
    with pytest.raises(RigError, match=r"a\.exr: needs channels R, G, B \(or Y\), but has 'Z'"):
        read_picture(tmp_path / "a.exr")


def whole_file(suffix: str, folder: Path) -> bytes:
    if suffix == ".exr":
        write_exr(folder / "whole.exr", RGB.astype(np.float16))
        return (folder / "whole.exr").read_bytes()
    return cv2.imencode(suffix, RGB)[1].tobytes()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".webp", ".bmp", ".exr"])
def test_every_truncation_is_one_quiet_error(tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]) -> None:
    data = whole_file(suffix, tmp_path)
    path = tmp_path / f"cut{suffix}"
    for length in {*range(0, len(data) - 1, 11), len(data) - 1, len(data) - 2}:
        path.write_bytes(data[:length])
        with pytest.raises(RigError, match=rf"cut\{suffix}: ") as caught:
            read_picture(path)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_damaged_png_data_is_found_by_its_checksum(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    data = bytearray(png_bytes(RGB))
    data[len(data) // 2] ^= 1
    (tmp_path / "a.png").write_bytes(data)
    with pytest.raises(RigError, match="checksum"):
        read_picture(tmp_path / "a.png")
    assert capfd.readouterr() == ("", "")


def test_absurd_sizes_are_refused_before_decoding(tmp_path: Path) -> None:
    header = b"IHDR" + struct.pack(">IIBBBBB", 1 << 30, 1 << 30, 8, 2, 0, 0, 0)
    chunk = struct.pack(">I", 13) + header + struct.pack(">I", zlib.crc32(header))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + chunk)
    with pytest.raises(RigError, match="1073741824 x 1073741824"):
        picture_size(tmp_path / "a.png")
    write_exr(tmp_path / "a.exr", np.ones((2, 2, 3), np.float32))
    data = (tmp_path / "a.exr").read_bytes()
    box = struct.pack("<4i", 0, 0, 1, 1)
    (tmp_path / "a.exr").write_bytes(data.replace(box, struct.pack("<4i", 0, 0, 2**31 - 1, 2**31 - 1)))
    with pytest.raises(RigError, match="claims a window"):
        read_picture(tmp_path / "a.exr")


def test_an_exr_that_is_much_larger_than_its_picture_is_refused_before_decoding(tmp_path: Path) -> None:
    """All channels and all parts are decoded, so their sum is what must be bounded."""
    path = tmp_path / "a.exr"
    small, large = np.ones((2, 3), np.float16), struct.pack("<4i", 0, 0, 16383, 16383)
    many = dict.fromkeys("RGBXY", small)
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}, many).write(str(path))
    path.write_bytes(path.read_bytes().replace(struct.pack("<4i", 0, 0, 2, 1), large))
    with pytest.raises(RigError, match=r"a\.exr: holds 1342177280 numbers in all its channels and parts"):
        read_picture(path)
    display = (np.zeros(2, np.int32), np.full(2, 9, np.int32))
    parts = [
        OpenEXR.Part({"name": "colours", "displayWindow": display}, dict.fromkeys("RGB", small[:1])),
        OpenEXR.Part({"name": "more", "displayWindow": display}, many),
    ]
    OpenEXR.File(parts).write(str(path))
    assert read_picture(path).shape == (10, 10, 3)
    path.write_bytes(path.read_bytes().replace(struct.pack("<4i", 0, 0, 2, 1), large))
    with pytest.raises(RigError, match=r"a\.exr: holds 1342177289 numbers in all its channels and parts"):
        read_picture(path)


def test_flipped_bytes_never_leak_another_exception(tmp_path: Path) -> None:
    for suffix in (".png", ".jpg", ".exr"):
        data = whole_file(suffix, tmp_path)
        path = tmp_path / f"flipped{suffix}"
        refused = 0
        for at in RNG.integers(0, len(data), 80):
            damaged = bytearray(data)
            damaged[at] ^= int(RNG.integers(1, 256))
            path.write_bytes(damaged)
            try:
                assert read_picture(path).shape[2] == 3
            except RigError:
                refused += 1
        assert refused > 0


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.png", b"hello, world, hello, world", "not a PNG"),
        ("a.jpg", b"hello, world, hello, world", "not a JPEG"),
        ("a.exr", b"hello, world, hello, world", "not an EXR"),
        ("a.txt", b"hello", "not a picture format"),
    ],
)
def test_other_files_are_refused(tmp_path: Path, name: str, content: bytes, message: str) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(RigError, match=message):
        read_picture(tmp_path / name)


@pytest.mark.parametrize("look", [read_picture, picture_facts])
def test_a_device_is_no_picture(tmp_path: Path, look: Callable[[Path], object]) -> None:
    (tmp_path / "a.png").symlink_to("/dev/null")
    with pytest.raises(RigError, match=r"a\.png: cannot be read \(this is no regular file\)"):
        look(tmp_path / "a.png")


def test_missing_picture(tmp_path: Path) -> None:
    with pytest.raises(RigError, match=r"gone\.png: cannot be read"):
        read_picture(tmp_path / "gone.png")


# --- WebP and BMP ---------------------------------------------------------------------------------------------------


def coded(suffix: str, pixels: np.ndarray) -> bytes:
    """Without loss."""
    quality = [cv2.IMWRITE_WEBP_QUALITY, 101] if suffix == ".webp" else []
    return cv2.imencode(suffix, pixels, quality)[1].tobytes()


@pytest.mark.parametrize("suffix", [".webp", ".bmp"])
def test_webp_and_bmp_are_read_exactly(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    alpha = RNG.integers(1, 256, RGB.shape[:2], dtype=np.uint8)
    for bgr in (RGB[:, :, ::-1], np.dstack([RGB[:, :, ::-1], alpha])):
        path.write_bytes(coded(suffix, bgr))
        np.testing.assert_array_equal(read_picture(path), RGB)
        assert picture_size(path) == (20, 12)
    has_alpha = read_alpha(path)
    if suffix == ".webp":
        np.testing.assert_allclose(has_alpha, alpha / 255, rtol=1e-6)
    else:
        assert has_alpha is None, "nobody says whether a BMP's fourth byte is alpha"
    path.write_bytes(coded(suffix, RGB[:, :, 0]))
    np.testing.assert_array_equal(read_picture(path), np.repeat(RGB[:, :, :1], 3, axis=2))


def test_webp_says_its_size_orientation_and_profile(tmp_path: Path) -> None:
    data = Image.Exif()
    data[274] = 6
    for kind in (False, True):
        Image.fromarray(RGB).save(tmp_path / "a.webp", lossless=kind, exif=data.tobytes(), icc_profile=b"no profile")
        facts = picture_facts(tmp_path / "a.webp")
        assert (facts.width, facts.height, facts.orientation) == (20, 12, 6)
        assert "ICC profile that is damaged" in facts.warnings[0]
    Image.fromarray(RGB).save(tmp_path / "a.webp")
    assert picture_size(tmp_path / "a.webp") == (20, 12)
    Image.fromarray(RGB).save(tmp_path / "a.webp", save_all=True, append_images=[Image.fromarray(255 - RGB)])
    with pytest.raises(RigError, match=r"a\.webp: a moving WebP is not read; write a picture for each frame"):
        read_picture(tmp_path / "a.webp")


def test_a_bmp_of_few_colours_is_refused(tmp_path: Path) -> None:
    Image.fromarray(RGB[:, :, 0]).convert("1").save(tmp_path / "a.bmp")
    with pytest.raises(RigError, match=r"a\.bmp: BMP of other than 8, 24 or 32 plain bits is not read"):
        picture_facts(tmp_path / "a.bmp")
