"""Everything that can be set, and the named sets of it.

A preset is a starting point; every field says in its own docstring which way is slower.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from decogs.codec.entropy import DEFAULT_LEVEL
from decogs.formats.errors import UsageError

from .baseline import BaselineSettings
from .corrections.settings import CorrectionSettings
from .economy import Coarseness, EconomySettings
from .effects.names import PRESET_EFFECTS
from .effort import PaceSettings
from .emergence import EmergenceSettings
from .frame_training import FrameSettings
from .keyframe import KeyframeSettings
from .masks import MaskSettings
from .selection import SelectionSettings

Method = Literal["decogs", "3dgstream"]
"""How later frames are trained (`methods`)."""


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
    """

    keyframe: KeyframeSettings = field(default_factory=KeyframeSettings)
    frame: FrameSettings = field(default_factory=FrameSettings)
    lattice_scale: float = 1.0
    zstd_level: int = DEFAULT_LEVEL
    method: Method = "decogs"
    baseline: BaselineSettings = field(default_factory=BaselineSettings)
    segment: int = 0
    frame_budget: float | None = None
    time_budget: float | None = None
    target_psnr: float | None = None
    effects: tuple[str, ...] = PRESET_EFFECTS
    ask_frames: bool = False
    corrections: CorrectionSettings = field(default_factory=CorrectionSettings)

    def as_document(self) -> dict[str, Any]:
        """The settings as plain JSON values, for the stream's header and the log; without the other method's.

        No budget, target, correction or choice of effects is no entry: a stream begun before there were any can still
        be gone on with.
        """
        document: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        del document["frame" if self.method == "3dgstream" else "baseline"]
        for name in ("frame_budget", "time_budget", "target_psnr"):
            if document[name] is None:
                del document[name]
        if (self.effects, self.ask_frames) == (PRESET_EFFECTS, False):
            del document["effects"], document["ask_frames"]
        if self.corrections == CorrectionSettings():
            del document["corrections"]
        return document


def _better(
    settings: EncodeSettings, *, keyframe: Mapping[str, Any], frame: Mapping[str, Any], **own: Any
) -> EncodeSettings:
    """The same settings with some of the keyframe's, of later frames' and of its own replaced."""
    return replace(
        settings, keyframe=replace(settings.keyframe, **keyframe), frame=replace(settings.frame, **frame), **own
    )


_LIVE = EncodeSettings(
    keyframe=KeyframeSettings(iterations=250, cap=30_000, sh_degree=1),
    frame=FrameSettings(
        masks=MaskSettings(
            threshold=10.0,
            radius_share=0.018,
            speck_area=8,
            since_trained=True,
            residual=25.0,
            mend_frames=8,
            light_threshold=4.0,
        ),
        cache=None,
        joint_iterations=30,
        warm_start=0.9,
        grow_share=0.01,
        beta1=0.7,
        beta2=0.99,
        pace=PaceSettings(usual_miss=0.15),
        economy=EconomySettings(
            worth=0.017,
            hold_at=0.5,
            coarseness=Coarseness(means=1, log_scales=1, quaternions=2, opacity_logits=3, sh_dc=2, sh_rest=1),
        ),
        emergence=EmergenceSettings(most_rays=500),
    ),
)
_DRAFT = _better(
    _LIVE,
    keyframe={"iterations": 500, "cap": 40_000},
    frame={"joint_iterations": 60, "emergence": EmergenceSettings(most_rays=2000)},
)
_STANDARD = _better(_DRAFT, keyframe={"iterations": 1500, "cap": 52_000}, frame={"joint_iterations": 120})
_HIGH = _better(
    _STANDARD, keyframe={"iterations": 3000, "cap": 80_000, "sh_degree": 2}, frame={"joint_iterations": 250}
)
_ARCHIVE = _better(
    _HIGH,
    keyframe={"iterations": 5000},
    frame={
        "joint_iterations": 400,
        "grow_share": 0.02,
        "economy": EconomySettings(
            worth=0.005,
            hold_at=0.5,
            coarseness=Coarseness(means=1, log_scales=1, quaternions=1, opacity_logits=2, sh_dc=1, sh_rest=1),
        ),
    },
    lattice_scale=0.7,
)

LADDER = ("live", "draft", "standard", "high", "archive")
"""Presets from fast to slow; each is the one before it with some settings made slower, larger and better."""

PRESETS: dict[str, EncodeSettings] = {
    **dict(zip(LADDER, (_LIVE, _DRAFT, _STANDARD, _HIGH, _ARCHIVE), strict=True)),
    "paper": EncodeSettings(
        keyframe=KeyframeSettings(iterations=3000, sh_degree=1),
        frame=FrameSettings(selection=SelectionSettings(rule="paper"), emergence=EmergenceSettings(most=0)),
    ),
}
"""The ladder (measured in DESIGN.md), and ``paper``: its numbers wherever it gives them, and nothing beyond it."""


def preset(name: str) -> EncodeSettings:
    """The settings of that name; raises UsageError for an unknown one."""
    if name not in PRESETS:
        raise UsageError(f"--preset {name}: there is no such preset; choose from {', '.join(PRESETS)}")
    return PRESETS[name]
