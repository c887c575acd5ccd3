"""A thousand frames of a small moving scene: what a long stream must keep, and what must not grow."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import decogs.encoder.coding.scene as scene
import decogs.encoder.frame.encode_frame as encode_frame
import decogs.encoder.frame.plan as plan
from decogs.codec.scene.digest import digest
from decogs.codec.scene.state import ARRAYS, State
from decogs.decoder.output.pictures import to_8bit
from decogs.decoder.rasterise import render
from decogs.decoder.reading.stream import open_stream
from decogs.encoder.frame.context import Context
from decogs.encoder.settings.encode import EncodeSettings
from decogs.encoder.stream.options import RunOptions
from decogs.encoder.stream.run import encode_stream
from decogs.encoder.training.method import MAX_GROWTH
from decogs.formats.cameras import scale_camera
from decogs.formats.rigs import open_rig
from decogs.formats.splats import join_splats
from decogs.rig.pictures.ingest import Ingest

FRAMES, PERIOD = 1000, 40


def resident_bytes() -> int:
    """What the process holds in memory, as the kernel counts it (Linux: /proc/self/statm, second field, in pages)."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@dataclass
class Observed:
    """What the encoder had after every frame, in a few bytes a frame; ``moved``: ids that ever were in S_t."""

    digests: list[int] = field(default_factory=list)
    memory: list[int] = field(default_factory=list)
    population: list[int] = field(default_factory=list)
    psnr: list[float] = field(default_factory=list)
    training_psnr: list[float] = field(default_factory=list)
    moved: set[int] = field(default_factory=set)
    first: State | None = None
    last: State | None = None


@pytest.fixture(scope="module")
def long_rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wall, and a square before it that goes round and round in PERIOD frames; sensor noise of 1.2 levels."""
    folder, random = tmp_path_factory.mktemp("long") / "rig", np.random.default_rng(5)
    views = [scale_camera(tiny_rig.camera(index), 0.5) for index in range(5)]
    wall = tiny_rig.patch((0, 0, 0.5), 28, 17, 0.22, 1)
    for view in views:
        (folder / view.name).mkdir(parents=True)
    for frame in range(FRAMES):
        turn = 2 * np.pi * frame / PERIOD
        square = tiny_rig.patch((0.25 * np.cos(turn), 0.2 * np.sin(turn), -0.2), 4, 4, 0.1, 2)
        for view in views:
            clean = to_8bit(render(join_splats(wall, square), view, threads=1).image)
            noisy = np.clip(np.rint(clean + random.normal(0, 1.2, clean.shape)), 0, 255).astype(np.uint8)
            tiny_rig.write_png(folder / view.name / f"{frame:04d}.png", noisy)
    (folder / "rig.json").write_text(json.dumps(tiny_rig.values(views)))
    return folder


def quick(settings: EncodeSettings) -> EncodeSettings:
    return replace(settings, frame=replace(settings.frame, joint_iterations=24))


@pytest.fixture(scope="module")
def long_encode(long_rig: Path, settings: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Observed]:
    seen, path = Observed(), tmp_path_factory.mktemp("encoded") / "long.dgs"
    reconstruct, select = scene.reconstruct, plan.select

    def observed_reconstruct(*arguments: Any, **options: Any) -> State:
        seen.last = reconstruct(*arguments, **options)
        seen.first = seen.first or seen.last
        seen.digests.append(digest(seen.last))
        seen.population.append(len(seen.last))
        return seen.last

    def observed_select(*arguments: Any) -> np.ndarray:
        chosen = select(*arguments)
        assert seen.last is not None
        seen.moved.update(seen.last.ids[chosen].tolist())
        return chosen

    def observed_frame(report: Any) -> None:
        seen.memory.append(resident_bytes())
        seen.psnr.append(report.held_out_psnr)
        seen.training_psnr.append(report.training_psnr)

    with pytest.MonkeyPatch.context() as patched:
        for module in (scene, encode_frame):  # later packets, the first one
            patched.setattr(module, "reconstruct", observed_reconstruct)
        patched.setattr(plan, "select", observed_select)
        ingest = Ingest(open_rig(long_rig), holdout=["cam02"])
        context = Context.of(ingest, quick(settings), seed=0, threads=1)
        encode_stream(context, path, range(FRAMES), RunOptions(on_frame=observed_frame))
    return path, seen


def decoded(path: Path) -> Iterator[Any]:
    with open_stream(path) as stream:
        yield from stream.frames()


def growth(memory: list[int]) -> float:
    """Bytes a frame, by medians of the second hundred frames and of the last."""
    return float(np.median(memory[-100:]) - np.median(memory[100:200])) / (len(memory) - 200)


@pytest.mark.soak
def test_the_decoder_is_the_encoder_at_every_frame_and_its_memory_is_flat(long_encode: tuple[Path, Observed]) -> None:
    path, seen = long_encode
    memory = []
    for frame, expected in zip(decoded(path), seen.digests, strict=True):
        assert digest(frame.state) == expected, frame.index
        memory.append(resident_bytes())
    print(f"decoder: {growth(memory):.0f} bytes a frame")
    assert growth(memory) < 1000


@pytest.mark.soak
def test_the_encoders_memory_is_flat(long_encode: tuple[Path, Observed]) -> None:
    """What grows is what is kept of every frame on purpose, here and in the encoder: its report and its place in the
    index. Measured: 4 257 bytes a frame, 4 MB in all of 98; a picture is 9 kB, a scene 240 kB.
    """
    _, seen = long_encode
    populations = [seen.population[i] for i in (0, 100, 500, 999)]
    print(f"encoder: {growth(seen.memory):.0f} bytes a frame of {seen.memory[-1] / 2**20:.0f} MiB; N {populations}")
    assert growth(seen.memory) < 6000
    assert max(seen.population) <= round(MAX_GROWTH * seen.population[0]) + 50, "and neither does the scene"


@pytest.mark.soak
def test_static_gaussians_are_bit_identical_from_first_to_last(long_encode: tuple[Path, Observed]) -> None:
    _, seen = long_encode
    first, last = seen.first, seen.last
    assert first is not None
    assert last is not None
    static = [id_ for id_ in first.ids.tolist() if id_ not in seen.moved]
    print(f"{len(static)} of {len(first)} never selected")
    assert len(static) > len(first) / 4
    before, after = (np.searchsorted(state.ids, static) for state in (first, last))
    np.testing.assert_array_equal(last.ids[after], static)
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(last, name)[after], getattr(first, name)[before])


MAX_FALL = 0.3
"""dB in 800 frames, mean of three seeds. These fall by .17 to .26 in the trained views, .21 in the mean, by -.04 to
.10 in the view left out, .05 in the mean. With earlier settings, .20 and .24 in the mean of five seeds, one seed
deviated by .09, three by .05. Without the limit on stretch (`training/schedule.py`) 40 steps a frame lose .97 and 2.2
dB."""


def fall(psnr: list[float]) -> float:
    """What a line through the means of the square's rounds falls, dB, from its sixth round to its last.

    The first five rounds are left out: until then the scene grows.
    """
    rounds = np.array(psnr[5 * PERIOD :]).reshape(-1, PERIOD).mean(axis=1)
    slope, level = np.polyfit(np.arange(len(rounds)), rounds, 1)
    print(f"{level:.2f} dB, {slope * len(rounds):+.3f} dB over {len(rounds)} rounds")
    return -float(slope) * len(rounds)


@pytest.mark.soak
def test_a_thousand_frames_lose_no_quality(
    long_rig: Path, long_encode: tuple[Path, Observed], settings: Any, tmp_path: Path
) -> None:
    _, seen = long_encode
    trained, left_out = [fall(seen.training_psnr)], [fall(seen.psnr)]
    for seed in (1, 2):
        reports: list[Any] = []
        ingest = Ingest(open_rig(long_rig), holdout=["cam02"])
        context = Context.of(ingest, quick(settings), seed=seed, threads=1)
        encode_stream(context, tmp_path / "again.dgs", range(FRAMES), RunOptions(on_frame=reports.append))
        trained.append(fall([report.training_psnr for report in reports]))
        left_out.append(fall([report.held_out_psnr for report in reports]))
        (tmp_path / "again.dgs").unlink()
    assert np.mean(trained) < MAX_FALL
    assert np.mean(left_out) < MAX_FALL
