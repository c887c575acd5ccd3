"""TIFF frames: exact pixels as they are stored, and one line for what is not read."""

from __future__ import annotations

import io
import struct
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image

from decogs.formats.errors import RigError
from decogs.formats.pictures.reading import picture_facts, read_picture

RNG = np.random.default_rng(7)
RGB = RNG.integers(0, 256, (12, 20, 3), dtype=np.uint8)
DEEP = RNG.integers(0, 65536, (12, 20, 3), dtype=np.uint16)


def tiff(picture: np.ndarray, order: str = "<", big: bool = False, **tags: Any) -> bytes:
    """One strip (one for each plane if ``planar`` is 2); ``tags`` by number as t258 = (type, values)."""
    height, width, samples = picture.shape
    bits = 8 * picture.dtype.itemsize
    picture = picture.astype(picture.dtype.newbyteorder(order))
    head = 16 if big else 8
    pixels = picture.tobytes()
    entries = {
        256: (4, [width]), 257: (4, [height]), 258: (3, [bits] * samples), 259: (3, [1]),
        262: (3, [2 if samples > 2 else 1]), 273: (4, [head]), 277: (3, [samples]), 278: (4, [height]),
        279: (4, [len(pixels)]),
    } | {int(name[1:]): tag for name, tag in tags.items()}  # fmt: skip
    entries = {tag: entry for tag, entry in entries.items() if entry is not None}
    count, entry, place, inline = ("Q", "HHQ", "Q", 8) if big else ("H", "HHI", "I", 4)
    at = head + len(pixels)
    after = at + struct.calcsize("=" + count) + len(entries) * (struct.calcsize("=" + entry) + inline) + inline
    table, beyond = struct.pack(order + count, len(entries)), b""
    for tag, (kind, values) in sorted(entries.items()):
        value = struct.pack(f"{order}{len(values)}{'BHI'[(1, 3, 4).index(kind)]}", *values)
        if len(value) > inline:
            value, beyond = struct.pack(order + place, after + len(beyond)), beyond + value
        table += struct.pack(order + entry, tag, kind, len(values)) + value.ljust(inline, b"\0")
    first = {"<": b"II", ">": b"MM"}[order]
    start = struct.pack(order + "HHHQ", 43, 8, 0, at) if big else struct.pack(order + "HI", 42, at)
    return first + start + pixels + table + bytes(inline) + beyond


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("picture", [RGB, DEEP])
def test_pixels_are_exact(tmp_path: Path, order: str, big: bool, picture: np.ndarray) -> None:
    path = tmp_path / "a.TIF"
    path.write_bytes(tiff(picture, order, big))
    expected = np.rint(picture / 257).astype(np.uint8) if picture.dtype == np.uint16 else picture
    np.testing.assert_array_equal(read_picture(path), expected)
    facts = picture_facts(path)
    assert (facts.width, facts.height, facts.orientation, facts.warnings) == (20, 12, 1, ())


@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_adobe_deflate", "packbits"])
def test_compressed_grey_and_palette(tmp_path: Path, compression: str) -> None:
    Image.fromarray(RGB).save(tmp_path / "a.tiff", compression=compression)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tiff"), RGB)
    palette = Image.fromarray(RGB).quantize(16)
    for picture in (Image.fromarray(RGB[..., 0]), palette, Image.fromarray(RGB[..., 0] > 99)):
        picture.save(tmp_path / "a.tiff", compression=compression)
        np.testing.assert_array_equal(read_picture(tmp_path / "a.tiff"), np.asarray(picture.convert("RGB")))


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("order", ["<", ">"])
def test_pixels_stay_as_stored(tmp_path: Path, orientation: int, order: str) -> None:
    (tmp_path / "a.tif").write_bytes(tiff(RGB, order, t274=(3, [orientation])))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif"), RGB)
    assert picture_facts(tmp_path / "a.tif").orientation == orientation


@pytest.mark.parametrize("kind", [0, 1, 2])
def test_alpha_is_dropped(tmp_path: Path, kind: int) -> None:
    alpha = np.full((12, 20, 1), 9, np.uint8)
    (tmp_path / "a.tif").write_bytes(tiff(np.dstack([RGB, alpha]), t338=(3, [kind])))
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif"), RGB)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (tiff(RGB.astype(np.float32), t339=(3, [3] * 3)), "other numbers than whole ones of 8 or 16 bit"),
        (tiff(RGB.astype(np.uint32)), "other numbers than whole ones of 8 or 16 bit"),
        (tiff(DEEP, t339=(3, [2] * 3)), "other numbers than whole ones of 8 or 16 bit"),
        (tiff(np.dstack([RGB, RGB[..., :1]]), t262=(3, [5])), "colours that are neither RGB nor grey"),
        (tiff(RGB, t262=(3, [8])), "colours that are neither RGB nor grey"),
        (tiff(RGB, t262=(3, [32803])), "colours that are neither RGB nor grey"),
        (tiff(DEEP, t284=(3, [2])), "16 bit with inverted or separate planes"),
        (tiff(DEEP[..., :1], t262=(3, [0])), "16 bit with inverted or separate planes"),
        (tiff(RGB, t256=(4, [1 << 20]), t257=(4, [1 << 20])), "claims 1048576 x 1048576 pixels"),
        (tiff(RGB, t322=(4, [1 << 16]), t323=(4, [1 << 16])), "tiles of an unusable size"),
        (tiff(RGB, t279=(4, [1 << 20])), "truncated"),
        (tiff(RGB, t273=(4, [1 << 20])), "truncated"),
        (tiff(RGB, t273=None), "truncated"),
        (tiff(RGB, t256=None), "not a TIFF file, or it is damaged"),
        (b"hello, world, hello, world", "not a TIFF file, or it is damaged"),
        (b"II*\0\x08\0\0\0\0\0\0\0\0\0\0\0\0\0", "not a TIFF file, or it is damaged"),
        (b"II*\0\xff\xff\xff\xff\0\0\0\0\0\0\0\0\0\0", "not a TIFF file, or it is damaged"),
        (b"", "not a TIFF file, or it is damaged"),
    ],
)
def test_what_is_not_read_is_one_line(
    tmp_path: Path, data: bytes, message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "a.tif").write_bytes(data)
    with pytest.raises(RigError, match=rf"a\.tif: .*{message}.*; ") as caught:
        read_picture(tmp_path / "a.tif")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


def encoded(compression: str) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.tile(RGB, (4, 4, 1))).save(file, "TIFF", compression=compression)
    return file.getvalue()


@pytest.mark.parametrize("compression", ["raw", "tiff_lzw", "tiff_adobe_deflate", "jpeg"])
def test_cuts_and_flips_are_quiet_errors(tmp_path: Path, compression: str, capfd: pytest.CaptureFixture[str]) -> None:
    data, path, refused = encoded(compression), tmp_path / "a.tif", 0
    for length in range(0, len(data) - 8, 1 + len(data) // 60):
        path.write_bytes(data[:length])
        with pytest.raises(RigError, match=r"a\.tif: "):
            read_picture(path)
    for at in RNG.integers(0, len(data), 300):
        broken = bytearray(data)
        broken[at] ^= int(RNG.integers(1, 256))
        path.write_bytes(broken)
        try:
            assert read_picture(path).shape[2] == 3
        except RigError:
            refused += 1
    assert refused
    assert capfd.readouterr() == ("", "")


def test_first_of_several_pages(tmp_path: Path) -> None:
    cv2.imwritemulti(str(tmp_path / "a.tif"), [RGB[..., ::-1], np.zeros_like(RGB)])
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif"), RGB)
