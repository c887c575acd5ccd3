"""Stereo pairs and 360 degree pictures: where small Gaussians must lie, by the projections' own formulas."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.lattice import default_lattice
from decogs.decoder import decode, render_view
from decogs.decoder.cameras.moves import looking
from decogs.decoder.commands import decode_main
from decogs.decoder.rendering.layouts import Equirectangular, Stereo
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.splats import SH_C0, Splats

UP = np.array([0.0, 0.0, 1.0])
PLACE = np.array([0.4, -0.3, 0.2])
CAMERA = Camera("c", 80, 60, 50.0, 50.0, 40.0, 30.0, looking(PLACE, PLACE + np.array([0.0, 1.0, 0.0]), UP))
HEADER = StreamHeader((CAMERA,), default_lattice(2.0), sh_degree=0)


def balls(places: np.ndarray, size: float, grey: float = 1.0) -> Splats:
    n = len(places)
    return Splats(
        np.asarray(places, np.float32),
        np.full((n, 3), np.log(size), np.float32),
        np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        np.full(n, 6, np.float32),
        np.full((n, 1, 3), (grey - 0.5) / SH_C0, np.float32),
    )


def middle_of(picture: np.ndarray) -> tuple[float, float]:
    """Column and row of the brightness's centre, in pixels from the corner."""
    rows, columns = np.mgrid[: picture.shape[0], : picture.shape[1]] + 0.5
    total = picture.sum()
    return float((columns * picture).sum() / total), float((rows * picture).sum() / total)


@pytest.mark.parametrize("longitude", [-155, -135, -90, -44, -10, 0, 45, 80, 135])
@pytest.mark.parametrize("latitude", [-70, -45, -20, 0, 30, 50, 75])
def test_a_direction_has_its_place_on_the_sphere(longitude: float, latitude: float) -> None:
    """Longitude to the right of the camera's direction, latitude upwards; the middle of the picture is ahead."""
    a, b = np.radians([longitude, latitude])
    ray = np.array([np.cos(b) * np.sin(a), np.cos(b) * np.cos(a), np.sin(b)])
    seen = Equirectangular().render(HEADER, balls((PLACE + 3 * ray)[None], 0.05), CAMERA, {})
    height, width = seen.alpha.shape
    assert (width, height) == (2 * round(np.pi * 50), round(np.pi * 50))
    column, row = middle_of(seen.image[..., 0])
    # A ball is stretched across near a pole, and its ellipse there is one of a face, which is flat.
    assert column == pytest.approx((longitude / 360 + 0.5) * width, abs=0.3 / np.cos(b))
    assert row == pytest.approx((0.5 - latitude / 180) * height, abs=0.3)
    at = seen.alpha.argmax()
    assert seen.depth.ravel()[at] == pytest.approx(3, rel=0.03)


def test_two_eyes_take_a_picture_twice_as_wide() -> None:
    picture = Stereo(0.1).picture_of(CAMERA)
    assert (picture.width, picture.height) == (2 * CAMERA.width, CAMERA.height)


def test_a_sphere_of_one_grey_shows_no_seam() -> None:
    """Points spread evenly (a Fibonacci sphere), so dense that every pixel is covered."""
    k = np.arange(4000) + 0.5
    z, turn = 1 - 2 * k / 4000, np.pi * (1 + 5**0.5) * k
    flat = np.sqrt(1 - z * z)
    places = PLACE + 3 * np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
    seen = Equirectangular().render(HEADER, balls(places, 0.2, grey=0.6), CAMERA, {})
    assert np.abs(seen.image - 0.6).max() < 2 / 255
    assert seen.alpha.min() > 0.99


def test_the_middle_is_what_the_camera_sees() -> None:
    ball = balls(PLACE[None] + [[0.05, 2, 0.04]], 0.1)
    around = Equirectangular().render(HEADER, ball, CAMERA, {})
    ahead = render_view(HEADER, ball, CAMERA)
    height, width = around.alpha.shape
    here, there = middle_of(around.image[..., 0]), middle_of(ahead.image[..., 0])
    assert np.subtract(here, (width / 2, height / 2)) == pytest.approx(np.subtract(there, (40, 30)), abs=0.1)
    assert around.image.sum() == pytest.approx(ahead.image.sum(), rel=0.03)


@pytest.mark.parametrize("depth", [1.0, 2.5])
def test_the_eyes_are_a_baseline_apart(depth: float) -> None:
    """Disparity f b / z, the left eye's picture on the left: it sees a point farther to the right."""
    seen = Stereo(0.1).render(HEADER, balls(PLACE[None] + [[0, depth, 0]], 0.05), CAMERA, {})
    assert seen.image.shape == (60, 160, 3)
    left, right = middle_of(seen.image[:, :80, 0]), middle_of(seen.image[:, 80:, 0])
    assert left[0] - right[0] == pytest.approx(50 * 0.1 / depth, abs=0.05)
    assert (left[0] + right[0]) / 2 == pytest.approx(40, abs=0.05)
    assert left[1] == pytest.approx(right[1], abs=1e-3)


def test_commands_write_them(small_stream, tmp_path) -> None:
    stream = str(small_stream.path)
    assert decode_main([stream, "--view", "cam01", "--stereo", "0.1", "--frames", ":1", "-o", f"{tmp_path}/s.png"]) == 0
    assert cv2.imread(f"{tmp_path}/s.png").shape == (44, 120, 3)
    report = decode(stream, tmp_path / "e.png", view="cam00", layout=Equirectangular(), frames=slice(1), scale=0.5)
    assert (report.width, report.height) == (188, 94)
    assert cv2.imread(f"{tmp_path}/e.png").shape == (94, 188, 3)


def test_what_cannot_be(small_stream, tmp_path) -> None:
    for layout, options, message in (
        (Stereo(0.0), {"output": "x.png"}, "`stereo` 0: give"),
        (Stereo(float("nan")), {"output": "x.png"}, "`stereo` nan"),
        (Stereo(1e308), {"output": "x.png"}, "at most 1e.12"),
        (Stereo(0.1), {"output": "x.exr"}, "is no EXR"),
        (Equirectangular(), {"output": "x.png", "scale": 30}, "8192 is the limit"),
    ):
        with pytest.raises(UsageError, match=message):
            decode(
                small_stream.path,
                tmp_path / options["output"],
                view="cam00",
                layout=layout,
                scale=options.get("scale", 1.0),
            )
    assert not list(tmp_path.glob("x*"))
