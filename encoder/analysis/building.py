"""The effects that an encode enables: the detected ones, or those that the user requests.

Chosen: an effect, in its own file, changes settings and nothing else; training depends on settings only. So a disabled
effect costs nothing, a stream's header lists the enabled ones, and one frame's choice is the same change of its
settings. Rejected: flags that training checks (an effect would be spread over many files, and a new one would change
them all).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace

from decogs.codec.header.header import StreamHeader
from decogs.codec.packets.corrections import lamps_of
from decogs.formats.errors import UsageError

from ..settings.effects import (
    CAMERA_EFFECTS,
    EFFECT_BASES,
    EFFECT_NAMES,
    PRESET_EFFECTS,
    WITHDRAWN,
)
from ..settings.encode import EncodeSettings
from .camera_shake import CameraShake
from .colour_drift import EXPOSURE_DRIFT, WHITE_BALANCE_DRIFT
from .colour_mismatch import ColourMismatch
from .content import WITHOUT
from .effect import Decision, Effect
from .lamp_flicker import LampFlicker
from .lens_distortion import LensDistortion
from .lens_falloff import LensFalloff
from .rolling_shutter import RollingShutter
from .sensor_noise import SensorNoise

AUTO, ALL, NONE = EFFECT_BASES

EFFECTS: tuple[Effect, ...] = (
    ColourMismatch(),
    EXPOSURE_DRIFT,
    WHITE_BALANCE_DRIFT,
    CameraShake(),
    LampFlicker(),
    LensDistortion(),
    RollingShutter(),
    SensorNoise(),
)
"""The effects that the analysis of a rig decides about, in the order of its table."""

SHOWN: tuple[Effect, ...] = (LensFalloff(),)
"""What the analysis shows to people only: an encode's keyframe decides about fall-off."""

_NEED_FIGURES = (LensDistortion.name, SensorNoise.name)

_WITHOUT = {**WITHOUT, **{effect.name: effect.disabled for effect in (*EFFECTS, *SHOWN)}}


@dataclass(frozen=True)
class EffectChoice:
    """The requested effects: a base, and names of effects added to it and dropped from it.

    ``base``: "auto" enables the detected effects, of the rig (whose analysis takes seconds) and of each frame;
    "all" every effect; "none" no effect. Raises UsageError for another base or an unknown name.
    """

    base: str
    added: AbstractSet[str] = frozenset()
    dropped: AbstractSet[str] = frozenset()

    def __post_init__(self) -> None:
        unknown = [name for name in (*sorted(self.added), *sorted(self.dropped)) if name not in EFFECT_NAMES]
        if self.base not in EFFECT_BASES:
            unknown.insert(0, self.base)
        if unknown and unknown[0] in WITHDRAWN:
            raise UsageError(
                f"`effects` {self}: {unknown[0]} is no effect any more: {WITHDRAWN[unknown[0]]}; leave it out"
            )
        if unknown:
            raise UsageError(
                f"`effects` {self}: there is no effect {unknown[0]!r}; choose auto, all, none or from "
                f"{', '.join(EFFECT_NAMES)}"
            )
        both = sorted(set(self.added) & set(self.dropped))
        if both:
            raise _refused(self, f"{both[0]} is both enabled and disabled")
        if self.dropped and self.base == NONE:
            raise _refused(self, f"-{min(self.dropped)} disables what is not enabled")

    def __str__(self) -> str:
        """As ``--effects`` takes it."""
        base = [] if self.base == NONE and self.added else [str(self.base)]
        return ",".join([*base, *sorted(self.added), *(f"-{name}" for name in sorted(self.dropped))])

    def names(self, detected: Collection[str]) -> tuple[str, ...]:
        """The requested names, in order, given those the rig calls for; frames and the keyframe decide about others."""
        bases = {AUTO: {*PRESET_EFFECTS, *detected}, ALL: set(EFFECT_NAMES), NONE: set[str]()}
        names = (bases[self.base] | self.added) - self.dropped
        return tuple(name for name in EFFECT_NAMES if name in names)


def effect_choice(text: str) -> EffectChoice:
    """The choice that a text states: auto, all or none, and names with commas; ``-name`` disables one.

    Names alone are those and no other; disabled ones alone are disabled of auto. Blanks do not count. Raises UsageError
    for a text that names nothing, or what there is not, twice, or both ways.
    """
    words = [word.strip() for word in text.split(",") if word.strip()]
    bases = [word for word in words if word in EFFECT_BASES]
    named = [word for word in words if word not in EFFECT_BASES]
    twice = [word for word in words if words.count(word) > 1]
    if not words:
        raise _refused(repr(text), "it names no effect")
    if twice:
        raise _refused(text, f"{twice[0]} is named twice")
    if len(bases) > 1:
        raise _refused(text, f"{bases[0]} and {bases[1]} exclude each other")
    added = frozenset(word for word in named if not word.startswith("-"))
    dropped = frozenset(word[1:].strip() for word in named if word.startswith("-"))
    return EffectChoice(bases[0] if bases else NONE if added else AUTO, added, dropped)


def _refused(asked: object, problem: str) -> UsageError:
    return UsageError(f"`effects` {asked}: {problem}; give auto, all, none, or names, such as auto,-camera_shake")


def with_effects(
    settings: EncodeSettings, wanted: EffectChoice, cameras: Sequence[str], decisions: Callable[[], Sequence[Decision]]
) -> EncodeSettings:
    """``settings`` with exactly the wanted effects; their ``effects`` list those that change the settings.

    ``cameras``: names of all that train, for an effect that is requested though it is not detected.
    ``decisions``: of the rig (`analysis.analyse`), called only if the wanted effects depend on them.
    """
    fixed = wanted.base != AUTO and not set(wanted.names(())) - set(PRESET_EFFECTS)
    by_effect = {} if fixed else {decision.effect: decision for decision in decisions()}
    names = wanted.names([name for name, decision in by_effect.items() if decision.detected])
    built = []
    enabled = {effect.name: effect.enabled for effect in EFFECTS}
    for name in EFFECT_NAMES:
        chosen = without = _WITHOUT[name](settings)
        if name in names:
            decision = by_effect.get(name)
            if decision is not None and (not decision.detected or _is_common(decision, cameras)):
                decision = replace(decision, cameras=tuple(cameras))
            chosen = settings if decision is None else enabled[name](settings, decision)
        if chosen != without:
            built.append(name)
        settings = chosen
    # Bands that stand still are for the keyframe to find.
    sought = wanted.base == AUTO and LampFlicker.name not in wanted.dropped
    settings = replace(settings, corrections=replace(settings.corrections, standing_bands=sought))
    return replace(settings, effects=tuple(built), detect_per_frame=wanted.base == AUTO)


def decided_beforehand(wanted: EffectChoice, header: StreamHeader | None) -> tuple[Decision, ...]:
    """Decisions on a rig whose frames are yet to come: the ``wanted`` effects are enabled for all cameras.

    Lamps are those of the keyframe that it starts from; ``header``: of that one's stream, None where there is none.
    Raises UsageError for effects of which only an analysis can tell more.
    """
    lamps = {} if header is None else lamps_of(header.camera_colours)
    unknown = [name for name in wanted.names(()) if name in _NEED_FIGURES]
    if wanted.base == AUTO or unknown:
        what = f"`effects` {wanted}: a recording that goes on cannot be analysed"
        raise UsageError(f"{what}, which {unknown[0]} needs; leave it out" if unknown else f"{what}; name the effects")
    if LampFlicker.name in wanted.names(()) and not lamps:
        raise UsageError(
            f"`effects` {wanted}: what the lamps are like is not known; give a `keyframe` of an earlier stream whose "
            f"header has lamp_flicker"
        )
    found = {LampFlicker.name: {"lamps": lamps}}
    return tuple(
        Decision(
            effect.name,
            detected=effect.name in found,
            confidence=0.0,
            cameras=tuple(lamps),
            frames=(),
            reason="its frames are yet to come",
            cost="",
            figures=found.get(effect.name, {}),
        )
        for effect in EFFECTS
    )


def _is_common(decision: Decision, cameras: Sequence[str]) -> bool:
    """Whether most cameras have a fault; then the others presumably have it below the detection limit."""
    return decision.effect in CAMERA_EFFECTS and 2 * len(decision.cameras) > len(cameras)


def disable(settings: EncodeSettings, names: Collection[str]) -> EncodeSettings:
    """``settings`` without the effects of these names, for a frame in which they are not detected."""
    for name in EFFECT_NAMES:
        if name in names:
            settings = _WITHOUT[name](settings)
    return settings
