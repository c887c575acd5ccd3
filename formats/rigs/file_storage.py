"""Values at the top of a file that OpenCV's FileStorage wrote, in YAML or XML.

OpenCV's own parser calls itself for every list in a list, so that a few thousand brackets, dashes or tags end the
process, and allocates what a matrix's header claims. Here a key is what begins a line, or an element below the root,
and a matrix is the numbers of its ``data``. Source: OpenCV documentation, "XML/YAML/JSON file storages".
"""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ..errors import RigError
from .fields import parse_xml, read_calibration_file

_MAX_LENGTH = 1 << 20
"""Characters of one value that is read."""


class FileStorage:
    """The values by their keys; raises RigError, naming file and key, for what is missing or of another kind."""

    def __init__(self, path: Path) -> None:
        self.path = path
        data = read_calibration_file(path)
        is_xml = data.lstrip().startswith(b"<")
        self._values = _of_xml(parse_xml(path, data)) if is_xml else _of_yaml(data.decode("utf-8-sig", "replace"))
        if not self._values:
            raise RigError(f"{path}: not a file of OpenCV's FileStorage, or empty; write it again")

    def __contains__(self, key: str) -> bool:
        return key in self._values

    def keys_after(self, prefix: str) -> list[str]:
        """What follows ``prefix`` in the keys that begin with it."""
        return sorted(key[len(prefix) :] for key in self._values if key.startswith(prefix))

    def number(self, key: str, default: float) -> float:
        """A finite number; ``default`` where there is none."""
        return float(self.matrix(key, 1)[0]) if key in self else default

    def text(self, key: str) -> str:
        """A text fit for one line of a message."""
        text = self._value(key).strip().strip('"')
        if not text.isprintable():
            raise self.wrong(key, "is not one line of text")
        return text

    def matrix(self, key: str, *sizes: int) -> NDArray[np.float64]:
        """The finite numbers of a matrix in the order of its rows; as many as one of ``sizes``, if any is given."""
        words = self._value(key).replace("[", " ").replace("]", " ").replace(",", " ").split()
        try:
            numbers = np.array([float(word) for word in words])
        except ValueError:
            numbers = np.array([math.nan])
        if not np.isfinite(numbers).all():
            raise self.wrong(key, "is not a matrix of finite numbers")
        if sizes and numbers.size not in sizes:
            raise self.wrong(key, f"has {numbers.size} numbers, not {' or '.join(map(str, sizes))}")
        return numbers

    def wrong(self, key: str, what: str) -> RigError:
        """The error to raise for a value: ``what`` is wrong with it."""
        return RigError(f"{self.path}: {key!r} {what}; correct the file")

    def _value(self, key: str) -> str:
        if key not in self:
            raise self.wrong(key, "is missing")
        if len(self._values[key]) > _MAX_LENGTH:
            raise self.wrong(key, "is longer than a camera's value")
        return self._values[key]


def _of_yaml(text: str) -> dict[str, str]:
    """What follows each key that begins a line, up to the next one; of a matrix only its data."""
    blocks: dict[str, list[str]] = {}
    lines: list[str] = []
    for line in text.splitlines():
        if line[:1].isalpha() or line[:1] == "_":
            key, _, first = line.partition(":")
            lines = blocks[key.rstrip()] = [first]
        elif not line.startswith(("%", "---", "...", "#")):
            lines.append(line)
    values = {key: "\n".join(lines) for key, lines in blocks.items()}
    return {key: value.partition("data:")[2] if "!!opencv-" in value[:40] else value for key, value in values.items()}


def _of_xml(root: ElementTree.Element) -> dict[str, str]:
    return {child.tag: child.findtext("data") or child.text or "" for child in root}
