"""Cuts in takes of closed segments: those after one start from its keyframe, in whatever part they are encoded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.codec.packets.corrections import Correction
from decogs.codec.packets.syntax import write_key
from decogs.codec.scene.lattice import dequantise
from decogs.codec.scene.state import State
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rasterise import render
from decogs.decoder.reading.stream import open_stream
from decogs.encoder import CorrectionSettings, EncodeSettings, join
from decogs.encoder.coding.scene import Scene
from decogs.encoder.frame.segment_starts import SceneStart, SegmentStarts
from decogs.formats.rigs import open_rig
from decogs.formats.rigs.live import LiveSource
from decogs.formats.splats import join_splats
from decogs.rig.pictures.ingest import Ingest, RigFrame
from encode_rig import encode_rig

SEGMENT = 2

Take = Callable[[str], Path]


@pytest.fixture(scope="module")
def take(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Take:
    """``take("AABB")``: so many frames of one scene, then of another; something moves in either."""
    made: dict[str, Path] = {}

    def write(shown: str) -> Path:
        if shown in made:
            return made[shown]
        moments = [0 if scene == "A" and not place else place % 3 for place, scene in enumerate(shown)]
        folder = tiny_rig.write(tmp_path_factory.mktemp("takes") / shown, frames=moments, noise=1.2, faults=drifting)
        random = np.random.default_rng(3)
        for frame in (place for place, scene in enumerate(shown) if scene == "B"):
            wall = tiny_rig.patch((0, 0, 0.4), 40, 24, 0.15, 21)
            other = join_splats(wall, tiny_rig.patch((0.1 * (frame % 4) - 0.5, 0, -0.3), 4, 4, 0.1, 22))
            for index in range(tiny_rig.cameras):
                camera = tiny_rig.camera(index)
                clean = to_8bit(render(other, camera, threads=1).image)
                seen = np.clip(np.rint(clean + random.normal(0, 1.2, clean.shape)), 0, 255).astype(np.uint8)
                tiny_rig.write_png(folder / camera.name / f"{frame:04d}.png", seen)
        return made.setdefault(shown, folder)

    return write


def start_with(frame: RigFrame) -> SceneStart:
    unread: Any = None
    return SceneStart(unread, unread, frame, corrections=None, stage=None)


def starts_of(ingest: Ingest) -> SegmentStarts:
    return SegmentStarts(ingest, SEGMENT, start_with(next(ingest.frames(0, 1))))


def drifting(name: str, frame: int) -> Correction:
    return Correction(exposure=50 * frame) if name == "cam01" else Correction()


@pytest.fixture(scope="module")
def settings(tiny_settings: EncodeSettings) -> EncodeSettings:
    """With a camera that is compensated, and enough steps that a keyframe differs from another one."""
    return replace(tiny_settings, corrections=CorrectionSettings(exposure=("cam01",)))


@pytest.fixture(scope="module")
def make(settings: EncodeSettings) -> Callable[..., Any]:
    """``make(rig, output, only)``: a part of the take, or all of it, and its report."""

    def run(rig: Path, output: Path, only: tuple[int, int] | None = None, **options: Any) -> Any:
        given = {"settings": settings, "segment": SEGMENT, "closed": True, "threads": 1} | options
        return encode_rig(rig, output, only=None if only is None else range(*only), **given)

    return run


@pytest.fixture(scope="module")
def whole(
    take: Take, make: Callable[..., Any], tmp_path_factory: pytest.TempPathFactory
) -> Callable[[str, int], tuple[Path, Any]]:
    """``whole("AABB", segment)``: the stream of that take in one go, and its report; no test may write to it."""

    @cache
    def encoded(shown: str, segment: int) -> tuple[Path, Any]:
        output = tmp_path_factory.mktemp("whole") / "scene.dgs"
        return output, make(take(shown), output, segment=segment)

    return encoded


def states(path: Path) -> list[State]:
    with open_stream(path) as stream:
        assert stream.complete
        return [frame.state for frame in stream.frames()]


@pytest.mark.parametrize("shown", ["AAABBBB", "AABBBB"])
def test_segments_after_a_cut_start_from_its_keyframe(
    whole: Callable[[str, int], tuple[Path, Any]], shown: str
) -> None:
    """A cut within a segment, or at a start. What stays has the same Gaussians in all of them."""
    path, report = whole(shown, SEGMENT)
    cut = shown.index("B")
    assert [frame.frame for frame in report.frames if frame.cut] == [cut]
    key, *later = states(path)[cut:]
    for state in later:
        assert np.isin(key.ids, state.ids).mean() > 0.9
        assert np.isin(key.hashes, state.hashes).any(), "those that nothing changes"


@pytest.mark.parametrize(
    ("shown", "segment"),
    [
        ("ABBB", 1),
        *(pytest.param(shown, length, marks=pytest.mark.slow) for shown, length in (("AAABBBB", 2), ("ABABABA", 3))),
    ],
)
def test_parts_of_a_take_with_cuts_are_the_encode_in_one_go(
    take: Take,
    make: Callable[..., Any],
    whole: Callable[[str, int], tuple[Path, Any]],
    tmp_path: Path,
    shown: str,
    segment: int,
) -> None:
    """Each segment is a part of its own, made from the first one; the fade before a start looks ahead over a cut."""
    rig, frames = take(shown), len(shown)
    in_one_go, _ = whole(shown, segment)
    made = [tmp_path / "0.dgs"]
    make(rig, made[0], (0, segment), segment=segment)
    for start in range(segment, frames, segment):
        made.append(tmp_path / f"{start}.dgs")
        make(rig, made[-1], (start, min(start + segment, frames)), segment=segment, keyframe=made[0])
    join(made, tmp_path / "joined.dgs")
    assert (tmp_path / "joined.dgs").read_bytes() == in_one_go.read_bytes()


@pytest.mark.parametrize("shown", ["AAABBB", pytest.param("AABBAAB", marks=pytest.mark.slow)])
def test_an_encode_with_cuts_is_resumed_to_the_same_bytes(
    encode: Any, take: Take, settings: EncodeSettings, tmp_path: Path, shown: str
) -> None:
    closed = replace(settings, segment=SEGMENT, closed=True)
    whole = encode(take(shown), settings=closed)
    for frames in (3, 4, 5):
        path = tmp_path / f"{frames}.dgs"
        path.with_name(f"{path.name}.part").write_bytes(whole.cut_off(frames, 9))
        assert encode(take(shown), settings=closed, output=path, resume=True).data == whole.data, frames


def test_a_take_that_returns_to_its_first_scene_starts_from_the_first_keyframe(
    take: Take, make: Callable[..., Any], tmp_path: Path
) -> None:
    make(take("AABBAA"), tmp_path / "scene.dgs")
    first, *_, again, _ = states(tmp_path / "scene.dgs")
    assert np.isin(first.ids, again.ids).mean() > 0.9


@pytest.mark.parametrize(
    ("shown", "start", "cut"),
    [
        ("AAABBBBB", 4, 3),
        ("AAABBBBB", 6, 3),
        ("AABBBB", 4, 2),
        ("ABBAABB", 6, 5),
        ("ABABBB", 2, None),
        ("AABB", 2, None),
    ],
)
def test_the_cut_is_found_from_pictures(take: Take, shown: str, start: int, cut: int | None) -> None:
    ingest = Ingest(open_rig(take(shown)))
    starts, frame = starts_of(ingest), next(ingest.frames(start, start + 1, first=0))
    asked: list[int] = []

    def train(recorded: RigFrame) -> None:
        asked.append(recorded.index)

    assert starts.before(frame, train) is None
    assert asked == ([] if cut is None else [cut])


def test_a_cut_in_which_a_camera_fails_begins_a_frame_later(take: Take, tiny_rig: Any, tmp_path: Path) -> None:
    rig = tiny_rig.poisoned(take("AAABBB"), tmp_path / "rig", "cam00")
    (rig / "cam01" / "0003.png").write_bytes(b"no picture")
    ingest = Ingest(open_rig(rig))
    frame = next(ingest.frames(4, 5, first=0))
    asked: list[int] = []
    starts_of(ingest).before(frame, lambda recorded: asked.append(recorded.index))
    assert asked == [], "frame 3 is lost, and frame 4 is the start itself"


def test_a_recording_that_goes_on_is_not_read_back(tiny_rig: Any) -> None:
    """There a segment starts from the last cut that was met; there are no parts."""
    live = LiveSource(Path("cam00"), tiny_rig.camera(0), recording=None)  # type: ignore[arg-type]
    rig: Any = SimpleNamespace(rig=SimpleNamespace(sources=[live]))
    first, *made = (start_with(RigFrame(index, [], [])) for index in (0, 5, 3))
    starts, frame = SegmentStarts(rig, SEGMENT, first), RigFrame(6, [], [])
    assert starts.before(frame, pytest.fail) is None
    for each in made:
        starts.keep(each)
    assert starts.before(frame, pytest.fail) is made[0]


def test_the_ids_of_a_long_scene_after_a_cut_can_be_listed(tiny_settings: Any, moving: Any) -> None:
    """Its segments' own Gaussians and the cut's keyframe must be less than 2^35 ids apart."""
    with open_stream(moving.path) as stream:
        header, key = stream.header, next(iter(stream.frames())).state
    scene = Scene(header, key, key, dequantise(key, header.lattice))
    first_id = scene.id_of_cut(90, 60)
    cut = replace(key, frame=90, ids=key.ids + first_id, next_id=key.next_id + first_id)
    for frame in (120, 120 + 1_000_000 * 4):
        before = scene.restart(cut, frame, 60)
        added = replace(before.state, ids=np.append(before.state.ids[:-1], before.state.next_id), next_id=1 << 60)
        write_key(added, first=key)
