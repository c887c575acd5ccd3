"""``--only`` and ``decogs-join``: a take in parts has the bytes of the same encode in one go."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.decoder.exporting.exporting import export
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import CorrectionSettings, EncodeSettings, Switches, Targets, join
from decogs.formats.stream.container import PacketKind
from packets import iterate_packets
from part_takes import FRAMES, SEGMENT, Make, drifting


def test_joined_parts_are_the_encode_in_one_go(whole: Path, parts: list[Path], tmp_path: Path) -> None:
    report = join(parts[::-1], tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == whole.read_bytes()
    assert (report.parts, report.frames, report.total_bytes) == (3, FRAMES, whole.stat().st_size)
    assert [path.name for path in tmp_path.iterdir()] == ["joined.dgs"]


@pytest.mark.parametrize(
    ("spans", "threads"), [([(0, 7)], 3), ([(0, 4), (4, 7)], 2), ([(0, 2), (2, 4), (4, 6), (6, 7)], 3)]
)
def test_whatever_the_number_of_parts_and_threads(
    make: Make, whole: Path, key: Path, tmp_path: Path, spans: list[tuple[int, int]], threads: int
) -> None:
    made = [make(tmp_path / f"{a}.dgs", (a, b), keyframe=key, threads=threads) for a, b in spans]
    join([key, *made], tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == whole.read_bytes()


def test_the_first_part_can_make_the_keyframe(make: Make, whole: Path, parts: list[Path], tmp_path: Path) -> None:
    first = make(tmp_path / "first.dgs", (0, 4))
    last = make(tmp_path / "last.dgs", (4, 7), keyframe=first)
    assert last.read_bytes() == parts[2].read_bytes(), "any part brings the same keyframe"
    join([first, last], tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == whole.read_bytes()


def test_detected_effects_are_decided_once(make: Make, settings: EncodeSettings, tmp_path: Path) -> None:
    chosen = {"effects": "auto", "settings": replace(settings, corrections=CorrectionSettings())}
    one = make(tmp_path / "one.dgs", **chosen)
    made = [make(tmp_path / "first.dgs", (0, 2), **chosen)]
    made += [make(tmp_path / f"{a}.dgs", (a, b), keyframe=made[0], **chosen) for a, b in [(2, 6), (6, 7)]]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


@pytest.mark.slow
def test_wide_lenses_are_joined_and_resumed(make: Make, tiny_rig: Any, tmp_path: Path) -> None:
    """Their blank borders are the same in every part, and the camera's drift is found within what was recorded."""
    wide = tiny_rig.write(tmp_path / "wide", frames=(0, 1, 3, 1), faults=drifting, lens=(-0.25, 0.0, 0.0, 0.0))
    one = make(tmp_path / "one.dgs", rig=wide)
    made = [make(tmp_path / "first.dgs", (0, 2), rig=wide)]
    made += [make(tmp_path / "second.dgs", (2, 4), rig=wide, keyframe=made[0])]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()
    (tmp_path / "cut.dgs").write_bytes(one.read_bytes()[: -one.stat().st_size // 6])
    make(tmp_path / "cut.dgs", rig=wide, resume=True)
    assert (tmp_path / "cut.dgs").read_bytes() == one.read_bytes()
    with open_stream(one) as stream:
        exposures = [frame.corrections["cam01"].exposure for frame in stream.frames()]
    assert np.diff(exposures) == pytest.approx([100, 100, 100], abs=30), "of pictures of 64x48"


@pytest.mark.slow
def test_metrics_are_joined_too(make: Make, tmp_path: Path) -> None:
    one = make(tmp_path / "one.dgs", metrics=True)
    with one.open("rb") as file:
        told = [packet.frame for packet in iterate_packets(file) if packet.kind == PacketKind.METRICS]
    assert told == list(range(FRAMES))
    key = make(tmp_path / "key.dgs", (0, 1), metrics=True)
    made = [
        make(tmp_path / f"{a}.dgs", (a, b), keyframe=key, metrics=True, threads=2) for a, b in [(0, 2), (2, 6), (6, 7)]
    ]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


@pytest.mark.parametrize(
    "options",
    [{"switches": Switches("paper")}, {"switches": Switches("3dgstream")}, {"targets": Targets(target_psnr=24.0)}],
    ids=["paper", "3dgstream", "target"],
)
@pytest.mark.parametrize("imported", [False, pytest.param(True, marks=pytest.mark.slow)], ids=["trained", "imported"])
def test_whatever_method_target_and_keyframe(
    make: Make, moving: Any, moving_rig: Path, tmp_path: Path, options: dict[str, Any], imported: bool
) -> None:
    """Methods that train every Gaussian, or have a cache; Gaussians from a file of another program."""
    chosen, begun = {"rig": moving_rig} | options, {}
    if imported:
        export(moving.path, tmp_path / "key.ply", frames=range(0, 1))
        begun = {"keyframe": tmp_path / "key.ply"}
    one = make(tmp_path / "one.dgs", **begun, **chosen)
    made = [make(tmp_path / "key.dgs", (0, 1), **begun, **chosen)]
    made += [make(tmp_path / f"{a}.dgs", (a, a + SEGMENT), keyframe=made[0], **chosen) for a in (0, SEGMENT)]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


def test_a_range_of_the_rig_and_a_keyframe_of_an_earlier_stream(
    make: Make, moving: Any, settings: EncodeSettings, moving_rig: Path, tiny_rig: Any, tmp_path: Path
) -> None:
    chosen = {"rig": moving_rig, "segment": 1, "holdout": [tiny_rig.held_out], "frames": slice(0, 3)}
    one = make(tmp_path / "one.dgs", keyframe=moving.path, **chosen)
    made = [make(tmp_path / "key.dgs", (0, 1), keyframe=moving.path, **chosen)]
    made += [make(tmp_path / f"{a}.dgs", (a, a + 1), keyframe=made[0], **chosen) for a in (1, 2)]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


def test_a_take_that_begins_later_counts_its_segments_from_there(make: Make, tmp_path: Path) -> None:
    """Keyframe, cross-fade, metrics and all, from an odd frame with segments of two."""
    chosen = {"frames": slice(1, 6), "metrics": True}
    one = make(tmp_path / "one.dgs", **chosen)
    made = [make(tmp_path / "key.dgs", (1, 2), **chosen)]
    made += [make(tmp_path / f"{a}.dgs", (a, b), keyframe=made[0], **chosen) for a, b in [(1, 3), (3, 5), (5, 6)]]
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


def test_a_take_of_one_frame_is_a_part_and_joined(make: Make, tmp_path: Path) -> None:
    one = make(tmp_path / "one.dgs", frames=slice(1))
    join([make(tmp_path / "key.dgs", (0, 1), frames=slice(1))], tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == one.read_bytes()


def test_a_part_reads_the_first_frame_its_own_and_the_next_start(
    make: Make, rig: Path, key: Path, parts: list[Path], tmp_path: Path
) -> None:
    spoilt = Path(shutil.copytree(rig, tmp_path / "rig"))
    for camera in spoilt.glob("cam*"):
        for number in (1, 5, 6):
            (camera / f"{number:04d}.png").write_bytes(b"no picture")
    made = make(tmp_path / "part.dgs", (2, 4), keyframe=key, rig=spoilt)
    assert made.read_bytes() == parts[1].read_bytes()


def test_a_part_is_a_stream_that_shows_its_frames(whole: Path, parts: list[Path]) -> None:
    with open_stream(whole) as stream:
        states = [frame.state for frame in stream.frames()]
    for path, places in zip(parts, ([0, 1], [0, 2, 3], [0, 4, 5, 6]), strict=True):
        with open_stream(path) as stream:
            assert stream.complete
            for frame, place in zip(stream.frames(), places, strict=True):
                np.testing.assert_array_equal(frame.state.hashes, states[place].hashes)
