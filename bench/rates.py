"""Rate and distortion: the encoder at several rates, and other ways to keep the frames of its finest stream."""

from __future__ import annotations

from decogs.formats.splat_files.ply import Ply
from decogs.formats.splat_files.sog import Sog
from decogs.formats.splat_files.splat import Splat
from decogs.formats.splat_files.spz import Spz

from .rivals.float_arrays import FloatArrays, FloatDeltas
from .rivals.sequences import FilePerFrame, Rival, WithoutDirections
from .rivals.splat4d import Splat4d
from .variants import Question, Variant

RATE_POINTS = tuple(
    Variant(f"rate-{quality}", f"quality {quality}", quality=quality, own_keyframe=True) for quality in (82, 66, 50, 34)
)
"""From the finest to the coarsest. The first one's stream is what the rivals keep."""

QUESTIONS = (
    Question(
        "rates",
        "Rates",
        "The same recipe at several rates, each from a keyframe of its own.",
        RATE_POINTS,
        (("psnr", "psnr_dynamic", "psnr_static", "mtv", "selected", "cpu", "gaussians"),),
    ),
)

_NO_DIRECTIONS = (
    "Keeps SH degree 0 only, and neither pays for the rest nor shows it: compare its PSNR with the row of float32 at "
    "degree 0."
)
_FIXED_COUNT = (
    f"{_NO_DIRECTIONS} Takes one fixed set of Gaussians: those that are not there yet, or no more, are kept with "
    "opacity 0. A world unit counts as a metre. It holds what never changes once for the whole clip and cannot be "
    "played before its end is known; its first frame is counted as the file of that frame alone."
)


def _spz(fraction_bits: int, sh1_bits: int, sh_rest_bits: int, note: str = "") -> Rival:
    return Rival(
        f"spz-{fraction_bits}-{sh1_bits}-{sh_rest_bits}",
        "SPZ",
        f"SPZ v3 per frame, positions 2^-{fraction_bits}, SH {sh1_bits}/{sh_rest_bits} bit{note}",
        FilePerFrame(Spz(fraction_bits, sh1_bits, sh_rest_bits)),
    )


def _splat4d(
    position_mm: float, colour_levels: int, rotation_steps: int, scale_percent: float, note: str = ""
) -> Rival:
    return Rival(
        f"splats4d-{position_mm:g}-{colour_levels}-{rotation_steps}-{scale_percent:g}",
        "splats4d",
        f"splats4d, ±{position_mm:g} mm, ±{colour_levels} levels, ±{rotation_steps}/128, ±{scale_percent:g} %{note}",
        Splat4d(position_mm, colour_levels, rotation_steps, scale_percent),
        _FIXED_COUNT,
    )


RIVALS = (
    Rival("float32", "float32 + zstd", "float32 arrays per frame, zstd 19", FilePerFrame(FloatArrays())),
    Rival(
        "float32-sh0",
        "float32 + zstd",
        "float32 arrays per frame, SH degree 0 only, zstd 19",
        WithoutDirections(FilePerFrame(FloatArrays())),
        "View-dependent colour is left out: what the formats without it can reach at best.",
    ),
    Rival("float32-deltas", "float32 deltas + zstd", "float32 of the rows that change, zstd 19", FloatDeltas()),
    Rival("ply", "PLY", "INRIA .ply per frame", FilePerFrame(Ply())),
    _spz(14, 8, 8),
    _spz(12, 5, 4, " (its library's default)"),
    _spz(10, 4, 3),
    _spz(8, 3, 3),
    Rival("sog", "SOG", "SOG v2 per frame", FilePerFrame(Sog())),
    Rival("splat", ".splat", ".splat per frame (what splats4d takes)", FilePerFrame(Splat()), _NO_DIRECTIONS),
    _splat4d(0.5, 1, 0, 0.5),
    _splat4d(2, 4, 0, 2, " (its default)"),
    _splat4d(4, 8, 2, 5),
    _splat4d(10, 16, 4, 10),
)
"""Families in the order of the plot's legend, and within a family from the finest to the coarsest."""

RIVALS_PART, CURVES = "rivals", "curves"
"""Keys for ``--only``: the rivals, and the figure, which shows all rate points."""
FIGURES = {CURVES: RATE_POINTS}
