"""An encode in one call, as most tests want it: the fields of an `EncodeJob`, and who follows it."""

from __future__ import annotations

from typing import Any

from decogs.encoder import EncodeJob, EncodeReport, encode


def encode_rig(*given: Any, progress: Any = None, on_warning: Any = None, **fields: Any) -> EncodeReport:
    """``encode`` of the job with these fields."""
    return encode(EncodeJob(*given, **fields), progress=progress, on_warning=on_warning)
