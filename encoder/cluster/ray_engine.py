"""Ray as the engine: the only file that imports it. It restarts a task whose worker or machine is gone."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from typing import Any

from decogs.formats.errors import TryAgainError, UsageError

from ..job.job import EncodeJob
from .tasks import Outcome, run_part

LOCAL = "local"
_ADDRESS = re.compile(r"(ray://)?[^/\s:]+:[0-9]{1,5}")
_FIRST_TOKEN_RELEASE = (2, 60)
"""The first release known to require a token of its own accord where it starts a cluster."""
_MAX_RESTARTS = 4
"""Times that Ray runs a task again whose worker died."""
_MAX_TRIES = 3
"""Times that a task is given to Ray: again where it says that another try may go well, or Ray has lost it."""
_POLL_SECONDS = 0.5
"""Seconds between two reports of progress."""


class _Board:
    """How many frames of each part are done; an actor beside the tasks."""

    def __init__(self) -> None:
        self._done: dict[int, int] = {}

    def set_done(self, part: int, frames: int) -> None:
        self._done[part] = frames

    def frames(self) -> int:
        return sum(self._done.values())


def _task(number: int, board: Any, job: EncodeJob, frames: range, keyframe: bytes | None) -> Outcome:
    return run_part(job, frames, keyframe, lambda done: board.set_done.remote(number, done))


class RayEngine:
    """A Ray cluster, on this machine alone or elsewhere; a context manager.

    ``address``: "local", "ray://HOST:PORT" of a cluster's client server, or "HOST:PORT" of one that this machine is
    part of. Raises UsageError without Ray, or for an address that says nothing; TryAgainError where no cluster answers.
    """

    def __init__(self, address: str, *, threads: int, device: str) -> None:
        if address != LOCAL and not _ADDRESS.fullmatch(address):
            raise UsageError(f"`cluster` {address}: give local, or ray://HOST:PORT")
        try:
            import ray
        except ImportError:
            raise UsageError("`cluster`: Ray is not installed; pip install 'ray[client]>=2.60'") from None
        if tuple(int(number) for number in re.findall(r"\d+", ray.__version__)[:2]) < _FIRST_TOKEN_RELEASE:
            raise UsageError(
                f"`cluster`: Ray {ray.__version__} takes tasks from everyone on the network; "
                "pip install 'ray[client]>=2.60'"
            )
        self._ray, self._address = ray, address
        self._needs = {"num_cpus": max(1, threads), "num_gpus": 1 if device == "cuda" else 0}

    @property
    def notice(self) -> str:
        """What the user should know of a cluster that is started here: Ray binds to no single address (2.60)."""
        if self._address != LOCAL:
            return ""
        is_guarded = os.environ.get("RAY_AUTH_MODE", "token").lower() == "token"
        callers = "callers that have its token" if is_guarded else "everyone, by RAY_AUTH_MODE"
        return f"`cluster` local: Ray listens on this machine's network addresses meanwhile, for {callers}"

    def __enter__(self) -> RayEngine:
        ray, quiet = self._ray, {"log_to_driver": False, "logging_level": logging.ERROR}
        try:
            if self._address == LOCAL:
                # Without an address, Ray would join a cluster that somebody else has started here, and end with it.
                ray.init(LOCAL, include_dashboard=False, **quiet)
            else:
                ray.init(self._address, **quiet)
        except (ConnectionError, TimeoutError, RuntimeError, ValueError) as error:
            reason = str(error).strip().splitlines() or [type(error).__name__]
            raise TryAgainError(
                f"`cluster` {self._address}: no cluster answers ({reason[0]}); start it first"
            ) from None
        self._board = ray.remote(num_cpus=0, max_restarts=-1)(_Board).remote()
        self._run = ray.remote(max_retries=_MAX_RESTARTS, **self._needs)(_task)
        return self

    def __exit__(self, *_: object) -> None:
        self._ray.shutdown()

    def run(
        self, job: EncodeJob, parts: Sequence[range], keyframe: bytes | None
    ) -> Iterator[tuple[range, Outcome] | int]:
        """Runs the parts as tasks: each one with its outcome when it is done, and now and then how many frames are.

        Raises TryAgainError when a part fails again and again.
        """
        ray = self._ray
        shared, key = ray.put(job), None if keyframe is None else ray.put(keyframe)

        def start(number: int) -> Any:
            return self._run.remote(number, self._board, shared, parts[number], key)

        running = {start(number): (number, 1) for number in range(len(parts))}
        try:
            while running:
                ready, _ = ray.wait(list(running), timeout=_POLL_SECONDS)
                for reference in ready:
                    number, tries = running.pop(reference)
                    outcome = self._outcome(reference)
                    if not outcome.again:
                        yield parts[number], outcome
                    elif tries < _MAX_TRIES:
                        running[start(number)] = (number, tries + 1)
                    else:
                        raise TryAgainError(f"{outcome.problem} (tried {tries} times)")
                yield self._frames_done()
        finally:
            for reference in running:
                with suppress(Exception):
                    ray.cancel(reference, force=True)

    def _outcome(self, reference: Any) -> Outcome:
        try:
            outcome: Outcome = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            # A lost argument of a task is an error of the task by its type.
            exceptions = self._ray.exceptions
            if isinstance(error, exceptions.RayTaskError) and not isinstance(error.cause, exceptions.ObjectLostError):
                raise
            message = str(error).strip().splitlines() or [type(error).__name__]
            return Outcome(problem=f"`cluster`: a worker was lost ({message[0]})", again=True)
        return outcome

    def _frames_done(self) -> int:
        """Frames that the tasks have done; 0 while the board is being moved to another machine."""
        with suppress(self._ray.exceptions.RayError):
            return int(self._ray.get(self._board.frames.remote(), timeout=_POLL_SECONDS))
        return 0
