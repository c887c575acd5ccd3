"""The method of an encode and its switched-off parts: the baseline, and the ablations of DecoGS's component table.

Switches change settings and nothing else, so that a stream's header says what made it. Methods share the keyframe, the
views, the rasteriser and the lattice; what a later frame does is all that differs. Rejected: presets for each
combination (a method applies on top of any preset).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, TypeVar

from decogs.formats.errors import UsageError

from .change.selection import SELECTION_RULES
from .coding.rate_control import with_budget
from .coding.time_control import with_target_psnr, with_time_budget
from .registry import Registry
from .settings.checked import Checked
from .settings.encode import EncodeSettings
from .settings.frame import ABLATIONS
from .training.densification import DENSIFICATIONS
from .training.methods import FRAME_METHODS, require_sparse

T = TypeVar("T")

_NAMED: dict[str, Registry[Any]] = {
    "method": FRAME_METHODS,
    "frame.selection.rule": SELECTION_RULES,
    "frame.densification": DENSIFICATIONS,
    "keyframe.densification": DENSIFICATIONS,
}
"""Settings that are names in a registry, which packages may extend."""


@dataclass(frozen=True)
class Switches(Checked):
    """What later frames are trained with, on top of settings; None and nothing are what those say.

    ``method``: a name in FRAME_METHODS: "decogs", "3dgstream", or one of an installed package. ``ablate``: parts of
    DecoGS to leave out, of ABLATIONS. ``selection``: a name in SELECTION_RULES.
    """

    method: str | None = None
    ablate: Sequence[str] = ()
    selection: str | None = None


def with_switches(settings: EncodeSettings, switches: Switches) -> EncodeSettings:
    """The same settings with these switches; raises UsageError for unknown names, and what excludes each other."""
    if switches.method is not None:
        settings = with_method(settings, switches.method)
    settings = without(settings, switches.ablate)
    return settings if switches.selection is None else with_selection(settings, switches.selection)


def check_together(settings: EncodeSettings) -> None:
    """Raises UsageError where a setting names what is not installed, or asks for what the others do not have.

    Settings themselves know no registry; an encode asks before it begins, not in the frame that needs the name.
    """
    for path, registry in _NAMED.items():
        _get(registry, attrgetter(path)(settings), path.rsplit(".")[-1])
    if settings.frame.ablated:
        require_sparse(settings, f"`ablate` {settings.frame.ablated[0]}", "has no such part")
    if settings.frame_budget is not None:
        with_budget(settings, settings.frame_budget)
    if settings.time_budget is not None:
        with_time_budget(settings, settings.time_budget)
    if settings.target_psnr is not None:
        with_target_psnr(settings, settings.target_psnr)


def _get(registry: Registry[T], name: str, parameter: str) -> T:
    try:
        return registry.get(name)
    except UsageError as error:
        raise UsageError(f"`{parameter}` {error}") from error


def with_method(settings: EncodeSettings, name: str) -> EncodeSettings:
    """The same settings with later frames trained by another method; raises UsageError for an unknown one.

    A dense method has none of DecoGS's parts: settings with an ablation are refused.
    """
    method = _get(FRAME_METHODS, name, "method")
    if method.dense and settings.frame.ablated:
        raise UsageError(f"`method` {name}: it has no {settings.frame.ablated[0]} to leave out; drop `ablate`")
    return replace(settings, method=name)


def with_selection(settings: EncodeSettings, rule: str) -> EncodeSettings:
    """The same settings with S_t chosen by another rule; raises UsageError for an unknown one.

    A rule without effect is refused: a dense method selects nothing, nor does DecoGS without ``select``.
    """
    _get(SELECTION_RULES, rule, "selection")
    require_sparse(settings, f"`selection` {rule}", "trains every Gaussian")
    if "select" in settings.frame.ablated:
        raise UsageError(f"`selection` {rule}: `ablate` select takes every Gaussian; drop one of the two")
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
    UsageError for an unknown part, and for a dense method, which has none of them. Source: the paper's component table.
    """
    for part in parts:
        if part not in ABLATIONS:
            raise UsageError(f"`ablate` {part}: there is no such part; choose from {', '.join(ABLATIONS)}")
    if parts:
        require_sparse(settings, f"`ablate` {parts[0]}", "has no such part")
    ablated = tuple(name for name in ABLATIONS if name in (*settings.frame.ablated, *parts))
    return replace(settings, frame=replace(settings.frame, ablated=ablated))
