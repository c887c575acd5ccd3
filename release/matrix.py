"""Installs a wheel beside the newest and the oldest releases of what it needs, Python by Python, and runs it.

    python release/matrix.py WHEEL FOLDER [PYTHON ...]

The oldest are the first in the ranges of pyproject.toml that have a wheel for that Python; uv finds them.
Environments are made in FOLDER. A line each: what passed, or what failed and why.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("python3.10", "python3.11", "python3.12", "python3.13", "python3.14")
PIP_ARGS = os.environ.get("PIP_ARGS", "").split()
TESTS = ("tests/test_installed.py", "tests/decoder/test_standalone.py", "tests/codec", "tests/conformance")


def finding_oldest(python: str, constraints: Path) -> list[str]:
    """The command that writes constraints of pip: the first release of each range with a wheel for that Python."""
    command = [sys.executable, "-m", "uv", "pip", "compile", "--quiet", "--no-header", "--no-annotate", *PIP_ARGS]
    command += ["--resolution", "lowest-direct", "--only-binary", ":all:", "--python", python, "--extra", "all"]
    return [*command, "pyproject.toml", "-o", str(constraints)]


def outcome(python: str, wheel: Path, folder: Path, which: str) -> str:
    """What became of it, in a line."""
    if shutil.which(python) is None:
        return "not run: is not installed"
    shutil.rmtree(folder, ignore_errors=True)
    made, said = _said([python, "-m", "venv", str(folder)])
    if not made:
        return f"not run: {said.strip().splitlines()[-1]}"
    within = str(folder / "bin" / "python")
    installing = [within, "-m", "pip", "install", "--quiet", "--no-compile", "--only-binary=:all:", *PIP_ARGS]
    if which == "oldest":
        constraints = folder / "oldest.txt"
        found, said = _said(finding_oldest(within, constraints))
        if not found:
            return f"not installed: {said.strip()}"
        installing += ["-c", str(constraints)]
    installed, said = _said([*installing, f"{wheel}[all]", "pytest", "hypothesis", "packaging"])
    if not installed:
        return f"not installed: {'; '.join(line for line in said.splitlines() if 'ERROR' in line)}"
    # By its script: with -m, the checkout's own decogs would come before what is installed.
    passed, said = _said([str(folder / "bin" / "pytest"), "-q", "-p", "no:cacheprovider", "-W", "default", *TESTS])
    versions = ", ".join(_versions(within))
    return f"{_last(r'.*(passed|failed|error).*', said)} with {versions}" + ("" if passed else f"\n{_failures(said)}")


def _versions(python: str) -> Iterator[str]:
    names = ("numpy", "zstandard", "pillow", "OpenEXR", "opencv-contrib-python-headless", "av", "usd-core")
    program = "import sys; from importlib.metadata import version; print(*map(version, sys.argv[1:]))"
    _, said = _said([python, "-c", program, *names])
    yield from map(" ".join, zip(names, said.split(), strict=True))


def _failures(said: str) -> str:
    return "\n".join(f"    {line}" for line in said.splitlines() if line.startswith(("FAILED", "ERROR")))


def _last(pattern: str, said: str) -> str:
    lines = [line for line in said.splitlines() if re.fullmatch(pattern, line)]
    return lines[-1] if lines else said.strip().splitlines()[-1]


def _said(command: list[str]) -> tuple[bool, str]:
    ran = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    return ran.returncode == 0, ran.stdout + ran.stderr


def main() -> int:
    """Prints a line for each; 1 where anything that was run failed."""
    if len(sys.argv) < 3:
        sys.exit("usage: python release/matrix.py WHEEL FOLDER [PYTHON ...]")
    wheel, folder, pythons = Path(sys.argv[1]).resolve(), Path(sys.argv[2]).resolve(), sys.argv[3:] or PYTHONS
    failed = 0
    for python, which in itertools.product(pythons, ("oldest", "newest")):
        became = outcome(python, wheel, folder / f"{Path(python).name}-{which}", which)
        print(f"{python}, {which}: {became}", flush=True)
        failed += "failed" in became or "error" in became or became.startswith("not installed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
