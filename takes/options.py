"""Options of commands as tables of a take file: the commands' own parsers say what there is."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, NoReturn

from decogs.formats.cli.command_line import Parser
from decogs.formats.errors import UsageError

_PARSERS = {
    "decogs-analyze": "encoder.analysis.commands:analyze_parser",
    "decogs-calibrate": "rig.calibration.commands:calibrate_parser",
    "decogs-decode": "decoder.commands:decode_parser",
    "decogs-edit": "decoder.editing.commands:edit_parser",
    "decogs-encode": "encoder.commands:encode_parser",
    "decogs-export": "decoder.commands:export_parser",
    "decogs-sync": "rig.synchronisation.commands:sync_parser",
    "decogs-view": "decoder.commands:view_parser",
}
_OWN = {"output", "quiet", "help", "version", "resume", "overwrite", "no_browser", "port", "follow", "idle", "only"}
"""What a take's making decides."""


def arguments(command: str, table: Mapping[str, Any], where: str) -> list[str]:
    """The options of ``command`` that a table asks for; its members are their long names, with _ or -.

    ``true`` stands for a flag, a list for an option that may be repeated. Raises UsageError, which names ``where`` the
    table stands, for a member that is no option, or a value that it does not take.
    """
    options = {name: action for action in _parser(command)._actions for name in action.option_strings}
    words: list[str] = []
    for name, value in table.items():
        option = f"--{name.replace('_', '-')}"
        action = options.get(option)
        if action is None or action.dest in _OWN:
            known = sorted(each[2:] for each, a in options.items() if each.startswith("--") and a.dest not in _OWN)
            raise UsageError(f"{where}: {name!r} is no option of {command} here; it has {', '.join(known)}")
        words += _words(option, action, value, f"{where}: {name}")
    return words


def check(command: str, words: list[str], where: str) -> None:
    """Raises UsageError, which names ``where``, unless the command takes the words behind its name."""
    parser = _parser(command)

    def refuse(message: str) -> NoReturn:
        raise UsageError(f"{where}: {message} ({command} --help)")

    parser.error = refuse  # type: ignore[method-assign]
    parser.parse_args(words)


def _parser(command: str) -> Parser:
    module, _, name = _PARSERS[command].partition(":")
    make: Callable[[], Parser] = getattr(import_module(f"decogs.{module}"), name)
    return make()


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
