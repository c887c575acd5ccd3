"""How a stream wants to be shown: what it is called, and where a player begins (SPEC.md, "Presentation").

Nothing of it is needed for decoding. What is out of its bounds counts as absent, so that a reader which knows no
presentation makes the same of any stream.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

MAX_TITLE = 1 << 16
MAX_POSTER = (1 << 31) - 1


@dataclass(frozen=True)
class Presentation:
    """``title``: what the stream is called; ``poster``: the frame that stands for it; ``first_view``: a camera's name.

    What is empty or None is left to whoever shows the stream.
    """

    title: str = ""
    poster: int | None = None
    first_view: str | None = None

    def as_document(self) -> dict[str, Any]:
        """The header's member; empty where there is nothing to say."""
        return {name: value for name, value in vars(self).items() if value not in ("", None)}


def read_presentation(document: object, cameras: Collection[str]) -> Presentation:
    """The presentation in a header's member of that name, None for none; ``cameras``: the stream's, by name."""
    members = document if isinstance(document, Mapping) else {}
    title, poster, first_view = (members.get(name) for name in ("title", "poster", "first_view"))
    return Presentation(
        title if isinstance(title, str) and len(title) <= MAX_TITLE else "",
        poster if type(poster) is int and 0 <= poster <= MAX_POSTER else None,
        first_view if isinstance(first_view, str) and first_view in cameras else None,
    )
