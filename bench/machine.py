"""What a figure of time depends on: the machine, how busy it was, and the code that ran."""

from __future__ import annotations

import ast
import hashlib
import os
import platform
from functools import lru_cache
from importlib import metadata, resources
from pathlib import Path
from typing import Any

PACKAGES = ("formats", "codec", "decoder", "rig", "encoder", "bench.methods")
_NOT_IN_A_STREAM = (
    "encoder/commands.py",
    "encoder/output/progress.py",
    "decoder/commands.py",
    "decoder/reading/info_text.py",
    "formats/cli/command_line.py",
)
_CODE = (".py", ".cpp", ".h")


def machine_facts() -> dict[str, Any]:
    """The processor's name, the cores this process may use, and the Python version."""
    return {"cpu": _processor(), "cores": _cores(), "python": platform.python_version(), "system": platform.system()}


def load() -> float:
    """Processes that ran or waited for a processor in the last minute, on average; 0 where the system does not report
    it."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else 0.0


@lru_cache(maxsize=1)
def code_version() -> str:
    """The package's version and a digest of the code that makes and shows streams.

    Comments and docstrings of Python files do not count, nor does the bench but for its methods.
    """
    digest = hashlib.sha256()
    for package in PACKAGES:
        root = Path(str(resources.files(f"decogs.{package}")))
        for path in sorted(path for path in root.rglob("*") if path.suffix in _CODE):
            name = f"{package.replace('.', '/')}/{path.relative_to(root).as_posix()}"
            if not name.startswith(_NOT_IN_A_STREAM):
                digest.update(name.encode() + b"\0" + _meaning(path))
    return f"{metadata.version('decogs')}+{digest.hexdigest()[:10]}"


def _meaning(path: Path) -> bytes:
    if path.suffix != ".py":
        return path.read_bytes()
    tree = ast.parse(path.read_text("utf-8"))
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [line for line in body if not _is_text(line)]  # type: ignore[attr-defined]
    return ast.dump(tree).encode()


def _is_text(line: ast.stmt) -> bool:
    return isinstance(line, ast.Expr) and isinstance(line.value, ast.Constant) and isinstance(line.value.value, str)


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()
