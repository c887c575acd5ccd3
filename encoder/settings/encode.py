"""Everything that an encode can be set to, as plain data."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from typing import Any

from decogs.codec.entropy import DEFAULT_LEVEL

from .compensation import CorrectionSettings
from .effects import FRAME_EFFECTS, PRESET_EFFECTS
from .frame import FrameSettings
from .keyframe import KeyframeSettings
from .threedgstream import BaselineSettings

_UNUSED = {"decogs": "baseline", "3dgstream": "frame"}
"""Settings that a method does not look at; a method of another package has no use for the baseline's either."""

_USUAL = (
    ("", "rate_control", "content"),
    ("keyframe", "optimiser", "adam"),
    ("keyframe", "densification", "clone-split"),
    ("frame", "optimiser", "adam"),
    ("frame", "densification", "clone-split"),
)
"""Extension points that a header names only where a package's are taken."""


@dataclass(frozen=True)
class EncodeSettings:
    """What an encode does. ``lattice_scale``: of the lattice's steps, in units of the
    default ones; higher is smaller and less exact. ``zstd_level``: higher is slower, smaller.

    ``method``: later frames follow ``frame`` ("decogs") or ``baseline`` ("3dgstream", slower). ``segment``: frames from
    one keyframe to the next, 0 for a single keyframe; fewer is larger, and quicker to seek. Only how a frame is told
    depends on it, not what is in it. ``frame_budget``: bytes that frames after the first may take on average (`rate`);
    lower is less exact, None leaves it to ``frame.economy``.
    ``time_budget``: seconds that frames after the first may take on average (`time_budget`); higher is slower, None is
    the whole schedule. ``target_psnr``: dB at which a frame's training ends (`effort.TargetWatch`); higher is slower,
    None is the whole schedule. ``effects``: those that are built (`effects`); fewer is faster and smaller.
    ``ask_frames``: of these, a frame builds those that its own pictures call for, and the keyframe says how far colours
    depend on the view; that is faster. ``corrections``: cameras whose own faults are taken out of their pictures.
    ``rate_control``: a name in RATE_CONTROLS, which keeps the frame budget.
    """

    keyframe: KeyframeSettings = field(default_factory=KeyframeSettings)
    frame: FrameSettings = field(default_factory=FrameSettings)
    lattice_scale: float = 1.0
    zstd_level: int = DEFAULT_LEVEL
    method: str = "decogs"
    baseline: BaselineSettings = field(default_factory=BaselineSettings)
    segment: int = 0
    frame_budget: float | None = None
    time_budget: float | None = None
    target_psnr: float | None = None
    effects: tuple[str, ...] = PRESET_EFFECTS
    ask_frames: bool = False
    corrections: CorrectionSettings = field(default_factory=CorrectionSettings)
    rate_control: str = "content"

    @property
    def frame_effects(self) -> tuple[str, ...]:
        """Those of the enabled effects that a frame may call for."""
        return tuple(name for name in FRAME_EFFECTS if name in self.effects)

    def as_document(self) -> dict[str, Any]:
        """The settings as plain JSON values, for the stream's header and the log; without the other method's.

        No budget, target, correction or choice of effects is no entry: a stream begun before there were any can still
        be gone on with.
        """
        document: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        del document[_UNUSED.get(self.method, "baseline")]
        for name in ("frame_budget", "time_budget", "target_psnr"):
            if document[name] is None:
                del document[name]
        if (self.effects, self.ask_frames) == (PRESET_EFFECTS, False):
            del document["effects"], document["ask_frames"]
        if self.corrections == CorrectionSettings():
            del document["corrections"]
        for part, name, usual in _USUAL:
            owner = document.get(part, {}) if part else document
            if owner.get(name) == usual:
                del owner[name]
        return document
