"""Where a scene holds: what cameras testify of a view, and the map and the fence that are made of it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.scene.lattice import default_lattice
from decogs.decoder.cameras.moves import looking
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import Camera, camera_centre
from decogs.formats.splats import Splats
from decogs.rig.check.plan import plan_axes
from decogs.takes.holding import Expected, _Stands, drawn, expected_psnr, holding, parts
from decogs.takes.witness import Witnessed, Witnesses, doubtful_blocks
from moving_walls import wall

UP = np.array([0.0, -1.0, 0.0])
TARGET = np.array([0.0, 0.0, 4.0])
COUNT = 5


def camera(name: str, degrees: float, distance: float = 4.0) -> Camera:
    """On an arc before the wall."""
    angle = np.radians(degrees)
    place = TARGET - distance * np.array([np.sin(angle), 0.0, np.cos(angle)])
    return Camera(name, 80, 60, 70.0, 70.0, 40.0, 30.0, looking(place, TARGET, UP))


CAMERAS = tuple(camera(f"cam{k}", 12.0 * (k - COUNT // 2)) for k in range(COUNT))
HEADER = StreamHeader(cameras=CAMERAS, lattice=default_lattice(1.0))


def recorded(scene: Splats, exposure: float = 1.0) -> dict[str, np.ndarray]:
    pictures = {each.name: np.clip(render_view(HEADER, scene, each).image, 0, 1) for each in CAMERAS}
    return {name: np.rint(255 * exposure * picture).astype(np.uint8) for name, picture in pictures.items()}


def nearer(scene: Splats, by: float) -> Splats:
    return replace(scene, means=(scene.means * np.float32(1 - by)).astype(np.float32))


def test_what_agrees_with_others_pictures_is_right_and_what_lies_elsewhere_is_not() -> None:
    """Gaussians at wrong depths look alike from the middle, but not from beside."""
    scene = wall()
    true, _ = Witnesses(HEADER, scene, recorded(scene)).testimony(camera("", 6.0))
    wrong, _ = Witnesses(HEADER, nearer(scene, 0.2), recorded(scene)).testimony(camera("", 6.0))
    assert true.agreement > wrong.agreement + 3
    assert true.seen > 0.6
    assert true.angle == pytest.approx(6.0, abs=1.5)


def test_a_camera_is_no_witness_of_its_own_picture() -> None:
    scene, pictures = wall(), recorded(wall())
    pictures["cam2"] = 255 - pictures["cam2"]
    untouched = Witnesses(HEADER, scene, {**pictures, "cam2": recorded(scene)["cam2"]})
    assert Witnesses(HEADER, scene, pictures).testimony(CAMERAS[2])[0] == untouched.testimony(CAMERAS[2])[0]
    assert Witnesses(HEADER, scene, pictures).testimony(CAMERAS[1])[0].agreement < 20


def test_a_camera_s_own_exposure_is_no_error_of_the_scene() -> None:
    scene = wall()
    bright, dark = (
        Witnesses(HEADER, scene, recorded(scene, exposure)).testimony(CAMERAS[2])[0] for exposure in (1.0, 0.6)
    )
    assert dark.agreement == pytest.approx(bright.agreement, abs=0.5)


def test_where_nobody_looks_nothing_is_known() -> None:
    scene = wall()
    away = Camera("", 80, 60, 70.0, 70.0, 40.0, 30.0, looking(np.zeros(3), np.array([0.0, 0.0, -1.0]), UP))
    testimony, error = Witnesses(HEADER, scene, recorded(scene)).testimony(away)
    assert testimony.seen == 0
    assert np.isnan(error).all()
    assert expected_psnr(testimony) is None


def test_the_last_of_an_arc_is_one_sided() -> None:
    scene = wall()
    witnesses = Witnesses(HEADER, scene, recorded(scene))
    middle, last = (witnesses.testimony(CAMERAS[k])[0] for k in (2, 4))
    assert middle.one_sided < 0.2 < 0.9 < last.one_sided
    same = Witnessed(25.0, 0.9, 10.0, middle.one_sided)
    one, other = expected_psnr(same), expected_psnr(replace(same, one_sided=last.one_sided))
    assert one is not None
    assert other is not None
    assert one > other + 1


def test_the_map_and_its_fence() -> None:
    scene = wall()
    witnesses = Witnesses(HEADER, scene, recorded(scene))
    found = holding(witnesses, CAMERAS, {})
    cells = [cell for row in found.cells for cell in row]
    assert set(found.own) == {each.name for each in CAMERAS}
    within = [cell.psnr for cell in cells if cell.is_within]
    assert within
    assert min(value for value in within if value is not None) >= found.least
    # A camera that was left out, and came out 4 dB worse than expected, lowers all by half of that.
    expected = expected_psnr(witnesses.testimony(camera("left", 6.0))[0])
    assert expected is not None
    lower = holding(witnesses, CAMERAS, {"left": (camera("left", 6.0), expected - 4)})
    assert lower.usual == pytest.approx(found.usual - 2)
    assert [cell.is_within for row in lower.cells for cell in row] == [cell.is_within for cell in cells]


def test_blocks_are_doubted_by_their_errors_and_where_nobody_saw() -> None:
    error = np.full((40, 50), 1e-4)  # two rows and three columns of whole blocks
    error[:16, 16:32] = 0.05
    error[16:32, :16] = np.nan
    error[16:22, 32:48] = np.nan  # a third that nobody saw
    np.testing.assert_array_equal(doubtful_blocks(error), [[False, True, False], [True, False, True]])


def test_the_picture_of_the_weakest_place_is_red_where_it_is_likely_wrong() -> None:
    scene = wall()
    pictures = recorded(scene)
    spoilt = {name: picture.copy() for name, picture in pictures.items()}
    for picture in spoilt.values():
        picture[:20] = 255 - picture[:20]
    right, wrong = (Witnesses(HEADER, scene, some).doubted(camera("", 0.5)).astype(int) for some in (pictures, spoilt))
    reddened = (wrong[..., 0] - right[..., 0] > 20) & (wrong[..., 1] < right[..., 1])
    assert reddened[:16].mean() > 0.5
    assert not reddened[32:].any()


def test_viewers_stand_upright_among_the_cameras() -> None:
    """Between two cameras, as high as these, looking where they do."""
    scene = wall()
    axes = plan_axes(CAMERAS)
    stands = _Stands(CAMERAS, Witnesses(HEADER, scene, recorded(scene)), axes)
    middle = (camera_centre(CAMERAS[1]) + camera_centre(CAMERAS[2])) / 2
    view, distance = stands.view(middle @ axes.T)
    assert view is not None
    assert distance == pytest.approx(1, abs=0.1)
    np.testing.assert_allclose(camera_centre(view), middle, atol=0.05)
    assert -view.world_to_camera[1, :3] @ UP > 0.99
    ways = [each.world_to_camera[2, :3] for each in (CAMERAS[1], CAMERAS[2], view)]
    assert (ways[0] + ways[1]) @ ways[2] > 1.95
    near, far = (stands.view((TARGET - distance * np.array([0.0, 0.0, 1.0])) @ axes.T)[1] for distance in (1.5, 7.0))
    assert near == pytest.approx(1.5 / 4, abs=0.1)
    assert far == pytest.approx(7 / 4, abs=0.2)
    assert stands.between(middle @ axes.T) == ("cam1", "cam2")


def test_the_map_is_drawn() -> None:
    scene = wall()
    found = holding(Witnesses(HEADER, scene, recorded(scene)), CAMERAS, {})
    known = replace(found, doubted=None, cells=((Expected(30.0, True), Expected(None, False)),))
    drawing = drawn(known, CAMERAS, ["cam1"])
    assert drawing.count("<rect") == 2
    assert "30.0 dB, within the fence" in drawing
    assert "<title>unknown</title>" in drawing
    assert drawing.count("<circle") == COUNT
    weak = Expected(21.0, False, ("cam1", "cam3"))
    _, told, *_ = parts(replace(known, cells=((*known.cells[0], weak),)), CAMERAS, [])
    assert "One more camera would bring most between cam1 and cam3: 21.0 dB are expected there." in told
    nothing = Expected(None, False, ("cam0", "cam1"))
    _, told, *_ = parts(replace(known, cells=((weak, nothing),)), CAMERAS, [])
    assert "between cam0 and cam1: nothing is known there." in told
    heading, told, _, _, data = parts(found, CAMERAS, [])
    assert heading == "<h2>Where it holds</h2>"
    read = json.loads(data.partition(">")[2].removesuffix("</script>"))
    rows, columns = len(read["within"]), len(read["within"][0])
    at = np.array(read["axes"]) @ camera_centre(CAMERAS[2])
    low, high = np.array(read["low"]), np.array(read["high"])
    column, row = ((at - low) / (high - low) * (columns, rows)).astype(int)
    assert read["within"][row][column]
    assert read["psnr"][row][column] > found.own["cam2"], "the camera does stand there"
    assert told.startswith("<p>5 cameras see little of each other")
    assert f"{found.usual:.1f} dB" in told
