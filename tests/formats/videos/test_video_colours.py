"""From planes to RGB: the kernel against the formula in floats, and colours through whole videos."""

from __future__ import annotations

import hashlib
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from decogs.formats.colours.ycbcr import HEEDS_SITING, YCbCr, chroma_siting, rgb_of
from decogs.formats.errors import RigError
from decogs.formats.system.kernels import INSTRUCTION_SETS
from decogs.formats.videos.reading import open_video
from instruction_sets import printed_on

WEIGHTS = {1: (0.2126, 0.0722), 5: (0.299, 0.114), 7: (0.212, 0.087), 9: (0.2627, 0.0593)}
"""Of red and blue in luma, by H.273's number of the matrix."""

PATCHES = [(200, 40, 40), (40, 180, 60), (50, 60, 210), (220, 200, 40), (30, 190, 200), (190, 60, 180)]
PATCHES += [(128, 128, 128), (235, 235, 235), (20, 20, 20), (240, 140, 60), (90, 120, 60), (180, 150, 130)]
SIDE = 32


def along(samples: np.ndarray, axis: int, count: int, on_first: bool) -> np.ndarray:
    """Samples at every place of luma, interpolated linearly between where they lie, in floats."""
    if samples.shape[axis] == count:
        return samples
    at = np.arange(count) / 2 if on_first else (np.arange(count) - 0.5) / 2
    at = np.clip(at, 0, samples.shape[axis] - 1)
    low = np.floor(at).astype(int)
    high = np.minimum(low + 1, samples.shape[axis] - 1)
    share = (at - low).reshape([-1 if k == axis else 1 for k in range(2)])
    return samples.take(low, axis) * (1 - share) + samples.take(high, axis) * share


def in_floats(picture: YCbCr) -> np.ndarray:
    """RGB from 0 to 255, not rounded. Source: H.273, the equations of MatrixCoefficients."""
    red, blue = WEIGHTS[picture.matrix]
    levels = 2 ** (picture.bits - 8)
    (height, width), peak = picture.planes[0].shape, 256 * levels - 1
    luma, *chroma = (plane.astype(float) for plane in picture.planes)
    cb, cr = (along(along(c, 1, width, picture.siting[0]), 0, height, picture.siting[1]) for c in chroma)
    if picture.full:
        y, cb, cr = luma / peak, (cb - 128 * levels) / peak, (cr - 128 * levels) / peak
    else:
        y, cb, cr = (luma / levels - 16) / 219, (cb / levels - 128) / 224, (cr / levels - 128) / 224
    r, b = y + 2 * (1 - red) * cr, y + 2 * (1 - blue) * cb
    g = (y - red * r - blue * b) / (1 - red - blue)
    return 255 * np.stack([r, g, b], axis=-1).clip(0, 1)


def random_picture(seed: int, size: tuple[int, int], halved: tuple[bool, bool], bits: int, **stated: Any) -> YCbCr:
    rng, (width, height) = np.random.default_rng(seed), size
    shape = tuple((length + 1) // 2 if half else length for length, half in zip((height, width), halved, strict=True))
    kind = np.uint8 if bits == 8 else np.uint16
    planes = [rng.integers(0, 2**bits, each).astype(kind) for each in ((height, width), shape, shape)]
    return YCbCr((planes[0], planes[1], planes[2]), bits, **stated)


@pytest.mark.parametrize("halved", [(True, True), (False, True), (True, False), (False, False)])
@pytest.mark.parametrize("siting", [(True, False), (False, False), (True, True), (False, True)])
@pytest.mark.parametrize(("bits", "matrix", "full"), [(8, 1, False), (8, 5, True), (10, 9, False), (12, 7, True)])
def test_the_kernel_rounds_the_formula_once(
    halved: tuple[bool, bool], siting: tuple[bool, bool], bits: int, matrix: int, full: bool
) -> None:
    for size in ((64, 48), (33, 21), (1, 1), (2, 3), (521, 5)):
        picture = random_picture(1, size, halved, bits, matrix=matrix, full=full, siting=siting)
        # Beside the rounding, half a unit of the matrix's 20 bits times one luma and two chroma samples in sixteenths.
        assert np.abs(rgb_of(picture) - in_floats(picture)).max() <= 0.5 + (1 + 2 * 16) * 2**bits / 2**21


def test_planes_may_lie_in_wider_memory() -> None:
    picture = random_picture(2, (40, 30), (True, True), 8, matrix=1, full=False, siting=(True, False))
    wide = [np.pad(plane, ((0, 0), (0, 24)), constant_values=255) for plane in picture.planes]
    cut = [plane[:, :-24] for plane in wide]
    np.testing.assert_array_equal(rgb_of(YCbCr((cut[0], cut[1], cut[2]), 8, 1, False, (True, False))), rgb_of(picture))


def digest() -> str:
    made = hashlib.sha256()
    for seed, bits in enumerate((8, 10, 12)):
        for halved in ((True, True), (False, True), (False, False)):
            for siting in ((True, False), (False, False)):
                given = {"matrix": 1, "full": False, "siting": siting}
                made.update(rgb_of(random_picture(seed, (333, 21), halved, bits, **given)).tobytes())
    return made.hexdigest()


@pytest.mark.parametrize("instruction_set", INSTRUCTION_SETS)
def test_any_instruction_set_gives_the_same_bits(instruction_set: str) -> None:
    folders = [str(Path(__file__).parent), str(Path(__file__).parents[2])]
    program = f"import sys; sys.path[:0] = {folders}; import test_video_colours; print(test_video_colours.digest())"
    assert printed_on(instruction_set, "-c", program) == digest()


def patches() -> np.ndarray:
    """4 x 3 patches, (H, W, 3)."""
    return np.array(PATCHES, np.uint8).reshape(3, 4, 3).repeat(SIDE, 0).repeat(SIDE, 1)


def write(path: Path, codec: str, pixels: str, matrix: int | None, full: bool, **options: str) -> None:
    """A video of the patches, whose planes are made here by the formula, tagged with the matrix and range."""
    shown, (red, blue) = patches().astype(float) / 255, WEIGHTS[matrix or 5]
    levels = 4 if "10" in pixels else 1
    r, g, b = (shown[..., k] for k in range(3))
    y = red * r + (1 - red - blue) * g + blue * b
    cb, cr = (b - y) / (2 * (1 - blue)), (r - y) / (2 * (1 - red))
    if full:
        peak = 256 * levels - 1
        planes = [y * peak, cb * peak + 128 * levels, cr * peak + 128 * levels]
    else:
        planes = [levels * (219 * y + 16), levels * (224 * cb + 128), levels * (224 * cr + 128)]
    steps = [(1, 1), *[(2 if "420" in pixels else 1, 1 if "444" in pixels else 2)] * 2]
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=25, options=options)
        stream.height, stream.width, stream.pix_fmt = *shown.shape[:2], pixels
        frame = av.VideoFrame(shown.shape[1], shown.shape[0], pixels)
        for target in (stream.codec_context, frame):
            target.color_range = 2 if full else 1
            target.colorspace = 2 if matrix is None else matrix
        kind = np.dtype("<u2" if levels > 1 else "u1")
        for plane, samples, (down, across) in zip(frame.planes, planes, steps, strict=False):
            rows = np.zeros((plane.height, plane.line_size // kind.itemsize), kind)
            rows[:, : plane.width] = np.rint(samples)[::down, ::across]
            plane.update(rows.tobytes())
        for t in range(3):
            frame.pts, frame.time_base = t, Fraction(1, 25)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())


def worst(picture: np.ndarray) -> float:
    """The largest difference of a patch's middle from its colour, in levels."""
    inside = slice(SIDE // 4, 3 * SIDE // 4)
    found = picture.reshape(3, SIDE, 4, SIDE, 3)[:, inside, :, inside].astype(float).mean((1, 3))
    return float(np.abs(found - np.array(PATCHES).reshape(3, 4, 3)).max())


X264, X265 = {"crf": "2"}, {"crf": "2", "x265-params": "log-level=none"}
CODECS = {
    "h264.mp4": ("libx264", "yuv420p", X264),
    "h264_444.mp4": ("libx264", "yuv444p", X264),
    "hevc.mp4": ("libx265", "yuv420p10le", X265),
    "prores.mov": ("prores_ks", "yuv422p10le", {}),
    "vp9.webm": ("libvpx-vp9", "yuv420p", {"crf": "2", "b": "0"}),
    "ffv1.mkv": ("ffv1", "yuv420p", {}),
    "ffv1_10.mkv": ("ffv1", "yuv422p10le", {}),
    "av1.mp4": ("libsvtav1", "yuv420p", {"crf": "4", "preset": "10", "svtav1-params": "lp=1"}),
}


@pytest.mark.parametrize("name", CODECS)
@pytest.mark.parametrize(("matrix", "full"), [(1, False), (5, False), (9, False), (1, True), (None, False)])
def test_patches_keep_their_colours_through_every_codec(
    tmp_path: Path, name: str, matrix: int | None, full: bool
) -> None:
    codec, pixels, options = CODECS[name]
    if codec == "prores_ks" and full:
        pytest.skip("ProRes has the limited range only")
    write(tmp_path / name, codec, pixels, matrix, full, **options)
    for picture in open_video(tmp_path / name).read(0, 3):
        # 8-bit planes round colours by up to 1.1 levels; the codecs, nearly lossless here, add the rest.
        assert worst(picture) <= 2


def test_untagged_videos_follow_their_size(tmp_path: Path) -> None:
    """BT.709 from 1280 columns or more than 576 rows on."""
    colour = np.array([40.0, 180.0, 60.0]) / 255
    for size, matrix in (((720, 576), 5), ((1280, 720), 1), ((720, 1280), 1), ((640, 360), 5), ((1352, 1014), 1)):
        red, blue = WEIGHTS[matrix]
        y = colour @ [red, 1 - red - blue, blue]
        values = (219 * y + 16, 112 * (colour[2] - y) / (1 - blue) + 128, 112 * (colour[0] - y) / (1 - red) + 128)
        with av.open(str(tmp_path / "a.mkv"), "w") as container:
            stream = container.add_stream("ffv1", rate=25)
            stream.width, stream.height, stream.pix_fmt = *size, "yuv420p"
            frame = av.VideoFrame(*size, "yuv420p")
            for plane, value in zip(frame.planes, values, strict=True):
                plane.update(bytes([round(value)]) * plane.buffer_size)
            container.mux(stream.encode(frame))
            container.mux(stream.encode())
        (picture,) = open_video(tmp_path / "a.mkv").read(0, 1)
        assert np.abs(picture.astype(float) - 255 * colour).max() < 1.6, size  # planes rounded to 8 bit


def test_420_has_no_bias(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    frame = av.VideoFrame(64, 48, "yuv420p")
    values = []
    for plane in frame.planes:
        values.append(rng.integers(60, 180, (plane.height, plane.line_size)).astype(np.uint8))
        plane.update(values[-1].tobytes())
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    source = open_video(tmp_path / "a.mkv")
    (picture,) = source.read(0, 1)
    y, cb, cr = (plane[:, :width].astype(float) for plane, width in zip(values, (64, 32, 32), strict=True))
    expected = in_floats(YCbCr((y, cb, cr), 8, 5, False, source.siting))
    assert np.abs((picture - expected).mean((0, 1))).max() < 0.05  # of 3072 values rounded to nearest: .005 each


@pytest.mark.skipif(not HEEDS_SITING, reason="PyAV before 17 does not tell")
@pytest.mark.parametrize(("location", "siting"), [(0, (True, False)), (1, (False, False)), (2, (True, True))])
@pytest.mark.parametrize(("codec", "pixels"), [("libx264", "yuv420p"), ("libx265", "yuv420p10le")])
def test_chroma_lies_where_the_stream_says(
    tmp_path: Path, location: int, siting: tuple[bool, bool], codec: str, pixels: str
) -> None:
    name = codec.removeprefix("lib")
    # One in two hundred pictures of x265 is refused by the writer of .mp4.
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        options = {f"{name}-params": f"chromaloc={location}:log-level=none", "crf": "2"}
        stream = container.add_stream(codec, rate=25, options=options)
        stream.width, stream.height, stream.pix_fmt = 64, 48, pixels
        frame = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with av.open(str(tmp_path / "a.mkv")) as container:
        frame = next(container.decode(video=0))
        samples = frame.to_ndarray()
        assert chroma_siting(frame) == siting
        assert (frame.to_ndarray() == samples).all()
    assert open_video(tmp_path / "a.mkv").siting == siting


@pytest.mark.parametrize("pixels", ["bgr0", "gbrp10le", "gray"])
def test_formats_without_chroma_are_read_as_they_are(tmp_path: Path, pixels: str) -> None:
    shown = patches()
    if pixels == "gray":
        shown = np.repeat(shown[..., 1:2], 3, axis=-1)
    with av.open(str(tmp_path / "a.mkv"), "w") as container:
        stream = container.add_stream("ffv1", rate=25)
        stream.height, stream.width, stream.pix_fmt = *shown.shape[:2], pixels
        frame = av.VideoFrame.from_ndarray(shown, format="rgb24")
        container.mux(stream.encode(frame.reformat(format=pixels, dst_color_range=2, interpolation=2 | 0x40000)))
        container.mux(stream.encode())
    (picture,) = open_video(tmp_path / "a.mkv").read(0, 1)
    assert np.abs(picture.astype(float) - shown).max() <= (0 if pixels == "bgr0" else 1)


@pytest.mark.parametrize("pixels", ["nv12", "yuyv422"])
@pytest.mark.parametrize("full", [False, True])
def test_other_orders_of_samples_keep_their_colours(tmp_path: Path, pixels: str, full: bool) -> None:
    with av.open(str(tmp_path / "a.mkv"), "w", format="matroska") as container:
        stream = container.add_stream("rawvideo", rate=25)
        stream.height, stream.width, stream.pix_fmt = *patches().shape[:2], pixels
        stream.codec_context.color_range, stream.codec_context.colorspace = 2 if full else 1, 1
        frame = av.VideoFrame.from_ndarray(patches(), format="rgb24").reformat(
            format=pixels, dst_colorspace=1, dst_color_range=2 if full else 1, interpolation=2 | 0x40000
        )
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    (picture,) = open_video(tmp_path / "a.mkv").read(0, 1)
    assert worst(picture) <= 3  # FFmpeg's way to these planes loses up to two levels


def test_a_matrix_that_is_not_read_is_named(tmp_path: Path) -> None:
    with av.open(str(tmp_path / "a.mp4"), "w") as container:
        stream = container.add_stream("libx264", rate=25, options={"x264-params": "colormatrix=YCgCo"})
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv444p"
        container.mux(stream.encode(av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8), format="rgb24")))
        container.mux(stream.encode())
    with pytest.raises(RigError, match=r"a\.mp4: colours coded as YCgCo are not read"):
        open_video(tmp_path / "a.mp4")
