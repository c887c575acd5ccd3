"""Operations on the header alone: set, strip, cameras. No scene changes, no packet but for corrections of cameras."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import CorrectedCameras, Correction, write_corrections
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.sound import SoundTrack
from decogs.codec.packets.syntax import write_key, write_skip
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.decoder.commands import decode_main, info_main
from decogs.decoder.editing import Cameras, Grade, Operation, Retime, Set, Speed, Strip, Transform, Trim, edit
from decogs.decoder.editing.commands import edit_main
from decogs.decoder.reading.stream import open_stream
from decogs.formats.cameras import Camera
from decogs.formats.errors import UsageError
from decogs.formats.splats import round_splats
from decogs.formats.stream.container import FRAME_KINDS, PacketKind, StreamWriter
from edited_streams import bodies, header_of
from packets import iterate_packets
from sounding_streams import with_sound

TOLD = {
    "a": Correction(exposure=5, yaw=7),
    "b": Correction(exposure=-9),
}


@pytest.fixture
def corrected_stream(tmp_path: Path) -> Path:
    """Cameras a (exposure and pose), b (exposure), c (colours of its own), d (held out), of two frames."""
    cameras = tuple(Camera(name, 32, 24, 30.0, 30.0, 16.0, 12.0, np.eye(4)) for name in "abcd")
    lattice = default_lattice(2.0)
    header = StreamHeader(
        cameras=cameras,
        lattice=lattice,
        effects=("motion", "colour_mismatch", "exposure_drift", "camera_shake"),
        held_out=("d",),
        corrected=CorrectedCameras(exposure_drift=("b", "a"), camera_shake=("a",)),
        camera_colours={"c": Correction(exposure=3)},
        settings={"recorded": {"pictures": ["x"]}, "part": {}, "preset": "none"},
        source_text="a room",
        licence="CC0",
    )
    dot = round_splats(np.array([[0, 0, 2.0]]), np.full((1, 3), 0.6), np.array([0.2]), np.array([0.9]), 0)
    state, _ = keyframe_state(quantise(dot, lattice))
    path = tmp_path / "corrected.dgs"
    with path.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes())
        block = write_corrections(TOLD, header.corrected)
        writer.write(PacketKind.KEY, 0, block + write_key(state).payload)
        writer.write(PacketKind.SKIP, 1, block + write_skip(state).payload)
        writer.finish()
    return path


def edited(path: Path, operation: object) -> Path:
    out = path.with_name("out.dgs")
    edit(path, out, [operation])
    return out


def corrections_of(path: Path) -> list[object]:
    with open_stream(path, strict=True) as stream:
        return [dict(frame.corrections) for frame in stream.frames()]


def test_set_changes_what_it_names_and_no_packet(small_stream) -> None:
    asked = Set("A title", "mine", "a room", 3, "wide", (1.0, 0.5, 0.0), (("", 0.5), ("cam01", 0.25)))
    out = edited(small_stream.path, asked)
    header, before = header_of(out), header_of(small_stream.path)
    assert header.presentation.as_document() == {"title": "A title", "poster": 3, "first_view": "wide"}
    assert (header.licence, header.source_text, header.background) == ("mine", "a room", (1.0, 0.5, 0.0))
    assert header.near_planes == {"cam00": 0.5, "cam01": 0.25, "wide": 0.5}
    assert (header.lattice, header.settings, header.effects) == (before.lattice, before.settings, before.effects)
    assert bodies(out) == bodies(small_stream.path)


def test_set_leaves_what_it_does_not_name(small_stream) -> None:
    once = edited(small_stream.path, Set(title="one", poster=0))
    again = once.with_name("again.dgs")
    edit(once, again, [Set(first_view="cam00")])
    assert header_of(again).presentation.as_document() == {"title": "one", "poster": 0, "first_view": "cam00"}
    edit(again, once, [Set(title="")])
    assert header_of(once).presentation.title == ""


def test_near_planes_are_of_the_world_that_is_shown(small_stream) -> None:
    out = small_stream.path.with_name("out.dgs")
    edit(small_stream.path, out, [Transform(scale=4.0), Set(near=(("wide", 2.0),))])
    assert header_of(out).near_planes["wide"] == pytest.approx(0.5)
    with open_stream(out) as stream:
        assert stream.header.near_planes["wide"] == pytest.approx(2.0)


@pytest.mark.parametrize(
    ("operation", "poster"),
    [
        (Trim(slice(2, None)), 3),
        (Trim(slice(6, None)), None),
        (Retime(reverse=True), 2),
        (Retime((Speed(0, None, 2, 2),)), None),
        (Retime((Speed(4, 6, 0.5, 0.5),)), 6),
    ],
)
def test_a_poster_stays_the_frame_that_it_is(operation: Operation, poster: int | None, small_stream) -> None:
    out = small_stream.path.with_name("out.dgs")
    edit(small_stream.path, out, [Set(poster=5), operation])
    assert header_of(out).presentation.poster == poster


def test_the_command_sets_what_its_options_say(small_stream, tmp_path: Path, capsys) -> None:
    words = ["set", "--title", "trim", "--poster", "2", "--background", "white", "--near", "wide=.5"]
    out = tmp_path / "out.dgs"
    assert edit_main([str(small_stream.path), "-o", str(out), *words[:1], "--title=trim", *words[3:]]) == 0
    header = header_of(out)
    assert (header.presentation.title, header.background, header.near_planes["wide"]) == ("trim", (1, 1, 1), 0.5)
    capsys.readouterr()
    assert info_main([str(out), "--json", "-q"]) == 0
    assert json.loads(capsys.readouterr().out)["header"]["presentation"] == {"title": "trim", "poster": 2}
    assert info_main([str(out), "-q"]) == 0
    assert "title        trim\nposter       2\n" in capsys.readouterr().out


def test_strip_leaves_the_licence_and_the_scenes(corrected_stream) -> None:
    header = header_of(edited(corrected_stream, Strip(("provenance",))))
    assert (header.settings, header.source_text, header.writer, header.licence) == ({}, "", "", "CC0")
    assert bodies(corrected_stream.with_name("out.dgs")) == bodies(corrected_stream)


def test_strip_of_provenance_leaves_no_name_of_a_file(corrected_stream) -> None:
    """Tracks of sound are called as the files that they come from; what the stream is called stays."""
    named = corrected_stream.with_name("named.dgs")
    track = SoundTrack(1, "secret.wav", (1.0, 2.0, 3.0))
    rated = corrected_stream.with_name("rated.dgs")
    edit(corrected_stream, rated, [Retime(fps=25.0)])
    edit(with_sound(rated, named, (track,)), named.with_name("titled.dgs"), [Set(title="Take")])
    header = header_of(edited(named.with_name("titled.dgs"), Strip(("provenance",))))
    assert header.sound == (replace(track, title=""),)
    assert header.presentation.title == "Take"
    assert b"secret" not in named.with_name("out.dgs").read_bytes()


def test_what_a_later_version_says_is_named_where_it_is_left_out(corrected_stream, tmp_path: Path) -> None:
    """Members of the header, also within others, and packets wherever they are; what says nothing is no loss."""
    later = tmp_path / "later.dgs"
    with later.open("wb") as file:
        for packet in iterate_packets(io.BytesIO(corrected_stream.read_bytes())):
            if packet.kind == PacketKind.HEADER:
                header = json.loads(packet.payload)
                header |= {"invented": [1], "presentation": {"title": "a", "chapters": [2]}, "empty": ""}
                header["cameras"][1]["rolling_shutter"] = 0.01
                writer = StreamWriter(file, json.dumps(header).encode())
            elif packet.kind in FRAME_KINDS:
                writer.write(packet.kind, packet.frame, packet.payload)
        writer.write(11, 1, b"later", critical=False)
        writer.write(200, 1, b"private", critical=False)
        writer.finish()
    said: list[str] = []
    edit(later, tmp_path / "out.dgs", [Set(licence="mine")], on_warning=said.append)
    assert said == [
        f"{later}: holds what this version does not know, which is left out: cameras[1].rolling_shutter, invented, "
        "presentation.chapters, packets of kind 11, packets of kind 200"
    ]
    said.clear()
    edit(corrected_stream, tmp_path / "out.dgs", [Set(licence="mine")], on_warning=said.append)
    assert said == []


def test_strip_of_the_rig_leaves_one_camera(corrected_stream) -> None:
    out = edited(corrected_stream, Strip(("rig",)))
    header = header_of(out)
    assert [camera.name for camera in header.cameras] == ["view"]
    assert header.effects == ("motion", "exposure_drift", "camera_shake")
    assert corrections_of(out) == [{"view": TOLD["a"]}] * 2
    edit(corrected_stream, out, [Set(first_view="c"), Strip(("rig",))])
    header = header_of(out)
    assert header.effects == ("motion", "colour_mismatch")
    assert (header.camera_colours, header.presentation.first_view) == ({"view": Correction(exposure=3)}, "view")
    assert corrections_of(out) == [{}] * 2


def test_what_only_holds_of_an_encode_is_left_out_where_it_does_not_hold(corrected_stream) -> None:
    """Of which part it is, always; of what footage, where scenes are others."""
    kept = {"preset": "none", "recorded": {"pictures": ["x"]}}
    assert header_of(edited(corrected_stream, Set(title="x"))).settings == kept
    assert header_of(edited(corrected_stream, Grade(exposure=1.0))).settings == {"preset": "none"}


def test_cameras_go_with_all_that_is_told_of_them(corrected_stream) -> None:
    out = edited(corrected_stream, Cameras(drop=("b", "d")))
    header = header_of(out)
    assert [camera.name for camera in header.cameras] == ["a", "c"]
    assert (header.held_out, header.corrected.exposure_drift) == ((), ("a",))
    assert corrections_of(out) == [{"a": TOLD["a"]}] * 2


def test_cameras_are_renamed_wherever_they_are_named(corrected_stream) -> None:
    edit(corrected_stream, corrected_stream.with_name("1.dgs"), [Set(first_view="d")])
    out = edited(corrected_stream.with_name("1.dgs"), Cameras(rename=(("a", "b"), ("b", "a"), ("d", "front"))))
    header = header_of(out)
    assert [camera.name for camera in header.cameras] == ["b", "a", "c", "front"]
    assert (header.held_out, header.presentation.first_view) == (("front",), "front")
    assert header.corrected == CorrectedCameras(exposure_drift=("a", "b"), camera_shake=("b",))
    assert corrections_of(out) == [{"a": TOLD["b"], "b": TOLD["a"]}] * 2


def test_added_cameras_can_be_looked_through(small_stream, tmp_path: Path) -> None:
    camera = {"width": 40, "height": 30, "fx": 40, "fy": 40}
    pose = {"world_to_camera": np.eye(4).tolist()}
    (tmp_path / "front.json").write_text(json.dumps(camera | pose))
    (tmp_path / "path.json").write_text(json.dumps([camera | pose, camera | pose]))
    out = edited(small_stream.path, Cameras(add=(str(tmp_path / "front.json"), str(tmp_path / "path.json"))))
    header = header_of(out)
    added = ["front", "path_0000", "path_0001"]
    assert [camera.name for camera in header.cameras[3:]] == added
    assert header.held_out == ("cam01", *added)
    assert bodies(out) == bodies(small_stream.path)
    pictures = ["-o", str(tmp_path / "p"), "-q", "--frames", ":1"]
    assert decode_main([str(out), "--view", "front", *pictures]) == 0


@pytest.mark.parametrize(
    ("operation", "message"),
    [
        (Set(), "nothing is to be set"),
        (Set(first_view="e"), "no camera 'e' in this stream; it has a, b, c, d"),
        (Set(near=(("e", 1.0),)), "no camera 'e'"),
        (Set(near=(("a", -1.0),)), "near is no number"),
        (Set(poster=2), "frame 2, is none of 0:2"),
        (Set(background=(0, 0, 2000)), "background is no number"),
        (Set(title="x" * 70_000), "presentation is out of its bounds"),
        (Cameras(), "nothing is to be done"),
        (Cameras(drop=tuple("abcd")), "at least one camera"),
        (Cameras(drop=("e",)), "no camera 'e'"),
        (Cameras(drop=("a",), rename=(("a", "e"),)), "a is dropped and renamed"),
        (Cameras(rename=(("a", "b"),)), "two cameras would be called 'b'"),
        (Cameras(rename=(("a", "x/y"),)), "path separator"),
        (Cameras(add=("nowhere.json",)), "nowhere.json"),
        (Strip(("licence",)), "no 'licence' to strip"),
    ],
)
def test_what_cannot_be_is_refused(operation: object, message: str, corrected_stream) -> None:
    with pytest.raises(UsageError, match=message):
        edited(corrected_stream, operation)
    assert not list(corrected_stream.parent.glob("out*"))


def test_an_added_file_is_not_written_over(small_stream, tmp_path: Path) -> None:
    pose = tmp_path / "front.json"
    pose.write_text(json.dumps({"width": 40, "height": 30, "fx": 40, "fy": 40, "world_to_camera": np.eye(4).tolist()}))
    with pytest.raises(UsageError, match="never replaces what it reads"):
        edit(small_stream.path, pose, [Cameras(add=(str(pose),))])
    assert replace(header_of(small_stream.path)).cameras
