"""A report for whoever gets a take: one page that holds all it shows."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

import numpy as np

from decogs import __version__
from decogs.decoder import decode
from decogs.decoder.reading.info import StreamInfo, info
from decogs.decoder.reading.info_text import summary_lines
from decogs.formats.cli.command_line import size_text
from decogs.formats.rigs import Rig
from decogs.formats.system.callbacks import OnProgress
from decogs.rig.check.plan import document

from .against import against
from .compared import Compared, compare, holding_of, pairs_of
from .figures import error_table, in_text, pair_figure
from .holding import document as map_document
from .holding import parts
from .records import file_digest
from .spent import Spent

FRAMES = 12
"""Of a take, that are compared."""
_WORST_SHARE = 0.05
_LOOP_WIDTH = 480
_STYLE = """<style>
pre { white-space: pre-wrap }
@media print { video { display: none } table, figure { break-inside: avoid } }
figure { display: inline-block; margin: 0 12px 12px 0 } figcaption { font-size: 90% }
table.errors td { text-align: right; min-width: 3em; color: #111 }
</style>"""


@dataclass(frozen=True)
class Extras:
    """What a page may have besides: what the encode took, and another stream of the take (``other``)."""

    spent: Spent | None = None
    other: Path | None = None


NOTHING_MORE = Extras()


def report(
    stream: Path, rig: Rig, title: str, on_frame: OnProgress, threads: int = 0, extras: Extras = NOTHING_MORE
) -> str:
    """The page, HTML. Raises StreamError, RigError, and UsageError where stream and rig have nothing in common."""
    facts = info(stream)
    compared = compare(stream, rig, FRAMES, on_frame, threads)
    ranked = compared.ranked()
    worst = ranked[: max(1, round(_WORST_SHARE * len(ranked)))]
    shown = list(
        dict.fromkeys((camera, frame) for _, camera, frame in [worst[0], ranked[len(ranked) // 2], ranked[-1]])
    )
    pairs = pairs_of(stream, rig, shown, threads)
    page = [
        _STYLE,
        f"<p>{escape(_in_short(facts, compared))}</p>",
        _loop(stream, facts, threads),
        _heard(facts),
        "<h2>Recorded beside shown</h2><p>The worst picture, the middle one and the best; errors in red.</p>",
        *(pair_figure(pairs[key]) for key in shown),
        *parts(holding_of(stream, rig, compared, threads), facts.header.cameras, compared.held_out),
        f"<h2>Errors</h2><p>{escape(_about_errors(compared))}</p>",
        error_table(compared),
        f"<h2>The worst {_WORST_SHARE:.0%}</h2><ul>",
        *(f"<li>{escape(camera)}, frame {frame}: {dB:.2f} dB</li>" for dB, camera, frame in worst),
        "</ul>",
        *([] if extras.other is None else against(stream, extras.other, rig, FRAMES, on_frame, threads)),
        "<h2>Bytes</h2>",
        _bytes(facts),
        "" if extras.spent is None else f"<p>{escape(extras.spent.text)}</p>",
        "<h2>The stream</h2><pre>",
        *(escape(line) for line in _facts(stream, facts)),
        "</pre>",
    ]
    return document(title, page)


def fence(stream: Path, rig: Rig, on_frame: OnProgress, threads: int = 0) -> str:
    """The page's map of where the scene holds, JSON, within which a player keeps views. Raises as `report` does."""
    compared = compare(stream, rig, 1, on_frame, threads)
    return json.dumps(map_document(holding_of(stream, rig, compared, threads)))


def _in_short(facts: StreamInfo, compared: Compared) -> str:
    header, count = facts.header, len(facts.frames)
    seconds = "" if header.fps is None else f", {count / header.fps:.1f} s"
    sound = f", {len(facts.sounds)} tracks of sound" if facts.sounds else ", no sound"
    of_training = [i for i, name in enumerate(compared.cameras) if name not in compared.held_out]
    values = [f"{_mean(compared, of_training):.1f} dB from its cameras"] if of_training else []
    if compared.held_out:
        held_out = [compared.cameras.index(name) for name in compared.held_out]
        values.append(f"{_mean(compared, held_out):.1f} dB where no camera of the training stood")
    about = ", ".join(values) or "no camera compared"
    return f"{count} frames{seconds}, {len(header.cameras)} cameras, {size_text(facts.file_bytes)}{sound}. {about}."


def _mean(compared: Compared, rows: Sequence[int]) -> float:
    return float(np.nanmean(compared.psnr[rows]))


def _about_errors(compared: Compared) -> str:
    of = "the subject's own pixels" if compared.subject else "whole pictures"
    return f"PSNR in dB of {of}, {len(compared.frames)} frames; cameras marked * were kept out of training."


def _loop(stream: Path, facts: StreamInfo, threads: int) -> str:
    """A turn around the scene while it plays."""
    width = max(camera.width for camera in facts.header.cameras)
    with tempfile.TemporaryDirectory() as folder:
        film = Path(folder) / "loop.mp4"
        decode(stream, film, move="orbit", scale=min(1.0, _LOOP_WIDTH / width), threads=threads)
        data = in_text(film.read_bytes())
    return f"<video autoplay loop muted playsinline controls src='data:video/mp4;base64,{data}'></video>"


def _heard(facts: StreamInfo) -> str:
    return "<p>The stream's sound is in the film: switch it on there.</p>" if facts.sounds else ""


def _bytes(facts: StreamInfo) -> str:
    """A bar for each frame, as high as its logarithm."""
    sizes = [frame.bytes for frame in facts.frames]
    most = max(np.log2(max(sizes, default=1) + 1), 1.0)
    width = max(1.0, 720 / max(1, len(sizes)))
    bars = "".join(
        f"<rect x='{i * width:.1f}' y='{60 * (1 - np.log2(size + 1) / most):.1f}' width='{0.8 * width:.1f}' "
        f"height='{60 * np.log2(size + 1) / most:.1f}' fill='{'#c60' if frame.kind == 'key' else '#357'}'/>"
        for i, (size, frame) in enumerate(zip(sizes, facts.frames, strict=True))
    )
    later = facts.totals["bytes_per_frame_without_first_key"]
    told = f"First frame {size_text(sizes[0])}" if sizes else "No frame"
    told += f", later ones {size_text(round(later))} on average; keyframes are orange." if later else "."
    return f"<svg width='720' height='60' viewBox='0 0 720 60'>{bars}</svg><p>{told}</p>"


def _facts(stream: Path, facts: StreamInfo) -> Iterator[str]:
    """What decogs-info says before its rows of frames, the file's digest, and what made the page."""
    for line in summary_lines(facts):
        if not line:
            break
        yield line.replace(str(facts.path), stream.name)
    yield f"SHA-256      {file_digest(stream)}"
    yield f"report       decogs {__version__}"
