"""Cameras that start at different times, with other lengths and rates, are read in step, or refused by name."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.formats.errors import RigError
from decogs.formats.mattes.per_frame import matte_rig
from decogs.formats.rigs import Rig, in_step, open_recordings, open_rig, read_frames
from decogs.formats.rigs.timeline import RigIndex
from decogs.rig.synchronisation.sync_file import read_starts

LENGTH = 9


def written(
    folder: Path, make: Any, starts: list[float | None], *, lengths: list[int] | None = None, **values: Any
) -> Path:
    """Cameras whose frame k is grey 30 + 20 k, counted from each one's own start."""
    document = make.rig_json_values(len(starts)) | values
    del document["frame_count"]
    if "fps" not in values:
        del document["fps"]
    for number, (camera, start) in enumerate(zip(document["cameras"], starts, strict=True)):
        make.video(folder / camera["file"], frames=lengths[number] if lengths else LENGTH)
        camera["start"] = start
    (folder / "rig.json").write_text(json.dumps(document))
    return folder


def shown(rig: Rig) -> list[list[int]]:
    """Of every frame, the number of the recording's frame that each camera shows."""
    return [[round((picture[..., 1].mean() - 30) / 20) for picture in pictures] for _, pictures in read_frames(rig)]


def test_cameras_that_start_later_are_read_from_an_earlier_frame_of_their_own(tmp_path: Path, make: Any) -> None:
    rig = open_rig(written(tmp_path, make, [0, 2, 1]))
    assert rig.frame_count == LENGTH - 2
    assert shown(rig) == [[k + 2, k, k + 1] for k in range(LENGTH - 2)]
    assert [pictures[1][0, 0, 1] for _, pictures in read_frames(rig, 1, 6, step=3)] == pytest.approx([50, 110], abs=3)
    (warning,) = rig.warnings
    assert warning.endswith("cameras start up to 2 frames apart; the 7 frames that all of them recorded are used")


@pytest.mark.parametrize("others", [[0, 0, 0], [5.0, 5.0, 5.0], [None, None, None]])
def test_starts_that_are_all_one_change_nothing(tmp_path: Path, make: Any, others: list[float | None]) -> None:
    rig = open_rig(written(tmp_path, make, others))
    assert rig.warnings == ()
    assert shown(rig) == [[k] * 3 for k in range(LENGTH)]


def test_lengths_may_differ_where_starts_are_known_and_are_refused_where_not(tmp_path: Path, make: Any) -> None:
    rig = open_rig(written(tmp_path / "known", make, [0, 1, 0], lengths=[9, 5, 7]))
    assert shown(rig) == [[k + 1, k, k + 1] for k in range(5)]
    together = open_rig(written(tmp_path / "together", make, [0, 0, 0], lengths=[9, 9, 7]))
    assert [text.partition("; ")[2] for text in together.warnings] == [
        "the 7 frames that all of them recorded are used"
    ]
    unknown = written(tmp_path / "unknown", make, [None] * 3, lengths=[9, 9, 7])
    with pytest.raises(RigError, match=r"cam02.mp4: 7 frames, but cam00.mp4 has 9; .*decogs-sync"):
        open_rig(unknown)
    assert [source.frame_count for source in open_recordings(unknown).sources] == [9, 9, 7]


def test_seconds_count_at_the_rate_of_the_rig(tmp_path: Path, make: Any) -> None:
    rig = open_rig(written(tmp_path, make, [0.0, 0.1, 0.0], start_unit="seconds"))
    assert shown(rig)[0] == [3, 0, 3]


def test_readouts_are_told_in_seconds_and_kept_in_frames_of_the_rig(tmp_path: Path, make: Any) -> None:
    folder = written(tmp_path, make, [0, 0.25, 0])
    values = json.loads((folder / "rig.json").read_text())
    values["cameras"][0]["readout"] = 0.02
    values["cameras"][1].update(readout=0.01, readout_from="bottom")
    (folder / "rig.json").write_text(json.dumps(values))
    rig = open_rig(folder)  # whose videos have 30 frames a second
    times = rig.timeline.row_times()
    assert {name: each.readout for name, each in times.items()} == pytest.approx({"cam00": 0.6, "cam01": -0.3})
    assert times["cam01"].late == pytest.approx(0.25)
    assert times["cam01"].at(np.array([0.0, 0.5, 1.0])) == pytest.approx([0.4, 0.25, 0.1])


@pytest.mark.parametrize(
    ("told", "message"),
    [
        ({"readout": -0.01}, r"cameras\[1\]: 'readout' is -0.01 s, not between 0 and 0.2"),
        ({"readout": 20}, r"'readout' is 20 s, not between 0 and 0.2"),
        ({"readout": "fast"}, "'readout' is not a number"),
        ({"readout": 0.01, "readout_from": "left"}, "'readout_from' is 'left', neither 'top' nor 'bottom'"),
        ({"readout_from": "top"}, "'readout' is missing"),
    ],
)
def test_readouts_that_no_camera_has_are_refused(tmp_path: Path, make: Any, told: dict[str, Any], message: str) -> None:
    folder = written(tmp_path, make, [0, 0, 0])
    values = json.loads((folder / "rig.json").read_text())
    values["cameras"][1].update(told)
    (folder / "rig.json").write_text(json.dumps(values))
    with pytest.raises(RigError, match=message):
        open_rig(folder)


@pytest.mark.parametrize("fps", [15, 29.97, 60])
@pytest.mark.parametrize(("unit", "late"), [("frames", 3), ("seconds", 0.1)])
def test_starts_count_as_recorded_whatever_rate_is_stated(
    tmp_path: Path, make: Any, fps: float, unit: str, late: float
) -> None:
    """Videos of 30 frames a second, which a stream plays at another rate."""
    rig = open_rig(written(tmp_path, make, [0, late, 0], start_unit=unit, fps=fps))
    assert shown(rig)[0] == [3, 0, 3]
    assert rig.fps == fps
    assert rig.timeline.rate == 30
    assert rig.timeline.clock("cam00").recorded_index(RigIndex(2)) == 5


def test_a_sync_file_counts_in_the_rate_that_it_states(tmp_path: Path, make: Any) -> None:
    recordings = open_recordings(written(tmp_path, make, [None] * 3, fps=15))
    file = tmp_path / "sync.json"
    for fps, offset in (30, 3), (15, 1.5), ("30000/1001", 2.997), (None, 3):
        cameras = [{"name": "cam00", "offset": 0}, {"name": "cam01", "offset": offset}, {"name": "cam02", "offset": 0}]
        file.write_text(json.dumps({"fps": fps, "cameras": cameras}))
        assert shown(in_step(recordings, read_starts(file, recordings)))[0] == [3, 0, 3], fps


def test_what_is_below_a_frame_is_said_and_as_little_as_can_be(tmp_path: Path, make: Any) -> None:
    rig = open_rig(written(tmp_path, make, [0.25, 1.25, 0.6]))
    assert shown(rig)[0] == [1, 0, 1]
    assert "camera cam02 stays out of step by up to 0.35 of a frame" in rig.warnings[-1]


def test_a_camera_without_a_start_starts_as_most_others_and_that_is_said(tmp_path: Path, make: Any) -> None:
    rig = open_rig(written(tmp_path, make, [2, 2, 0, None]))
    assert shown(rig)[0] == [0, 0, 2, 0]
    assert "no start is known of camera cam03" in rig.warnings[-1]


def test_a_camera_of_twice_the_rate_gives_every_second_frame(tmp_path: Path, make: Any) -> None:
    folder = written(tmp_path, make, [0, 0.5, 1])
    make.video(folder / "cam02.mp4", frames=11, fps=60)
    rig = open_rig(folder)
    assert rig.fps == pytest.approx(30)
    # Its frames are half a frame apart on the rig's clock, and it starts a whole one late.
    assert shown(rig)[:3] == [[1, 0, 0], [2, 1, 2], [3, 2, 4]]
    make.video(folder / "cam02.mp4", frames=11, fps=25)
    with pytest.raises(RigError, match=r"cam00.mp4: 30.000 frames per second is no multiple of the 25.000 of cam02"):
        open_rig(folder)


def test_picture_folders_are_read_in_step_by_their_files(tmp_path: Path, make: Any) -> None:
    folder = written(tmp_path, make, [0, 1, 0])
    document = json.loads((folder / "rig.json").read_text())
    make.pictures(folder / "pictures", frames=LENGTH)
    document["cameras"][1]["file"] = "pictures"
    (folder / "rig.json").write_text(json.dumps(document))
    assert shown(open_rig(folder))[0] == [1, 0, 1]


def test_mattes_follow_the_recording_of_their_camera(tmp_path: Path, make: Any) -> None:
    rig = open_rig(written(tmp_path / "rig", make, [0, 2, 1]))
    for name in ("cam01", "cam02"):
        make.video(tmp_path / "masks" / f"{name}.mp4", frames=LENGTH)
    make.pictures(tmp_path / "masks" / "cam00", frames=LENGTH)
    mattes = matte_rig(tmp_path / "masks", rig, ["cam00", "cam01", "cam02"], range(3))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("decogs.formats.mattes.per_frame._without_colour", lambda path, matte: matte)
        assert shown(mattes) == shown(rig)


@pytest.mark.parametrize(
    ("starts", "values", "message"),
    [
        ([0, 20, 0], {}, "camera cam00 ends before camera cam01 starts, so that they share no frame"),
        ([0, "late", 0], {}, r"cameras\[1\]: 'start' is not a number"),
        ([0, 1e300, 0], {}, "'start' of cam01 is 1e\\+300 frames away, which no recording is"),
        ([0, 1, 0], {"start_unit": "hours"}, "'start_unit' is 'hours', neither 'frames' nor 'seconds'"),
    ],
)
def test_what_cannot_be_brought_in_step_is_refused(
    tmp_path: Path, make: Any, starts: list[Any], values: dict[str, Any], message: str
) -> None:
    with pytest.raises(RigError, match=message):
        open_rig(written(tmp_path, make, starts, **values))


def test_starts_of_none_of_the_cameras_are_refused(tmp_path: Path, make: Any) -> None:
    with pytest.raises(RigError, match="the starts name none of its cameras"):
        in_step(open_recordings(written(tmp_path, make, [None] * 3)), {"someone": 1.0})


def test_any_starts_give_frames_of_one_instant(tmp_path: Path, make: Any) -> None:
    recordings = open_recordings(written(tmp_path, make, [None] * 4))
    rng = np.random.default_rng(3)
    for _ in range(30):
        starts = rng.uniform(-3, 3, 4)
        rig = in_step(recordings, {camera.name: starts[row] for row, camera in enumerate(recordings.cameras)})
        first = np.array([getattr(source, "first", 0) for source in rig.sources])
        # Half a frame of the clock and half of each camera's own rounding bound what remains.
        assert np.ptp(first + starts) <= 1
        assert (first >= 0).all()
        assert (first + rig.frame_count <= LENGTH).all()
        assert (first + rig.frame_count == LENGTH).any()
