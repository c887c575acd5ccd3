"""FLIP, when its package (``flip_evaluator``) is installed: what people see when they flip between two pictures."""

from __future__ import annotations

import importlib
import importlib.util
from functools import lru_cache
from typing import Any

import numpy as np

from .metrics import BytePicture


def flip(seen: BytePicture, recorded: BytePicture) -> float | None:
    """The mean of LDR-FLIP, 0 (alike) to 1, at 67 pixels a degree; None without the package.

    Source: Andersson et al. 2020, by their own implementation.
    """
    package = _package()
    if package is None:
        return None
    one, other = (np.ascontiguousarray(picture, np.float32) / np.float32(255) for picture in (recorded, seen))
    _, mean, _ = package.evaluate(one, other, "LDR", applyMagma=False)
    return float(mean)


@lru_cache(maxsize=1)
def _package() -> Any:
    name = "flip_evaluator"
    return None if importlib.util.find_spec(name) is None else importlib.import_module(name)
