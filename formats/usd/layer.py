"""Opens a stranger's USD file: that file alone, without whatever it refers to.

Files from strangers are hostile, and composing them opens others, waits for pipes, and can fill any memory from a few
lines. What composes is therefore refused, wherever it stands in the file, and what OpenUSD will allocate is estimated
before it opens anything.
Source: OpenUSD, pxr/usd/sdf/crateFile.h (layout of .usdc), and its "Usdz File Format Specification".
"""

from __future__ import annotations

import mmap
import struct
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import UsageError

MAX_DEPTH = 256
"""Prims inside each other. OpenUSD reads them by recursion, and some ten thousand end the process."""

_ARCS = {
    "references": "references",
    "payload": "a payload",
    "inheritPaths": "inherits",
    "specializes": "specializes",
    "variantSetNames": "variants",
    "clips": "value clips",
    "relocates": "relocates",
}
"""What composes a prim from other places, by Sdf's names."""

_TEXT_EXPANSION = 64
"""Bytes that a byte of text takes: up to 54 were measured (a list of one-digit numbers)."""
_CRATE = {b"TOKENS": 200, b"FIELDS": 100, b"FIELDSETS": 8, b"PATHS": 500, b"SPECS": 200}
"""Bytes that an item of a section of .usdc takes: together a third more than was measured of prims and attributes."""

_CRATE_HEAD, _CRATE_SECTION = struct.Struct("<8s8sq"), struct.Struct("<16sqq")
_MOST_SECTIONS = 64
_ZIP_HEAD = struct.Struct("<4s4xH16xHH")


def flat_layer(path: Path, max_memory: int) -> Any:
    """The file's layer, of which nothing is composed.

    Raises UsageError for what is no USD file, might take more than ``max_memory`` bytes, or is not flat. To be called
    after ``load_openusd``.
    """
    from pxr import Sdf, Tf

    try:
        _check_content(path, max_memory)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read ({error.strerror}); name a USD file") from None
    try:
        layer = Sdf.Layer.OpenAsAnonymous(str(path.resolve()))
    except Tf.ErrorException:
        layer = None
    damaged = UsageError(f"{path}: is no USD file that OpenUSD can read; export it again")
    if layer is None:
        raise damaged
    if layer.subLayerPaths:
        raise _not_flat(f"{path}", "sublayers")
    prims = [(prim, 1) for prim in layer.rootPrims]
    while prims:
        prim, depth = prims.pop()
        if prim is None:  # its parent lists a child that is not there
            raise damaged
        for key in prim.ListInfoKeys():
            if key in _ARCS:
                raise _not_flat(f"{path}:{prim.path}", _ARCS[key])
        if depth > MAX_DEPTH:
            raise UsageError(f"{path}: has more than {MAX_DEPTH} prims inside each other; export the camera alone")
        prims += [(child, depth + 1) for child in prim.nameChildren]
    return layer


def _not_flat(where: str, arc: str) -> UsageError:
    return UsageError(
        f"{where}: has {arc}, and a camera's file must stand for itself; export the camera alone, or flatten the file "
        "(usdcat --flatten)"
    )


def _check_content(path: Path, max_memory: int) -> None:
    with path.open("rb") as file:
        if not file.read(1):
            raise UsageError(f"{path}: is empty; export it again")
        with mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content, memoryview(content) as data:
            start = _start_in_package(content)
            if content[start : start + 8] == b"PXR-USDC":
                try:
                    needed = _needed_by_crate(content, start)
                except UsageError as error:
                    raise UsageError(f"{path}: {error}") from None
            elif content[start : start + 5] in (b"#usda", b"#sdf "):
                needed = (len(content) - start) * _TEXT_EXPANSION
                if needed <= max_memory and _depth(data[start:]) > 2 * MAX_DEPTH:
                    raise UsageError(f"{path}: its brackets are nested too deep; export the camera alone")
            else:
                raise UsageError(f"{path}: is no USD file; export it again")
    if needed > max_memory:
        raise UsageError(
            f"{path}: may take {needed >> 20} MiB to read; export the camera alone, or allow more memory than "
            f"{max_memory >> 20} MiB (`max_memory`)"
        )


def _start_in_package(content: mmap.mmap) -> int:
    """Where the layer begins: a .usdz is a ZIP that packs nothing, and its first file is the layer."""
    if len(content) < _ZIP_HEAD.size or content[:4] != b"PK\3\4":
        return 0
    _, method, name, extra = _ZIP_HEAD.unpack_from(content)
    return len(content) if method else _ZIP_HEAD.size + name + extra


def _needed_by_crate(content: mmap.mmap, start: int) -> int:
    """Bytes for the structure of a .usdc, whose sections begin with their numbers of items; arrays are read when asked.

    Raises UsageError, without the file's name, for sections outside the file; what else is damaged is left to OpenUSD,
    which refuses it.
    """
    needed = 0
    try:
        *_, at = _CRATE_HEAD.unpack_from(content, start)
        (count,) = struct.unpack_from("<Q", content, start + at)
        for number in range(min(count, _MOST_SECTIONS)):
            name, begin, size = _CRATE_SECTION.unpack_from(content, start + at + 8 + number * _CRATE_SECTION.size)
            name = name.rstrip(b"\0")
            if not (begin >= 0 and 0 <= size <= len(content) - start - begin):
                raise UsageError("is damaged: a section lies outside of it; export it again")
            items, unpacked = struct.unpack_from("<QQ", content, start + begin)
            needed += _CRATE.get(name, 0) * items + (unpacked if name == b"TOKENS" else 0)
    except struct.error:
        return needed
    return needed


def _depth(text: memoryview) -> int:
    """How deep brackets of any kind are nested, those in strings and comments included."""
    characters = np.frombuffer(text, np.uint8)
    change = np.zeros(256, np.int8)
    for opening, closing in ("()", "[]", "{}"):
        change[ord(opening)], change[ord(closing)] = 1, -1
    steps = change[characters]
    return int(np.cumsum(steps[steps != 0], dtype=np.int64).max(initial=0))
