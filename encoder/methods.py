"""The method of an encode and its switched-off parts: the baseline, and the ablations of DecoGS's component table.

Switches change settings and nothing else, so that a stream's header says what made it. Methods share the keyframe, the
views, the rasteriser and the lattice; what a later frame does is all that differs. Rejected: presets for each
combination (a method applies on top of any preset).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

from decogs.formats.errors import UsageError

from .change.selection import SELECTION_RULES
from .settings.encode import EncodeSettings, Method

METHODS: tuple[Method, ...] = get_args(Method)
"""``decogs``, and ``3dgstream``: the dense baseline it is measured against (`baseline`)."""

ABLATIONS = ("select", "focus", "gate")
"""The parts of DecoGS that can be left out; `without` says what then happens."""


def with_method(settings: EncodeSettings, name: str) -> EncodeSettings:
    """The same settings with later frames trained by another method; raises UsageError for an unknown one.

    ``3dgstream`` has none of DecoGS's parts: settings with an ablation are refused.
    """
    if name not in METHODS:
        raise UsageError(f"--method {name}: there is no such method; choose from {', '.join(METHODS)}")
    if name != "decogs" and settings.frame.ablated:
        raise UsageError(f"--method {name}: it has no {settings.frame.ablated[0]} to leave out; drop --ablate")
    return replace(settings, method=name)


def with_selection(settings: EncodeSettings, rule: str) -> EncodeSettings:
    """The same settings with S_t chosen by another rule; raises UsageError for an unknown one.

    A rule without effect is refused: ``3dgstream`` selects nothing, nor does DecoGS without ``select``.
    """
    try:
        SELECTION_RULES.get(rule)
    except UsageError as error:
        raise UsageError(f"--selection {error}") from error
    if settings.method != "decogs":
        raise UsageError(f"--selection {rule}: --method {settings.method} trains every Gaussian; drop one of the two")
    if "select" in settings.frame.ablated:
        raise UsageError(f"--selection {rule}: --ablate select takes every Gaussian; drop one of the two")
    selection = replace(settings.frame.selection, rule=rule)
    return replace(settings, frame=replace(settings.frame, selection=selection))


def without(settings: EncodeSettings, parts: Sequence[str]) -> EncodeSettings:
    """The same settings with parts of DecoGS left out, in addition to those that already are.

    * ``select``: every Gaussian is selected (S_t = all) in any frame whose pictures changed; masks still focus the
      loss.
    * ``focus``: the plain 3DGS loss over the whole picture in both stages; masks have no part in the loss.
    * ``gate``: stage 2's gradients reach every Gaussian, and Adam's moments are kept from frame to frame for all of
      them, so that static ones walk on stale momentum and on noise; the cache and densification stay with the selected.

    All three leave a recipe close to plain per-frame fine-tuning, not the baseline: that is ``3dgstream``. Raises
    UsageError for an unknown part, and for ``3dgstream``, which has none of them. Source: the paper's component table.
    """
    for part in parts:
        if part not in ABLATIONS:
            raise UsageError(f"--ablate {part}: there is no such part; choose from {', '.join(ABLATIONS)}")
    if parts and settings.method != "decogs":
        raise UsageError(f"--ablate {parts[0]}: --method {settings.method} has no such part; drop one of the two")
    ablated = tuple(name for name in ABLATIONS if name in (*settings.frame.ablated, *parts))
    return replace(settings, frame=replace(settings.frame, ablated=ablated))
