"""What a run says of the machine and the code."""

from __future__ import annotations

from pathlib import Path

import pytest

from decogs.bench import machine


@pytest.fixture
def code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Stand-ins for the layers' folders."""
    folder = lambda package: tmp_path / package.replace(".", "/")  # noqa: E731
    for package in machine.PACKAGES:
        folder(package).mkdir(parents=True)
    monkeypatch.setattr(machine.resources, "files", lambda package: folder(package.partition(".")[2]))
    (tmp_path / "codec" / "steps.py").write_text('"""Text."""\n\n\ndef half(x):\n    return x / 2\n')
    return tmp_path


def version() -> str:
    machine.code_version.cache_clear()
    try:
        return machine.code_version()
    finally:
        machine.code_version.cache_clear()


def test_the_digest_follows_what_the_code_does(code: Path) -> None:
    before = version()
    assert before.startswith("0.1.0+")
    (code / "codec" / "steps.py").write_text(
        '"""Other text."""\n# a comment\ndef half(x):\n    "Half of it."\n    return x / 2'
    )
    assert version() == before
    (code / "bench" / "tables.py").write_text("x = 1")
    assert version() == before, "the bench makes no stream"
    (code / "bench" / "methods" / "dense.py").write_text("x = 1")
    with_method = version()
    assert with_method != before, "but with its methods"
    (code / "rig" / "noise.py").write_text("x = 1")
    assert version() != with_method
    (code / "codec" / "steps.py").write_text("def half(x):\n    return x / 3\n")
    changed = version()
    assert changed != before
    (code / "encoder" / "kernel.h").write_text("int x;")
    assert version() != changed


def test_facts_are_filled_in() -> None:
    facts = machine.machine_facts()
    assert facts["cores"] >= 1
    assert facts["cpu"]
    assert machine.load() >= 0
