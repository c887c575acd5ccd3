"""The effects that an encode enables: those that a scene calls for, or those that the user requests.

Chosen: an effect, in its own file, changes settings and nothing else; training depends on settings only. So a disabled
effect costs nothing, a stream's header lists the enabled ones, and one frame's choice is the same change of its
settings. Rejected: flags that training checks (an effect would be spread over many files, and a new one would change
them all).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from decogs.formats.errors import UsageError

from ..settings.effects import CAMERA_EFFECTS, EFFECT_NAMES, FRAME_EFFECTS
from .effect import Decision

if TYPE_CHECKING:
    from ..settings.encode import EncodeSettings

AUTO, ALL, NONE = "auto", "all", "none"


@dataclass(frozen=True)
class Wanted:
    """Requested effects: a ``base`` (AUTO, ALL or NONE), and names added to it and dropped from it."""

    base: str
    added: frozenset[str] = frozenset()
    dropped: frozenset[str] = frozenset()

    def names(self, detected: Collection[str]) -> tuple[str, ...]:
        """The requested names, in order, given the detected ones; effects detected per frame count as detected."""
        bases = {AUTO: {*FRAME_EFFECTS, *detected}, ALL: set(EFFECT_NAMES), NONE: set[str]()}
        names = (bases[self.base] | self.added) - self.dropped
        return tuple(name for name in EFFECT_NAMES if name in names)


def wanted_effects(text: str) -> Wanted:
    """Reads ``--effects``: auto, all or none, or names with commas; ``-name`` takes one away. Raises UsageError."""
    words = [word.strip() for word in text.split(",") if word.strip()]
    base = words.pop(0) if words and words[0] in (AUTO, ALL, NONE) else ALL if text.startswith("-") else NONE
    added = frozenset(word for word in words if not word.startswith("-"))
    dropped = frozenset(word[1:] for word in words if word.startswith("-"))
    if unknown := sorted((added | dropped) - set(EFFECT_NAMES)):
        raise UsageError(
            f"--effects {text}: there is no effect {unknown[0]!r}; choose auto, all, none or from "
            f"{', '.join(EFFECT_NAMES)}"
        )
    return Wanted(base, added, dropped)


def with_effects(
    settings: EncodeSettings, wanted: Wanted, cameras: Sequence[str], decisions: Callable[[], Sequence[Decision]]
) -> EncodeSettings:
    """``settings`` with exactly the wanted effects; their ``effects`` list those that change the settings.

    ``cameras``: names of all that train, for an effect that is wanted where the scene does not call for it.
    ``decisions``: of the rig (`analysis.analyse`), called only if the wanted effects depend on them.
    """
    from . import EFFECTS

    fixed = wanted.base != AUTO and not set(wanted.names(())) - {*FRAME_EFFECTS, "view_dependence"}
    found = {} if fixed else {decision.effect: decision for decision in decisions()}
    names = wanted.names([name for name, decision in found.items() if decision.detected])
    built = []
    for effect in EFFECTS:
        chosen = without = effect.disabled(settings)
        if effect.name in names:
            decision = found.get(effect.name)
            if decision is not None and (not decision.detected or _is_common(decision, cameras)):
                decision = replace(decision, cameras=tuple(cameras))
            chosen = settings if decision is None else effect.enabled(settings, decision)
        if chosen != without:
            built.append(effect.name)
        settings = chosen
    return replace(settings, effects=tuple(built), detect_per_frame=wanted.base == AUTO)


def _is_common(decision: Decision, cameras: Sequence[str]) -> bool:
    """Whether most cameras have a fault; then the others presumably have it below the detection limit."""
    return decision.effect in CAMERA_EFFECTS and 2 * len(decision.cameras) > len(cameras)


def disable(settings: EncodeSettings, names: Collection[str]) -> EncodeSettings:
    """``settings`` without the effects of these names, for a frame that does not call for them."""
    from . import EFFECTS

    for effect in EFFECTS:
        if effect.name in names:
            settings = effect.disabled(settings)
    return settings
