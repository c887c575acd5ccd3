"""Pictures that a camera lacks amid those of the others: their frames stay, each with the path of a file that is not
there, so that reading them says so."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from .sources import FrameSource, PictureSource


def with_gaps(sources: Sequence[FrameSource]) -> tuple[FrameSource, ...]:
    """The sources, with as many files as most of the others where files between their first and last are missing."""
    numbers = {row: own for row, source in enumerate(sources) if (own := _numbers(source))}
    lists = sorted(map(tuple, numbers.values()), key=len, reverse=True)
    usual = max(lists, key=lists.count, default=())
    return tuple(
        _filled(source, numbers[row], usual)
        if row in numbers and len(numbers[row]) < len(usual) and isinstance(source, PictureSource)
        else source
        for row, source in enumerate(sources)
    )


def _numbers(source: FrameSource) -> list[int]:
    """The frames' numbers; none where names do not tell them, or by several numbers together."""
    numbers = source.frame_numbers() if isinstance(source, PictureSource) else None
    return [number for (number,) in numbers] if numbers and len(numbers[0]) == 1 else []


def _filled(source: PictureSource, own: Sequence[int], usual: Sequence[int]) -> PictureSource:
    """The source with the frames ``usual``; as it is where more than those between its first and last differ."""
    if (own[0], own[-1]) != (usual[0], usual[-1]) or not set(own) < set(usual) or 2 * len(own) < len(usual):
        return source
    files = dict(zip(own, source.files, strict=True))
    first, last = (re.split(r"([0-9]+)", file.stem) for file in (source.files[0], source.files[-1]))
    index = max(k for k in range(1, len(first), 2) if (int(first[k]), int(last[k])) == (own[0], own[-1]))

    def named(number: int) -> Path:
        digits = f"{number:0{len(first[index])}d}"
        name = "".join([*first[:index], digits, *first[index + 1 :]])
        return source.files[0].with_name(name + source.files[0].suffix)

    return replace(source, files=tuple(files.get(number) or named(number) for number in usual))
