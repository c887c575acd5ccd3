"""Python's pickles: calibrations that are programs, and are not opened."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..errors import RigError
from ..files.regular_files import open_regular

_SUFFIXES = frozenset({".pkl", ".pickle", ".npy"})


def refuse_pickles(files: Iterable[Path]) -> None:
    """Raises RigError for the first file that is a pickle, also inside a NumPy file, with the way out."""
    for file in files:
        if file.suffix.lower() in _SUFFIXES and _is_pickle(file):
            raise RigError(
                f"{file}: a Python pickle, which may run any program and is not opened; load it where you trust it, "
                "and write a rig.json (docs/rig.md)"
            )


def _is_pickle(file: Path) -> bool:
    try:
        with open_regular(file) as opened:
            head = opened.read(256)
    except OSError:
        return False
    if head.startswith(b"\x93NUMPY"):
        return b"'descr': '|O'" in head or (b"'descr': [" in head and b"|O" in head)
    # Protocols 2 to 5 begin with their number; 0 and 1, of Python 2, with the first thing in them.
    return (head[:1] == b"\x80" and head[1:2] in b"\2\3\4\5") or file.suffix.lower() in (".pkl", ".pickle")
