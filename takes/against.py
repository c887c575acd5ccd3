"""Two streams of one take beside each other: where one is nearer to what was recorded than the other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from html import escape
from pathlib import Path

import numpy as np

from decogs.decoder.reading.stream import open_stream
from decogs.formats.cli.command_line import size_text
from decogs.formats.errors import UsageError
from decogs.formats.rigs import Rig
from decogs.formats.system.callbacks import OnProgress

from .compared import F64, Compared, compare, pairs_of
from .figures import error_picture, figure, table

_WORST_SHARE = 0.05
_STRONG_DB = 3.0
"""Difference that has the strongest colour."""


def against(stream: Path, other: Path, rig: Rig, most_frames: int, on_frame: OnProgress, threads: int) -> list[str]:
    """Parts of a page. Raises UsageError for streams that begin with other frames, and as `compare`."""
    with open_stream(stream) as one, open_stream(other) as two:
        if one.header.first_frame != two.header.first_frame:
            begins = f"{one.header.first_frame} and {two.header.first_frame}"
            raise UsageError(f"`against` {other}: the streams begin with the rig's frames {begins}; `trim` one of them")
        count = min(one.frame_count, two.frame_count)
    mine, theirs = (compare(each, rig, most_frames, on_frame, threads, upto=count) for each in (stream, other))
    names = [name for name in mine.cameras if name in theirs.cameras]
    rows = [compared.psnr[[compared.cameras.index(name) for name in names]] for compared in (mine, theirs)]
    gain = rows[0] - rows[1]
    if not np.isfinite(gain).any():
        raise UsageError(f"`against` {other}: the streams have no picture in common")
    return [
        f"<h2>Against {escape(other.name)}</h2>",
        *_summary((stream, other), (mine, theirs), rows),
        "<p>dB by which this stream is nearer to what was recorded; * was kept out of the training of both.</p>",
        _gain_table(names, mine, theirs, gain),
        *_figures(stream, other, rig, names, mine.frames, gain, threads),
    ]


def _summary(streams: tuple[Path, Path], compared: tuple[Compared, Compared], rows: Sequence[F64]) -> Iterator[str]:
    yield "<table><tr><th></th><th>bytes</th><th>dB</th><th>worst camera</th><th>worst frame</th>"
    yield f"<th>worst {_WORST_SHARE:.0%}</th></tr>"
    for path, values in zip(streams, rows, strict=True):
        known = np.sort(values[np.isfinite(values)])
        worst = known[: max(1, round(_WORST_SHARE * len(known)))].mean()
        lowest = [float(np.nanmin(np.nanmean(values, axis=axis))) for axis in (1, 0)]
        cells = [size_text(path.stat().st_size), *(f"{dB:.2f}" for dB in (known.mean(), *lowest, worst))]
        yield f"<tr><th>{escape(path.name)}</th>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"
    yield "</table>"


def _gain_table(names: Sequence[str], mine: Compared, theirs: Compared, gain: F64) -> str:
    both = set(mine.held_out) & set(theirs.held_out)
    labels = [f"{name}{'*' if name in both else ''}" for name in names]
    return table(labels, mine.frames, gain, _cell)


def _cell(value: float) -> str:
    if not np.isfinite(value):
        return "<td>-</td>"
    share = float(np.clip(abs(value) / _STRONG_DB, 0, 1))
    return f"<td style='background:hsl({120 if value > 0 else 0} 60% {100 - 25 * share:.0f}%)'>{value:+.1f}</td>"


def _figures(
    stream: Path, other: Path, rig: Rig, names: Sequence[str], frames: Sequence[int], gain: F64, threads: int
) -> Iterator[str]:
    """Where this stream is best and worst against the other: recorded, both, and their errors."""
    places = (divmod(int(pick(gain)), gain.shape[1]) for pick in (np.nanargmax, np.nanargmin))
    wanted = list(dict.fromkeys((names[row], frames[column]) for row, column in places))
    one, two = (pairs_of(path, rig, wanted, threads) for path in (stream, other))
    for key in wanted:
        mine, theirs = one[key], two[key]
        caption = f"{key[0]}, frame {key[1]}: recorded; {mine.psnr:.2f} dB; {other.name} {theirs.psnr:.2f} dB; errors"
        pictures = [mine.recorded, mine.shown, theirs.shown, error_picture(mine), error_picture(theirs)]
        yield figure(pictures, caption)
