"""The rival codec .splat4d, through the command that the PyPI package ``splats4d`` brings (0.1.0 was tried)."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from decogs.codec.scene.state import Rows
from decogs.formats.splat_files import Room
from decogs.formats.splat_files.splat import records
from decogs.formats.splat_sequences.splat4d import Splat4dFile, run_splat4d, splat4d_command
from decogs.formats.splats import Splats

from .sequences import NO_DIRECTIONS, Frames, Rival, Sizes

_STREAM, _FIRST = "scene.splat4d", "first.splat4d"


@dataclass(frozen=True)
class Splat4d:
    """All frames in one file. Bounds of the error: millimetres (a world unit counts as a metre), 8-bit levels of colour
    and opacity, 1/128 of a quaternion's component, percent of the size.

    Its input has the same Gaussians in every frame: one that is not there yet, or no more, stays where it first, or
    last, was, with opacity 0.
    """

    position_mm: float
    colour_levels: int
    rotation_steps: int
    scale_percent: float

    def missing(self) -> str | None:
        return None if splat4d_command() else "not installed"

    def write(self, frames: Frames, folder: Path) -> Sizes:
        """The first frame's bytes are those of a file of that frame alone: the whole one does not separate them.

        It shows once the first group of (30) frames is there: they are one compressed block.
        """
        series, alone = folder / "series", folder / "alone"
        series.mkdir()
        alone.mkdir()
        for number, table in enumerate(of_one_length(frames)):
            (series / f"frame_{number:06d}.splat").write_bytes(table.tobytes())
        shutil.copy(series / "frame_000000.splat", alone)
        first, total = self._encode(alone, folder / _FIRST), self._encode(series, folder / _STREAM)
        facts, _ = json.JSONDecoder().raw_decode(run_splat4d("info", str(folder / _STREAM)))
        group = facts["gops"][0]
        shutil.rmtree(series)
        return Sizes(first, total, group["offset"] + group["len"])

    def read(self, folder: Path) -> Iterator[Splats]:
        return (frame.splats for frame in Splat4dFile(folder / _STREAM, Room()).frames())

    def _encode(self, frames: Path, output: Path) -> int:
        bounds = [
            f"--pos-mm={self.position_mm:g}",
            f"--color-levels={self.colour_levels}",
            f"--rot-steps={self.rotation_steps}",
            f"--scale-pct={self.scale_percent:g}",
            "--zstd-level=19",
        ]
        run_splat4d("encode", "-i", str(frames), "-o", str(output), *bounds)
        return output.stat().st_size


def of_one_length(frames: Frames) -> Iterator[NDArray[np.void]]:
    """Every frame as records of all Gaussians that are ever there, in the order of their ids."""
    ids, table = _first_seen(frames)
    table["opacity"] = 0
    for frame in frames():
        rows = np.searchsorted(ids, frame.ids)
        table["opacity"] = 0
        table[rows] = records(frame.splats)
        yield table


def _first_seen(frames: Frames) -> tuple[Rows, NDArray[np.void]]:
    """Each Gaussian's id, ascending, and its record in the first frame that has it."""
    ids: Rows = np.zeros(0, np.int64)
    tables = []
    for frame in frames():
        # Ids only grow, and no later Gaussian reuses one.
        new = frame.ids > (ids[-1] if len(ids) else -1)
        ids = np.concatenate([ids, frame.ids[new]])
        tables.append(records(frame.splats)[new])
    return ids, np.concatenate(tables)


_FIXED_COUNT = (
    f"{NO_DIRECTIONS} Takes one fixed set of Gaussians: those that are not there yet, or no more, are kept with "
    "opacity 0. A world unit counts as a metre. It holds what never changes once for the whole clip and cannot be "
    "written before its end is known; its first frame is counted as the file of that frame alone, but shows only once "
    "its group of 30 frames is there."
)


def _splat4d(
    position_mm: float, colour_levels: int, rotation_steps: int, scale_percent: float, note: str = ""
) -> Rival:
    return Rival(
        f"splats4d-{position_mm:g}-{colour_levels}-{rotation_steps}-{scale_percent:g}",
        "splats4d",
        f"splats4d, ±{position_mm:g} mm, ±{colour_levels} levels, ±{rotation_steps}/128, ±{scale_percent:g} %{note}",
        Splat4d(position_mm, colour_levels, rotation_steps, scale_percent),
        _FIXED_COUNT,
    )


RIVALS = (
    _splat4d(0.5, 1, 0, 0.5),
    _splat4d(2, 4, 0, 2, " (its default)"),
    _splat4d(4, 8, 2, 5),
    _splat4d(10, 16, 4, 10),
)
