"""Builds the decoder's kernel as WebAssembly, the player's exact picture: ``python player/exact.py [FILE]``.

Zig is the compiler: it is a package of PyPI (``pip install ziglang==0.17.0``) and brings a C++ library for this target.
The flags are those of setup.py as far as they decide about bits. What the committed file was built of is told by
sources.sha256 beside its source, so that a test notices a kernel that changed without it.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BUILT = ROOT / "player" / "src" / "exact" / "exact.wasm"
SOURCE = ROOT / "player" / "src" / "exact" / "exact.cpp"
HEADERS = ROOT / "decoder" / "rasterise" / "kernel"
STATED = SOURCE.with_name("sources.sha256")
ZIG = "0.17.0"
"""Another one may give other bytes, which draw the same picture."""

EXPORTS = ("exact_failure", "exact_scene", "exact_camera", "exact_draw", "exact_pixels")
FLAGS = [
    "-target",
    "wasm32-wasi",
    "-mexec-model=reactor",
    "-msimd128",
    "-std=c++17",
    "-O3",
    "-g0",
    "-ffp-contract=off",
    "-fno-math-errno",
    "-fno-exceptions",
    "-fno-rtti",
    "-Wl,--strip-all",
    *(f"-Wl,--export={name}" for name in EXPORTS),
]


def digest() -> str:
    """Of everything that the kernel is built of: the same as long as nothing of it changes."""
    said = [ZIG, *FLAGS, *(path.read_text("utf-8") for path in (SOURCE, *sorted(HEADERS.glob("*.h"))))]
    return hashlib.sha256("\0".join(said).encode()).hexdigest()


def build(file: Path) -> None:
    """Compiles the kernel into ``file``."""
    file.parent.mkdir(parents=True, exist_ok=True)
    compiler = [sys.executable, "-m", "ziglang", "c++"]
    subprocess.run([*compiler, *FLAGS, f"-I{HEADERS}", str(SOURCE), "-o", str(file)], check=True)
    file.chmod(0o644)


if __name__ == "__main__":
    if len(sys.argv) > 1:
        build(Path(sys.argv[1]))
    else:
        build(BUILT)
        STATED.write_text(digest() + "\n")
