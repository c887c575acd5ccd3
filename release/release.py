"""Builds everything that is published, twice, and compares: ``python release/release.py FOLDER [--once]``.

Both times from what is committed, exported to a folder of its own, so that nothing else can get in. Needs what
`make release` installs, Node, and the player's packages (player/node_modules).
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

import tomllib
from wheels import ROOT

SUMS = "SHA256SUMS"


def main() -> int:
    """Builds into the folder; 1 where the second build has other bytes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="what was there is removed")
    parser.add_argument("--once", action="store_true", help="do not build a second time to compare")
    options = parser.parse_args()
    _check_clean()
    commit = _git("rev-parse", "HEAD").strip()
    first = build(options.folder.resolve(), commit)
    print(first, end="", flush=True)
    if options.once:
        return 0
    with tempfile.TemporaryDirectory() as folder:
        second = build(Path(folder, "again"), commit)
    differ = sorted(set(first.splitlines()) ^ set(second.splitlines()))
    print("\n".join(["the second build differs:", *differ]) if differ else "the second build has the same bytes")
    return 1 if differ else 0


def build(folder: Path, commit: str) -> str:
    """Everything, from the sources of a commit; returns the checksums, a line a file."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    # Each build compiles for itself.
    environment = {k: v for k, v in os.environ.items() if k != "DECOGS_KERNEL_CACHE"}
    environment |= {
        "SOURCE_DATE_EPOCH": _git("log", "-1", "--format=%ct", commit).strip(),
        "PYTHONDONTWRITEBYTECODE": "1",
    }
    with tempfile.TemporaryDirectory() as exported:
        sources = Path(exported)
        _export(commit, sources)
        version = tomllib.loads((sources / "pyproject.toml").read_text("utf-8"))["project"]["version"]

        def run(*command: str | Path, cwd: Path = sources) -> None:
            subprocess.run(command, cwd=cwd, env=environment, check=True, stdout=subprocess.DEVNULL)

        run(sys.executable, "release/wheels.py", folder)
        run(sys.executable, "release/check.py", *folder.glob("*.whl"))
        run(sys.executable, "blender/build.py", folder / f"decogs-blender-{version}.zip")
        run(sys.executable, "release/bill_of_materials.py", folder / f"decogs-{version}.cdx.json")
        (sources / "player" / "node_modules").symlink_to(ROOT / "player" / "node_modules")
        run("npm", "pack", "--silent", "--pack-destination", folder, cwd=sources / "player")
        run(sys.executable, "report/browse.py", folder / f"decogs-report-{version}.html")
    full = ROOT / "report" / "full.zip"
    if full.exists():
        shutil.copyfile(full, folder / f"decogs-report-full-{version}.zip")
    sums = "".join(
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n" for file in sorted(folder.iterdir())
    )
    (folder / SUMS).write_text(sums)
    return sums


def _check_clean() -> None:
    changed = _git("status", "--porcelain").splitlines()
    if changed:
        sys.exit(f"release/release.py: {changed[0][3:]} is not committed; commit or remove what git status lists")


def _export(commit: str, folder: Path) -> None:
    with tempfile.TemporaryDirectory() as packed:
        file = Path(packed, "sources.tar")
        _git("archive", "-o", str(file), commit)
        with tarfile.open(file) as archive:
            archive.extractall(folder, filter="tar")


def _git(*words: str) -> str:
    return subprocess.run(["git", "-C", ROOT, *words], check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    sys.exit(main())
