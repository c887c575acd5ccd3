"""Files of a report: numbers that people read, too, written whole or not at all."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any


def rounded(value: Any) -> Any:
    """Floats to seven significant digits, in lists and mappings, too."""
    if isinstance(value, dict):
        return {name: rounded(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [rounded(entry) for entry in value]
    return float(f"{value:.7g}") if isinstance(value, float) else value


def write_whole(path: Path, data: bytes) -> None:
    """Writes the file so that an interruption leaves the one that was there, or none."""
    growing = path.with_name(path.name + ".part")
    growing.write_bytes(data)
    os.replace(growing, path)
