"""What was made, of what: a file in the folder of what is made, beside it.

A step is up to date while nothing that its result depends on is another: command, options, version, and the contents of
all files that it reads. What lies in its place is only replaced if it is what the step made.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from decogs import __version__
from decogs.formats.errors import UsageError
from decogs.formats.files.outputs import write_whole
from decogs.formats.system.operating_systems import take_lock

from .steps import STAGING, Step

FILE = ".decogs-make.json"
_PIECE = 1 << 20
_VERSION = 1


@dataclass
class Made:
    """Of one step: the ``fingerprint`` of what it depends on, the ``files`` that it made, by their path in its place,
    with their digests, and those that lay there before, until they are replaced."""

    fingerprint: str
    files: dict[str, str]
    replaced: dict[str, str] = field(default_factory=dict)


class Records:
    """The record of a take: what its steps made, and what was being made; digests of files are kept while their sizes
    and times stay."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE
        self._digests: dict[str, list[Any]] = {}
        self.made: dict[str, Made] = {}
        self.begun: dict[str, str] = {}
        self._load()

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Nobody else makes this take meanwhile. Raises UsageError where somebody does."""
        self._path.parent.mkdir(parents=True, exist_ok=True)
        with self._path.with_suffix(".lock").open("ab") as file:
            try:
                take_lock(file.fileno())
            except BlockingIOError:
                raise UsageError(f"{self._path.parent}: is being made by another decogs-make; wait for it") from None
            except OSError:
                pass  # Some network file systems have no locks.
            self._load()
            yield

    def save(self) -> None:
        """Writes it, whole or not at all."""
        made = {name: asdict(entry) for name, entry in self.made.items()}
        # What was worked on lies elsewhere by now.
        digests = {file: known for file, known in self._digests.items() if STAGING not in file}
        document = {"version": _VERSION, "made": made, "begun": self.begun, "digests": digests}
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(self._path, json.dumps(document, indent=1, sort_keys=True).encode())

    def digests(self, place: Path) -> dict[str, str]:
        """The digest of each file in a place, by its path there; of a file, "" is its path. Empty where nothing is."""
        return {
            "" if file == place else file.relative_to(place).as_posix(): self._digest(file) for file in _files(place)
        }

    def fingerprint(self, step: Step, folder: Path, read: Sequence[str]) -> str:
        """Of all that a step's result depends on; ``read``: the files and folders that it reads, from ``folder``."""
        inputs = {name: self.digests(folder / name) for name in read}
        told = json.dumps([__version__, step.line(), inputs], sort_keys=True)
        return hashlib.sha256(told.encode()).hexdigest()

    def _digest(self, file: Path) -> str:
        status = file.stat()
        stamp = [status.st_size, status.st_mtime_ns, status.st_ino]
        known = self._digests.get(str(file))
        if known is not None and known[:3] == stamp:
            return str(known[3])
        digest = file_digest(file)
        self._digests[str(file)] = [*stamp, digest]
        return digest

    def _read(self) -> Any:
        try:
            return json.loads(self._path.read_bytes())
        except FileNotFoundError:
            return {"version": _VERSION, "made": {}, "begun": {}, "digests": {}}

    def _load(self) -> None:
        try:
            self._take_over(self._read())
        except (AttributeError, KeyError, TypeError, ValueError):
            raise UsageError(
                f"{self._path}: is no record of what was made; move the folder away, or name another output"
            ) from None

    def _take_over(self, document: Any) -> None:
        """Raises one of several errors for what is no record."""
        if document["version"] != _VERSION:
            raise ValueError
        self.made = {str(name): Made(**entry) for name, entry in document["made"].items()}
        self.begun, self._digests = dict(document["begun"]), dict(document["digests"])


def file_digest(path: Path) -> str:
    """The SHA-256 of a file, hexadecimal."""
    digest = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(_PIECE):
            digest.update(piece)
    return digest.hexdigest()


def _files(place: Path) -> Iterator[Path]:
    """All files in a folder, in order of their paths, or the file; links are followed but to folders."""
    if place.is_file():
        yield place
    for folder, folders, names in os.walk(place):
        folders.sort()
        yield from (Path(folder) / name for name in sorted(names) if (Path(folder) / name).is_file())


def foreign_file(there: Mapping[str, str], made: Made | None) -> str | None:
    """One of the files that are ``there`` in a step's place which the step did not make; None if it made all."""
    for name, digest in there.items():
        if made is None or digest not in (made.files.get(name), made.replaced.get(name)):
            return name
    return None
