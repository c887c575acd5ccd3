"""Extension points: implementations by name, our own and those of installed packages (docs/extending.md).

Chosen: entry points, as zarr has its codecs: a package joins by being installed, nothing is imported before its name is
asked for, and a stream's header, which has the name, says what is missing. Rejected: registration by import (the user
would have to import the package first, and the commands cannot).

What a package offers is guarded: what it raises and what it returns wrongly is a UsageError that names package and
entry point. Python shows the error inside as its cause.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Generic, TypeVar

from decogs.formats.errors import DecogsError, UsageError
from decogs.formats.system.extras import install

T = TypeVar("T")
Fault = Callable[[str], UsageError]
"""Makes an error that names the implementation, of what it does wrong: a text such as "is no function"."""
Check = Callable[..., str]
"""What is wrong with a result, in words, given it and the arguments of the call; "" for nothing."""


def guarded(check: Check) -> Callable[[Any, Fault], Any]:
    """A guard for functions whose results are checked so."""

    def guard(function: Any, fault: Fault) -> Any:
        if not callable(function):
            raise fault(f"is no function but {described(function)}")

        @wraps(function, updated=())
        def called(*given: Any, **named: Any) -> Any:
            try:
                result = function(*given, **named)
            except (DecogsError, MemoryError):
                raise
            except (Exception, SystemExit) as error:  # whatever a stranger's code does
                raise fault(f"raised {type(error).__name__}: {error}") from error
            if problem := check(result, *given, **named):
                raise fault(f"returned {problem}")
            return result

        return called

    return guard


class GuardedObject:
    """A package's object with those of its methods guarded that ``checks`` names."""

    def __init__(self, inner: object, checks: Mapping[str, Check], fault: Fault) -> None:
        self._inner = inner
        for name, check in checks.items():
            setattr(self, name, guarded(check)(getattr(inner, name, None), fault))

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def anything(result: object, *given: object, **named: object) -> str:
    """The check that accepts any result."""
    return ""


def described(value: object) -> str:
    """A wrong value in a few words: an array's type and shape, else its type."""
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        return f"{value.dtype} {value.shape}"
    return "None" if value is None else type(value).__name__


class Registry(Generic[T]):
    """The implementations of one extension point.

    ``kind``: its name in messages; ``group``: the entry points under which packages offer theirs; ``own``: ours, which
    no package can replace. ``guard``: takes what a package offers, and what makes an error of a problem with it.
    """

    def __init__(self, kind: str, group: str, own: Mapping[str, T], guard: Callable[[Any, Fault], T]) -> None:
        self._kind, self._group, self._own, self._guard = kind, group, dict(own), guard
        self._loaded: dict[str, T] = {}

    def names(self) -> tuple[str, ...]:
        """Ours first, then those of packages in alphabetical order."""
        return (*self._own, *sorted(self._offered()))

    def get(self, name: str) -> T:
        """The implementation of that name. Raises UsageError for an unknown one, or one that cannot be imported."""
        if name in self._own:
            return self._own[name]
        # Used in every frame, and a search through all installed packages takes milliseconds.
        if name in self._loaded:
            return self._loaded[name]
        offered = self._offered().get(name)
        if offered is None:
            raise UsageError(f"{name}: there is no such {self._kind}; choose from {', '.join(self.names())}")
        try:
            loaded = offered.load()
        except (Exception, SystemExit) as error:  # whatever a stranger's module does when it is imported
            if offered.value.startswith("decogs.bench.") and isinstance(error, ModuleNotFoundError):
                message = f"{name}: this {self._kind} comes with the bench, which is not installed: {install('bench')}"
                raise UsageError(message) from error
            raise self._fault(offered, f"cannot be imported: {error}") from error
        self._loaded[name] = self._guard(loaded, lambda problem: self._fault(offered, problem))
        return self._loaded[name]

    def _fault(self, point: EntryPoint, problem: str) -> UsageError:
        package = "" if point.dist is None else f" of the package {point.dist.name}"
        return UsageError(f"{point.name}: the {self._kind} {point.value}{package} {' '.join(problem.split())}")

    def _offered(self) -> dict[str, EntryPoint]:
        return {point.name: point for point in entry_points(group=self._group) if point.name not in self._own}
