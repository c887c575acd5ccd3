"""The method of an encode, and parts of it that are left out.

Switches change settings and nothing else, so that a stream's header records them. Methods share the keyframe, the
views, the rasteriser and the lattice; what a later frame does is all that differs. Rejected: presets for each
combination (a method applies on top of any preset).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any, TypeVar

from decogs.formats.errors import UsageError

from ..change.selection import SELECTION_RULES
from ..coding.rate_control import with_budget
from ..coding.time_control import with_target_psnr, with_time_budget
from ..methods import FRAME_METHODS, method_of, require_sparse
from ..registry import Registry
from ..settings.checked import Checked
from ..settings.encode import EncodeSettings

T = TypeVar("T")

ABLATIONS = ("select", "focus", "gate")
"""The parts of a method that can be left out: its selection, its focus loss, its gate."""

_REGISTERED_SETTINGS: dict[str, Registry[Any]] = {
    "method": FRAME_METHODS,
    "frame.selection.rule": SELECTION_RULES,
}
"""Settings that are names in a registry, which packages may extend."""


@dataclass(frozen=True)
class Switches(Checked):
    """What later frames are trained with, on top of settings; None and nothing are what those say.

    ``method``: a name in FRAME_METHODS: "decogs", "paper", or one of the bench or of an installed package. ``ablate``:
    parts of it to leave out, of ABLATIONS. ``selection``: a name in SELECTION_RULES.
    """

    method: str | None = None
    ablate: Sequence[str] = ()
    selection: str | None = None


def with_switches(settings: EncodeSettings, switches: Switches) -> EncodeSettings:
    """The same settings with these switches; raises UsageError for unknown names, and what excludes each other."""
    if switches.method is not None:
        settings = with_method(settings, switches.method)
    settings = ablate(settings, switches.ablate)
    if switches.selection is None:
        return settings
    if "select" in switches.ablate:
        raise UsageError(f"`selection` {switches.selection}: `ablate` select takes every Gaussian; drop one of the two")
    return with_selection(settings, switches.selection)


def check_together(settings: EncodeSettings) -> None:
    """Raises UsageError where a setting names what is not installed, or asks for what the others do not have.

    Settings themselves know no registry; an encode asks before it begins, not in the frame that needs the name.
    """
    for path, registry in _REGISTERED_SETTINGS.items():
        _get(registry, attrgetter(path)(settings), path.rsplit(".")[-1])
    method_of(settings)
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
    """The same settings with later frames trained by another method; raises UsageError for an unknown one."""
    _get(FRAME_METHODS, name, "method")
    changed = replace(settings, method=name)
    method_of(changed)
    return changed


def with_selection(settings: EncodeSettings, rule: str) -> EncodeSettings:
    """The same settings with S_t chosen by another rule; raises UsageError for an unknown one.

    A rule without effect is refused: a dense method selects nothing.
    """
    _get(SELECTION_RULES, rule, "selection")
    require_sparse(settings, f"`selection` {rule}", "trains every Gaussian")
    selection = replace(settings.frame.selection, rule=rule)
    return replace(settings, frame=replace(settings.frame, selection=selection))


def ablate(settings: EncodeSettings, parts: Sequence[str]) -> EncodeSettings:
    """The same settings with parts of the method left out, in addition to those that already are.

    ``select``: every Gaussian is selected in any frame whose pictures changed. ``focus``: the plain loss over the whole
    picture. ``gate``: gradients reach every Gaussian, and momentum lasts. The bench does it (`bench.ablations`). Raises
    UsageError for an unknown part, and for a method that has none of them.
    """
    for part in parts:
        if part not in ABLATIONS:
            raise UsageError(f"`ablate` {part}: there is no such part; choose from {', '.join(ABLATIONS)}")
    if "select" in parts:
        require_sparse(settings, "`ablate` select", "has no such part")
        settings = with_selection(settings, "all")
    ablated = tuple(name for name in ABLATIONS[1:] if name in (*settings.frame.ablated, *parts))
    changed = replace(settings, frame=replace(settings.frame, ablated=ablated))
    method_of(changed)
    return changed
