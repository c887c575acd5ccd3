"""A played view: the bits of a whole rendering, whatever is touched, removed, added, skipped or sought."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.codec.coding.index_sets import read_index_set
from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import CorrectedCameras, Correction, Corrections, write_corrections
from decogs.codec.packets.deltas import apply_delta, difference
from decogs.codec.packets.keyframes import keyframe_state
from decogs.codec.packets.syntax import Coded, write_delta, write_key, write_skip
from decogs.codec.scene.lattice import default_lattice, quantise
from decogs.codec.scene.state import Attributes, Rows, State, take_rows
from decogs.decoder import open_stream, render_view
from decogs.decoder.rasterise import Rendering
from decogs.decoder.rasterise.incremental_view import IncrementalView
from decogs.decoder.rendering.played_view import PlayedView
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats
from decogs.formats.stream.container import PACKET_OVERHEAD, PacketKind, StreamWriter
from decogs.formats.stream.cursor import Cursor

LATTICE = default_lattice(2.0)
POSE = np.eye(4)
POSE[:3, 3] = [0.1, 0, 0.2]
CAMERAS = (
    Camera("pinhole", 123, 85, 110.0, 112.0, 60.0, 44.0, np.eye(4)),
    Camera("lens", 100, 70, 90.0, 91.0, 52.0, 33.0, POSE, "opencv", (-0.25, 0.05, 0.001, -0.002)),
)
KINDS = ("key", "delta", "delta", "skip", "delta", "key", "delta", "skip", "skip", "delta", "delta")


def some_splats(rng: np.random.Generator, count: int, *, low: tuple[float, ...] = (-0.7, -0.5, 1.6)) -> Splats:
    """Small blobs in a box about 2 units in front of the cameras."""
    values = (
        np.asarray(low) + rng.uniform(0, [1.4, 1.0, 1.0], (count, 3)),
        rng.uniform(-4.5, -2.5, (count, 3)),
        rng.normal(size=(count, 4)),
        rng.uniform(-2, 4, count),
        rng.normal(0, 0.4, (count, 4, 3)),
    )
    return Splats(*(np.ascontiguousarray(value, np.float32) for value in values))


def jittered(rng: np.random.Generator, attributes: Attributes) -> Attributes:
    """All integers somewhat other ones; depths that were equal may part and others may meet."""
    names = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
    arrays = (getattr(attributes, name) for name in names)
    return Attributes(*(a + rng.integers(-30, 31, a.shape).astype(np.int32) for a in arrays))


class StreamFile:
    """A stream that is written packet by packet from the states it leads through."""

    def __init__(self, path: Path, corrected: CorrectedCameras | None = None) -> None:
        self.path, self._corrected = path, corrected or CorrectedCameras()
        self._header = StreamHeader(
            cameras=CAMERAS,
            lattice=LATTICE,
            sh_degree=1,
            background=(0.2, 0.3, 0.4),
            effects=self._corrected.effects,
            corrected=self._corrected,
        )
        self.corrections: Corrections = {}
        """Of the frames that are written from here on."""
        self._packets: list[tuple[PacketKind, bytes]] = []
        self._state: State | None = None

    @property
    def state(self) -> State:
        assert self._state is not None
        return self._state

    def key(self, attributes: Attributes) -> None:
        first = 0 if self._state is None else self._state.next_id
        self._state, _ = keyframe_state(attributes, len(self._packets), first_id=first)
        self._add(PacketKind.KEY, write_key(self._state))

    def delta(
        self, rows: np.ndarray, values: Attributes, removed: np.ndarray | None = None, added: Attributes | None = None
    ) -> None:
        delta = difference(self.state, rows, values, removed=removed, added=added)
        self._add(PacketKind.DELTA, write_delta(self.state, delta))
        self._state = apply_delta(self.state, delta)

    def skip(self) -> None:
        self._state = replace(self.state, frame=len(self._packets))
        self._add(PacketKind.SKIP, write_skip(self._state))

    def _add(self, kind: PacketKind, coded: Coded) -> None:
        self._packets.append((kind, write_corrections(self.corrections, self._corrected) + coded.payload))

    def finish(self) -> Path:
        with self.path.open("wb") as file:
            writer = StreamWriter(file, self._header.to_bytes())
            for frame, (kind, payload) in enumerate(self._packets):
                writer.write(kind, frame, payload)
            writer.finish()
        return self.path


def random_stream(path: Path, rng: np.random.Generator, count: int) -> Path:
    """Deltas that touch, remove and add in random shares; touched rows may be among the removed ones."""
    stream = StreamFile(path)
    for kind in KINDS:
        if kind == "key":
            stream.key(quantise(some_splats(rng, count), LATTICE))
        elif kind == "skip":
            stream.skip()
        else:
            touched, gone = (np.flatnonzero(rng.random(len(stream.state)) < rng.choice([0, 0.05, 0.6])) for _ in "tr")
            added = quantise(some_splats(rng, int(rng.choice([0, 7]))), LATTICE)
            stream.delta(touched, jittered(rng, take_rows(stream.state, touched)), gone, added)
    return stream.finish()


def assert_same(played: Rendering, whole: Rendering) -> None:
    for name in ("image", "alpha", "depth"):
        assert np.array_equal(getattr(played, name), getattr(whole, name)), name


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize(("seed", "count"), [(0, 400), (1, 400), (2, 40), (3, 1), (4, 0)])
def test_played_frames_are_whole_renderings_bit_for_bit(tmp_path: Path, seed: int, count: int, threads: int) -> None:
    rng = np.random.default_rng(seed)
    with open_stream(random_stream(tmp_path / "random.dgs", rng, count)) as stream:
        for camera in CAMERAS:
            for options in ({}, {"scale": 0.7, "background": (0.0, 1.0, 0.5), "undistorted": True}):
                view = PlayedView(stream.header, camera.name, threads=threads, **options)
                for frame in stream.frames():
                    whole = render_view(stream.header, frame.splats, camera.name, threads=1, **options)
                    assert_same(view.show(frame), whole)


def test_a_delta_is_parsed_once_when_it_is_decoded_and_played(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parsed: list[int] = []

    def observed(cursor: Cursor, count: int) -> Rows:
        parsed.append(count)
        return read_index_set(cursor, count)

    monkeypatch.setattr("decogs.codec.packets.syntax.read_index_set", observed)
    with open_stream(random_stream(tmp_path / "random.dgs", np.random.default_rng(8), 300)) as stream:
        view, deltas = PlayedView(stream.header, "pinhole", scale=0.1), 0
        for frame in stream.frames():
            view.show(frame)
            assert sum(frame.costs.values()) == frame.packet_bytes - PACKET_OVERHEAD
            deltas += frame.kind == PacketKind.DELTA
    assert deltas
    assert len(parsed) == 2 * deltas  # the touched rows and the removed ones


def test_frames_may_come_in_any_order(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    with open_stream(random_stream(tmp_path / "random.dgs", rng, 300)) as stream:
        view, frames = PlayedView(stream.header, "pinhole"), list(stream.frames())
        for index in (*rng.integers(0, len(frames), 20), 3, 4, 4, 9, 10):
            assert_same(view.show(frames[index]), render_view(stream.header, frames[index].splats, "pinhole"))


def test_only_touched_tiles_are_drawn_and_nothing_when_nothing_shows(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    stream = StreamFile(tmp_path / "one.dgs")
    behind = some_splats(rng, 10, low=(-0.7, -0.5, -4.0))
    stream.key(quantise(some_splats(rng, 300), LATTICE))
    stream.delta(np.array([17]), jittered(rng, take_rows(stream.state, np.array([17]))))
    stream.skip()
    nothing = np.zeros(0, np.int64)
    stream.delta(nothing, take_rows(stream.state, nothing), added=quantise(behind, LATTICE))
    rows = np.arange(300, 310)
    stream.delta(rows, jittered(rng, take_rows(stream.state, rows)), removed=rows[:3])
    with open_stream(stream.finish()) as opened:
        for camera in CAMERAS:
            view = PlayedView(opened.header, camera.name)
            shown, drawn = [], []
            for frame in opened.frames():
                shown.append(view.show(frame))
                drawn.append(view.redrawn)
                assert_same(shown[-1], render_view(opened.header, frame.splats, camera.name))
            assert 0 < drawn[1] < drawn[0] / 2
            assert drawn[2:] == [0, 0, 0]
            assert shown[1] is shown[2] is shown[3] is shown[4]


CORRECTED = CorrectedCameras(("pinhole", "lens"), ("lens",), ("lens",))


def corrected_stream(path: Path, rng: np.random.Generator) -> Path:
    """Frames 0 to 6: colours and poses come, stay, change alone and together, while the scene changes or does not."""
    stream = StreamFile(path, CORRECTED)
    stream.key(quantise(some_splats(rng, 300), LATTICE))
    first = {"pinhole": Correction(exposure=900), "lens": Correction(-700, 400, -300, 4000, -3000, 9000)}
    for told in (first, first, {**first, "pinhole": Correction(exposure=-900)}, {}, {}):
        stream.corrections = told
        stream.skip()
    stream.corrections = {"lens": Correction(yaw=-2500)}
    stream.delta(np.arange(9), jittered(rng, take_rows(stream.state, np.arange(9))))
    return stream.finish()


@pytest.mark.parametrize("options", [{}, {"scale": 0.7, "undistorted": True, "threads": 2}])
def test_a_played_view_shows_what_a_camera_recorded(tmp_path: Path, options: dict[str, Any]) -> None:
    with open_stream(corrected_stream(tmp_path / "faults.dgs", np.random.default_rng(3))) as stream:
        for camera in CAMERAS:
            recorded = PlayedView(stream.header, camera.name, **options)
            drift_free = PlayedView(stream.header, camera.name, drift_free=True, **options)
            for frame in [*stream.frames(), *stream.frames(2, 4)]:
                whole = render_view(stream.header, frame.splats, camera.name, corrections=frame.corrections, **options)
                assert_same(recorded.show(frame), whole)
                assert_same(drift_free.show(frame), render_view(stream.header, frame.splats, camera.name, **options))


def test_only_a_new_pose_is_rendered_anew(tmp_path: Path) -> None:
    with open_stream(corrected_stream(tmp_path / "faults.dgs", np.random.default_rng(3))) as stream:
        shown, drawn = {}, {}
        for camera in CAMERAS:
            view = PlayedView(stream.header, camera.name)
            shown[camera.name] = [view.show(frame) for frame in stream.frames()]
            view = PlayedView(stream.header, camera.name)
            drawn[camera.name] = [view.redrawn for frame in stream.frames() if view.show(frame)]
    assert not any(drawn["pinhole"][1:6])
    assert [bool(tiles) for tiles in drawn["lens"][:6]] == [True, True, False, False, True, False]
    assert shown["pinhole"][1] is shown["pinhole"][2]
    assert shown["lens"][1] is shown["lens"][2] is shown["lens"][3]


def test_other_cameras_show_the_scene_as_it_is(tmp_path: Path) -> None:
    """One that happens to be equal to a camera of the rig is not that camera."""
    with open_stream(corrected_stream(tmp_path / "faults.dgs", np.random.default_rng(3))) as stream:
        frame = list(stream.frames())[1]
        free = render_view(stream.header, frame.splats, CAMERAS[0], corrections=frame.corrections)
        assert_same(free, render_view(stream.header, frame.splats, "pinhole"))
        assert_same(PlayedView(stream.header, CAMERAS[0]).show(frame), free)


def test_pictures_cannot_be_written(tmp_path: Path) -> None:
    with open_stream(random_stream(tmp_path / "random.dgs", np.random.default_rng(2), 10)) as stream:
        picture = PlayedView(stream.header, "pinhole").show(next(stream.frames()))
    with open_stream(corrected_stream(tmp_path / "faults.dgs", np.random.default_rng(3))) as stream:
        recorded = PlayedView(stream.header, "pinhole").show(list(stream.frames())[1])
    for array in (picture.image, picture.alpha, picture.depth, recorded.image):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_changes_that_do_not_fit_are_refused() -> None:
    scene = some_splats(np.random.default_rng(1), 5)
    none = np.zeros(0, np.int64)
    view = IncrementalView(CAMERAS[0], (0.0, 0.0, 0.0), threads=1)
    with pytest.raises(ValueError, match="in the scene"):  # which is empty
        view.change(np.array([0]), scene, none, population=0)
    view.set_scene(scene)
    with pytest.raises(ValueError, match="ascend"):
        view.change(np.array([3, 1]), scene, np.arange(5), population=5)
    with pytest.raises(ValueError, match="in the scene"):
        view.change(np.array([5]), scene, np.arange(5), population=5)
    with pytest.raises(ValueError, match="in the scene"):
        view.change(none, scene, np.arange(5), population=4)
    with pytest.raises(ValueError, match="rows"):
        view.change(none, scene, np.arange(4), population=5)
    for renumbered in (np.arange(4), np.arange(1, 6)):
        with pytest.raises(ValueError, match="new numbers"):
            view.change(np.arange(5), scene, np.arange(5), population=5, renumbered=renumbered)
