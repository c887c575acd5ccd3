"""Values of a file that OpenCV's FileStorage wrote: YAML, XML or JSON."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import RigError
from ..quiet import quiet_opencv
from .fields import read_calibration_file

_MAX_DEPTH = 32
"""Brackets inside brackets; OpenCV's parser calls itself for each."""


class FileStorage:
    """The top level of such a file; raises RigError, naming file and key, for what is missing or of another kind."""

    def __init__(self, path: Path) -> None:
        import cv2

        self.path = path
        text = read_calibration_file(path).decode("utf-8-sig", errors="replace")
        # In memory: by its path OpenCV also opens what is compressed, of any size.
        if _is_too_deep(text) or "<!DOCTYPE" in text or "\0" in text:
            raise self._malformed()
        try:
            with quiet_opencv():
                self._storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
                self._keys = frozenset(self._storage.root().keys())
        except (cv2.error, SystemError):
            raise self._malformed() from None

    def __contains__(self, key: str) -> bool:
        return key in self._keys

    def keys_after(self, prefix: str) -> list[str]:
        """What follows ``prefix`` in the keys that begin with it."""
        return sorted(key[len(prefix) :] for key in self._keys if key.startswith(prefix))

    def number(self, key: str, default: float) -> float:
        """A finite number; ``default`` where there is none."""
        if key not in self:
            return default
        node = self._storage.getNode(key)
        if not (node.isReal() or node.isInt()) or not math.isfinite(node.real()):
            raise self.wrong(key, "is not a finite number")
        return float(node.real())

    def text(self, key: str) -> str:
        """A text."""
        node = self._node(key)
        if not node.isString():
            raise self.wrong(key, "is not a text")
        return str(node.string())

    def matrix(self, key: str, *sizes: int) -> NDArray[np.float64]:
        """The finite numbers of a matrix in the order of its rows; as many as one of ``sizes``, if any is given."""
        data = self._node(key)
        data = data.getNode("data") if data.isMap() else data
        # Read one by one: what the file says of rows and columns would be allocated before it is compared.
        numbers = np.array([self._element(key, data.at(i)) for i in range(data.size())]) if data.isSeq() else None
        if numbers is None or not np.isfinite(numbers).all():
            raise self.wrong(key, "is not a matrix of finite numbers")
        if sizes and numbers.size not in sizes:
            raise self.wrong(key, f"has {numbers.size} numbers, not {' or '.join(map(str, sizes))}")
        return numbers

    def wrong(self, key: str, what: str) -> RigError:
        """The error to raise for a value: ``what`` is wrong with it."""
        return RigError(f"{self.path}: {key!r} {what}; correct the file")

    def _node(self, key: str) -> Any:
        if key not in self:
            raise self.wrong(key, "is missing")
        return self._storage.getNode(key)

    def _element(self, key: str, node: Any) -> float:
        if not (node.isReal() or node.isInt()):
            raise self.wrong(key, "is not a matrix of finite numbers")
        return float(node.real())

    def _malformed(self) -> RigError:
        return RigError(f"{self.path}: not a file of OpenCV's FileStorage, or malformed; write it again")


def _is_too_deep(text: str) -> bool:
    depth = 0
    for character in text:
        depth += (character in "[{") - (character in "]}")
        if depth > _MAX_DEPTH:
            return True
    return False
