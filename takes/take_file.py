"""take.toml: what is recorded, how it is encoded and edited, and what is delivered (docs/takes.md)."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from decogs.decoder.editing.recipe import parse_operations
from decogs.formats.errors import UsageError
from decogs.formats.rigs.fields import read_toml

from . import options
from .deliverables import CAMERAS, KINDS
from .steps import Step

_TEXTS = ("rig", "output", "title")
_TABLES = ("calibrate", "sync", "encode", "edit", "deliver")
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
STREAM = "scene.dgs"


@dataclass(frozen=True)
class Take:
    """A take file that is right: its ``folder``, from which all its paths count; the folder of what is made, below
    that; the ``steps`` in an order in which they can be done."""

    path: Path
    folder: Path
    output: PurePosixPath
    steps: tuple[Step, ...]


def read_take(path: Path) -> Take:
    """The take in a file. Raises UsageError, which names file and member, for whatever is wrong in it."""
    values = read_toml(path).values
    for name, value in values.items():
        if name not in (*_TEXTS, *_TABLES):
            raise UsageError(f"{path}: there is no {name!r} in a take; it has {', '.join((*_TEXTS, *_TABLES))}")
        if not isinstance(value, str if name in _TEXTS else dict):
            raise UsageError(f"{path}: {name} is {'no text' if name in _TEXTS else 'no table'}")
    if not values.get("rig"):
        raise UsageError(f'{path}: names no rig; write rig = "FOLDER"')
    output = _relative(values.get("output", path.stem), f"{path}: output")
    maker = _Maker(path, output)
    stream = maker.stream(values)
    wanted: Any = values.get("deliver", {})
    for name, table in wanted.items():
        maker.deliver(name, table, stream)
    return Take(path, path.parent, output, tuple(maker.steps))


class _Maker:
    """Collects the steps of a take."""

    def __init__(self, path: Path, output: PurePosixPath) -> None:
        self._path, self._output = path, output
        self.steps: list[Step] = []
        self._rig: dict[str, Any] = {}

    def stream(self, values: Mapping[str, Any]) -> str:
        """The steps up to the edited stream; returns its path."""
        rig = values["rig"]
        if "calibrate" in values:
            rig = self._add("calibrate", "decogs-calibrate", [rig], values["calibrate"], "rig/")
        if "sync" in values:
            rig = self._add("sync", "decogs-sync", [rig], values["sync"], "rig_in_step/")
        edits, encode = values.get("edit", {}), values.get("encode", {})
        self._rig = {"rig": rig} | ({"sync": encode["sync"]} if "sync" in encode else {})
        words = self._operations(edits, values.get("title"))
        stream = self._add("encode", "decogs-encode", [rig], encode, "encoded.dgs" if words else STREAM)
        return self._add("edit", "decogs-edit", [stream], {}, STREAM, behind=words) if words else stream

    def deliver(self, name: str, table: Any, stream: str) -> None:
        where = f"{self._path}: [deliver.{name}]"
        if not _NAME.fullmatch(name):
            raise UsageError(f"{where}: {name!r} is no name; letters, digits, - and _ are")
        if name in (step.name for step in self.steps):
            raise UsageError(f"{where}: {name} is a step of the take itself; choose another name, and say its kind")
        if not isinstance(table, dict):
            raise UsageError(f"{where}: is no table")
        kind = KINDS.get(table.get("kind", name))
        if kind is None:
            raise UsageError(f"{where}: kind {table.get('kind', name)!r} is none of {', '.join(KINDS)}")
        chosen = {**kind.options, **{key: value for key, value in table.items() if key not in ("kind", "file")}}
        if kind.command == "decogs-decode" and not any(chosen.get(member) for member in CAMERAS):
            raise UsageError(f"{where}: nothing says from where: view, camera, orbit or spiral")
        text = table.get("file", f"{name}{_ending(kind.file)}")
        file = f"{_relative(text, f'{where}: file')}{'/' * text.endswith('/')}"
        if "####" in file and "/" not in file:
            raise UsageError(f"{where}: file {file!r} is many files: put them into a folder, such as {name}/{file}")
        chosen |= self._rig if kind.reads_rig else {}
        self._add(name, kind.command, [stream], chosen, file)

    def _operations(self, table: Mapping[str, Any], title: str | None) -> list[str]:
        where = f"{self._path}: [edit]"
        lines = table.get("operations", [])
        if (
            set(table) - {"operations"}
            or not isinstance(lines, list)
            or not all(isinstance(each, str) for each in lines)
        ):
            raise UsageError(f'{where}: holds a list alone, such as operations = ["trim 0:48", "clean"]')
        words = [word for line in lines for word in _split(line, where)] + (
            ["set", f"--title={title}"] if title else []
        )
        try:
            parse_operations(words)
        except UsageError as error:
            raise UsageError(f"{where}: {error}") from None
        return words

    def _add(
        self,
        name: str,
        command: str,
        inputs: list[str],
        table: Mapping[str, Any],
        output: str,
        *,
        behind: list[str] | None = None,
    ) -> str:
        where = f"{self._path}: [{name}]"
        made = f"{self._output}/{output}"
        words = options.arguments(command, table, where)
        if command != "decogs-edit":
            options.check(command, [*inputs, "-o", made.rstrip("/"), *words], where)
        step = Step(name, command, tuple(inputs), made, (*words, *(behind or [])))
        place = PurePosixPath(step.place)
        for other in self.steps:
            there = PurePosixPath(other.place)
            if place in (there, *there.parents) or there in place.parents:
                raise UsageError(f"{where}: makes {place}, where [{other.name}] makes {there}; name another file")
        self.steps.append(step)
        return made.rstrip("/")


def _split(line: str, where: str) -> list[str]:
    try:
        return shlex.split(line)
    except ValueError as error:
        raise UsageError(f"{where}: {line!r}: {error}") from None


def _ending(file: str) -> str:
    return file[file.index("/") :] if "/" in file else PurePosixPath(file).suffix


def _relative(text: Any, where: str) -> PurePosixPath:
    """A path below the folder that it counts from."""
    path = PurePosixPath(str(text))
    if not isinstance(text, str) or path.is_absolute() or ".." in path.parts or not path.parts:
        raise UsageError(f"{where} is {text!r}: write a path below the take's own folder")
    return path
