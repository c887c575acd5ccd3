"""What runs on a machine of the cluster: one part of a take, from its options to its bytes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from decogs.formats.errors import DecogsError, TryAgainError

from ..encoding import encode
from ..job.job import EncodeJob
from ..output.observer import EncodeObserver
from ..output.reports import FrameReport

OnDone = Callable[[int], None]
"""Called with the number of frames of the part that are done."""


@dataclass(frozen=True)
class Outcome:
    """A part's bytes, or what went wrong, in one line; ``again``: whether another try may go well."""

    data: bytes = b""
    problem: str = ""
    again: bool = False
    warnings: tuple[str, ...] = ()


class _Counting(EncodeObserver):
    def __init__(self, frames: range, on_done: OnDone) -> None:
        self._frames, self._on_done, self._done = frames, on_done, 0

    def frame(self, report: FrameReport) -> None:
        if report.frame in self._frames:
            self._done += 1
            self._on_done(self._done)


def run_part(job: EncodeJob, frames: range, keyframe: bytes | None, on_done: OnDone) -> Outcome:
    """Encodes ``frames`` of a job in a folder that goes away; ``keyframe``: the part that they start from."""
    warnings: list[str] = []
    with tempfile.TemporaryDirectory(prefix="decogs-") as folder:
        output, key = Path(folder, "part.dgs"), Path(folder, "key.dgs")
        job = replace(job, output=output, only=frames)
        if keyframe is not None:
            key.write_bytes(keyframe)
            job = replace(job, keyframe=key)
        try:
            encode(job, progress=_Counting(frames, on_done), on_warning=warnings.append)
        except TryAgainError as error:
            return Outcome(problem=str(error), again=True)
        except DecogsError as error:
            return Outcome(problem=str(error))
        except (OSError, MemoryError) as error:
            return Outcome(problem=str(error) or "out of memory", again=True)
        return Outcome(output.read_bytes(), warnings=tuple(warnings))
