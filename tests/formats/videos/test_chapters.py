"""Recordings that a camera split into chapters are one: their frames, their sound, their files."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.encoder.input.sound import sound_source
from decogs.formats.errors import RigError
from decogs.formats.rigs import in_step, open_recordings, open_rig
from decogs.formats.rigs.opening import files_of
from decogs.formats.rigs.sources import open_source
from decogs.formats.rigs.timeline import RigTime
from decogs.formats.videos.chapters import ChapteredVideo, chapters_from, open_recording
from decogs.rig.calibration.footage import open_footage
from videos_with_sound import write_video

LENGTHS = 4, 3, 5


def level(picture: np.ndarray) -> int:
    return round((picture[..., 1].mean() - 30) / 20)


def chapters(folder: Path, names: list[str], make: Any) -> list[Path]:
    files = [folder / name for name in names]
    for file, frames in zip(files, LENGTHS, strict=False):
        make.video(file, frames=frames)
    return files


@pytest.mark.parametrize(
    "names",
    [
        ["GX010042.MP4", "GX020042.MP4", "GX030042.MP4"],
        ["GH010042.MP4", "GH020042.MP4", "GH030042.MP4"],
        ["GOPR0042.MP4", "GP010042.MP4", "GP020042.MP4"],
        ["gx010042.mp4", "gx020042.mp4", "gx030042.mp4"],
    ],
)
def test_chapters_are_one_recording(names: list[str], tmp_path: Path, make: Any) -> None:
    files = chapters(tmp_path, names, make)
    video = open_recording(files[0])
    assert video.frame_count == sum(LENGTHS)
    expected = [frame for length in LENGTHS for frame in range(length)]
    assert [level(picture) for picture in video.read(0, 12)] == expected
    for start, stop, step in (2, 11, 3), (4, 7, 1), (5, 12, 4), (0, 12, 7), (8, 8, 1):
        assert [level(picture) for picture in video.read(start, stop, step)] == expected[start:stop:step]
    assert [chapters_from(video, frame)[1] for frame in (3, 4, 7, 11)] == [3, 0, 0, 4]
    assert open_recording(files[1]).frame_count == LENGTHS[1], "a later chapter alone is what it is"


def test_a_folder_of_chapters_names_what_to_state(tmp_path: Path, make: Any) -> None:
    chapters(tmp_path, ["GX010042.MP4", "GX020042.MP4"], make)
    with pytest.raises(RigError, match=r"holds GX010042\.MP4, but no pictures; name the video itself"):
        open_source(tmp_path)


def test_damage_ends_with_its_chapter(tmp_path: Path, make: Any) -> None:
    video = open_recording(chapters(tmp_path, ["GX010042.MP4", "GX020042.MP4", "GX030042.MP4"], make)[0])
    assert isinstance(video, ChapteredVideo)
    assert [video.readable_after(frame) for frame in (1, 3, 6, 11)] == [2, 4, 7, 12], "every picture is a keyframe"


def test_other_names_and_other_recordings_are_left_alone(tmp_path: Path, make: Any) -> None:
    files = chapters(tmp_path, ["GX010042.MP4", "GX020043.MP4", "cam020042.MP4"], make)
    assert open_recording(files[0]).frame_count == LENGTHS[0]
    assert [each.name for each in open_footage(tmp_path)] == ["GX010042", "GX020043", "cam020042"]


def test_a_link_to_the_first_chapter_goes_on_where_that_does(tmp_path: Path, make: Any) -> None:
    first, *_ = chapters(tmp_path, ["GX010042.MP4", "GX020042.MP4"], make)
    (tmp_path / "links").mkdir()
    (tmp_path / "links/cam00.MP4").symlink_to(first)
    assert open_recording(tmp_path / "links/cam00.MP4").frame_count == sum(LENGTHS[:2])


def test_what_does_not_go_on_is_refused(tmp_path: Path, make: Any) -> None:
    first, second, _ = chapters(tmp_path, ["GX010042.MP4", "GX020042.MP4", "GX030042.MP4"], make)
    second.rename(tmp_path / "gone.mp4")
    with pytest.raises(RigError, match=r"GX010042.MP4: its chapter GX020042 is missing, but .*GX030042.MP4 is there"):
        open_recording(first)
    make.video(second, frames=3, fps=60)
    with pytest.raises(RigError, match=r"GX020042.MP4: has 60.000 frames per second, not 30.000 as GX010042.MP4"):
        open_recording(first)


def rig_of_chapters(folder: Path, make: Any) -> Path:
    values = make.rig_json_values(3)
    del values["frame_count"]
    for number, camera in enumerate(values["cameras"]):
        camera["file"] = f"GX01000{number}.MP4"
        chapters(folder, [f"GX0{chapter}000{number}.MP4" for chapter in (1, 2)], make)
    (folder / "rig.json").write_text(json.dumps(values))
    return folder


def test_a_rig_reads_its_cameras_chapters_and_guards_them(tmp_path: Path, make: Any) -> None:
    rig = open_rig(rig_of_chapters(tmp_path / "rig", make))
    assert rig.frame_count == sum(LENGTHS[:2])
    (warning,) = rig.warnings
    assert warning.endswith("GX010000.MP4 and 2 more: goes on in 1 more chapter, read as one recording")
    read = {file.name for file, _ in files_of(rig)}
    assert read >= {f"GX0{chapter}000{camera}.MP4" for chapter in (1, 2) for camera in range(3)}
    cut = in_step(open_recordings(tmp_path / "rig"), {"cam00": RigTime(0), "cam01": RigTime(5), "cam02": RigTime(0)})
    assert [level(picture) for picture in cut.sources[0].read(0, 2)] == [1, 2], "the second chapter's"


def test_the_sound_goes_on_with_the_chapters(tmp_path: Path, make: Any) -> None:
    """A tone in the first half second of each chapter; a stream that begins in the first, and one in the second."""
    values = make.rig_json_values(1)
    values["cameras"][0] |= {"file": "GX010000.MP4", "width": 64, "height": 48}
    del values["frame_count"]
    tone = 0.5 * np.sin(np.arange(48000) * 0.1).astype(np.float32) * (np.arange(48000) < 24000)
    for chapter in 1, 2:
        write_video(tmp_path / f"GX0{chapter}0000.MP4", np.zeros((30, 48, 64, 3), np.uint8), tone)
    (tmp_path / "rig.json").write_text(json.dumps(values))
    rig = open_rig(tmp_path)
    for first, begins in (15, [0.5]), (0, [0.0, 1.0]), (30, [0.0]):
        source = sound_source("cam00", rig, first, print)
        assert source is not None
        samples = np.concatenate([piece for part in source.pieces for piece in part.samples(1)], axis=1)[0]
        loud = np.abs(samples[: len(samples) // 480 * 480].reshape(-1, 480)).max(axis=1) > 0.1
        edges = np.flatnonzero(np.diff(np.concatenate([[False], loud]).astype(int)) == 1) * 0.01
        assert edges == pytest.approx(begins, abs=0.03)
    assert isinstance(rig.recording("cam00"), ChapteredVideo)
