"""Cleaning: each limit takes what it says, in all frames of a segment or not at all, and shows it in red."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_delta, write_key
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.codec.scene.state import take_rows
from decogs.decoder.editing import Clean, Transform, edit
from decogs.decoder.editing.commands import edit_main
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.pictures.reading import read_picture
from decogs.formats.splats import Splats, join_splats, round_splats
from decogs.formats.stream.container import PacketKind, StreamWriter
from edited_streams import states_of

STEPS = np.linspace(-0.5, 0.5, 6)
GRID = np.stack(np.meshgrid(STEPS, STEPS, STEPS + 3), -1).reshape(-1, 3)
GREEN = (0.0, 1.0, 0.0)


def some(places: np.ndarray, sigma: float = 0.05, opacity: float = 0.9) -> Splats:
    count = len(places)
    return round_splats(places, np.tile(GREEN, (count, 1)), np.full(count, sigma), np.full(count, opacity), 0)


@dataclass(frozen=True)
class Cluttered:
    """A block, and floaters by their kind; all shift to the right by .01 in frame 1."""

    path: Path
    odd: dict[str, np.ndarray]


@pytest.fixture
def cluttered(tmp_path: Path) -> Cluttered:
    kinds = {
        "block": some(GRID),
        "faint": some(np.array([[0.05, 0.05, 3.05]]), opacity=0.005),
        "huge": some(np.array([[0.02, 0.1, 3.1]]), sigma=2.0),
        "alone": some(np.array([[1.4, 0.9, 3.0]])),
        "behind": some(np.array([[0.0, 0.0, -3.0], [0.0, 0.1, -3.0], [0.1, 0.0, -3.0], [0.1, 0.1, -3.0]])),
    }
    lattice = default_lattice(4.0)
    cameras = tuple(
        Camera(
            name, 64, 48, 50.0, 50.0, 32.0, 24.0, np.array([[1.0, 0, 0, x], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
        )
        for name, x in (("left", 0.2), ("right", -0.2))
    )
    header = StreamHeader(cameras=cameras, lattice=lattice)
    whole = None
    for splats in kinds.values():
        whole = splats if whole is None else join_splats(whole, splats)
    attributes = quantise(whole, lattice)
    state, _ = keyframe_state(attributes)
    rows = np.arange(len(state))
    moved = take_rows(state, rows)
    moved = replace(moved, means=moved.means + np.array([round(0.01 / lattice.means[0]), 0, 0], np.int32))
    delta = difference(state, rows, moved)
    path = tmp_path / "cluttered.dgs"
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state).payload)
        writer.write(PacketKind.DELTA, 1, write_delta(state, delta).payload)
        writer.finish()
    assert len(apply_delta(state, delta)) == 216 + 7
    return Cluttered(path, {name: quantise(splats, lattice).means for name, splats in kinds.items()})


def gone(cluttered: Cluttered, operation: Clean, frame: int = 0, tmp: str = "out.dgs") -> set[str]:
    """The kinds of which nothing is left; no kind is halved."""
    out = cluttered.path.with_name(tmp)
    edit(cluttered.path, out, [operation])
    left = {row.tobytes() for row in states_of(out)[frame].means.astype(np.int32)}
    lost = set()
    for name, means in cluttered.odd.items():
        there = [row.tobytes() in left for row in means]
        assert all(there) or not any(there)
        lost |= set() if any(there) else {name}
    return lost


def test_each_limit_takes_its_own(cluttered) -> None:
    assert gone(cluttered, Clean(opacity=0.01)) == {"faint"}
    assert gone(cluttered, Clean(size=1.0)) == {"huge"}
    assert gone(cluttered, Clean(isolation=0.25)) == {"alone"}
    assert gone(cluttered, Clean(seen=1)) == {"behind"}
    assert gone(cluttered, Clean(opacity=0.01, size=1.0, isolation=0.25, seen=2)) == {
        "faint",
        "huge",
        "alone",
        "behind",
    }


def test_without_limits_the_usual_ones_count_and_large_ones_stay(cluttered, capsys) -> None:
    report = edit(cluttered.path, None, [Clean()])
    assert report.notes[0].startswith("clean: ")
    assert "by opacity (0.01)" in report.notes[0]
    assert gone(cluttered, Clean()) >= {"faint", "behind"}
    assert "huge" not in gone(cluttered, Clean())


def test_the_report_counts_by_reason(cluttered) -> None:
    report = edit(cluttered.path, None, [Clean(opacity=0.01, seen=1)])
    assert report.notes[0] == ("clean: 5 of 223 Gaussians of the first frame go: 1 by opacity (0.01), 4 by seen (1)")


def test_sizes_and_places_are_of_the_world_that_is_shown(cluttered, tmp_path: Path) -> None:
    edit(cluttered.path, tmp_path / "turned.dgs", [Transform(turns=(("Y", 90.0),), scale=10.0)])
    turned = replace(cluttered, path=tmp_path / "turned.dgs")
    assert gone(turned, Clean(size=10.0)) == {"huge"}
    assert gone(turned, Clean(isolation=2.5)) == {"alone"}
    assert gone(turned, Clean(seen=1)) == {"behind"}


def test_the_picture_shows_in_red_what_goes(cluttered, tmp_path: Path) -> None:
    picture = tmp_path / "goes.png"
    report = edit(cluttered.path, None, [Clean(isolation=0.25, picture=picture)])
    assert "1 by isolation" in report.notes[0]
    shown = read_picture(picture).astype(int)
    red = (shown[..., 0] > 150) & (shown[..., 1] < 80)
    assert red.any()
    # The floater at (1.4, .9, 3) in the camera at x = -.2: u = 50 * 1.6 / 3 + 32, v = 50 * .9 / 3 + 24.
    rows, columns = np.nonzero(red)
    assert abs(columns.mean() + 0.5 - 58.7) < 1
    assert abs(rows.mean() + 0.5 - 39) < 1
    others = shown[~red]
    assert np.abs(others - others.mean(axis=1, keepdims=True)).max() < 140, "the rest is grey but for the edge"


def test_the_command_says_it_in_words(cluttered, tmp_path: Path) -> None:
    words = f"clean --opacity .01 --size 1 --isolation .25 --seen 1 --picture {tmp_path}/x.png"
    assert edit_main([str(cluttered.path), "--dry-run", "-q", *words.split()]) == 0
    assert (tmp_path / "x.png").exists()


@pytest.mark.parametrize(
    ("operation", "message"),
    [
        (Clean(opacity=0.0), "limits above 0"),
        (Clean(seen=-1), "limits above 0"),
        (Clean(size=float("nan")), "nan is not possible"),
        (Clean(picture=Path("x.jpg")), "the picture is a PNG"),
        (Clean(picture=Path("{scene}")), "the picture is a PNG"),
    ],
)
def test_what_cannot_be_is_refused(operation: Clean, message: str, cluttered) -> None:
    with pytest.raises(UsageError, match=message):
        edit(cluttered.path, None, [operation])


def test_a_picture_is_not_written_over_the_stream(cluttered, tmp_path: Path) -> None:
    path = tmp_path / "scene.png"
    path.write_bytes(cluttered.path.read_bytes())
    with pytest.raises(UsageError, match="never replaces what it reads"):
        edit(path, tmp_path / "out.dgs", [Clean(picture=path)])
    with pytest.raises(UsageError, match="is written there, too"):
        edit(cluttered.path, path.with_name("o.png"), [Clean(picture=tmp_path / "o.png")])
    assert path.read_bytes() == cluttered.path.read_bytes()
