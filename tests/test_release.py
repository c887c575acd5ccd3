"""What is published depends on the sources alone, and says what it consists of."""

from __future__ import annotations

import io
import json
import os
import re
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.skipif(sys.version_info < (3, 11), reason="releases are made with Python 3.11 or later")


def run(script: str, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, ROOT / "release" / script, *arguments],
        env={**os.environ, "SOURCE_DATE_EPOCH": "1700000000"},
        capture_output=True,
        text=True,
        timeout=60,
    )


def packed(names: list[str], time: int, user: str, mode: int) -> bytes:
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w:gz") as archive:
        for name in names:
            member = tarfile.TarInfo(name)
            member.size, member.mtime, member.uname, member.uid, member.mode = 3, time, user, time % 1000, mode
            archive.addfile(member, io.BytesIO(b"abc"))
    return file.getvalue()


def test_an_archive_tells_nothing_of_who_packed_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT / "release"))
    from wheels import nobodys

    one = nobodys(packed(["a", "b"], 1_600_000_000, "ann", 0o664), 1_700_000_000)
    assert one == nobodys(packed(["b", "a"], 1_650_000_001, "bob", 0o600), 1_700_000_000)
    assert one != nobodys(packed(["a", "c"], 1_600_000_000, "ann", 0o664), 1_700_000_000)
    with tarfile.open(fileobj=io.BytesIO(one)) as archive:
        members = {member.name: (member.mode, member.mtime, member.uname) for member in archive.getmembers()}
    assert members == dict.fromkeys("ab", (0o644, 1_700_000_000, ""))


def test_a_platform_that_is_none_is_said_in_one_line(tmp_path: Path) -> None:
    ran = run("wheels.py", tmp_path, "amiga")
    assert ran.returncode == 1
    assert re.fullmatch(
        r"release/wheels.py: amiga is no platform of setup.py; choose from linux-x86_64, .*\n", ran.stderr
    )


def test_the_bill_lists_what_is_needed_and_what_is_within(tmp_path: Path) -> None:
    ran = run("bill_of_materials.py", tmp_path / "bill.json")
    assert ran.returncode == 0, ran.stderr
    bill = json.loads((tmp_path / "bill.json").read_text())
    scopes = {component["name"]: component["scope"] for component in bill["components"]}
    assert scopes["numpy"] == scopes["zstandard"] == scopes["llvm-project"] == scopes["zstddec"] == "required"
    assert scopes["torch"] == scopes["usd-core"] == "optional"
    assert not {"pytest", "ruff"} & set(scopes)
    refs = [component["bom-ref"] for component in bill["components"]]
    assert bill["dependencies"] == [{"ref": "decogs", "dependsOn": refs}]
    assert bill["metadata"]["timestamp"] == "2023-11-14T22:13:20Z"
    run("bill_of_materials.py", tmp_path / "again.json")
    assert (tmp_path / "bill.json").read_bytes() == (tmp_path / "again.json").read_bytes()
