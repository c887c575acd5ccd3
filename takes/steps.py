"""The steps of a take: each is one public command."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import PurePosixPath

STAGING = ".decogs-making-"


@dataclass(frozen=True)
class Step:
    """``command`` with ``inputs``, then ``words``; ``output``: the file, folder (with a slash at its end) or numbered
    files that it makes. Paths count from the take's folder."""

    name: str
    command: str
    inputs: tuple[str, ...]
    output: str
    words: tuple[str, ...]

    def line(self, output: str | None = None) -> list[str]:
        """The command line; ``output``: in place of the step's own."""
        made = (self.output if output is None else output).rstrip("/")
        return [self.command, *self.inputs, "-o", made or ".", *self.words]

    @property
    def text(self) -> str:
        """The command line as one would type it."""
        return shlex.join(self.line())

    @property
    def place(self) -> str:
        """The file or the folder that holds all that the step makes and nothing else."""
        return self.output.rpartition("/")[0] if self.is_folder else self.output

    @property
    def staging(self) -> str:
        """The folder in which it works: beside its place, since a rig names files by where they lie from it."""
        return str(PurePosixPath(self.place).with_name(f"{STAGING}{self.name}"))

    @property
    def staged_place(self) -> str:
        """What it makes in there, to be moved to its place."""
        return self.staging if self.is_folder else f"{self.staging}/{PurePosixPath(self.place).name}"

    @property
    def staged(self) -> str:
        """What its command is told to make."""
        return f"{self.staged_place}{self.output.removeprefix(self.place)}"

    @property
    def is_folder(self) -> bool:
        """Whether it makes more files than one."""
        return self.output.endswith("/") or "####" in self.output
