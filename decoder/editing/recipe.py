"""Operations as users write them: words behind each other on the command line, and lists of lines in a file."""

from __future__ import annotations

import argparse
import os
import re
import shlex
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import NoReturn

from decogs.formats.cli.command_line import Parser
from decogs.formats.errors import UsageError
from decogs.formats.rigs.fields import read_toml

from .operations import OPERATIONS
from .operations.base import Operation

_LIST = "operations"


class _OptionParser(Parser):
    """The options of one operation; coordinates and ranges may begin with a minus."""

    def __init__(self, operation: type[Operation]) -> None:
        super().__init__(prog=f"decogs-edit SCENE.DGS -o OUT.DGS {operation.name}", description=f"{operation.summary}.")
        self._name = operation.name
        self._negative_number_matcher = re.compile(r"-[0-9.].*")
        operation.add_options(self)

    def takes_value(self, word: str) -> bool:
        """Whether the next word is the value of this one, an option or the beginning of its name."""
        named = [action for action in self._actions if any(each.startswith(word) for each in action.option_strings)]
        return word.startswith("--") and len(named) == 1 and named[0].nargs != 0

    def error(self, message: str) -> NoReturn:
        raise UsageError(f"{self._name}: {message} (decogs-edit {self._name} --help)")


def operation_parser(name: str) -> _OptionParser:
    """The options behind an operation's name."""
    return _OptionParser(OPERATIONS[name])


def parse_operation(words: Sequence[str]) -> Operation:
    """The operation that ``words``, its name first, ask for. Raises UsageError."""
    name, *rest = words
    if name not in OPERATIONS:
        raise UsageError(f"{name}: there is no such operation; choose from {', '.join(OPERATIONS)}")
    return OPERATIONS[name].of_options(operation_parser(name).parse_args(rest))


def parse_operations(words: Sequence[str]) -> list[Operation]:
    """The operations in a list of words, each from its name up to the next one's. Raises UsageError."""
    begins = [] if not words or words[0] in OPERATIONS else [0]  # which says what is wrong with the first word
    is_value = False
    for index, word in enumerate(words):
        if word in OPERATIONS and not is_value:
            begins.append(index)
            parser = operation_parser(word)
            is_value = any(not action.option_strings and action.nargs in (None, "+") for action in parser._actions)
        else:
            is_value = bool(begins and words[begins[-1]] in OPERATIONS) and parser.takes_value(word)
    return [parse_operation(words[a:b]) for a, b in pairwise([*begins, len(words)])]


def read_recipe(path: str | os.PathLike[str]) -> list[Operation]:
    """The operations that a TOML file lists: ``operations = ["trim 0:48", "set --title 'Take 3'"]``, a line each.

    Raises UsageError, which names the file, for anything else.
    """
    fields = read_toml(Path(path))
    lines = fields.values.get(_LIST)
    if not isinstance(lines, list) or not lines or not all(isinstance(line, str) and line.split() for line in lines):
        raise UsageError(f'{path}: is no recipe; write a list such as {_LIST} = ["trim 0:48", "strip provenance"]')
    if others := [name for name in fields.values if name != _LIST]:
        raise UsageError(f"{path}: {others[0]!r} is no part of a recipe, which has {_LIST} alone")
    return [_parse_line(line, path) for line in lines]


def _parse_line(line: str, path: str | os.PathLike[str]) -> Operation:
    try:
        return parse_operation(shlex.split(line))
    except (UsageError, ValueError) as error:  # shlex: a quotation without an end
        raise UsageError(f"{path}: {line!r}: {error}") from None


def split_arguments(words: Sequence[str], parser: argparse.ArgumentParser) -> tuple[list[str], list[str]]:
    """The command's own arguments, and the operations behind them.

    Options that are flags may also stand behind the operations.
    """
    takes_value = {name for action in parser._actions if action.nargs != 0 for name in action.option_strings}
    flags = {name for action in parser._actions if action.nargs == 0 for name in action.option_strings}
    begin = next(
        (
            index
            for index, word in enumerate(words)
            if word in OPERATIONS and not (index and words[index - 1] in takes_value)
        ),
        len(words),
    )
    flags -= {"-h", "--help", "--version"}  # of the operation
    behind = [word for word in words[begin:] if word in flags]
    return [*words[:begin], *behind], [word for word in words[begin:] if word not in flags]
