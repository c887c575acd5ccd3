"""Options of commands as tables of a take file: the commands' own parsers say what there is."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, NoReturn

from decogs.formats.cli.command_line import Parser
from decogs.formats.cli.option_tables import words_of
from decogs.formats.errors import UsageError

_PARSERS = {
    "decogs-analyze": "encoder.analyze_command:analyze_parser",
    "decogs-calibrate": "rig.calibration.commands:calibrate_parser",
    "decogs-decode": "decoder.commands:decode_parser",
    "decogs-edit": "decoder.editing.commands:edit_parser",
    "decogs-encode": "encoder.commands:encode_parser",
    "decogs-export": "decoder.commands:export_parser",
    "decogs-report": "takes.commands:report_parser",
    "decogs-sync": "rig.synchronisation.commands:sync_parser",
    "decogs-view": "decoder.commands:view_parser",
}
_OWN = {"output", "quiet", "help", "version", "resume", "overwrite", "no_browser", "port", "follow", "idle", "only"}
_OWN |= {"live", "config"}
"""What a take's making decides, by what options set."""


def arguments(command: str, table: Mapping[str, Any], where: str) -> list[str]:
    """The options of ``command`` that a table asks for. Raises UsageError, which names ``where`` the table stands."""
    return words_of(_parser(command), table, where, _OWN)


def check(command: str, words: list[str], where: str) -> None:
    """Raises UsageError, which names ``where``, unless the command takes the words behind its name."""
    parser = _parser(command)

    def refuse(message: str) -> NoReturn:
        raise UsageError(f"{where}: {message} ({command} --help)")

    parser.error = refuse  # type: ignore[method-assign]
    parser.parse_args(words)


def has_option(command: str, option: str) -> bool:
    """Whether the command has this option."""
    return any(option in action.option_strings for action in _parser(command)._actions)


def _parser(command: str) -> Parser:
    module, _, name = _PARSERS[command].partition(":")
    make: Callable[[], Parser] = getattr(import_module(f"decogs.{module}"), name)
    return make()
