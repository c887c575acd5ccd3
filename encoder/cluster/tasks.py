"""What runs on a machine of the cluster: one part of a take, from its options to its bytes."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from decogs.formats.errors import DecogsError, TryAgainError

from ..encoding import encode
from ..output.observer import EncodeObserver
from ..output.reports import FrameReport

Tell = Callable[[int], None]
"""Called with the number of frames of the part that are done."""


@dataclass(frozen=True)
class Outcome:
    """A part's bytes, or what went wrong, in one line; ``again``: whether another try may go well."""

    data: bytes = b""
    problem: str = ""
    again: bool = False
    warnings: tuple[str, ...] = ()


class _Counting(EncodeObserver):
    def __init__(self, frames: range, tell: Tell) -> None:
        self._frames, self._tell, self._done = frames, tell, 0

    def frame(self, report: FrameReport) -> None:
        if report.frame in self._frames:
            self._done += 1
            self._tell(self._done)


def run_part(rig: str, frames: range, keyframe: bytes | None, options: Mapping[str, Any], tell: Tell) -> Outcome:
    """Encodes one part in a folder that goes away; ``keyframe``: the part that it starts from."""
    warnings: list[str] = []
    with tempfile.TemporaryDirectory(prefix="decogs-") as folder:
        given = dict(options)
        if keyframe is not None:
            given["keyframe"] = Path(folder, "key.dgs")
            given["keyframe"].write_bytes(keyframe)
        output = Path(folder, "part.dgs")
        try:
            encode(rig, output, only=frames, progress=_Counting(frames, tell), on_warning=warnings.append, **given)
        except TryAgainError as error:
            return Outcome(problem=str(error), again=True)
        except DecogsError as error:
            return Outcome(problem=str(error))
        except (OSError, MemoryError) as error:
            return Outcome(problem=str(error) or "out of memory", again=True)
        return Outcome(output.read_bytes(), warnings=tuple(warnings))
