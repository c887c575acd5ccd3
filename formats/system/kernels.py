"""Loads the kernels, C++ libraries with a plain C interface, compiled for this machine's instruction set."""

from __future__ import annotations

import ctypes
import os
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

from ..errors import UsageError

INSTRUCTION_SETS = ("base", "avx2", "avx512")
"""Slowest first; a kernel gives the same bits on all of them."""

_SUFFIX = ".pyd" if sys.platform == "win32" else ".abi3.so"
"""Python's own, for libraries that suit all its versions."""
_REMEDY = "install decogs again (in a checkout: make)"


def kernel_path(package: Path, stem: str, instruction_set: str) -> Path:
    """Where a package keeps a kernel compiled for this instruction set."""
    return package / f"{stem}_{instruction_set}{_SUFFIX}"


@lru_cache(maxsize=1)
def best_instruction_set() -> str:
    """The widest installed instruction set this machine runs; DECOGS_INSTRUCTION_SET (base, avx2, avx512) chooses one.

    What was built from source has the plain one and that of the machine it was built on.
    """
    folder = Path(__file__).parents[1] / "colours"
    base = _loaded(kernel_path(folder, "_ycbcr", "base"))
    runs = INSTRUCTION_SETS[: base.decogs_instruction_set() + 1]
    installed = [name for name in runs if kernel_path(folder, "_ycbcr", name).exists()]
    wanted = os.environ.get("DECOGS_INSTRUCTION_SET", installed[-1])
    if wanted not in installed:
        raise UsageError(f"DECOGS_INSTRUCTION_SET={wanted}: this machine runs {', '.join(installed)}, as installed")
    return wanted


def load_kernel(package: Path, stem: str, structs: Sequence[type[ctypes.Structure]]) -> ctypes.CDLL:
    """The kernel library ``stem`` in folder ``package`` for this machine.

    ``structs``: those of its interface, in the order of its ``decogs_sizes``. UsageError when the library was never
    built, for another machine, or from other sources: it would read garbage.
    """
    path = kernel_path(package, stem, best_instruction_set())
    library = _loaded(path)
    if _sizes(library, len(structs)) != [*map(ctypes.sizeof, structs), 0]:
        raise UsageError(f"{path}: the compiled kernel is of another version of decogs; {_REMEDY}")
    return library


def _sizes(library: ctypes.CDLL, count: int) -> list[int]:
    """Sizes of ``count`` structs and the 0 behind them, as the library has them; nothing from one that does not say."""
    try:
        sizes = library.decogs_sizes
    except AttributeError:
        return []
    sizes.restype = ctypes.POINTER(ctypes.c_int64)
    native_sizes: list[int] = []
    while len(native_sizes) <= count and 0 not in native_sizes:
        native_sizes.append(sizes()[len(native_sizes)])
    return native_sizes


def _loaded(path: Path) -> ctypes.CDLL:
    if not path.exists():
        raise UsageError(f"{path}: the compiled kernel is missing; {_REMEDY}")
    try:
        return ctypes.CDLL(str(path))
    except OSError as error:
        why = str(error).removeprefix(f"{path}: ")
        raise UsageError(f"{path}: the compiled kernel cannot be loaded ({why}); {_REMEDY}") from error


def check_memory(status: int) -> None:
    """Raises MemoryError when a kernel found no memory; the ``restype`` of kernel functions that nothing else stops."""
    if status:
        raise MemoryError("the kernel found no memory")


def checked_handle(handle: int | None) -> int:
    """What a kernel created; raises MemoryError when it found no memory for it."""
    if handle is None:
        raise MemoryError("the kernel found no memory")
    return handle
