"""An encode's figures as JSON lines."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from .json_lines import JsonLines
from .observer import EncodeObserver
from .reports import FrameReport


class EncodeLog(JsonLines, EncodeObserver):
    """Writes one JSON object per line to ``path``, as things happen; a context manager.

    "look": the detected effects, if the rig was analysed; "start"; one "frame" per frame: the fields of FrameReport,
    and ``elapsed`` seconds; "end". ``append``: after what is there. Raises UsageError when it cannot be written.
    """

    def __init__(self, path: Path, *, append: bool = False) -> None:
        super().__init__(path, "log", append=append)
        self._began = time.perf_counter()

    def looked(self, detected: Mapping[str, Sequence[str]]) -> None:
        self._write({"event": "look", "detected": {effect: list(names) for effect, names in detected.items()}})

    def started(self, facts: Mapping[str, Any]) -> None:
        self._write({"event": "start", **facts})

    def frame(self, report: FrameReport) -> None:
        self._write({"event": "frame", "elapsed": self._elapsed(), **asdict(report)})

    def finished(self, facts: Mapping[str, Any]) -> None:
        self._write({"event": "end", "elapsed": self._elapsed(), **facts})

    def _elapsed(self) -> float:
        return round(time.perf_counter() - self._began, 3)

    def _write(self, record: dict[str, Any]) -> None:
        self.write(record)
        self.flush()
