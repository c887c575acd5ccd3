"""How many threads ``--threads 0`` means, in a container with a quota of processors as well."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from decogs.formats.system import threads as threads_module
from decogs.formats.system.threads import processor_count, thread_count

MANY = 64


@pytest.fixture(autouse=True)
def many_processors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: set(range(MANY)))


def container(folder: Path, monkeypatch: pytest.MonkeyPatch, own: str | None, **quotas: str) -> None:
    """Control groups: the process is in ``own``; ``quotas`` are lines of cpu.max by group, with _ for /."""
    monkeypatch.setattr(threads_module, "_CGROUPS", folder / "cgroup")
    monkeypatch.setattr(threads_module, "_OWN_CGROUP", folder / "own")
    if own is not None:
        (folder / "own").write_text(f"9:name=systemd:/x\n0::{own}\n")
    for name, line in quotas.items():
        group = (folder / "cgroup").joinpath(*name.split("_"))
        group.mkdir(parents=True, exist_ok=True)
        (group / "cpu.max").write_text(f"{line}\n")


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("200000 100000", 2),
        ("150000 100000", 2),
        ("10000 100000", 1),
        ("max 100000", MANY),
        ("9900000 100000", MANY),
        ("", MANY),
        ("1 0", MANY),
        ("-100000 100000", 1),
    ],
)
def test_the_quota_of_a_container(line: str, expected: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    container(tmp_path, monkeypatch, "/", **{"": line})
    assert processor_count() == thread_count(0) == expected
    assert thread_count(7) == 7, "who asks for more gets it"


def test_the_narrowest_of_the_groups_around_the_process_counts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    container(tmp_path, monkeypatch, "/a/b", a="300000 100000", a_b="max 100000", c="100000 100000")
    assert processor_count() == 3


def test_a_container_that_sees_the_path_of_the_host(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    container(tmp_path, monkeypatch, "/docker/0123", **{"": "400000 100000"})
    assert processor_count() == 4


def test_no_control_groups_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    container(tmp_path, monkeypatch, None)
    assert processor_count() == MANY
