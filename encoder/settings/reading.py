"""Settings from the plain values that a stream's header has of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from .encode import EncodeSettings

_S = TypeVar("_S")


def read_settings(document: Mapping[str, Any]) -> EncodeSettings:
    """The inverse of `EncodeSettings.as_document`; names that are no setting are passed over.

    Raises TypeError, ValueError or UsageError for values that are none.
    """
    return _read(EncodeSettings, document)


def _read(kind: type[_S], document: Mapping[str, Any]) -> _S:
    hints = get_type_hints(kind)
    given = [field.name for field in fields(kind) if field.name in document]  # type: ignore[arg-type]
    return kind(**{name: _value(hints[name], document[name]) for name in given})


def _value(hint: Any, value: Any) -> Any:
    for kind in (hint, *get_args(hint)):
        if is_dataclass(kind) and isinstance(kind, type) and value is not None:
            return _read(kind, value)
        if get_origin(kind) is tuple:
            return tuple(value)
    return value
