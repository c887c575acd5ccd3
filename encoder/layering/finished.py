"""A finished stream put in layers, under its own name."""

from __future__ import annotations

import os
from pathlib import Path

from decogs.decoder.editing import edit
from decogs.decoder.editing.editing import EditReport
from decogs.decoder.editing.operations.layer import MakeLayers
from decogs.formats.system.callbacks import OnProgress, OnWarning


def put_in_layers(
    stream: str | os.PathLike[str], *, on_frame: OnProgress | None = None, on_warning: OnWarning | None = None
) -> EditReport:
    """Replaces the stream by the same in layers, once that is whole; raises as `edit` does, and the stream stays."""
    path = Path(stream)
    made = path.with_name(path.name + ".layers")
    try:
        report = edit(path, made, [MakeLayers()], on_frame=on_frame, on_warning=on_warning)
        os.replace(made, path)
    finally:
        made.unlink(missing_ok=True)
    return report
