"""Reads .splat4d through the command ``splat4d`` that the PyPI package ``splats4d`` brings (0.1.0 was tried)."""

from __future__ import annotations

import json
import math
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import UsageError
from ..splat_files import Room
from ..splat_files.reading import finite_splats
from ..splat_files.splat import RECORD, Splat
from ..splats import take_splats
from . import SequenceFrame

_WAIT_SECONDS = 600
"""For one frame: the command unpacks the group of frames that it is in."""


class Splat4dFile:
    """A .splat4d: the same Gaussians in every frame, of which those with opacity 0 are not there. Raises UsageError."""

    up: Literal["Y", "-Y"] = Splat.up

    def __init__(self, path: Path, room: Room, fps: float | None = None) -> None:
        self._path, self._room = path, room
        facts = self._facts()
        self.fps: float = fps or facts["fps"]
        self.frame_count: int = facts["t"]
        self._count: int = facts["n"]
        try:
            room.check(self._count, 1, held=path.stat().st_size + RECORD.itemsize * self._count)
        except UsageError as error:
            raise UsageError(f"{path}: {error}") from None

    def frames(self) -> Iterator[SequenceFrame]:
        with tempfile.TemporaryDirectory(prefix="decogs-") as folder:
            decoded = Path(folder) / "frame.splat"
            for index in range(self.frame_count):
                self._run("decode", str(self._path.absolute()), "--frame", str(index), "-o", str(decoded))
                yield self._frame(decoded, index)

    def _frame(self, decoded: Path, index: int) -> SequenceFrame:
        size = decoded.stat().st_size
        if size != RECORD.itemsize * self._count:
            raise UsageError(f"{self._path}: frame {index} has {size} bytes, which are not {self._count} Gaussians")
        data = decoded.read_bytes()
        rows = np.flatnonzero(np.frombuffer(data, RECORD)["opacity"])
        found, kept, left_out = finite_splats(take_splats(Splat().decode(data), rows))
        return SequenceFrame(found, rows[kept], left_out)

    def _facts(self) -> dict[str, Any]:
        """What its header says: ``n`` Gaussians, ``t`` frames, ``fps``."""
        try:
            facts, _ = json.JSONDecoder().raw_decode(self._run("info", str(self._path.absolute())))
            count, frames, fps = facts["n"], facts["t"], float(facts["fps"])
            if not (isinstance(count, int) and count > 0 and isinstance(frames, int) and frames > 0):
                raise ValueError
            if not (math.isfinite(fps) and fps > 0):
                raise ValueError
        except (ValueError, LookupError, TypeError, RecursionError):
            raise UsageError(f"{self._path}: does not say what it holds; write it again") from None
        return {"n": count, "t": frames, "fps": fps}

    def _run(self, *arguments: str) -> str:
        try:
            return run_splat4d(*arguments, memory=self._room.memory)
        except UsageError as error:
            raise UsageError(f"{self._path}: {error}") from None


def splat4d_command() -> str | None:
    """Where the command is; None where it is not installed."""
    return shutil.which("splat4d") or shutil.which("splat4d", path=sysconfig.get_path("scripts"))


def run_splat4d(*arguments: str, memory: int | None = None) -> str:
    """What the command says. ``memory``: bytes that it may take (Linux). Raises UsageError with the reason it gives."""
    command = splat4d_command()
    if command is None:
        raise UsageError("this needs the package splats4d, which is not installed: pip install splats4d")
    try:
        done = subprocess.run(
            [command, *arguments],
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
            timeout=_WAIT_SECONDS,
            preexec_fn=_limit(memory),
        )
    except subprocess.TimeoutExpired:
        raise UsageError(f"splat4d {arguments[0]}: took more than {_WAIT_SECONDS} s") from None
    if done.returncode:
        raise UsageError(f"splat4d {arguments[0]}: {_reason(done.stderr)}")
    return done.stdout


def _limit(memory: int | None) -> Callable[[], None] | None:
    """Sets the limit in the command's own process: its counts are a stranger's, and it believes them."""
    if memory is None or sys.platform != "linux":
        return None
    import resource

    return lambda: resource.setrlimit(resource.RLIMIT_AS, (memory, memory))


def _reason(stderr: str) -> str:
    """Its first line; of a panic the second, as the first says where in the program."""
    lines = [line.strip() for line in stderr.splitlines() if line.strip()]
    if len(lines) > 1 and "panicked at" in lines[0]:
        return lines[1]
    return lines[0] if lines else "no reason given"
