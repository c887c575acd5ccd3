"""Builds the player's inner loops as WebAssembly: ``python player/kernel.py``.

Zig is the compiler, as for the exact picture (exact.py); nothing is linked, no C library either. The page's build
copies the committed file beside the worker's script. What it was built of is told by kernel/sources.sha256.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

SRC = Path(__file__).resolve().parent / "src"
NAMES = ("kernel/kernel.c", "kernel/blocks.c", "kernel/room.c", "worker/packing.c", "worker/depth_order.c")
PARTS = tuple(SRC / name for name in NAMES)
HEADER = SRC / "kernel" / "kernel.h"
BUILT = SRC / "kernel" / "kernel.wasm"
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
    said = [ZIG, *FLAGS, *(path.read_text("utf-8") for path in (HEADER, *PARTS))]
    return hashlib.sha256("\0".join(said).encode()).hexdigest()


def build(file: Path) -> None:
    """Compiles the kernel into ``file``."""
    subprocess.run([sys.executable, "-m", "ziglang", "cc", *FLAGS, *map(str, PARTS), "-o", str(file)], check=True)
    file.chmod(0o644)


if __name__ == "__main__":
    build(BUILT)
    STATED.write_text(digest() + "\n")
