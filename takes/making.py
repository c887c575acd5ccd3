"""Brings a take up to date: does the steps whose results are not what they would be now, and tells what was done."""

from __future__ import annotations

import os
import shutil
import threading
import time
from collections.abc import Callable, Collection, Iterable, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass
from pathlib import Path

from decogs.formats.errors import DecogsError, UsageError
from decogs.formats.rigs import files_of, open_rig

from .child import run_command
from .options import has_option
from .records import Made, Records, foreign_file
from .steps import Step
from .take_file import Take

CURRENT, MADE, FAILED, LEFT_OUT, DUE = "up to date", "made", "failed", "left out", "due"
_READ_BY = {"--masks", "--background-plate", "--ignore", "--keyframe", "--audio", "--sync", "--camera", "--subject"}
_READ_BY |= {"--intrinsics", "--fence"}
"""Options whose values may name what is read."""
_THREADS = "--threads"
_OF_RIGS = ("decogs-encode", "decogs-sync")


@dataclass(frozen=True)
class Outcome:
    """What became of a step: ``state``; ``why``: it was done, or not; ``size`` of what is there in bytes."""

    step: Step
    state: str
    why: str = ""
    seconds: float = 0.0
    size: int = 0

    @property
    def is_bad(self) -> bool:
        """Whether there is nothing, or what is there is not what would be now, and that is not for want of asking."""
        return self.state in (FAILED, LEFT_OUT)

    def row(self, size_text: Callable[[int], str]) -> tuple[str, ...]:
        """Step, state, seconds, size, and what it made or why."""
        seconds = f"{self.seconds:.1f} s" if self.seconds else ""
        told = self.step.place if self.state in (MADE, CURRENT) else self.why
        return self.step.name, self.state, seconds, size_text(self.size) if self.size else "", told


class Making:
    """The making of one take. ``tell(line)`` is called with what happens; ``threads``: of a step that does not say, 0
    for all processors; ``quiet``: commands show no progress."""

    def __init__(self, take: Take, tell: Callable[[str], None], *, threads: int = 0, quiet: bool = False) -> None:
        self._take, self._tell, self._threads, self._quiet = take, tell, threads, ["-q"] if quiet else []
        self._output = take.folder / take.output
        self._records = Records(self._output)
        self._lock = threading.Lock()

    def plan(self) -> list[Outcome]:
        """What would be done, and why; a step is due, too, if one is that it reads from."""
        due: set[str] = set()
        outcomes = {}
        for step in _in_order(self._take.steps):
            why = self._why_due(step, self._fingerprint(step), due)
            if why:
                due.add(step.place)
            outcomes[step.name] = Outcome(step, DUE if why else CURRENT, why, size=0 if why else self._size(step))
        return [outcomes[step.name] for step in self._take.steps]

    def make(self, jobs: int) -> list[Outcome]:
        """Does what is due, ``jobs`` steps at a time. A step that fails leaves out those that read from it, alone."""
        outcomes: dict[str, Outcome] = {}
        left = _in_order(self._take.steps)
        with self._records.locked(), ThreadPoolExecutor(jobs) as pool:
            running: dict[Future[Outcome], Step] = {}
            while left or running:
                for step in [each for each in left if self._can_begin(each, left, running.values())]:
                    if len(running) == jobs:
                        break
                    left.remove(step)
                    running[pool.submit(self._brought_up, step, outcomes, shown=jobs == 1)] = step
                done, _ = wait(running, return_when=FIRST_COMPLETED)
                for future in done:
                    step = running.pop(future)
                    outcomes[step.name] = future.result()
        return [outcomes[step.name] for step in self._take.steps]

    def _can_begin(self, step: Step, left: Sequence[Step], running: Iterable[Step]) -> bool:
        return not any(_reads(step, other) for other in (*left, *running) if other is not step)

    def _why_due(self, step: Step, fingerprint: str, due: Collection[str] = ()) -> str:
        """Why a step has to be done; empty if it has not. ``due``: places of what will be made before."""
        if any(name in due for name in (*step.inputs, *_named(step))):
            return "what it reads will be another"
        made = self._records.made.get(step.name)
        if made is None:
            return "was never made"
        if fingerprint != made.fingerprint:
            return "what it reads, its options or the version is another"
        there = self._records.digests(self._take.folder / step.place)
        return "" if there == made.files else "what it made is not there"

    def _fingerprint(self, step: Step) -> str:
        return self._records.fingerprint(step, self._take.folder, _read_by(step, self._take.folder))

    def _brought_up(self, step: Step, outcomes: dict[str, Outcome], *, shown: bool) -> Outcome:
        needed = [outcomes[each.name] for each in self._take.steps if _reads(step, each)]
        if failed := next((each for each in needed if each.state in (FAILED, LEFT_OUT)), None):
            return Outcome(step, LEFT_OUT, f"needs {failed.step.name}")
        with self._lock:
            self._finish_move(step)
            fingerprint = self._fingerprint(step)
            why = self._why_due(step, fingerprint)
            if not why:
                return Outcome(step, CURRENT, size=self._size(step))
            place = self._take.folder / step.place
            foreign = foreign_file(self._records.digests(place), self._records.made.get(step.name))
        if foreign is not None:
            name = f"{step.place}/{foreign}" if foreign else step.place
            return self._failed(step, f"{name} is not what this made; move it away, or name another file")
        return self._done(step, fingerprint, why, shown=shown)

    def _done(self, step: Step, fingerprint: str, why: str, *, shown: bool) -> Outcome:
        resumes = self._begin(step, fingerprint)
        self._tell(f"{step.name}: {why}\n  $ {step.text}")
        began = time.monotonic()
        code, printed, said = run_command(
            [*step.line(step.staged), *resumes, *self._told_threads(step), *self._quiet],
            self._take.folder,
            shown=shown,
        )
        seconds = time.monotonic() - began
        for line in printed.replace(step.staged_place, step.place).splitlines():
            self._tell(f"  {line}")
        if code:
            return self._failed(step, said or f"{step.command} ended with code {code}", seconds)
        with self._lock:
            made = self._records.made.get(step.name)
            place = self._take.folder / step.staged_place
            replaced = {} if made is None else made.files
            self._records.made[step.name] = Made(fingerprint, self._records.digests(place), replaced)
            del self._records.begun[step.name]
            self._records.save()
            self._finish_move(step)
        return Outcome(step, MADE, why, seconds, self._size(step))

    def _begin(self, step: Step, fingerprint: str) -> list[str]:
        """Makes room for a step; what it left of the same work stays, and is gone on with where the command can."""
        with self._lock:
            staging = self._take.folder / step.staging
            goes_on = self._records.begun.get(step.name) == fingerprint and step.command == "decogs-encode"
            if not goes_on:
                shutil.rmtree(staging, ignore_errors=True)
            (self._take.folder / step.staged_place).parent.mkdir(parents=True, exist_ok=True)
            self._records.begun[step.name] = fingerprint
            self._records.save()
        return ["--resume"] if goes_on and any(staging.rglob("*.part")) else []

    def _told_threads(self, step: Step) -> list[str]:
        """What a step is told of threads: results do not depend on them, so that it is none of its own words."""
        says = any(word.startswith(_THREADS) for word in step.words)
        is_told = self._threads and not says and has_option(step.command, _THREADS)
        return [f"{_THREADS}={self._threads}"] if is_told else []

    def _finish_move(self, step: Step) -> None:
        """Puts what a step has made in its place, where that is not done."""
        made = self._records.made.get(step.name)
        staging, staged, place = (self._take.folder / each for each in (step.staging, step.staged_place, step.place))
        if made is None or not staged.exists() or self._records.digests(staged) != made.files:
            return
        foreign = foreign_file(self._records.digests(place), made)
        if foreign is not None:
            return
        if place.is_dir():
            shutil.rmtree(place)
        place.parent.mkdir(parents=True, exist_ok=True)
        os.replace(staged, place)
        shutil.rmtree(staging, ignore_errors=True)
        made.replaced = {}
        self._records.save()

    def _failed(self, step: Step, why: str, seconds: float = 0.0) -> Outcome:
        self._tell(f"{step.name}: {why}")
        return Outcome(step, FAILED, why, seconds)

    def _size(self, step: Step) -> int:
        place = self._take.folder / step.place
        files = place.rglob("*") if place.is_dir() else [place]
        return sum(file.stat().st_size for file in files if file.is_file())


def _in_order(steps: Sequence[Step]) -> list[Step]:
    """As they are, but each behind those that it reads from. Raises UsageError where two read each other."""
    left, ordered = list(steps), list[Step]()
    while left:
        free = [step for step in left if not any(_reads(step, other) for other in left if other is not step)]
        if not free:
            raise UsageError(f"{left[0].name} and {left[-1].name} read what the other makes; take one of both out")
        ordered.append(free[0])
        left.remove(free[0])
    return ordered


def _reads(step: Step, other: Step) -> bool:
    return other.output.rstrip("/") in (*step.inputs, *_named(step))


def _named(step: Step) -> list[str]:
    """What a step reads besides its inputs, as far as its words name it."""
    read = _READ_BY | ({"--log", "--against"} if step.command == "decogs-report" else set())
    told = [word.partition("=") for word in step.words]
    return [value for option, _, value in told if option in read and value]


def _read_by(step: Step, folder: Path) -> list[str]:
    """The files and folders that a step reads, as far as its words name them."""
    named = [value for value in _named(step) if (folder / value).exists()]
    rigs = [value for option, _, value in (word.partition("=") for word in step.words) if option == "--rig"]
    inputs = list(step.inputs)
    if step.command in _OF_RIGS:
        rigs.append(inputs.pop(0))
    return [*inputs, *named, *(file for rig in rigs for file in _files_of_rig(rig, folder))]


def _files_of_rig(rig: str, folder: Path) -> list[str]:
    """What a rig consists of; all in its folder where it cannot be opened."""
    try:
        files = files_of(open_rig(str(folder / rig)))
        return sorted({os.path.relpath(file, folder) for file, _ in files})
    except DecogsError:
        return [rig]


def check_apart(takes: Sequence[Take]) -> None:
    """Raises UsageError where two takes make the same folder."""
    seen: dict[Path, Path] = {}
    for take in takes:
        place = (take.folder / take.output).resolve()
        if place in seen:
            raise UsageError(f"{take.path}: its output is that of {seen[place]}; name another one")
        seen[place] = take.path
