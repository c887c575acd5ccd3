"""Rate and distortion: the encoder at several rates, and other ways to keep the frames of its finest stream."""

from __future__ import annotations

from decogs.formats.splat_files.ply import Ply
from decogs.formats.splat_files.sog import Sog
from decogs.formats.splat_files.splat import Splat
from decogs.formats.splat_files.spz import Spz, SpzVersion

from ..rivals.float_arrays import FloatArrays, FloatDeltas
from ..rivals.fourdgs import FourDGS
from ..rivals.sequences import FilePerFrame, Rival, WithoutDirections
from ..rivals.splat4d import Splat4d
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
        (("psnr", "psnr_dynamic", "psnr_static", "psnr_subject", "mtv", "selected", "cpu", "gaussians"),),
    ),
)

_NO_DIRECTIONS = (
    "Keeps SH degree 0 only, and neither pays for the rest nor shows it: compare its PSNR with the row of float32 at "
    "degree 0."
)
_FIXED_COUNT = (
    f"{_NO_DIRECTIONS} Takes one fixed set of Gaussians: those that are not there yet, or no more, are kept with "
    "opacity 0. A world unit counts as a metre. It holds what never changes once for the whole clip and cannot be "
    "written before its end is known; its first frame is counted as the file of that frame alone, but shows only once "
    "its group of 30 frames is there."
)
_ONE_GRID = (
    f"{_NO_DIRECTIONS} Its package's writer of keyframe-delta files writes no more, though the format could hold it. "
    "Colours outside 0..1 are put at its ends; positions lie within a share of the median size of all Gaussians. Each "
    "frame is one of its samples, in which no Gaussian moves or fades by itself; a file plays from its front on, so "
    "that its first frame is what lies before the second one."
)


def _spz(
    version: SpzVersion, fraction_bits: int = 12, sh1_bits: int = 5, sh_rest_bits: int = 4, note: str = ""
) -> Rival:
    return Rival(
        f"spz{version}-{fraction_bits}-{sh1_bits}-{sh_rest_bits}",
        f"SPZ {version}",
        f"SPZ {version} per frame, positions 2^-{fraction_bits}, SH {sh1_bits}/{sh_rest_bits} bit{note}",
        FilePerFrame(Spz(fraction_bits, sh1_bits, sh_rest_bits, version)),
    )


def _fourdgs(coder: FourDGS, note: str) -> Rival:
    keyframes = "first" if coder.keyframe_every is None else f"every{coder.keyframe_every}"
    description = f"4dgs, profile {coder.profile}, {note}"
    return Rival(f"4dgs-{coder.profile}-{keyframes}", "4dgs", description, coder, _ONE_GRID)


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
    _spz(3, note=" (its library's default)"),
    _spz(4, 14, 8, 8),
    _spz(4, note=" (its library's default)"),
    _spz(4, 10, 4, 3),
    _spz(4, 8, 3, 3),
    Rival("sog", "SOG", "SOG v2 per frame", FilePerFrame(Sog())),
    Rival("splat", ".splat", ".splat per frame (what splats4d takes)", FilePerFrame(Splat()), _NO_DIRECTIONS),
    _splat4d(0.5, 1, 0, 0.5),
    _splat4d(2, 4, 0, 2, " (its default)"),
    _splat4d(4, 8, 2, 5),
    _splat4d(10, 16, 4, 10),
    _fourdgs(FourDGS("default", 8, None), "a keyframe every 8 frames, deflate (as it comes)"),
    _fourdgs(FourDGS("fine"), "one keyframe, zstd 19"),
    _fourdgs(FourDGS("default"), "one keyframe, zstd 19"),
    _fourdgs(FourDGS("coarse"), "one keyframe, zstd 19"),
)
"""Families in the order of the plot's legend, and within a family from the finest to the coarsest."""

RIVALS_PART, CURVES = "rivals", "curves"
"""Keys for ``--only``: the rivals, and the figure, which shows all rate points."""
FIGURES = {CURVES: RATE_POINTS}
