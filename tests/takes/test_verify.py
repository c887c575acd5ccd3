"""decogs-verify: some of a stream encoded again has the same bytes, or it is said what is another."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from decogs.codec.header.header import StreamHeader
from decogs.decoder.editing import Grade, Set, edit
from decogs.decoder.editing.operations.layer import MakeLayers
from decogs.encoder.commands import encode_main
from decogs.formats.stream.container import FRAME_KINDS, LAYERED_VERSION, PacketKind, StreamWriter
from decogs.takes.commands import verify_main
from edited_streams import header_of
from packets import iterate_packets
from tiny_rigs import TinyRig

OPTIONS = ["--preset", "live", "--frames", "1:7", "--threads", "1", "-q"]
CLOSED = [*OPTIONS, "--segment", "2", "--closed"]


@pytest.fixture(scope="module")
def rig(tiny_rig: type[TinyRig], tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_rig.write(tmp_path_factory.mktemp("verify") / "rig", frames=(3, 0, 1, 2, 3, 1, 0))


@pytest.fixture(scope="module", params=["open", pytest.param("closed", marks=pytest.mark.slow)])
def encoded(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, rig: Path
) -> tuple[Path, list[str]]:
    options = OPTIONS if request.param == "open" else CLOSED
    path = tmp_path_factory.mktemp("verify") / "scene.dgs"
    assert encode_main([str(rig), "-o", str(path), "--log", str(path.with_suffix(".log")), *options]) == 0
    return path, options


def changed_in(stream: Path, output: Path, frame: int) -> Path:
    """The stream with another packet of a frame; checksums are right."""
    with stream.open("rb") as file:
        head, *packets = list(iterate_packets(file))
    with output.open("wb") as file:
        writer = StreamWriter(file, head.payload)
        for packet in packets:
            if packet.kind in (PacketKind.INDEX, PacketKind.END):
                continue
            hit = packet.kind in FRAME_KINDS and packet.frame == frame
            writer.write(packet.kind, packet.frame, packet.payload[:-1] + b"\xff" if hit else packet.payload)
        writer.finish()
    return output


def test_a_stream_is_what_it_was_made_of(
    encoded, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Every closed segment, and a packet that is another in any of them; of others the first frames."""
    stream, options = encoded
    for frame in (0, 2, 5) if options is CLOSED else (0,):
        asked = ["--frame", str(frame), "-q"]
        assert verify_main([*asked, str(stream), str(rig), *options]) == 0
        assert "are the same bytes, encoded again" in capsys.readouterr().out
    hit = 5 if options is CLOSED else 2
    other = changed_in(stream, tmp_path / "other.dgs", hit)
    assert verify_main(["--frame", str(hit), "-q", str(other), str(rig), *options]) == 1
    assert f"frame {hit} is another: " in capsys.readouterr().out
    if options is CLOSED:
        assert verify_main(["--frame", "1", "-q", str(other), str(rig), *options]) == 0
        assert verify_main(["--frame", "6", "-q", str(other), str(rig), *options]) == 2


@pytest.mark.parametrize("encoded", ["open"], indirect=True)
def test_what_is_another_is_said(encoded, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    stream, options = encoded
    other = shutil.copytree(rig, tmp_path / "rig")
    shutil.copytree(rig / "cam03", other / "cam04", dirs_exist_ok=True)
    assert verify_main(["-q", str(stream), str(other), *options]) == 1
    assert "camera cam04 recorded another first picture\n" in capsys.readouterr().out
    log = stream.with_suffix(".log")
    assert verify_main(["-q", "--log", str(log), str(stream), str(other), *options]) == 1
    assert "camera cam04 recorded other pictures of frames 1 to 2\n" in capsys.readouterr().out
    assert verify_main(["-q", "--log", str(log), str(stream), str(rig), *options]) == 0
    assert verify_main(["-q", "--log", str(stream), str(stream), str(rig), *options]) == 2
    assert "is no log of decogs-encode --log" in capsys.readouterr().err
    assert verify_main(["-q", str(stream), str(rig), *options, "--seed", "3"]) == 1
    said = capsys.readouterr().out
    assert "was begun with seed 0, this encode has 3" in said
    assert "frame 0 is another" in said


@pytest.mark.slow
def test_an_edited_stream_is_verified_where_its_scenes_stayed(
    encoded, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stream, options = encoded
    out = tmp_path / "edited.dgs"
    edit(stream, out, [Set(title="x"), MakeLayers()])
    for frame in (0, 5) if options is CLOSED else (0,):
        assert verify_main(["--frame", str(frame), "-q", str(out), str(rig), *options]) == 0
    edit(stream, out, [Grade(exposure=1.0)])
    assert verify_main(["-q", str(out), str(rig), *options]) == 2
    assert "was edited since it was encoded" in capsys.readouterr().err


@pytest.mark.parametrize("encoded", ["open"], indirect=True)
@pytest.mark.slow
def test_layers_of_another_scene_are_found(
    encoded, rig: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit(encoded[0], tmp_path / "graded.dgs", [Grade(exposure=0.5), MakeLayers()])
    settings = header_of(encoded[0]).settings
    other = tmp_path / "other.dgs"
    with (tmp_path / "graded.dgs").open("rb") as file:
        head, *packets = list(iterate_packets(file))
    header = replace(StreamHeader.from_bytes(head.payload), settings=settings)
    with other.open("wb") as file:
        writer = StreamWriter(file, header.to_bytes(), LAYERED_VERSION)
        for packet in packets:
            if packet.kind in (*FRAME_KINDS, PacketKind.REFINE):
                writer.write(packet.kind, packet.frame, packet.payload)
        writer.finish()
    assert verify_main(["-q", str(other), str(rig), *encoded[1]]) == 1
    assert "frame 0 is another: a scene in the stream, a scene encoded again" in capsys.readouterr().out
