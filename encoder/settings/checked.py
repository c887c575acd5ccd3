"""What each field of settings may be, said in its type, and checked when settings are made.

``iterations: Annotated[int, Within(1, 1_000_000)] = 1000`` is type, range and default on one line; a comment there
says what it is, its unit, and which way is slower. Rejected: a table of
ranges beside the fields (a new field is forgotten there); `dataclasses.field` with metadata (the default moves into a
call, and type checkers see `Any`); pydantic (a dependency for a hundred comparisons).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from decogs.formats.errors import UsageError


@dataclass(frozen=True)
class Within:
    """Numbers from ``low`` to ``high``, both included."""

    low: float
    high: float

    def takes(self, value: float) -> bool:
        """NaN and infinities are in no range."""
        return self.low <= value <= self.high

    def text(self, kind: str) -> str:
        """In words; ``kind``: of number."""
        return f"a {kind} from {self.low:.15g} to {self.high:.15g}"


@dataclass(frozen=True)
class OneOf:
    """One of these names; in a tuple, any of them."""

    names: tuple[str, ...]


Share = Annotated[float, Within(0, 1)]
Opacity = Annotated[float, Within(1e-6, 1 - 1e-6)]
"""Of a Gaussian that is trained: 0 and 1 have no logit."""
Size = Annotated[float, Within(1e-3, 1e3)]
"""Of a Gaussian, as a multiple of something."""
Steps = Annotated[int, Within(0, 1_000_000)]
Count = Annotated[int, Within(1, 1_000_000)]
Levels = Annotated[float, Within(0, 255)]
"""8-bit levels."""
Rate = Annotated[float, Within(0, 1e9)]
"""Of an optimiser, or a mean gradient from which something happens."""
MOST_BYTES = 1e12
Bytes = Annotated[float, Within(1, MOST_BYTES)]
MOST_LOSS = 1e9
Loss = Annotated[float, Within(0, MOST_LOSS)]
"""Millionths of a picture's mean loss."""
Decay = Annotated[float, Within(0, 0.999_999)]
"""Of Adam's moments."""
Multiple = Annotated[float, Within(0, 1000)]


class Checked:
    """Base of all settings: raises UsageError for a field that its type does not take."""

    def __post_init__(self) -> None:
        for name, hint in _hints(type(self)).items():  # type: ignore[arg-type]
            value = getattr(self, name)
            if wanted := _wanted(hint, value):
                raise UsageError(f"`{name}` {_printed(value)}: give {wanted} ({type(self).__name__})")


@cache
def _hints(kind: Hashable) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _wanted(hint: Any, value: object) -> str:
    """What a field of this type takes, in words; empty when that is what it has."""
    kind, limits = get_args(hint)[:2] if get_origin(hint) is Annotated else (hint, None)
    origin, inner = get_origin(kind), get_args(kind)
    if type(None) in inner:
        text = "" if value is None else _wanted(inner[0], value)
        return text and f"{text}, or None"
    if kind in (int, float):
        return _wanted_number(kind, limits, value)
    if kind is str:
        return "" if _is_name(value, limits) else f"a name{_listed(limits)}"
    if origin is Sequence:
        # A text is a sequence of texts, too.
        good = isinstance(value, (tuple, list)) and all(_is_name(one, limits) for one in value)
        return "" if good else "a list of names"
    if origin is tuple:
        good = isinstance(value, tuple) and all(_is_name(one, limits) for one in value)
        return "" if good and len(set(value)) == len(value) else f"a tuple of names{_listed(limits)}, each once"  # type: ignore[call-overload,arg-type]
    if origin is Mapping:
        if not (isinstance(value, Mapping) and all(_is_name(key, None) for key in value)):
            return "a dictionary of names"
        return next((f"for each name {text}" for one in value.values() if (text := _wanted(inner[1], one))), "")
    return "" if isinstance(value, kind) else "True or False" if kind is bool else kind.__name__


def _wanted_number(kind: type, limits: Any, value: object) -> str:
    is_number = isinstance(value, int if kind is int else (int, float)) and not isinstance(value, bool)
    if is_number and (limits is None or limits.takes(value)):
        return ""
    text = "whole number" if kind is int else "number"
    return f"a {text}" if limits is None else str(limits.text(text))


def _is_name(value: object, limits: OneOf | None) -> bool:
    return isinstance(value, str) and value != "" and (limits is None or value in limits.names)


def _listed(limits: OneOf | None) -> str:
    return "" if limits is None else f" from {', '.join(limits.names)}"


def _printed(value: object) -> str:
    try:
        return f"{value!r:.60}"
    except ValueError:  # Python prints no integer of thousands of digits.
        return f"of type {type(value).__name__}"
