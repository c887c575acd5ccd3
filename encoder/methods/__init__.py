"""Frame methods by name: ours and those of installed packages (docs/extending.md).

What they share is in ``training/``, as functions; none inherits from another.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from decogs.formats.errors import UsageError

from ..registry import Fault, GuardedObject, Registry, described, guarded
from ..settings.encode import EncodeSettings
from ..training.densification import are_splats
from ..training.method import FrameInput, FrameMethod, TrainedFrame
from ..training.schedule import Pace
from .decogs import DecogsTrainer
from .paper import PaperTrainer


def _wrong_frame(trained: object, frame: FrameInput) -> str:
    if not isinstance(trained, TrainedFrame):
        return f"{described(trained)}, no TrainedFrame"
    rows: list[int] = []
    for name in ("kept", "removed"):
        each = getattr(trained, name)
        if not (isinstance(each, np.ndarray) and each.ndim == 1 and np.issubdtype(each.dtype, np.integer)):
            return f"`{name}` as {described(each)}, not as row numbers"
        if len(each) and not (each[0] >= 0 and each[-1] < len(frame.scene) and (np.diff(each) > 0).all()):
            return f"`{name}` with rows that are not ascending from 0 to {len(frame.scene) - 1}"
        rows += each.tolist()
    if len(set(rows)) < len(rows):
        return "rows as both `kept` and `removed`"
    if not are_splats(trained.values, frame.scene, len(trained.kept)):
        return "`values` that are not finite Splats with a row for each one kept"
    if trained.sensitivity is not None and not are_splats(trained.sensitivity, frame.scene, len(trained.kept)):
        return "`sensitivity` that is not finite Splats with a row for each one kept"
    if not isinstance(trained.pace, Pace | None):
        return f"`pace` as {described(trained.pace)}"
    if not are_splats(trained.added, frame.scene):
        return "`added` that are not finite Splats of the scene's SH degree"
    return ""


def _guarded_method(method: Any, fault: Fault) -> FrameMethod:
    if not isinstance(method, FrameMethod):
        raise fault(f"is no FrameMethod but {described(method)}")

    def wrong_trainer(trainer: object, *given: object) -> str:
        good = callable(getattr(trainer, "train", None))
        return "" if good else f"{described(trainer)}, which has no function `train`"

    new = guarded(wrong_trainer)(method.trainer, fault)
    return replace(method, trainer=lambda context: GuardedObject(new(context), {"train": _wrong_frame}, fault))


FRAME_METHODS: Registry[FrameMethod] = Registry(
    "method",
    "decogs.frame_methods",
    {"decogs": FrameMethod(DecogsTrainer), "paper": FrameMethod(PaperTrainer)},
    _guarded_method,
)


def method_of(settings: EncodeSettings) -> FrameMethod:
    """The settings' method; with parts of it left out, the one that the bench offers for that.

    Raises UsageError for a name that is not installed, and for a method that has no such parts.
    """
    if not settings.frame.ablated:
        return FRAME_METHODS.get(settings.method)
    name = f"{settings.method}-ablated"
    if name not in FRAME_METHODS.names():
        part = settings.frame.ablated[0]
        raise UsageError(f"`ablate` {part}: `method` {settings.method} has no such part; drop one of the two")
    return FRAME_METHODS.get(name)


def require_sparse(settings: EncodeSettings, asked: str, why: str) -> None:
    """Raises UsageError where the settings' method is dense, which what is ``asked`` for excludes: ``why``."""
    if FRAME_METHODS.get(settings.method).dense:
        raise UsageError(f"{asked}: `method` {settings.method} {why}; drop one of the two")
