"""Figures as JSON lines, written as things happen: what ``log`` and ``convergence_log`` name."""

from __future__ import annotations

import json
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import open_in_place

S = TypeVar("S", bound="JsonLines")


class JsonLines:
    """One JSON object per line in ``path``, new or, by ``append``, continued.

    ``parameter``: what asked for it. Every method raises UsageError, which names both, when it cannot be written.
    """

    def __init__(self, path: Path, parameter: str, *, append: bool = False) -> None:
        self._description = f"`{parameter}` {path}"
        try:
            self._file = open_in_place(path, append=append)
        except OSError as error:
            raise UsageError(
                f"{self._description}: {error.strerror}; name a file in a folder that can be written"
            ) from error
        except UsageError as error:
            raise UsageError(f"`{parameter}` {error}") from None

    def __enter__(self: S) -> S:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            if kind is None:
                self.flush()
        finally:
            # What it does not take any more was reported before.
            with suppress(OSError):
                self._file.close()

    def write(self, record: dict[str, Any]) -> None:
        """Writes one object as a line; others see it after the next ``flush``."""
        try:
            self._file.write((json.dumps(record) + "\n").encode())
        except OSError as error:
            self._refuse(error)

    def flush(self) -> None:
        """Lets others read what was written."""
        try:
            self._file.flush()
        except OSError as error:
            self._refuse(error)

    def _refuse(self, error: OSError) -> None:
        raise UsageError(f"{self._description}: {error.strerror}; free space, or name a file elsewhere") from error
