"""Everything that an encode can be set to, as plain data."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field, replace
from functools import reduce
from operator import attrgetter, getitem
from typing import Annotated, Any

from decogs.formats.errors import UsageError
from decogs.formats.stream.container import MAX_FRAME

from .checked import Bytes, Checked, OneOf, Within
from .effects import EFFECT_NAMES, FRAME_EFFECTS, PRESET_EFFECTS, RIG_EFFECTS, CorrectionSettings
from .frame import FrameSettings
from .keyframe import KeyframeSettings

_OMITTED_DEFAULTS = (
    ("frame.focus.over", "region"),
    ("frame_budget", None),
    ("time_budget", None),
    ("target_psnr", None),
    ("corrections", CorrectionSettings()),
)
"""Settings by dotted path, and the value of each that a header omits."""


@dataclass(frozen=True)
class EncodeSettings(Checked):
    """Everything that an encode can be set to.

    The scene does not depend on ``segment``, only how frames are coded, unless segments are ``closed``: each one then
    starts from the first keyframe's Gaussians and depends on no other segment (`frame.next_segment`).
    """

    keyframe: KeyframeSettings = field(default_factory=KeyframeSettings)
    frame: FrameSettings = field(default_factory=FrameSettings)
    lattice_scale: Annotated[float, Within(1e-3, 1e3)] = 1.0  # of the default steps; more: smaller, less exact
    method: str = "decogs"  # of later frames, a name in FRAME_METHODS; the bench's are slower
    segment: Annotated[int, Within(0, MAX_FRAME)] = 0  # frames between keyframes; fewer: larger, seek faster; 0: one
    closed: bool = False  # segments depend on no other: slower
    cross_fade: Annotated[int, Within(0, 1000)] = 3  # frames that are faded into such a start; more: slower; 0: a jump
    frame_budget: Bytes | None = None  # mean bytes of a later frame; fewer: less exact; None: by frame.significance
    time_budget: Annotated[float, Within(1e-4, 1e6)] | None = None  # mean seconds of a later frame; None: all steps
    target_psnr: Annotated[float, Within(1e-9, 100)] | None = None  # dB at which training stops; more: slower; None: no
    effects: Annotated[tuple[str, ...], OneOf(EFFECT_NAMES)] = PRESET_EFFECTS  # enabled ones; fewer: faster, smaller
    detect_per_frame: bool = False  # frames and keyframe enable only what their pictures show: faster
    corrections: CorrectionSettings = field(default_factory=CorrectionSettings)  # of drifting cameras

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.closed and not self.segment:
            raise UsageError("`closed`: say how many frames a segment has, with `segment`")
        if self.closed and self.time_budget is not None:
            raise UsageError(
                "`closed`: `time_budget` carries time from segment to segment, so none stands on its own; drop one of "
                "the two"
            )
        if self.closed and "gate" in self.frame.ablated:
            raise UsageError(
                "`closed`: `ablate` gate carries Adam's moments from segment to segment, so none stands on its own; "
                "drop one of the two"
            )

    @property
    def frame_effects(self) -> tuple[str, ...]:
        """Those of the enabled effects that a frame may call for."""
        return tuple(name for name in FRAME_EFFECTS if name in self.effects)

    @property
    def fading(self) -> int:
        """How many frames before the start of a segment are faded into it."""
        return min(self.cross_fade, self.segment - 1) if self.closed else 0

    def as_document(self) -> dict[str, Any]:
        """The settings as plain JSON values, for the stream's header and the log.

        Omitted are what the bench's dense baseline does not read, unset budgets, targets, corrections and choices
        of effects, so that streams started without such settings can still be resumed, and effects that the first frame
        or the rig decides about: what was found is in the header's cameras.
        """
        shown = replace(
            self,
            corrections=replace(
                self.corrections,
                lamps={},
                lamp_phases={},
                standing_bands=CorrectionSettings.standing_bands,
                falloff=CorrectionSettings.falloff,
                rolling_shutter=CorrectionSettings.rolling_shutter,
            ),
            effects=tuple(name for name in self.effects if name not in ("lens_falloff", *RIG_EFFECTS)),
        )
        document: dict[str, Any] = json.loads(json.dumps(asdict(shown)))
        for found in ("lamps", "lamp_phases", "standing_bands", "falloff", "rolling_shutter"):
            del document["corrections"][found]
        omitted = [path for path, usual in _OMITTED_DEFAULTS if attrgetter(path)(shown) == usual]
        if (self.effects, self.detect_per_frame) == (PRESET_EFFECTS, False):
            omitted += ["effects", "detect_per_frame"]
        if not self.closed:
            omitted += ["closed", "cross_fade"]
        if self.method == "3dgstream":
            omitted.append("frame")
        for path in omitted:
            *groups, name = path.split(".")
            del reduce(getitem, groups, document)[name]
        return document
