"""The transform in the header: what rig cameras see stays, free cameras and exports see the scene where it is shown."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.scene.lattice import dequantise
from decogs.decoder.cameras.pose_file import read_free_cameras
from decogs.decoder.editing import Box, Cameras, Concat, Crop, Transform, edit
from decogs.decoder.editing.commands import edit_main
from decogs.decoder.exporting.exporting import export
from decogs.decoder.reading.following import follow_stream
from decogs.decoder.reading.stream import Stream, open_stream
from decogs.decoder.rendering.played_view import PlayedView
from decogs.decoder.rendering.views import render_view
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.geometry.similarity import Similarity, transformed_camera, transformed_splats
from decogs.formats.geometry.up_direction import up_of
from decogs.formats.splat_files.reading import Room, read_splats
from edited_streams import assert_same_values, bodies, header_of, states_of

TURNED = Transform(origin=(0.1, 0.2, 2.0), turns=(("Y", 30.0), ("X", -50.0)), scale=2.5, shift=(1.0, -2.0, 0.5))


@pytest.fixture
def turned(small_stream, tmp_path: Path) -> Path:
    edit(small_stream.path, tmp_path / "turned.dgs", [TURNED])
    return tmp_path / "turned.dgs"


def by_hand(points: np.ndarray) -> np.ndarray:
    """TURNED, written out."""
    c, s = np.cos(np.radians(30)), np.sin(np.radians(30))
    about_y = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    c, s = np.cos(np.radians(-50)), np.sin(np.radians(-50))
    about_x = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    return 2.5 * (points - [0.1, 0.2, 2.0]) @ (about_x @ about_y).T + [1.0, -2.0, 0.5]


def image(stream: Stream, frame: int, view: str | Camera) -> np.ndarray:
    shown = next(stream.frames(frame, frame + 1))
    return render_view(stream.header, shown.splats, view, corrections=shown.corrections).image


def test_no_packet_changes_and_positions_are_where_they_are_said_to_be(small_stream, turned) -> None:
    assert bodies(turned) == bodies(small_stream.path)
    assert (
        replace(header_of(turned), presentation=header_of(small_stream.path).presentation).to_bytes()
        == header_of(small_stream.path).to_bytes()
    )
    with open_stream(turned) as stream:
        shown = next(stream.frames(3, 4)).splats
    stored = dequantise(small_stream.states[3], small_stream.header.lattice)
    # Positions of up to 6 units in float32, before and after.
    np.testing.assert_allclose(shown.means, by_hand(stored.means), atol=6 * 2.0**-22)
    np.testing.assert_allclose(shown.log_scales, stored.log_scales + np.log(2.5), atol=1e-6)


def test_cameras_of_the_rig_see_what_they_saw(small_stream, turned) -> None:
    with open_stream(small_stream.path) as before, open_stream(turned) as after:
        for camera in before.header.cameras:
            was, now = image(before, 3, camera.name), image(after, 3, camera.name)
            # Float32 positions turned: a border of a Gaussian may fall on the other side of a pixel's threshold.
            assert np.abs(was - now).max() < 2e-3
        assert after.header.near_planes == {name: 2.5 * near for name, near in before.header.near_planes.items()}


def test_free_cameras_see_the_scene_where_it_is_shown(small_stream, turned, tmp_path: Path) -> None:
    camera = replace(small_stream.header.cameras[0], name="free")
    by = header_of(turned).presentation.similarity
    with open_stream(small_stream.path) as before, open_stream(turned) as after:
        was, now = image(before, 3, camera), image(after, 3, transformed_camera(camera, by))
        assert np.abs(was - now).max() < 2e-3
        assert np.abs(was - image(after, 3, camera)).max() > 0.2


def test_a_played_view_shows_the_pixels_of_a_rendered_one(turned) -> None:
    with open_stream(turned) as stream:
        for view in ("cam00", "cam01"):
            played = PlayedView(stream.header, view)
            for frame in stream.frames():
                expected = render_view(stream.header, frame.splats, view, corrections=frame.corrections)
                np.testing.assert_array_equal(played.show(frame).image, expected.image)


def test_a_followed_stream_is_shown_there_too(turned) -> None:
    with open_stream(turned) as opened, follow_stream(io.BytesIO(turned.read_bytes())) as followed:
        np.testing.assert_array_equal(
            opened.header.cameras[1].world_to_camera, followed.header.cameras[1].world_to_camera
        )
        for one, other in zip(opened.frames(), followed.frames(), strict=True):
            np.testing.assert_array_equal(one.splats.means, other.splats.means)


def test_exports_hold_the_scene_where_it_is_shown(small_stream, turned, tmp_path: Path) -> None:
    for name, path in (("was", small_stream.path), ("now", turned)):
        export(path, tmp_path / f"{name}.ply", frames=slice(0, 1), up="none")
    was, now = (read_splats(tmp_path / f"{name}.ply", Room(1 << 20)).splats for name in ("was", "now"))
    expected = transformed_splats(was, header_of(turned).presentation.similarity)
    for name in ("means", "log_scales", "sh"):
        np.testing.assert_allclose(getattr(now, name), getattr(expected, name), atol=5e-6)


def test_up_becomes_the_axis_that_is_named(small_stream, tmp_path: Path) -> None:
    edit(small_stream.path, tmp_path / "out.dgs", [Transform(up="Z")])
    with open_stream(tmp_path / "out.dgs") as stream:
        np.testing.assert_allclose(up_of(stream.header.cameras), [0, 0, 1], atol=1e-12)


def test_transforms_add_up_and_can_be_undone(small_stream, turned, tmp_path: Path) -> None:
    whole = Transform(turns=(("Z", 90.0),), shift=(3, 2, 1))
    edit(turned, tmp_path / "again.dgs", [whole])
    found = header_of(tmp_path / "again.dgs").presentation.similarity.matrix
    turn = Similarity(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1.0]]), shift=np.array([3, 2, 1.0])).matrix
    np.testing.assert_allclose(found, turn @ header_of(turned).presentation.similarity.matrix, atol=1e-12)
    edit(tmp_path / "again.dgs", tmp_path / "back.dgs", [Transform(reset=True)])
    assert (tmp_path / "back.dgs").read_bytes() == small_stream.path.read_bytes()
    edit(small_stream.path, tmp_path / "round.dgs", [Transform(turns=(("X", 90.0),)), Transform(turns=(("X", 270.0),))])
    assert (tmp_path / "round.dgs").read_bytes() == small_stream.path.read_bytes()


def test_regions_and_added_cameras_are_of_the_world_that_is_shown(small_stream, turned, tmp_path: Path) -> None:
    inside = by_hand(dequantise(small_stream.states[0], small_stream.header.lattice).means)
    low, high = (tuple(corner) for corner in np.percentile(inside, [20, 70], axis=0))
    edit(turned, tmp_path / "out.dgs", [Crop(Box(low, high))])
    kept = {values.tobytes() for values in states_of(tmp_path / "out.dgs")[0].sh}
    expected = ((inside > low) & (inside < high)).all(axis=1)
    assert {values.tobytes() for values in small_stream.states[0].sh[expected]} <= kept
    assert len(kept) < 60
    pose = tmp_path / "free.json"
    pose.write_text(
        '{"width": 40, "height": 30, "fx": 40, "fy": 40, "position": [1, -2, -4], '
        '"look_at": [1, -2, 0], "up": [0, -1, 0]}'
    )
    edit(turned, tmp_path / "out.dgs", [Cameras(add=(str(pose),))])
    with open_stream(tmp_path / "out.dgs") as stream:
        given = read_free_cameras(pose).cameras[0]
        np.testing.assert_allclose(stream.header.cameras[3].world_to_camera, given.world_to_camera, atol=1e-12)


def test_a_take_that_is_appended_is_brought_to_where_it_is_shown(small_stream, turned, tmp_path: Path) -> None:
    """Half a turn is exact but for the signs of quaternions; positions are rounded to the lattice."""
    edit(small_stream.path, tmp_path / "half.dgs", [Transform(turns=(("Y", 180.0),), shift=(0.25, 0, 0))])
    report = edit(small_stream.path, tmp_path / "out.dgs", [Concat((tmp_path / "half.dgs",))])
    assert "brought to where its transform says" in report.notes[0]
    with open_stream(tmp_path / "out.dgs") as stream, open_stream(tmp_path / "half.dgs") as half:
        step = stream.header.lattice.means[0]
        for now, was in zip(stream.frames(8, 11), half.frames(0, 3), strict=True):
            np.testing.assert_allclose(now.splats.means, was.splats.means, atol=step / 2 + 1e-6)
            np.testing.assert_allclose(now.splats.sh, was.splats.sh, atol=1e-6)
        assert [camera.name for camera in stream.header.cameras] == [
            *("cam00", "cam01", "wide", "cam00_2", "cam01_2", "wide_2")
        ]
        was, now = image(half, 0, "cam00"), image(stream, 8, "cam00_2")
        assert np.abs(was - now).mean() < 2e-3
    # Two takes with the same transform are on one lattice.
    edit(turned, tmp_path / "out.dgs", [Concat((turned,))])
    assert_same_values(states_of(tmp_path / "out.dgs")[8:], states_of(turned))


def test_the_command_says_it_in_words(small_stream, tmp_path: Path) -> None:
    words = "transform --origin 0.1,0.2,2 --turn y=30 --turn X=-50 --scale 2.5 --shift 1,-2,.5"
    assert edit_main([str(small_stream.path), "-o", str(tmp_path / "out.dgs"), "-q", *words.split()]) == 0
    np.testing.assert_allclose(
        header_of(tmp_path / "out.dgs").presentation.similarity.matrix[:3, 3], by_hand(np.zeros((1, 3)))[0], atol=1e-12
    )


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("transform", "nothing is to be done"),
        ("transform --scale 0", "a scale of 0 is not possible"),
        ("transform --scale 1.1e6", "a scale of 1.1e+06 is not possible"),
        ("transform --scale .9e-6", "a scale of 9e-07 is not possible"),
        ("transform --scale nan", "transform: nan is not possible"),
        ("transform --turn w=3", "'w=3' is no turn"),
        ("transform --turn x=a", "'a' is no number"),
        ("transform --shift 1,2", "'1,2' is no vector"),
        ("transform --shift 1,2,inf", "'1,2,inf' is no vector"),
        ("transform --shift 1e12,0,0 transform --shift 1e12,0,0", "presentation is out of its bounds"),
    ],
)
def test_what_cannot_be_is_refused(words: str, message: str, small_stream, tmp_path: Path, capsys) -> None:
    assert edit_main([str(small_stream.path), "-o", str(tmp_path / "out.dgs"), *words.split()]) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.glob("out*"))
    with pytest.raises(UsageError, match="scale"):
        edit(small_stream.path, None, [Transform(scale=-1.0)])


@pytest.mark.parametrize("scale", [1e6, 1e-6])
def test_the_largest_and_the_smallest_scale_are_kept(scale: float, small_stream, tmp_path: Path) -> None:
    edit(small_stream.path, tmp_path / "out.dgs", [Transform(scale=scale)])
    assert header_of(tmp_path / "out.dgs").presentation.similarity.scale == pytest.approx(scale)
