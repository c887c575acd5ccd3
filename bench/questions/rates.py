"""Rate and distortion: the encoder at several rates, and other ways to keep the frames of its finest stream."""

from __future__ import annotations

from ..rivals import float_arrays, fourdgs, splat4d, splat_files
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
        (
            ("psnr", "psnr_dynamic", "psnr_static", "psnr_subject", "mtv", "selected", "cpu", "gaussians"),
            ("psnr_worst_camera", "psnr_worst_frame", "psnr_worst_5"),
        ),
    ),
)

RIVALS = (*float_arrays.RIVALS, *splat_files.RIVALS, *splat4d.RIVALS, *fourdgs.RIVALS)
"""Families in the order of the plot's legend, and within a family from the finest to the coarsest."""

RIVALS_PART, CURVES = "rivals", "curves"
"""Keys for ``--only``: the rivals, and the figure, which shows all rate points."""
FIGURES = {CURVES: RATE_POINTS}
