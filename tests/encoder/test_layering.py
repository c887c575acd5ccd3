"""A base that is trained on the decoded scene: exact with what refines it, like the whole alone, the same each time."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import write_key
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.codec.scene.state import take_rows
from decogs.decoder.editing import edit
from decogs.decoder.editing.operations.layer import MakeLayers
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.backends import training_kernel
from decogs.encoder.commands import encode_main
from decogs.encoder.input.imported_keyframe import read_keyframe
from decogs.encoder.layering import layers
from decogs.encoder.layering.finished import finish_stream
from decogs.encoder.layering.utility import utility
from decogs.formats.errors import StreamError, UsageError
from decogs.formats.splats import Splats
from decogs.formats.stream.container import PacketKind, StreamWriter
from edited_streams import states_of
from layered_streams import rows_of
from moving_walls import CAMERAS, bases_of, likeness, moving_wall, wall


@pytest.fixture
def moving(tmp_path: Path) -> SimpleNamespace:
    return moving_wall(tmp_path / "moving.dgs")


def test_all_layers_are_the_stream_and_the_base_looks_like_it(moving, tmp_path: Path) -> None:
    """Untrained, the same Gaussians leave holes."""
    out = tmp_path / "out.dgs"
    report = edit(moving.path, out, [MakeLayers(0.25)])
    whole = states_of(moving.path)
    for one, other in zip(states_of(out), whole, strict=True):
        np.testing.assert_array_equal(rows_of(one), rows_of(other))
    trained = likeness(whole, bases_of(out), moving.lattice)
    with open_stream(out) as stream:
        base = stream.header.layers[0]
        untrained = [frame.blocks[0] for frame in stream.frames() if frame.blocks is not None]
    assert 0.2 < base.gaussians / max(map(len, whole)) < 0.3
    assert base.psnr == pytest.approx(np.mean(trained), abs=1.0)
    assert f"{base.psnr:.1f} dB of the whole" in report.notes[0]
    assert np.min(trained) > np.mean(likeness(whole, untrained, moving.lattice)) + 6
    edit(moving.path, tmp_path / "again.dgs", [MakeLayers(0.25)])
    assert (tmp_path / "again.dgs").read_bytes() == out.read_bytes()


def test_a_later_round_keeps_what_stands_still(moving, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Offsets of Gaussians that nothing moves are coded once, those of the others again."""
    monkeypatch.setattr(layers, "_ROUND_FRAMES", 4)
    out = tmp_path / "out.dgs"
    edit(moving.path, out, [MakeLayers(0.25)])
    whole = states_of(moving.path)
    for one, other in zip(states_of(out), whole, strict=True):
        np.testing.assert_array_equal(rows_of(one), rows_of(other))
    assert np.ptp(likeness(whole, bases_of(out), moving.lattice)) < 3
    with open_stream(out, layer="base") as stream:
        fresh = [frame.changes.touched / len(frame.state) for frame in stream.frames()]
    assert 0.2 < fresh[4] < 0.95
    assert max(fresh[1:4] + fresh[5:]) < 0.4


def test_what_covers_most_is_worth_most() -> None:
    scene = wall()
    large = Splats(scene.means, scene.log_scales.copy(), scene.quaternions, scene.opacity_logits.copy(), scene.sh)
    large.log_scales[0] += 2.0
    large.opacity_logits[1] = -12.0
    worth = utility(training_kernel("cpu", 1), large, CAMERAS, np.random.default_rng(1))
    assert worth.argmax() == 0
    assert worth[1] < np.median(worth) / 100


@pytest.mark.parametrize("count", [0, 1])
def test_scenes_of_hardly_any_gaussian(tmp_path: Path, count: int) -> None:
    path, lattice = tmp_path / "few.dgs", default_lattice(1.0)
    scene = quantise(wall(), lattice)
    state, _ = keyframe_state(take_rows(scene, np.arange(count)))
    with path.open("wb") as file:
        writer = StreamWriter(file, StreamHeader(cameras=CAMERAS, lattice=lattice).to_bytes())
        writer.write(PacketKind.KEY, 0, write_key(state).payload)
        writer.finish()
    if count:
        edit(path, tmp_path / "out.dgs", [MakeLayers(0.25)])
        assert len(bases_of(tmp_path / "out.dgs")[0]) == 1
    else:
        with pytest.raises(UsageError, match="no Gaussian is there in frames 0 to 0"):
            edit(path, tmp_path / "out.dgs", [MakeLayers(0.25)])


def test_a_finished_stream_is_replaced(moving, tmp_path: Path) -> None:
    """And stays as it is where that fails; nothing is left beside it."""
    edit(moving.path, tmp_path / "out.dgs", [MakeLayers()])
    before = moving.path.read_bytes()
    finish_stream(moving.path, [MakeLayers()])
    assert moving.path.read_bytes() == (tmp_path / "out.dgs").read_bytes()
    moving.path.write_bytes(before[:-200] + bytes(100) + before[-100:])
    damaged = moving.path.read_bytes()
    with pytest.raises(StreamError):
        finish_stream(moving.path, [MakeLayers()], on_warning=lambda text: None)
    assert moving.path.read_bytes() == damaged
    assert sorted(path.name for path in tmp_path.iterdir()) == ["moving.dgs", "out.dgs"]


def test_what_layers_do_not_go_with(moving, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for words, said in (
        (["-o", "-", "--profile", "phone"], "not with -o -"),
        (["-o", "x.dgs", "--only", "0:1"], "not with --only"),
    ):
        assert encode_main([str(tmp_path), "--layers", *words]) == 2
        assert said in capsys.readouterr().err
    finish_stream(moving.path, [MakeLayers()])
    with pytest.raises(UsageError, match="the stream is in layers; take them off"):
        read_keyframe(moving.path)
