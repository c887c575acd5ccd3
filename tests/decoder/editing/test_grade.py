"""Grades: what becomes of a colour, to half a step of the lattice, and rows that keep their bits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.scene.lattice import dequantise
from decogs.decoder.editing import Grade, Sphere, edit
from decogs.decoder.editing.commands import edit_main
from decogs.formats.errors import UsageError
from decogs.formats.geometry.spherical_harmonics import sh_basis
from decogs.formats.stream.container import PacketKind
from edited_streams import assert_same_values, bodies, header_of, states_of

GREY = np.array([0.2126, 0.7152, 0.0722])
DIRECTIONS = np.random.default_rng(4).normal(size=(5, 3))


def colours_of(path: Path, frame: int) -> np.ndarray:
    """(directions, N, 3) of a frame's Gaussians, by the formula."""
    splats = dequantise(states_of(path)[frame], header_of(path).lattice)
    unit = DIRECTIONS / np.linalg.norm(DIRECTIONS, axis=1, keepdims=True)
    return 0.5 + np.einsum("dk,nkc->dnc", sh_basis(np, splats.sh_degree, unit), splats.sh.astype(np.float64))


def by_hand(colours: np.ndarray, grade: Grade) -> np.ndarray:
    white = np.array(grade.white)
    balanced = colours * (white @ GREY / white) * 2 ** (grade.exposure / 2.2)
    brightness = (balanced @ GREY)[..., None]
    return brightness + grade.saturation * (balanced - brightness)


@pytest.mark.parametrize(
    "grade",
    [Grade(1.0), Grade(-2.0), Grade(saturation=0.0), Grade(white=(1.0, 0.8, 0.6)), Grade(0.5, (0.9, 1.0, 1.2), 1.4)],
)
def test_colours_become_what_the_formula_says(grade: Grade, small_stream) -> None:
    out = small_stream.path.with_name("out.dgs")
    edit(small_stream.path, out, [grade])
    lattice = header_of(out).lattice
    # Half a step of each coefficient times its basis function: .283, and three of at most .489.
    bound = 0.5 * (0.283 * lattice.sh_dc + 3 * 0.489 * lattice.sh_rest)
    for frame in (0, 3, 7):
        expected = by_hand(colours_of(small_stream.path, frame), grade)
        assert np.abs(colours_of(out, frame) - expected).max() < bound
    for now, was in zip(states_of(out), states_of(small_stream.path), strict=True):
        assert not np.array_equal(now.sh, was.sh)
    plain = [replace(state, sh=was.sh) for state, was in zip(states_of(out), states_of(small_stream.path), strict=True)]
    if grade == Grade(1.0):
        np.testing.assert_array_equal(
            np.sort(plain[0].means, axis=0), np.sort(states_of(small_stream.path)[0].means, 0)
        )


def test_what_stays_goes_on_staying(small_stream, tmp_path: Path) -> None:
    edit(small_stream.path, tmp_path / "out.dgs", [Grade(0.7)])
    was, now = bodies(small_stream.path), bodies(tmp_path / "out.dgs")
    assert [kind for kind, _ in now] == [kind for kind, _ in was]
    skips = [len(body) for kind, body in now if kind == PacketKind.SKIP]
    assert skips == [8, 8, 8]
    # The same rows move, and nothing else: a delta of ten rows is no longer than it was.
    assert len(now[1][1]) == len(was[1][1])


def test_outside_a_region_every_bit_stays(small_stream, tmp_path: Path) -> None:
    region = Sphere((0.1, 0, 2.0), 0.4501)
    edit(small_stream.path, tmp_path / "out.dgs", [Grade(1.0, region=region)])
    lattice = header_of(small_stream.path).lattice
    states = states_of(small_stream.path)
    inside = np.zeros(60, bool)
    for state in states[:4]:
        of_first = np.isin(states[0].ids, state.ids[region.depth(dequantise(state, lattice).means) >= 0])
        inside |= of_first
    found = {row.tobytes() for row in states_of(tmp_path / "out.dgs")[0].sh}
    assert {row.tobytes() for row in states[0].sh[~inside]} <= found
    assert not {row.tobytes() for row in states[0].sh[inside]} & found
    assert 3 < inside.sum() < 57
    edit(small_stream.path, tmp_path / "out.dgs", [Grade(1.0, region=Sphere((50, 0, 0), 1.0))])
    assert_same_values(states_of(tmp_path / "out.dgs"), states)
    assert bodies(tmp_path / "out.dgs") == bodies(small_stream.path)


def test_the_command_says_it_in_words(small_stream, tmp_path: Path) -> None:
    words = "grade --exposure -.5 --white 1,.9,.8 --saturation 1.2 --in sphere .1,0,2 .45"
    expected = Grade(-0.5, (1, 0.9, 0.8), 1.2, Sphere((0.1, 0, 2), 0.45))
    edit(small_stream.path, tmp_path / "1.dgs", [expected])
    assert edit_main([str(small_stream.path), "-o", str(tmp_path / "2.dgs"), "-q", *words.split()]) == 0
    assert (tmp_path / "1.dgs").read_bytes() == (tmp_path / "2.dgs").read_bytes()


@pytest.mark.parametrize(
    ("grade", "message"),
    [
        (Grade(), "nothing is to be done"),
        (Grade(10.1), "an exposure of -10 to 10"),
        (Grade(-10.1), "an exposure of -10 to 10"),
        (Grade(float("nan")), "nan is not possible"),
        (Grade(saturation=-0.1), "a saturation of 0 to 10"),
        (Grade(saturation=10.1), "a saturation of 0 to 10"),
        (Grade(white=(1.0, 0.0, 1.0)), "a white above 0"),
    ],
)
def test_what_cannot_be_is_refused(grade: Grade, message: str, small_stream) -> None:
    with pytest.raises(UsageError, match=message):
        edit(small_stream.path, None, [grade])


@pytest.mark.parametrize("grade", [Grade(10.0), Grade(-10.0), Grade(saturation=10.0)])
def test_as_much_as_is_allowed_is_done(grade: Grade, small_stream, tmp_path: Path) -> None:
    edit(small_stream.path, tmp_path / "out.dgs", [grade])
    assert bodies(tmp_path / "out.dgs") != bodies(small_stream.path)
