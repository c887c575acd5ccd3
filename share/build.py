"""Writes the man pages and the completions of bash and zsh, which the wheel installs, from the commands' own options.

    python share/build.py

They are committed, so that a build needs no more than setuptools; a test compares them with the options. fish makes its
completions of the man pages (``fish_update_completions``).
"""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path

import shtab
from argparse_manpage.manpage import Manpage

from decogs import __version__
from decogs.bench.commands import bench_parser
from decogs.decoder.commands import decode_parser, export_parser, info_parser, view_parser
from decogs.decoder.editing.commands import edit_parser
from decogs.decoder.editing.operations import OPERATIONS
from decogs.encoder import PRESETS
from decogs.encoder.analyze_command import analyze_parser
from decogs.encoder.commands import encode_parser
from decogs.encoder.packing.commands import pack_parser
from decogs.encoder.parts.commands import join_parser
from decogs.rig.calibration.commands import calibrate_parser
from decogs.rig.synchronisation.commands import sync_parser
from decogs.takes.commands import make_parser, report_parser, verify_parser

SHARE = Path(__file__).parent
PARSERS = (
    analyze_parser,
    calibrate_parser,
    bench_parser,
    decode_parser,
    edit_parser,
    encode_parser,
    export_parser,
    info_parser,
    join_parser,
    make_parser,
    pack_parser,
    report_parser,
    sync_parser,
    verify_parser,
    view_parser,
)
FOLDERS = {"rig_dir", "rigs", "rig", "new"}
FILES = {
    "output",
    "stream",
    "files",
    "parts",
    "camera",
    "audio",
    "keyframe",
    "log",
    "convergence_log",
    "sync",
    "recipe",
    "takes",
}
"""What arguments name, by what they set."""
EXIT_STATUS = """0: all went well. 2: an error, which one line on stderr names. 75: try again (parts of a take alone).
130: interrupted by Ctrl\\-C. 141: the reader of a pipe is gone."""
WORDS = {
    "settings": list(PRESETS),
    "device": ["auto", "cpu", "cuda"],
    "cluster": ["local"],
    "operations": list(OPERATIONS),
}


def shell_files() -> dict[str, str]:
    """The text of every file, by its path in share/."""
    # A page is wrapped where it is shown; wrapped here, an option's name would break at its dash.
    os.environ["COLUMNS"] = "10000"
    files: dict[str, str] = {}
    for make in PARSERS:
        parser = make()
        files[f"man/man1/{parser.prog}.1"] = _man_page(parser)
        _tell_values(parser)
        files[f"bash-completion/completions/{parser.prog}"] = _completion(parser, "bash")
        files[f"zsh/site-functions/_{parser.prog}"] = _completion(parser, "zsh")
    return files


def _man_page(parser: argparse.ArgumentParser) -> str:
    page = Manpage(parser)
    page.date, page.source, page.manual = "", f"decogs {__version__}", "decogs"
    page.description = re.split(r"\.(?:\s|$)", parser.description or "")[0]
    page.add_section("exit status", "=", EXIT_STATUS)
    return str(page)


def _completion(parser: argparse.ArgumentParser, shell: str) -> str:
    lines = shtab.complete(parser, shell=shell).splitlines()
    return "".join(f"{line.rstrip()}\n" for line in lines)


def _tell_values(parser: argparse.ArgumentParser) -> None:
    """Says what completes the value of each argument: files, folders, or words that the library knows."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for within in action.choices.values():
                _tell_values(within)
        elif action.dest in WORDS:
            action.choices = WORDS[action.dest]
        elif action.dest in FOLDERS:
            action.complete = shtab.DIRECTORY  # type: ignore[attr-defined]
        elif action.dest in FILES or (action.dest == "json" and action.metavar):
            action.complete = shtab.FILE  # type: ignore[attr-defined]


if __name__ == "__main__":
    for name, text in shell_files().items():
        path = SHARE / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    sys.stdout.write(f"{SHARE}: written\n")
