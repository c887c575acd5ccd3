"""Everything that can be set, and the named sets of it.

A preset is a starting point; every field says in its own docstring which way is slower.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from decogs.codec.entropy import DEFAULT_LEVEL
from decogs.formats.errors import UsageError

from .baseline import BaselineSettings
from .economy import Coarseness, EconomySettings
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
    """

    keyframe: KeyframeSettings = field(default_factory=KeyframeSettings)
    frame: FrameSettings = field(default_factory=FrameSettings)
    lattice_scale: float = 1.0
    zstd_level: int = DEFAULT_LEVEL
    method: Method = "decogs"
    baseline: BaselineSettings = field(default_factory=BaselineSettings)
    segment: int = 0
    frame_budget: float | None = None

    def as_document(self) -> dict[str, Any]:
        """The settings as plain JSON values, for the stream's header and the log; without the other method's.

        No budget is no entry: a stream begun before there were any can still be gone on with.
        """
        document: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        del document["frame" if self.method == "3dgstream" else "baseline"]
        if self.frame_budget is None:
            del document["frame_budget"]
        return document


_STANDARD = EncodeSettings(
    keyframe=KeyframeSettings(iterations=1500, sh_degree=1),
    frame=FrameSettings(
        masks=MaskSettings(threshold=10.0, radius_share=0.018, speck_area=8, since_trained=True, residual=25.0),
        cache=None,
        joint_iterations=150,
        warm_start=0.9,
        grow_share=0.01,
        beta1=0.7,
        beta2=0.99,
        economy=EconomySettings(
            worth=0.02,
            hold_at=0.5,
            coarseness=Coarseness(means=2, log_scales=1, quaternions=2, opacity_logits=3, sh_dc=2, sh_rest=1),
        ),
    ),
)

PRESETS: dict[str, EncodeSettings] = {
    "draft": replace(
        _STANDARD,
        keyframe=KeyframeSettings(iterations=500, cap=40_000),
        frame=replace(_STANDARD.frame, joint_iterations=60),
    ),
    "standard": _STANDARD,
    "high": replace(
        _STANDARD,
        keyframe=KeyframeSettings(iterations=3000, cap=80_000, sh_degree=2),
        frame=replace(_STANDARD.frame, joint_iterations=250),
    ),
    "paper": EncodeSettings(
        keyframe=KeyframeSettings(iterations=3000, sh_degree=1),
        frame=FrameSettings(selection=SelectionSettings(rule="paper"), emergence=EmergenceSettings(most=0)),
    ),
}
"""From fast to slow, and ``paper``: the paper's numbers wherever it gives them (method.md), and nothing beyond it."""


def preset(name: str) -> EncodeSettings:
    """The settings of that name; raises UsageError for an unknown one."""
    if name not in PRESETS:
        raise UsageError(f"--preset {name}: there is no such preset; choose from {', '.join(PRESETS)}")
    return PRESETS[name]
