"""Builds the player's inner loops as WebAssembly: ``python player/kernel.py [FILE]``.

Zig is the compiler, as for the exact picture (exact.py); nothing is linked, no C library either. esbuild puts the
committed file into the worker's script. What it was built of is told by sources.sha256 beside it.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).resolve().parent / "src" / "kernel"
SOURCE = FOLDER / "kernel.c"
BUILT = FOLDER / "kernel.wasm"
STATED = FOLDER / "sources.sha256"
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
    return hashlib.sha256("\0".join([ZIG, *FLAGS, SOURCE.read_text("utf-8")]).encode()).hexdigest()


def build(file: Path) -> None:
    """Compiles the kernel into ``file``."""
    subprocess.run([sys.executable, "-m", "ziglang", "cc", *FLAGS, str(SOURCE), "-o", str(file)], check=True)
    file.chmod(0o644)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        build(Path(sys.argv[1]))
    else:
        build(BUILT)
        STATED.write_text(digest() + "\n")
