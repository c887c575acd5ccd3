"""Options of a command as a table of a TOML file: its members are their long names, with _ or -."""

from __future__ import annotations

import argparse
from collections.abc import Collection, Mapping
from typing import Any

from ..errors import UsageError


def words_of(
    parser: argparse.ArgumentParser, table: Mapping[str, Any], where: str, without: Collection[str]
) -> list[str]:
    """The words on a command line that a ``table`` stands for: ``true`` is a flag, a list repeats an option.

    ``without``: what options set that no table may. Raises UsageError, which names ``where`` the table stands, for a
    member that is no option, or a value of another kind than the option takes.
    """
    options = {name: action for action in parser._actions for name in action.option_strings}
    words: list[str] = []
    for name, value in table.items():
        option = f"--{name.replace('_', '-')}"
        action = options.get(option)
        if action is None or action.dest in without:
            known = sorted(each[2:] for each, a in options.items() if each.startswith("--") and a.dest not in without)
            raise UsageError(f"{where}: {name!r} is no option of {parser.prog} here; it has {', '.join(known)}")
        words += _words(option, action, value, f"{where}: {name}")
    return words


def _words(option: str, action: argparse.Action, value: Any, where: str) -> list[str]:
    if action.nargs == 0:
        if not isinstance(value, bool):
            raise UsageError(f"{where} is a switch: write true or false")
        return [option] if value else []
    values = value if isinstance(value, list) else [value]
    if isinstance(value, list) and not isinstance(action, argparse._AppendAction):
        raise UsageError(f"{where} is given once: write one value, no list")
    for each in values:
        if isinstance(each, bool) or not isinstance(each, (str, int, float)):
            raise UsageError(f"{where} is {each!r}: write a text or a number")
    return [f"{option}={each}" for each in values]
