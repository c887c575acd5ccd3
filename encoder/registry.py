"""Extension points: implementations by name, our own and those of installed packages (docs/extending.md).

Chosen: entry points, as zarr has its codecs: a package joins by being installed, nothing is imported before its name is
asked for, and a stream's header, which has the name, says what is missing. Rejected: registration by import (the user
would have to import the package first, and the commands cannot).
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Generic, TypeVar

from decogs.formats.errors import UsageError

T = TypeVar("T")


class Registry(Generic[T]):
    """The implementations of one extension point.

    ``kind``: its name in messages; ``group``: the entry points under which packages offer theirs; ``own``: ours, which
    no package can replace.
    """

    def __init__(self, kind: str, group: str, own: Mapping[str, T]) -> None:
        self._kind, self._group, self._own = kind, group, dict(own)
        self._loaded: dict[str, T] = {}

    def names(self) -> tuple[str, ...]:
        """Ours first, then those of packages in alphabetical order."""
        return (*self._own, *sorted(self._offered()))

    def get(self, name: str) -> T:
        """The implementation of that name. Raises UsageError for an unknown one, or one that cannot be imported."""
        if name in self._own:
            return self._own[name]
        # Asked for in every frame, and it takes milliseconds to look through all installed packages.
        if name in self._loaded:
            return self._loaded[name]
        offered = self._offered().get(name)
        if offered is None:
            raise UsageError(f"{name}: there is no such {self._kind}; choose from {', '.join(self.names())}")
        try:
            loaded: T = offered.load()
        except Exception as error:  # whatever a stranger's module does when it is imported
            raise UsageError(f"{name}: the {self._kind} {offered.value} cannot be imported: {error}") from error
        self._loaded[name] = loaded
        return loaded

    def _offered(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=self._group) if point.name not in self._own}
