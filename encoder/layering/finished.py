"""A finished stream edited under its own name: put in layers, held to a profile."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from decogs.decoder.editing import edit
from decogs.decoder.editing.editing import EditReport
from decogs.decoder.editing.operations.base import Operation
from decogs.formats.system.callbacks import OnProgress, OnWarning


def finish_stream(
    stream: str | os.PathLike[str],
    operations: Sequence[Operation],
    *,
    threads: int = 0,
    on_frame: OnProgress | None = None,
    on_warning: OnWarning | None = None,
) -> EditReport:
    """Replaces the stream by the edited one, once that is whole; raises as `edit` does, and the stream stays."""
    path = Path(stream)
    made = path.with_name(path.name + ".edited")
    try:
        report = edit(path, made, operations, threads=threads, on_frame=on_frame, on_warning=on_warning)
        os.replace(made, path)
    finally:
        made.unlink(missing_ok=True)
    return report
