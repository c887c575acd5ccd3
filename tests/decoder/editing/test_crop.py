"""Crops: regions against formulas of their own, what stays keeps its bits and one id, a fade changes opacity alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.scene.lattice import dequantise
from decogs.codec.scene.state import State, part_of
from decogs.decoder.editing import Box, Concat, Crop, Polygon, Region, Sphere, Trim, edit
from decogs.decoder.editing.regions import region_of
from decogs.formats.errors import UsageError
from decogs.formats.splats import sigmoid
from edited_streams import assert_same_values, bodies, header_of, in_order_of_values, states_of

PLACES = np.random.default_rng(8).uniform(-3, 3, (4000, 3))
SQUARE = ((-1.0, -2.0), (1.5, -2.0), (1.5, 1.0), (-1.0, 1.0))


@pytest.mark.parametrize(
    ("words", "region"),
    [
        ("box -1,-2,-3 1,2,3.5", Box((-1, -2, -3), (1, 2, 3.5))),
        ("sphere 1,2,-3 0.5", Sphere((1, 2, -3), 0.5)),
        ("polygon 0,0 1,0 0,1", Polygon(((0, 0), (1, 0), (0, 1)))),
        ("polygon -1,0 1,0 0,1 axis=z from=-1 to=2", Polygon(((-1, 0), (1, 0), (0, 1)), "z", -1, 2)),
    ],
)
def test_a_region_is_written_in_words(words: str, region: Region) -> None:
    assert region_of(words.split()) == region


@pytest.mark.parametrize(
    "words",
    [
        "box",
        "box 0,0,0",
        "box 0,0,0 1,1",
        "box 1,0,0 0,1,1",
        "box 0,0,0 1,1,nan",
        "box 0,0,0 1,1,inf",
        "sphere 0,0,0 0",
        "sphere 0,0,0 -1",
        "sphere 0,0 1",
        "sphere 0,0,0 a",
        "polygon 0,0 1,0",
        "polygon 0,0 1,0 0,1 axis=w",
        "polygon 0,0 1,0 0,1 from=2 to=1",
        "polygon 0,0 1,0 0,1 above=1",
        "cylinder 0,0,0 1",
    ],
)
def test_what_is_no_region_is_refused(words: str) -> None:
    with pytest.raises(UsageError):
        region_of(words.split())


def test_depth_is_the_distance_to_the_nearest_place_of_the_border() -> None:
    """Against the nearest of many points on it: never nearer, and farther by less than their spacing of .02."""
    directions = np.random.default_rng(1).normal(size=(60_000, 3))
    sphere = Sphere((0.5, 0, -0.5), 1.2)
    on_sphere = sphere.centre + sphere.radius * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    grid = np.arange(0, 1.0001, 0.02)
    faces = np.array([np.insert((a, b), axis, end) for axis in range(3) for end in (0, 1) for a in grid for b in grid])
    box = Box((-1, -2, -0.5), (1, -1, 1.5))
    on_box = faces * np.subtract(box.high, box.low) + box.low
    for region, border in ((sphere, on_sphere), (box, on_box)):
        points = PLACES[:300]
        nearest = np.array([np.linalg.norm(border - point, axis=1).min() for point in points])
        found = np.abs(region.depth(points))
        assert (found <= nearest + 1e-12).all()
        assert (nearest - found).max() < 0.04
        inside = np.linalg.norm(points - sphere.centre, axis=1) < 1.2
        if region is box:
            inside = ((points > box.low) & (points < box.high)).all(axis=1)
        np.testing.assert_array_equal(region.depth(points) > 0, inside)


def test_a_square_plan_is_a_box() -> None:
    for axis, place in (("x", 0), ("y", 1), ("z", 2)):
        low, high = (np.insert(corner, place, level) for corner, level in ((SQUARE[0], -0.5), (SQUARE[2], 2.0)))
        box, plan = Box(tuple(low), tuple(high)), Polygon(SQUARE, axis, -0.5, 2.0)
        np.testing.assert_allclose(plan.depth(PLACES), box.depth(PLACES), atol=1e-12)
    turned = Polygon(SQUARE[::-1], "z", -0.5, 2.0)
    np.testing.assert_allclose(turned.depth(PLACES), plan.depth(PLACES), atol=1e-12)


def test_a_plan_may_have_dents() -> None:
    dented = Polygon(((-2, -2), (2, -2), (2, 2), (0, 0), (-2, 2)))
    x, z = PLACES[:, 0], PLACES[:, 2]
    inside = (np.abs(x) < 2) & (z > -2) & (z < np.abs(x))
    np.testing.assert_array_equal(dented.depth(PLACES) > 0, inside)


def assert_same_gaussians(found: list[State], expected: list[State]) -> None:
    """In any order: what comes back into a crop has another id, and so another place."""
    for one, other in zip(found, expected, strict=True):
        now, was = ([values for values, _ in in_order_of_values(state)] for state in (one, other))
        assert now == was


REGIONS = [Sphere((0.1, 0, 2.0), 0.4501), Box((-0.3001, -0.4001, 1.8001), (0.5001, 0.2001, 2.4001))]
"""No point of the lattice lies on a border, where single precision and double differ."""


def expected_states(path: Path, region: Region, outside: bool, segments: list[slice]) -> list[State]:
    """By floats and sets of ids: in any frame of a segment inside is in all of them."""
    lattice, states, found = header_of(path).lattice, states_of(path), []
    for segment in segments:
        kept: set[int] = set()
        for state in states[segment]:
            inside = (region.depth(dequantise(state, lattice).means) >= 0) != outside
            kept |= set(state.ids[inside].tolist())
        found += [part_of(state, np.isin(state.ids, list(kept))) for state in states[segment]]
    return found


@pytest.mark.parametrize("region", REGIONS)
@pytest.mark.parametrize("outside", [False, True])
@pytest.mark.parametrize("kind", ["small_stream", "segmented_stream"])
def test_what_is_kept_keeps_its_bits_in_every_frame(kind: str, region: Region, outside: bool, request) -> None:
    path = request.getfixturevalue(kind).path
    out = path.with_name("out.dgs")
    edit(path, out, [Crop(region, outside)])
    step = 4 if kind == "small_stream" else 5
    expected = expected_states(
        path, region, outside, [slice(k, k + step) for k in range(0, len(states_of(path)), step)]
    )
    assert_same_gaussians(states_of(out), expected)
    assert 0 < len(expected[0]) < len(states_of(path)[0])
    assert [kind for kind, _ in bodies(out)] == [kind for kind, _ in bodies(path)]


def test_every_gaussian_has_one_name_and_every_name_one_gaussian(segmented_stream, tmp_path: Path) -> None:
    region = REGIONS[0]
    edit(segmented_stream.path, tmp_path / "out.dgs", [Crop(region)])
    expected = expected_states(segmented_stream.path, region, False, [slice(k, k + 5) for k in range(0, 20, 5)])
    owner: dict[int, int] = {}
    before: dict[int, int] = {}
    for was, now in zip(expected, states_of(tmp_path / "out.dgs"), strict=True):
        pairs = zip(in_order_of_values(was), in_order_of_values(now), strict=True)
        names = {inner: outer for (_, inner), (_, outer) in pairs}
        for inner, outer in names.items():
            assert owner.setdefault(outer, inner) == inner
            assert before.get(inner, outer) == outer
        before = names
    assert len(owner) > len(expected[0])


def test_a_crop_that_holds_everything_changes_no_byte(segmented_stream, tmp_path: Path) -> None:
    edit(segmented_stream.path, tmp_path / "out.dgs", [Crop(Sphere((0, 0, 0), 1e6))])
    assert (tmp_path / "out.dgs").read_bytes() == segmented_stream.path.read_bytes()


def test_operations_behind_a_crop_and_before_it(small_stream, tmp_path: Path) -> None:
    """Segments are those of the take that is cropped, whatever part of it is read."""
    path, region = small_stream.path, REGIONS[0]
    edit(path, tmp_path / "out.dgs", [Crop(region), Trim(slice(2, 6))])
    assert_same_gaussians(
        states_of(tmp_path / "out.dgs"), expected_states(path, region, False, [slice(0, 4), slice(4, 8)])[2:6]
    )
    edit(path, tmp_path / "out.dgs", [Trim(slice(2, 6)), Crop(region)])
    assert_same_gaussians(
        states_of(tmp_path / "out.dgs"), expected_states(path, region, False, [slice(2, 4), slice(4, 6)])
    )
    edit(path, tmp_path / "out.dgs", [Concat((path,)), Crop(region), Crop(region)])
    once = expected_states(path, region, False, [slice(0, 4), slice(4, 8)])
    assert_same_gaussians(states_of(tmp_path / "out.dgs"), once + once)


@pytest.mark.parametrize("outside", [False, True])
def test_a_fade_lets_opacity_fall_to_nothing_and_changes_nothing_else(outside: bool, segmented_stream) -> None:
    path = segmented_stream.path
    out, region, fade = path.with_name("out.dgs"), Sphere((0.1, 0, 2.0), 0.3), 0.25
    edit(path, out, [Trim(slice(0, 5)), Crop(region, outside, fade)])
    header = header_of(path)
    wide = Sphere(region.centre, region.radius + (-fade if outside else fade))
    expected = expected_states(path, wide, outside, [slice(0, 5)])
    for was, now in zip(expected, states_of(out), strict=True):
        was, now = (part_of(state, np.lexsort(state.means.T)) for state in (was, now))
        assert_same_values([replace(now, opacity_logits=was.opacity_logits)], [was])
        depth = region.depth(dequantise(was, header.lattice).means) * (-1 if outside else 1)
        np.testing.assert_array_equal(now.opacity_logits[depth > 0], was.opacity_logits[depth > 0])
        before, after = (sigmoid(state.opacity_logits * header.lattice.opacity_logits) for state in (was, now))
        assert (after <= before).all()
        # Nothing: one step of the lattice around 1/1024.
        assert after[depth < -fade].max(initial=0) < 2 / 1024
        half = np.abs(depth + fade / 2) < 0.01
        assert half.any()
        # The middle of the fade; .01 units and half a step of .25 in the logit are at most .06 and .04 of opacity.
        np.testing.assert_allclose(after[half] / before[half], 0.5, atol=0.11)


def test_nothing_left_says_where_the_scene_is(small_stream, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"nothing would be left; 96 % of the first frame lies between -0\.\d"):
        edit(small_stream.path, tmp_path / "out.dgs", [Crop(Sphere((50, 0, 0), 1.0))])
    with pytest.raises(UsageError, match="a fade of -1 is not possible"):
        edit(small_stream.path, tmp_path / "out.dgs", [Crop(REGIONS[0], fade=-1)])
    assert not list(tmp_path.glob("out*"))
