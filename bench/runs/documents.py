"""A run as a JSON file: written a line for each field and each frame, read again, and told apart by a digest."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

R = TypeVar("R")


def digest(facts: Mapping[str, Any]) -> str:
    """Ten hexadecimal digits that tell runs of different facts apart."""
    return hashlib.sha256(json.dumps(facts, sort_keys=True).encode()).hexdigest()[:10]


def document(run: DataclassInstance) -> str:
    """A run, which has ``frames``, as JSON, a line for each field and each frame."""
    values = asdict(run)
    frames = ",\n  ".join(json.dumps(frame) for frame in values.pop("frames"))
    lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in values.items()]
    return "{\n " + ",\n ".join([*lines, f'"frames": [\n  {frames}\n ]']) + "\n}\n"


def read_document(path: Path, kind: type[R], frame_kind: type[DataclassInstance]) -> R | None:
    """What ``document`` wrote, with its ``frames``; None when the file is not there, damaged, or of another format."""
    try:
        values = json.loads(path.read_text("utf-8"))
        values["frames"] = [frame_kind(**frame) for frame in values["frames"]]
        return kind(**values)
    except (OSError, ValueError, TypeError, KeyError):
        return None
