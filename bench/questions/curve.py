"""What accuracy costs in time: every way to have less or more of it, from the presets to single settings.

Rows share the keyframe wherever they do not change it.
"""

from __future__ import annotations

from decogs.encoder.settings.presets import LADDER

from .rates import RATE_POINTS
from .variants import Question, Variant

_TIME = ("psnr", "psnr_dynamic", "psnr_static", "ssim", "ssim_dynamic", "ssim_static", "cpu", "seconds")
_SPACE = ("megabytes", "megabytes_all", "gaussians", "fps", "decode_fps", "keyframe_seconds")
_COLUMNS = (_TIME, _SPACE)

PRESET_ROWS = tuple(Variant(f"preset-{name}", name, preset=name, own_keyframe=True) for name in LADDER)

QUESTIONS = (
    Question(
        "presets",
        "Presets",
        "`--preset`, from the fastest to the slowest, each with a keyframe of its own.",
        PRESET_ROWS,
        _COLUMNS,
    ),
    Question(
        "iterations",
        "Training steps",
        "Steps of stage 2 that a later frame is trained for, from the shared keyframe.",
        tuple(
            Variant(f"steps-{steps}", f"{steps} steps", {"frame.joint_iterations": steps})
            for steps in (15, 30, 60, 90, 120, 300, 600)
        ),
        _COLUMNS,
    ),
    Question(
        "resolution",
        "Training resolution",
        "`--scale` of the pictures trained on, each with a keyframe of its own. The held-out view is measured at the "
        "same size in every row.",
        tuple(
            Variant(f"scale-{scale:g}", f"scale {scale:g}", scale=scale, own_keyframe=True)
            for scale in (0.25, 0.5, 0.75, 1.0)
        ),
        _COLUMNS,
    ),
    Question(
        "gaussians",
        "Gaussians",
        "The most that a keyframe may have, each trained on its own.",
        tuple(
            Variant(f"cap-{cap}", f"{cap // 1000}k Gaussians", {"keyframe.cap": cap}, own_keyframe=True)
            for cap in (13_000, 26_000, 52_000, 80_000)
        ),
        _COLUMNS,
    ),
    Question(
        "sh",
        "View dependence",
        "Degree of the spherical harmonics, each with a keyframe of its own.",
        tuple(
            Variant(f"sh-{degree}", f"SH degree {degree}", {"keyframe.sh_degree": degree}, own_keyframe=True)
            for degree in (0, 1, 2, 3)
        ),
        _COLUMNS,
    ),
    Question(
        "quality",
        "Quantisation",
        "`--quality`: lattice, significance threshold and lambda, each with a keyframe of its own.",
        RATE_POINTS,
        _COLUMNS,
    ),
)
"""Families of the plot, in the order of its legend."""
