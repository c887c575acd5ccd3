"""How a stream wants to be shown: what it is called, and where a player begins (SPEC.md, "Presentation").

Nothing of it is needed for decoding. What is out of its bounds counts as absent, so that a reader which knows no
presentation makes the same of any stream.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from decogs.formats.geometry.rotations import is_orthonormal
from decogs.formats.geometry.similarity import NO_CHANGE, Similarity

MAX_TITLE = 1 << 16
MAX_POSTER = (1 << 31) - 1
MAX_SCALE = 1e6
"""Of a transform, and its reciprocal the least."""

_COORDINATE_MAX = 1e12
_RIGID_TOLERANCE = 1e-2

Matrix = tuple[tuple[float, float, float, float], ...]
"""Three rows."""


@dataclass(frozen=True)
class Presentation:
    """``title``: what the stream is called; ``poster``: the frame that stands for it; ``first_view``: a camera's name.

    ``transform``: takes scene and cameras as they are stored to the world in which they are shown; a rotation times a
    scale, and a shift. What is empty or None is left to whoever shows the stream.
    """

    title: str = ""
    poster: int | None = None
    first_view: str | None = None
    transform: Matrix | None = None

    @property
    def similarity(self) -> Similarity:
        """The transform."""
        if self.transform is None:
            return NO_CHANGE
        matrix = np.array(self.transform)
        scale = _scale_of(matrix)
        return Similarity(matrix[:, :3] / scale, scale, matrix[:, 3])

    def as_document(self) -> dict[str, Any]:
        """The header's member; empty where there is nothing to say."""
        document = {name: value for name, value in vars(self).items() if value not in ("", None)}
        if self.transform is not None:
            document["transform"] = [list(map(float, row)) for row in self.transform]
        return document


def read_presentation(document: object, cameras: Collection[str]) -> Presentation:
    """The presentation in a header's member of that name, None for none; ``cameras``: the stream's, by name."""
    members = document if isinstance(document, Mapping) else {}
    title, poster, first_view = (members.get(name) for name in ("title", "poster", "first_view"))
    transform = _matrix(members.get("transform"))
    return Presentation(
        title if isinstance(title, str) and len(title) <= MAX_TITLE else "",
        poster if type(poster) is int and 0 <= poster <= MAX_POSTER else None,
        first_view if isinstance(first_view, str) and first_view in cameras else None,
        transform if transform is not None and _is_similarity(np.array(transform)) else None,
    )


def transform_of(similarity: Similarity) -> Matrix | None:
    """The member that says so; None where nothing is transformed."""
    if similarity.is_identity:
        return None
    a, b, c = similarity.matrix[:3].tolist()
    return tuple(a), tuple(b), tuple(c)


def _matrix(value: object) -> Matrix | None:
    """Three rows of four numbers, none too large; None for anything else."""
    if not isinstance(value, list) or len(value) != 3:
        return None
    if not all(isinstance(row, list) and len(row) == 4 for row in value):
        return None
    numbers = [number for row in value for number in row]
    if not all(type(number) in (int, float) and abs(number) <= _COORDINATE_MAX for number in numbers):
        return None
    return tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in value)


def _is_similarity(matrix: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> bool:
    scale = _scale_of(matrix)
    return 1 / MAX_SCALE <= scale <= MAX_SCALE and is_orthonormal(matrix[:, :3] / scale, _RIGID_TOLERANCE)


def _scale_of(matrix: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    """The cube root of how it changes volumes; not above 0 for one that mirrors."""
    return float(np.cbrt(np.linalg.det(matrix[:, :3])))
