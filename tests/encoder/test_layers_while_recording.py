"""A stream put in layers while it grows: exact, with a base that follows the scene, whole wherever it ends."""

from __future__ import annotations

import io
import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.codec.packets.keyframes import keyframe_state, new_state
from decogs.codec.packets.syntax import write_key
from decogs.codec.scene.lattice import Lattice, dequantise
from decogs.codec.scene.state import Rows, State, all_rows, part_of, take_rows
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.commands import encode_main
from decogs.encoder.layering import movers as movers_module
from decogs.encoder.layering import recording
from decogs.encoder.layering.movers import Movers
from decogs.encoder.layering.recording import LayeredOutput
from decogs.encoder.layering.rounds import Round, grown
from decogs.encoder.output.stream_output import open_output
from decogs.formats.errors import TryAgainError, UsageError
from decogs.formats.rigs import open_live, open_rig
from decogs.formats.splats import sigmoid
from decogs.formats.stream.container import FRAME_KINDS, PacketKind
from edited_streams import states_of
from encode_rig import encode_rig
from layered_streams import rows_of
from moving_walls import bases_of, likeness, moving_wall
from packets import iterate_packets

FRAMES = 8


def packets_of(path: Path) -> list[Any]:
    with path.open("rb") as file:
        return list(iterate_packets(file))


def recorded(packets: list[Any], output: Path, frames: int = FRAMES) -> None:
    """The packets written in layers, as an encode writes them, of which it counts the first ``frames``."""
    with LayeredOutput(open_output(output)) as target:
        target.begin(packets[0].payload)
        for packet in packets[1:]:
            if packet.kind in FRAME_KINDS:
                target.write(packet.kind, packet.frame, packet.payload)
        target.close(frames)
        target.publish()


def assert_exact(path: Path, whole: list[State]) -> None:
    for one, other in zip(states_of(path), whole, strict=True):
        assert len(one) == len(other)
        np.testing.assert_array_equal(rows_of(one), rows_of(other))


@pytest.fixture
def moving(tmp_path: Path) -> SimpleNamespace:
    return moving_wall(tmp_path / "moving.dgs")


def test_all_layers_are_the_stream_and_the_base_follows_it(moving: SimpleNamespace, tmp_path: Path) -> None:
    """What moves and what comes is in the base; the same packets give the same bytes."""
    out, whole = tmp_path / "out.dgs", states_of(moving.path)
    recorded(packets_of(moving.path), out)
    assert_exact(out, whole)
    bases = bases_of(out)
    found = likeness(whole, bases, moving.lattice)
    assert min(found) > 35  # 32 of a base that nobody joins
    with open_stream(out, layer="base") as stream:
        base = stream.header.layers[0]
    assert base.psnr == pytest.approx(found[0], abs=1.0)
    assert base.gaussians >= max(map(len, bases))
    recorded(packets_of(moving.path), tmp_path / "again.dgs")
    assert (tmp_path / "again.dgs").read_bytes() == out.read_bytes()


def test_half_of_what_moves_or_comes_joins_the_base(moving: SimpleNamespace) -> None:
    """Those that cover most, no more trained but larger; what stands still or has gone is left as it was."""
    before, state = states_of(moving.path)[:2]  # four come, two go
    there = np.intersect1d(before.ids, state.ids)
    far, near = there[::5], there[1::5]
    placed = take_rows(state, np.arange(len(state)))
    placed.means[np.isin(state.ids, far), 0] += round(1.0 / moving.lattice.means[0])
    state = new_state(placed, 1, ids=state.ids, next_id=state.next_id)
    own = np.sort(np.concatenate([far[:40], near, np.setdiff1d(before.ids, state.ids)]))
    trained = grown(len(own), before.coefficients, 1.0, moving.lattice)
    movers = Movers(before, moving.lattice)
    base = movers.joined(Round(own, trained, [30.0]), before, state)
    assert len(np.intersect1d(base.ids, np.setdiff1d(state.ids, before.ids))) == 2
    assert len(np.intersect1d(base.ids, far)) == round(len(far) / 2)
    assert set(own) - set(base.ids) == set(before.ids) - set(state.ids)
    sizes = base.offsets.log_scales[:, 0] * moving.lattice.log_scales
    stands = np.isin(base.ids, near)
    np.testing.assert_allclose(sizes[stands], 1.0, atol=moving.lattice.log_scales)
    np.testing.assert_allclose(sizes[~stands], movers_module._GROWTH, atol=moving.lattice.log_scales)
    joined, left = np.setdiff1d(np.intersect1d(base.ids, far), own), np.setdiff1d(far, base.ids)
    assert covered(state, joined, moving.lattice).min() >= covered(state, left, moving.lattice).max()
    np.testing.assert_array_equal(movers.joined(base, state, state).ids, base.ids)


def covered(state: State, ids: Rows, lattice: Lattice) -> np.ndarray:
    """Opacity times the product of the two larger sizes."""
    splats = dequantise(part_of(state, np.searchsorted(state.ids, ids)), lattice)
    sizes = np.sort(np.exp(splats.log_scales), axis=1)
    return sigmoid(splats.opacity_logits) * sizes[:, 1] * sizes[:, 2]


def test_a_base_that_grows_above_what_the_header_says_is_chosen_anew(
    moving: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(recording, "_MOST_SHARE", 0.21)
    recorded(packets_of(moving.path), tmp_path / "out.dgs")
    assert_exact(tmp_path / "out.dgs", states_of(moving.path))
    sizes = [len(base) for base in bases_of(tmp_path / "out.dgs")]
    assert min(after - before for before, after in pairwise(sizes)) < -2
    with open_stream(tmp_path / "out.dgs") as stream:
        assert max(sizes) <= stream.header.layers[0].gaussians


@pytest.mark.parametrize("frames", [1, 5, 7])
def test_a_recording_that_ends_early_is_whole(moving: SimpleNamespace, tmp_path: Path, frames: int) -> None:
    """One packet more was written than frames were told of."""
    recorded(packets_of(moving.path)[: frames + 2], tmp_path / "out.dgs", frames)
    assert_exact(tmp_path / "out.dgs", states_of(moving.path)[:frames])


def test_another_scene_has_a_base_at_once(moving: SimpleNamespace, tmp_path: Path) -> None:
    packets = packets_of(moving.path)
    first = states_of(moving.path)[0]
    mirrored = replace(all_rows(first), means=first.means * np.array([-1, 1, 1], np.int32))
    other = new_state(mirrored, 1, ids=first.ids + len(first), next_id=2 * len(first))
    cut = SimpleNamespace(kind=PacketKind.KEY, frame=1, payload=write_key(other).payload)
    recorded([*packets[:2], cut], tmp_path / "out.dgs", 2)
    assert_exact(tmp_path / "out.dgs", [first, other])
    assert min(likeness([first, other], bases_of(tmp_path / "out.dgs"), moving.lattice)) > 24


@pytest.mark.parametrize("count", [0, 1])
def test_scenes_of_hardly_any_gaussian(moving: SimpleNamespace, tmp_path: Path, count: int) -> None:
    packets = packets_of(moving.path)
    few, _ = keyframe_state(take_rows(states_of(moving.path)[0], np.arange(count)))
    key = SimpleNamespace(kind=PacketKind.KEY, frame=0, payload=write_key(few).payload)
    recorded([packets[0], key], tmp_path / "out.dgs", 1)
    assert_exact(tmp_path / "out.dgs", [few])


def test_a_full_disk_is_one_line(moving: SimpleNamespace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What was complete before stays, and plays."""
    packets, out = packets_of(moving.path), tmp_path / "out.dgs"
    with LayeredOutput(open_output(out)) as target:
        target.begin(packets[0].payload)
        target.write(packets[1].kind, 0, packets[1].payload)
        monkeypatch.setattr(target.open(), "_append", full)
        with pytest.raises(TryAgainError, match=r"out\.dgs\.part: No space left"):
            target.write(packets[2].kind, 1, packets[2].payload)
        target.close(1)
    assert len(bases_of(tmp_path / "out.dgs.part")) == 1


def full(data: bytes) -> None:
    raise OSError(28, "No space left on device")


@pytest.fixture
def sources(tmp_path: Path, moving_rig: Path) -> Path:
    """The file of cameras that have recorded ``moving_rig``."""
    shutil.copytree(moving_rig, tmp_path / "capture")
    rig = open_rig(moving_rig)
    lines = [f'calibration = "{moving_rig}"', f"fps = {rig.fps}", "late = 0.03", "end = 0.1", "[cameras]"]
    lines += [f'{camera.name} = "capture/{camera.name}/{{:04d}}.png"' for camera in rig.cameras]
    path = tmp_path / "sources.toml"
    path.write_text("\n".join(lines))
    return path


def test_a_recording_in_layers_into_a_file_and_a_pipe(
    tmp_path: Path, sources: Path, moving_rig: Path, tiny_settings: Any
) -> None:
    """Exactly the scenes of an encode afterwards."""
    encode_rig(moving_rig, tmp_path / "after.dgs", settings=tiny_settings)
    encode_rig(open_live(sources), tmp_path / "live.dgs", settings=tiny_settings, layers=True)
    pipe = io.BytesIO()
    encode_rig(open_live(sources), pipe, settings=tiny_settings, layers=True)
    assert pipe.getvalue() == (tmp_path / "live.dgs").read_bytes()
    assert_exact(tmp_path / "live.dgs", states_of(tmp_path / "after.dgs"))


def test_the_command_measures_what_it_recorded(
    tmp_path: Path, sources: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """After Ctrl-C, too, which is how a recording ends."""
    out = tmp_path / "live.dgs"
    words = ["--live", str(sources), "--preset", "live", "--layers", "--profile", "phone", "-o", str(out)]
    assert encode_main(words) == 0, capsys.readouterr().err
    with open_stream(out) as stream:
        base, every = stream.header.layers
        assert stream.header.profiles == ("phone", "phone")
        frames = list(stream.frames())
    assert every.gaussians == max(len(frame.state) for frame in frames)
    assert every.bytes_per_frame == pytest.approx(np.mean([frame.packet_bytes for frame in frames]))
    assert 0 < base.bytes_per_frame < 0.6 * every.bytes_per_frame

    def interrupted(self: Any, packet: Any) -> None:
        add(self, packet)
        if packet.frame == 1:
            raise KeyboardInterrupt

    add = recording._Recording.add
    monkeypatch.setattr(recording._Recording, "add", interrupted)
    out.unlink()
    assert encode_main(words) == 130
    with open_stream(out) as stream:
        assert stream.frame_count == 1
        assert stream.header.layers[0].bytes_per_frame > 0


def test_what_layers_while_recording_do_not_go_with(tmp_path: Path, moving_rig: Path, tiny_settings: Any) -> None:
    for fields in {"resume": True}, {"only": slice(0, 1)}:
        with pytest.raises(UsageError, match=f"`layers` while recording: not with `{next(iter(fields))}`"):
            encode_rig(moving_rig, tmp_path / "out.dgs", settings=tiny_settings, layers=True, **fields)
    assert not list(tmp_path.glob("out.dgs*"))
