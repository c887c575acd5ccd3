"""Packages whose names are loaded when somebody asks for them: whoever wants one need not wait for all.

A command's module lies in such a package, and to import a module runs its package first.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any


def lazy_names(package: str, homes: Mapping[str, str]) -> Callable[[str], Any]:
    """A package's ``__getattr__`` (PEP 562); ``homes``: the module, relative to the package, of every name.

    The package imports the same names where only type checkers look, since they see no other way.
    """

    def load(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(f".{homes[name]}", package), name)

    return load
