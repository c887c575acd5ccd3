"""Numbers in the files of a report: people read them, too."""

from __future__ import annotations

from typing import Any


def rounded(value: Any) -> Any:
    """Floats to seven significant digits, in lists and mappings, too."""
    if isinstance(value, dict):
        return {name: rounded(entry) for name, entry in value.items()}
    if isinstance(value, list):
        return [rounded(entry) for entry in value]
    return float(f"{value:.7g}") if isinstance(value, float) else value
