"""Typed reading of calibrations in JSON or TOML: a field that is missing or of a wrong kind is named with its file."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path, PureWindowsPath
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ..errors import RigError
from ..files.regular_files import open_regular
from ..files.unicode_forms import as_it_lies, composed
from ..frames.rates import read_rate

_MAX_BYTES = 64 << 20
_FASTEST = 10_000
"""Frames per second."""


@dataclass(frozen=True)
class Fields:
    """The members of one JSON object; ``where`` begins every error message (file, and place in it)."""

    values: dict[str, object]
    where: str

    def __contains__(self, key: str) -> bool:
        return self.values.get(key) is not None

    def wrong(self, key: str, what: str) -> RigError:
        """The error to raise for a field: ``what`` is wrong with it."""
        return RigError(f"{self.where}: {key!r} {what}; correct the file")

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; ``default`` (if any) where the field is missing or null."""
        value = self.values.get(key)
        if value is None:
            if default is None:
                raise self.wrong(key, "is missing")
            return default
        return self._finite(key, value)

    def rate(self, key: str) -> float:
        """Frames per second: a number, or a text such as "30000/1001". Raises RigError for what is no rate."""
        value = self.values.get(key)
        rate = read_rate(value) if isinstance(value, str) else self.number(key)
        if rate is None or not 0 < rate < _FASTEST:
            raise self.wrong(key, f"is {value!r}, not a frame rate")
        return rate

    def integer(self, key: str) -> int:
        """A whole number; raises RigError when it is missing or none."""
        value = self.number(key)
        if value != int(value):
            raise self.wrong(key, f"is {value:g}, not a whole number")
        return int(value)

    def text(self, key: str, default: str | None = None) -> str:
        """A text; ``default`` (if any) where the field is missing or null. Raises RigError for anything else."""
        value = self.values[key] if key in self else default
        if not isinstance(value, str):
            raise self.wrong(key, "is missing" if value is None else "is not a text")
        return value

    def label(self, key: str, default: str | None = None) -> str:
        """A text fit for one line of a message, such as a name, in one of Unicode's forms."""
        return composed(self._printable(key, default))

    def _printable(self, key: str, default: str | None) -> str:
        value = self.text(key, default)
        if not value.isprintable():
            raise self.wrong(key, "holds control characters")
        return value

    def path(self, key: str, folder: Path, default: str | None = None) -> Path:
        """A path relative to ``folder``, also as Windows spells it. Raises RigError for one with a Windows drive."""
        text = self._printable(key, default)
        windows = PureWindowsPath(text)
        if os.path.exists(folder / text) or not (windows.drive or "\\" in text):
            return as_it_lies(folder / text)
        if windows.drive:
            raise self.wrong(key, f"is {text!r}, a place on a Windows machine and not relative to {folder}")
        return as_it_lies(folder / windows.as_posix())

    def numbers(self, key: str) -> tuple[float, ...]:
        """A list of finite numbers; raises RigError for anything else."""
        return tuple(self._finite(key, value) for value in self._list(key))

    def matrix(self, key: str) -> NDArray[np.float64]:
        """A matrix with four columns and three or four rows."""
        rows = self._list(key)
        if len(rows) not in (3, 4) or not all(isinstance(row, list) and len(row) == 4 for row in rows):
            raise self.wrong(key, "is no 3 x 4 or 4 x 4 matrix")
        numbers = [[self._number(key, value) for value in row] for row in rows if isinstance(row, list)]
        return np.array(numbers, np.float64)

    def array(self, key: str, *shapes: tuple[int, ...]) -> NDArray[np.float64]:
        """Finite numbers in lists, however nested, in the first of ``shapes`` that has as many."""
        numbers = list(self._flat(key, self._list(key), 3))
        shape = next((shape for shape in shapes if math.prod(shape) == len(numbers)), None)
        if shape is None:
            expected = " or ".join(" x ".join(map(str, shape)) for shape in shapes)
            raise self.wrong(key, f"has {len(numbers)} numbers, not {expected}")
        return np.array(numbers, np.float64).reshape(shape)

    def _flat(self, key: str, values: list[object], depth: int) -> Iterator[float]:
        for value in values:
            if isinstance(value, list) and depth:
                yield from self._flat(key, value, depth - 1)
            else:
                yield self._finite(key, value)

    def records(self, key: str) -> list[Fields]:
        """A non-empty list of objects."""
        records = [
            Fields(value, f"{self.where}, {key}[{index}]")
            for index, value in enumerate(self._list(key))
            if isinstance(value, dict)
        ]
        if not records or len(records) != len(self._list(key)):
            raise self.wrong(key, "is not a list of objects")
        return records

    def _list(self, key: str) -> list[object]:
        value = self.values.get(key)
        if not isinstance(value, list):
            raise self.wrong(key, "is missing" if value is None else "is not a list")
        return value

    def _number(self, key: str, value: object) -> float:
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.wrong(key, "is not a number")
        try:
            return float(value)
        except OverflowError:
            raise self.wrong(key, "is too large a number") from None

    def _finite(self, key: str, value: object) -> float:
        number = self._number(key, value)
        if not math.isfinite(number):
            raise self.wrong(key, "is NaN or infinite")
        return number


def read_json(path: Path) -> Fields:
    """The object in a JSON file. Raises RigError if it cannot be read or is malformed, with the line."""
    value = _parsed(path)
    if not isinstance(value, dict):
        raise RigError(f"{path}: the JSON file holds no object; correct the file")
    return Fields(value, str(path))


def read_json_list(path: Path, named: str) -> list[Fields]:
    """The objects in the list that a JSON file holds, ``named`` in messages. Raises RigError as ``read_json``."""
    return Fields({named: _parsed(path)}, str(path)).records(named)


def read_toml(path: Path) -> Fields:
    """The table in a TOML file. Raises RigError if it cannot be read or is malformed."""
    if sys.version_info >= (3, 11):
        import tomllib
    else:
        import tomli as tomllib
    try:
        return Fields(tomllib.loads(read_calibration_file(path).decode("utf-8-sig")), str(path))
    except (ValueError, RecursionError) as error:
        what = " ".join(str(error).split())[:200]
        raise RigError(f"{path}: malformed TOML ({what}); correct the file") from None


def read_calibration_file(path: Path) -> bytes:
    """All bytes of a file that is no larger than a calibration is. Raises RigError."""
    try:
        with open_regular(path) as file:
            data = file.read(_MAX_BYTES + 1)
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); put the file back or fix its rights") from None
    if len(data) > _MAX_BYTES:
        raise RigError(f"{path}: larger than {_MAX_BYTES >> 20} MiB, which no calibration is; check the file")
    return data


def parse_xml(path: Path, data: bytes) -> ElementTree.Element:
    """The root of an XML file's content. Raises RigError for what is malformed, or declares a document type."""
    try:
        if b"<!DOCTYPE" in data:  # whose entities may grow without bound
            raise ElementTree.ParseError("a document type is declared")
        return ElementTree.fromstring(data)
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise RigError(f"{path}: malformed XML ({error}); write the file again") from None


def _parsed(path: Path) -> object:
    try:
        # UTF-8 or, from some editors, UTF-16; with a byte order mark or without
        value: object = json.loads(read_calibration_file(path))
    except json.JSONDecodeError as error:
        raise RigError(f"{path}: malformed JSON in line {error.lineno} ({error.msg}); correct the file") from None
    except (ValueError, RecursionError):  # no Unicode, absurdly long numbers, absurdly deep nesting
        raise RigError(f"{path}: malformed JSON; correct the file") from None
    return value
