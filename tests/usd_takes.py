"""Takes for the tests of USD exports: Gaussians that move, are born, die, rest and are shuffled."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
from numpy.typing import NDArray

from decogs.decoder.exporting.usd import ExportFrame
from decogs.formats.splats import Splats, join_splats, take_splats


def some_splats(rng: np.random.Generator, count: int, sh_degree: int = 1) -> Splats:
    arrays = (
        rng.normal(size=(count, 3)),
        rng.normal(-3, 0.5, (count, 3)),
        rng.normal(size=(count, 4)) * 3,
        rng.normal(0, 2, count),
        rng.normal(0, 1, (count, (sh_degree + 1) ** 2, 3)),
    )
    return Splats(*(array.astype(np.float32) for array in arrays))


def moved(splats: Splats, rows: NDArray[np.intp], rng: np.random.Generator) -> Splats:
    fresh = some_splats(rng, len(rows))
    values = {name: value.copy() for name, value in vars(splats).items()}
    for name, value in values.items():
        value[rows] = getattr(fresh, name)
    return Splats(**values)


def living_scene() -> list[ExportFrame]:
    """40 Gaussians over 7 frames from index 3: 8 move, one dies, three are born, one of these moves and dies, order is
    shuffled in every frame, and one frame repeats the one before it."""
    rng = np.random.default_rng(5)
    ids, splats = np.arange(40, dtype=np.int64) * 3, some_splats(rng, 40)
    frames = [(ids, splats)]
    splats = moved(splats, np.arange(8), rng)
    frames.append((ids, splats))
    frames.append((ids, splats))
    keep = np.arange(40) != 20
    ids, splats = np.append(ids[keep], [200, 201, 202]), join_splats(take_splats(splats, keep), some_splats(rng, 3))
    frames.append((ids, splats))
    splats = moved(splats, np.array([2, 39]), rng)
    frames.append((ids, splats))
    keep = ids != 200
    ids, splats = ids[keep], take_splats(splats, keep)
    frames.append((ids, splats))
    frames.append((ids, moved(splats, np.array([2]), rng)))
    shuffled = []
    for index, (frame_ids, frame_splats) in enumerate(frames, start=3):
        order = rng.permutation(len(frame_ids))
        shuffled.append(ExportFrame(index, frame_ids[order], take_splats(frame_splats, order)))
    return shuffled


def replay(frames: list[ExportFrame]) -> Callable[[], Iterator[ExportFrame]]:
    return lambda: iter(frames)


def a_long_take(frames: int, *, everywhere: bool) -> list[ExportFrame]:
    """2000 Gaussians, of which 1 % die in a frame and as many are born.

    In one place: always the same 35 % move, and who is born there, half of them in a frame. Everywhere: motion of 40
    comes past all, and who has once moved rests again.
    """
    rng = np.random.default_rng(1)
    count, fresh = 2000, 20
    ids, splats, taken = np.arange(count, dtype=np.int64), some_splats(rng, count), []
    for index in range(frames):
        taken.append(ExportFrame(index, ids, splats))
        places = np.arange(count) if everywhere else np.flatnonzero((ids < 0.35 * count) | (ids >= count))
        keep = ~np.isin(np.arange(count), rng.choice(places, fresh, replace=False))
        ids = np.append(ids[keep], count + fresh * index + np.arange(fresh))
        splats = join_splats(take_splats(splats, keep), some_splats(rng, fresh))
        places = np.flatnonzero((ids < 0.35 * count) | (ids >= count))
        wave = (np.arange(40) + 30 * index) % count
        splats = moved(splats, wave if everywhere else rng.choice(places, len(places) // 2, replace=False), rng)
    return taken
