"""Which frame a matte file is of: by the pictures' names or numbers, counted from 0, or in order; or it is refused."""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import pytest

from decogs.formats.errors import RigError
from decogs.formats.mattes.numbering import mattes_of_recording, mattes_of_stream
from decogs.formats.mattes.per_frame import alpha_of, matte_rig, stream_matte_rig
from decogs.formats.rigs import open_rig, read_frames
from decogs.formats.rigs.sources import PictureSource
from decogs.formats.rigs.timeline import CameraClock, RecordedIndex
from decogs.formats.videos.reading import VideoSource
from rig_layouts import FRAMES, SIZE, cameras, write_video

MASKS = Path("masks/cam00")
FROM_0, FROM_1 = range(10), range(1, 11)


def files(numbers: Sequence[int], pattern: str = "{:04d}.png") -> tuple[Path, ...]:
    return tuple(Path(pattern.format(number)) for number in numbers)


def recording(numbers: Sequence[int] | None, pattern: str = "frame_{:05d}.jpg", count: int = 10) -> Any:
    """A folder of pictures with these numbers, or a video of ``count`` frames."""
    if numbers is None:
        return VideoSource(Path("cam00.mp4"), 64, 48, count, 30.0)
    return PictureSource(Path("cam00"), files(numbers, pattern), 64, 48)


def numbers_of(
    given: Sequence[int],
    of: Any,
    frames: range,
    *,
    first: int = 0,
    step: int = 1,
    count: int = 10,
    pattern: str = "{:04d}.png",
) -> list[int]:
    """The numbers of the mattes that are taken for ``frames``."""
    clock = CameraClock(RecordedIndex(first), step)
    found = mattes_of_recording(MASKS, files(given, pattern), of, clock, count, frames)
    return [int(found[frame].stem) for frame in frames]


@pytest.mark.parametrize(
    ("own", "given", "frames", "taken"),
    [
        (FROM_1, FROM_0, range(10), list(range(10))),  # 0 is no number of a picture: counted from 0
        (FROM_1, range(5), range(5), [0, 1, 2, 3, 4]),  # the same, only frames that are encoded
        (FROM_1, FROM_1, range(10), list(range(1, 11))),
        (FROM_1, range(1, 6), range(5), [1, 2, 3, 4, 5]),
        (range(0, 20, 2), range(0, 20, 2), range(10), list(range(0, 20, 2))),
        (range(0, 20, 2), range(20), range(10), list(range(0, 20, 2))),  # a matte of every recorded frame
        (range(100, 110), FROM_0, range(10), list(range(10))),
        (FROM_0, range(1001, 1011), range(10), list(range(1001, 1011))),  # as many, in order
        (None, FROM_1, range(10), list(range(1, 11))),
        (None, [2, 3, 4], range(2, 5), [2, 3, 4]),
        (FROM_1, range(1, 7), range(1, 5), [2, 3, 4, 5]),
        (range(20, 30), [1, 2, 3, 4], range(1, 5), [1, 2, 3, 4]),  # those of the frames that are encoded, from 0
    ],
)
def test_numbers_tell_the_frame(
    own: Sequence[int] | None, given: Sequence[int], frames: range, taken: list[int]
) -> None:
    assert numbers_of(given, recording(own), frames) == taken


@pytest.mark.parametrize(
    ("own", "given", "frames", "message"),
    [
        (
            FROM_0,
            [0, 1, 2, 3, 4, 6, 7, 8, 9, 10],
            range(10),
            "0000.png to 0010.png, fit neither",
        ),
        (None, [0, 1, 2, 3, 4, 6, 7, 8, 9, 10], range(10), "fit neither"),
        (FROM_0, [0, 1, 2, 3, 4, 5, 6, 7, 8], range(10), "no matte of frame 9; give one for every frame"),
        (FROM_0, [0, 9], range(10), "no matte of frame 1; give one for every frame"),
        (FROM_1, range(11), range(10), "fit neither"),  # one too many, at which end?
        (FROM_0, [], range(10), "no matte of frame 0"),
        (None, range(1, 7), range(1, 5), "fit neither"),  # from 0 or from 1?
        (FROM_1, [1, 2, 3, 4], range(1, 5), "no matte of frame 4"),  # numbers of pictures, or from 0?
    ],
)
def test_what_is_not_sure_is_refused(
    own: Sequence[int] | None, given: Sequence[int], frames: range, message: str
) -> None:
    with pytest.raises(RigError, match=message):
        numbers_of(given, recording(own), frames)


def test_a_matte_that_is_missing_in_between_moves_no_other() -> None:
    given = files([0, 1, 2, 3, 4, 6, 7, 8, 9])
    found = mattes_of_recording(MASKS, given, recording(FROM_0), CameraClock(), 10, range(10))
    assert [file.stem for file in found[4:7]] == ["0004", "", "0006"]


def test_the_names_of_the_pictures_are_sure() -> None:
    named = recording(FROM_1, "{:04d}.jpg")
    assert numbers_of(range(1, 7), named, range(1, 5)) == [2, 3, 4, 5]


def test_mattes_count_in_the_rig_s_frames_or_the_recording_s_after_cameras_were_brought_in_step() -> None:
    """Of 20 recorded frames the rig has 15, from the fourth on."""
    cut: dict[str, Any] = {"first": 3, "count": 15}
    for own in recording(range(1, 21)), recording(None, count=20):
        assert numbers_of(range(15), own, range(5), **cut) == [0, 1, 2, 3, 4]
        assert numbers_of(range(20), own, range(5), **cut) == [3, 4, 5, 6, 7]
        assert numbers_of(range(1, 21), own, range(5), **cut) == [4, 5, 6, 7, 8]
        assert numbers_of([3, 4, 5, 6, 7], recording(None, count=20), range(5), **cut) == [3, 4, 5, 6, 7]
    with pytest.raises(RigError, match=r"not sure .*rig's first frame, or 0003.png .*the recording's first frame"):
        numbers_of(range(8), recording(None, count=20), range(5), **cut)
    assert numbers_of(range(20), recording(None, count=20), range(3), first=1, step=2, count=9) == [1, 3, 5]


@pytest.mark.parametrize(
    ("given", "taken"),
    [
        (range(4), [0, 1, 2, 3]),  # of the stream's four frames
        (range(3, 7), [3, 4, 5, 6]),  # at the rig's numbers
        (range(10), [3, 4, 5, 6]),
        (range(101, 105), [101, 102, 103, 104]),
    ],
)
def test_mattes_of_a_stream_count_from_its_beginning_or_the_rig_s(given: Sequence[int], taken: list[int]) -> None:
    found = mattes_of_stream(MASKS, files(given), 3, 4, range(4))
    assert [int(file.stem) for file in found] == taken


def test_mattes_of_a_stream_with_a_hole_are_refused() -> None:
    with pytest.raises(RigError, match="fit neither"):
        mattes_of_stream(MASKS, files([10, 11, 13, 14]), 0, 4, range(4))


def numbered_from(folder: Path, first: int, make: Any) -> Path:
    """Three pictures of each of two cameras, ``first`` the number of the first."""
    for camera in "cam00", "cam01":
        make.pictures(folder / camera, frames=3)
        for file in sorted((folder / camera).iterdir(), reverse=True):
            file.rename(file.with_name(f"{int(file.stem) + first:04d}.png"))
    return folder


def test_what_was_matched_to_what_is_said_where_numbers_differ(tmp_path: Path, make: Any) -> None:
    values = make.rig_json_values(2)
    del values["frame_count"]
    for camera in values["cameras"]:
        camera["file"] = camera["name"]
    folder = numbered_from(tmp_path / "rig", 1, make)
    (folder / "rig.json").write_text(json.dumps(values))
    rig, names = open_rig(folder), ["cam00", "cam01"]
    assert matte_rig(numbered_from(tmp_path / "from1", 1, make), rig, names, range(3)).warnings == ()
    (warning,) = matte_rig(numbered_from(tmp_path / "from0", 0, make), rig, names, range(3)).warnings
    assert warning.endswith("cam00/0000.png and 1 more: taken for the matte of 0001.png, frame 0")


@pytest.mark.parametrize(
    ("first", "count", "is_fitting"), [(0, FRAMES, True), (3, FRAMES, True), (0, 3, True), (2, 3, False), (0, 6, False)]
)
def test_a_video_of_mattes_has_the_streams_frames_or_the_rigs_from_its_first(
    first: int, count: int, is_fitting: bool, tmp_path: Path
) -> None:
    write_video(tmp_path / "a.mp4", SIZE)
    with nullcontext() if is_fitting else pytest.raises(RigError, match=f"5 frames, but the stream has {count}; cut"):
        rig = stream_matte_rig(tmp_path, cameras("none", ["a"]), first, count, range(count))
        assert [alpha_of(picture).shape for _, (picture,) in read_frames(rig)] == [SIZE[::-1]] * count
