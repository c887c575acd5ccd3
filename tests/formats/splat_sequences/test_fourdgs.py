"""Files of the PyPI package fourdgs: what a moment shows is what the package says, and hostile ones are one line."""

from __future__ import annotations

import itertools
import math
import random
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.formats.errors import UsageError
from decogs.formats.splat_files import Room
from decogs.formats.splat_files.quantised import opacities
from decogs.formats.splat_sequences import SequenceFrame, fourdgs
from decogs.formats.splat_sequences.opening import open_sequence
from decogs.formats.splats import SH_C0

SECONDS = 2.0
needs_fourdgs = pytest.mark.skipif(not fourdgs.has_fourdgs(), reason="needs the PyPI package fourdgs")


def gaussians(count: int, seed: int = 0, **values: Any) -> Any:
    """Gaussians that move, most of which fade; others never do."""
    from fourdgs import GaussianSet

    numbers = np.random.default_rng(seed)
    turns = numbers.normal(size=(count, 4))
    arrays = {
        "positions": numbers.normal(size=(count, 3)),
        "scales": np.exp(numbers.normal(-3, 0.2, (count, 3))),
        "rotations": turns / np.linalg.norm(turns, axis=1, keepdims=True),
        "colors": numbers.uniform(0.1, 0.9, (count, 4)),
        "motions": numbers.normal(0, 0.1, (count, 3)),
        "mu_t": numbers.uniform(0, SECONDS, count),
        "sigma_t": np.where(numbers.uniform(size=count) < 0.3, np.inf, 0.15),
        "win_lo": np.zeros(count),
        "win_hi": np.full(count, SECONDS),
    }
    arrays |= values
    return GaussianSet(**{name: np.asarray(each, np.float32) for name, each in arrays.items()})


def births(path: Path, *, index: bool = True, codec: int = 0, degree: int = 0, seconds: float = SECONDS) -> Any:
    """A file of chunks in which Gaussians move and fade, as the package reads it."""
    import fourdgs as package

    scene = gaussians(400)
    if degree:
        scene.sh = np.random.default_rng(1).integers(90, 160, (400, 3 * ((degree + 1) ** 2 - 1))).astype(np.uint8)
        scene.sh_degree = degree
    options = package.WriteOptions(min_chunk_gaussians=16, write_index=index, codec=codec)
    package.write(str(path), scene, seconds, options=options)
    return package.read(str(path))


def deltas(path: Path, *, frames: int = 5, fps: float = 25, times: list[float] | None = None) -> Any:
    """A file of states, in which Gaussians come, go and move by themselves, as the package reads it."""
    from fourdgs import keyframe_delta_file as files
    from fourdgs.keyframe_delta_writer import KeyframeDeltaOptions, Sample

    times = times or [number / fps for number in range(frames)]
    samples = []
    for number, time in enumerate(times):
        ids = np.arange(5 * number, 60 + 5 * number)
        lives = {"mu_t": np.full(60, time), "sigma_t": np.full(60, 0.05), "win_hi": np.full(60, 100.0)}
        samples.append(Sample(time, ids, gaussians(60, number % 2, **lives)))
    data = files.write_sequence(
        samples, times[-1] + 1 / fps, kd=KeyframeDeltaOptions(keyframe_every=3), profile="fine", codec=0, level=6
    )
    path.write_bytes(data)
    return files.decode_streamed(data)


def assert_shows(frame: SequenceFrame, centers: Any, opacity: Any, rgb: Any) -> None:
    splats = frame.splats
    assert len(splats) == len(centers)
    np.testing.assert_allclose(splats.means, centers, atol=1e-5)
    np.testing.assert_allclose(opacities(splats), np.clip(opacity, 1e-6, 1), atol=1e-5)
    np.testing.assert_allclose(splats.sh[:, 0] * SH_C0 + 0.5, rgb, atol=1e-5)


@needs_fourdgs
@pytest.mark.parametrize("degree", [0, 2])
def test_gaussians_that_move_and_fade_are_where_the_package_has_them(tmp_path: Path, degree: int) -> None:
    scene = births(tmp_path / "a.4dgs", degree=degree)
    sequence = open_sequence(tmp_path / "a.4dgs", Room(), 10)
    assert (sequence.fps, sequence.frame_count) == (10, 20)
    for number, frame in enumerate(sequence.frames()):
        state = scene.state_at(number / 10)
        # The package reads the file from its front on; ids number its Gaussians in the order of the index.
        order, theirs = np.argsort(frame.ids), np.argsort(state["indices"])
        np.testing.assert_array_equal(frame.ids[order], state["indices"][theirs])
        rows = state["indices"]
        found = SequenceFrame(type(frame.splats)(*(each[order] for each in vars(frame.splats).values())), frame.ids)
        assert_shows(found, state["centers"], state["opacity"], scene.gaussians.colors[rows, :3])
        np.testing.assert_allclose(np.exp(found.splats.log_scales), scene.gaussians.scales[rows], rtol=1e-5)
        np.testing.assert_allclose(found.splats.quaternions, np.roll(state["orientations"], 1, axis=1), atol=1e-6)
        assert found.splats.sh_degree == degree
        if degree:
            red = scene.gaussians.sh[rows, :8].astype(np.float64) * 8 / 255 - 4
            np.testing.assert_allclose(found.splats.sh[:, 1:, 0], red, atol=1e-5)


@needs_fourdgs
@pytest.mark.parametrize("fps", [None, 25, 60])
def test_states_are_taken_at_their_own_rate_or_at_another(tmp_path: Path, fps: float | None) -> None:
    from fourdgs import keyframe_delta_file as files

    decoded = deltas(tmp_path / "a.4dgs")
    sequence = open_sequence(tmp_path / "a.4dgs", Room(), fps)
    assert (sequence.fps, sequence.frame_count) == ((60, 12) if fps == 60 else (25, 5))
    for number, frame in enumerate(sequence.frames()):
        state = files.render_at(decoded, number / sequence.fps + 1e-9)
        np.testing.assert_array_equal(frame.ids, state["ids"])
        assert_shows(frame, state["centers"], state["opacity"], state["rgb"])


@needs_fourdgs
@pytest.mark.parametrize("codec", [0, 1])
def test_only_chunks_of_the_moment_are_in_memory(tmp_path: Path, codec: int) -> None:
    """The limit is on what a frame needs, not on the file."""
    births(tmp_path / "a.4dgs", codec=codec)
    most = max(len(frame.ids) for frame in open_sequence(tmp_path / "a.4dgs", Room(), 10).frames())
    assert most < 300, "of 400"
    with pytest.raises(UsageError, match=r"a\.4dgs: holds \d+ Gaussians, and at most 50 are read; remove some"):
        list(open_sequence(tmp_path / "a.4dgs", Room(50), 10).frames())
    with pytest.raises(UsageError, match=r"a\.4dgs: holds \d+ Gaussians, which take .*`max_memory`"):
        list(open_sequence(tmp_path / "a.4dgs", Room(memory=100_000), 10).frames())
    with pytest.raises(UsageError, match=r"a\.4dgs: has \d+ bytes; allow more memory than 1000"):
        open_sequence(tmp_path / "a.4dgs", Room(memory=1000), 10)


@needs_fourdgs
def test_what_says_no_rate_wants_one(tmp_path: Path) -> None:
    births(tmp_path / "births.4dgs")
    deltas(tmp_path / "one.4dgs", frames=1)
    deltas(tmp_path / "uneven.4dgs", times=[0, 0.1, 0.3, 0.4])
    for name in ("births", "one", "uneven"):
        path = tmp_path / f"{name}.4dgs"
        with pytest.raises(UsageError, match=f"{name}.4dgs: does not say how many frames a second has; give `fps`"):
            open_sequence(path, Room())
        assert next(open_sequence(path, Room(), 25).frames()).ids.size
    with pytest.raises(UsageError, match="too many frames; give a smaller `fps`"):
        open_sequence(tmp_path / "births.4dgs", Room(), 1e12)


@needs_fourdgs
def test_what_is_no_such_file_is_one_line(tmp_path: Path) -> None:
    births(tmp_path / "endless.4dgs", seconds=math.inf)
    births(tmp_path / "unindexed.4dgs", index=False)
    (tmp_path / "empty.4dgs").write_bytes(b"")
    (tmp_path / "other.4dgs").write_bytes(b"ply\nformat binary_little_endian 1.0\n")
    for name, says in (
        ("endless", "has no end; give a file of finite length"),
        ("unindexed", "has no index of its chunks; write it with one"),
        ("empty", "cannot be read by fourdgs: "),
        ("other", "cannot be read by fourdgs: not a 4dgs file"),
        ("none", "is no file; give a .4dgs or .splat4d"),
    ):
        with pytest.raises(UsageError, match=f"{name}.4dgs: {says}") as caught:
            list(open_sequence(tmp_path / f"{name}.4dgs", Room(), 25).frames())
        assert "\n" not in str(caught.value)


@needs_fourdgs
@pytest.mark.parametrize("make", [births, deltas])
def test_a_stream_that_would_unpack_to_more_than_is_said_is_refused(tmp_path: Path, make: Any) -> None:
    """The number of elements stands before each stream; a constant one of any length is a few bytes."""
    path = tmp_path / "a.4dgs"
    make(path)
    data = bytearray(path.read_bytes())
    changed = 0
    for at in range(len(data) - 17):
        # Position: attribute 0, three channels; mode and codec of the writer.
        identity, width, mode, codec, channels, elements, length = fourdgs._STREAM.unpack_from(data, at)
        named = (identity, codec, channels) == (0, 0, 3) and width in (1, 2, 4) and mode < 3
        if named and 0 < elements <= 400 and 0 < length < 10_000:
            data[at + 5 : at + 9] = (1 << 24).to_bytes(4, "little")
            changed += 1
    assert changed
    path.write_bytes(data)
    with pytest.raises(UsageError, match=r"a\.4dgs: is damaged: 16777216 x 3 values of \d+ Gaussians; write it again"):
        list(open_sequence(path, Room(), 25).frames())


@needs_fourdgs
@pytest.mark.parametrize("make", [births, deltas])
def test_damaged_files_are_one_line_or_are_read(tmp_path: Path, make: Any) -> None:
    make(tmp_path / "a.4dgs")
    data, path = (tmp_path / "a.4dgs").read_bytes(), tmp_path / "b.4dgs"
    numbers = random.Random(5)
    refused: list[str] = []
    for attempt in range(90):
        damaged = bytearray(data)
        if attempt % 3 == 0:
            del damaged[numbers.randrange(len(data)) :]
        for _ in range(numbers.randrange(1, 4)):
            if damaged:
                damaged[numbers.randrange(min(len(damaged), 900))] = numbers.randrange(256)
        path.write_bytes(damaged)
        try:
            # One whose length was damaged may have millions.
            list(itertools.islice(open_sequence(path, Room(10_000, 1 << 26), 25).frames(), 60))
        except UsageError as error:
            refused.append(str(error))
    assert len(refused) > 20
    assert all(text.startswith(f"{path}: ") and "\n" not in text for text in refused)


def test_without_the_package_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fourdgs.importlib.util, "find_spec", lambda name: None)
    (tmp_path / "a.4dgs").write_bytes(b"anything")
    with pytest.raises(UsageError, match=r"a\.4dgs: .*not installed: pip install fourdgs$"):
        open_sequence(tmp_path / "a.4dgs", Room())
