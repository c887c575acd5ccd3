"""Builds the player's inner loops as WebAssembly: ``python player/kernel.py``.

Zig is the compiler, as for the exact picture (exact.py); nothing is linked, no C library either. esbuild puts the
committed files into the worker's script. What they were built of is told by kernel/sources.sha256.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

SRC = Path(__file__).resolve().parent / "src"
SOURCES = (SRC / "kernel" / "kernel.c", SRC / "worker" / "packing.c")
STATED = SRC / "kernel" / "sources.sha256"
ZIG = "0.17.0"
"""Another one may give other bytes, which count the same."""

FLAGS = [
    "-target",
    "wasm32-freestanding",
    "-msimd128",
    "-std=c11",
    "-O2",
    "-g0",
    "-ffp-contract=off",
    "-fno-builtin",
    "-nostdlib",
    "-Wall",
    "-Wextra",
    "-Werror",
    "-Wl,--no-entry",
    "-Wl,--strip-all",
    "-Wl,-z,stack-size=16384",
]


def digest() -> str:
    """Of everything that the kernel is built of: the same as long as nothing of it changes."""
    return hashlib.sha256("\0".join([ZIG, *FLAGS, *(path.read_text("utf-8") for path in SOURCES)]).encode()).hexdigest()


def build(source: Path) -> None:
    """Compiles a kernel into the file beside its source."""
    file = source.with_suffix(".wasm")
    subprocess.run([sys.executable, "-m", "ziglang", "cc", *FLAGS, str(source), "-o", str(file)], check=True)
    file.chmod(0o644)


if __name__ == "__main__":
    for path in SOURCES:
        build(path)
    STATED.write_text(digest() + "\n")
