"""Frame methods by name: ours and those of installed packages (docs/extending.md)."""

from __future__ import annotations

from decogs.formats.errors import UsageError

from ..registry import Registry
from ..settings.encode import EncodeSettings
from .delta import DeltaTrainer
from .method import FrameMethod
from .threedgstream import BaselineTrainer

FRAME_METHODS: Registry[FrameMethod] = Registry(
    "method",
    "decogs.frame_methods",
    {"decogs": FrameMethod(DeltaTrainer), "3dgstream": FrameMethod(BaselineTrainer, dense=True)},
)


def require_sparse(settings: EncodeSettings, asked: str, why: str) -> None:
    """Raises UsageError where the settings' method is dense, which what is ``asked`` for excludes: ``why``."""
    if FRAME_METHODS.get(settings.method).dense:
        raise UsageError(f"{asked}: `method` {settings.method} {why}; drop one of the two")
