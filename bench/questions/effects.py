"""What effects cost and what they gain: the detected ones, all, none, and each one wrongly disabled."""

from __future__ import annotations

from decogs.encoder.analysis import EffectChoice
from decogs.encoder.settings.effects import EFFECT_NAMES

from .variants import Question, Variant

AUTO = Variant("effects-auto", "detected (auto)", effects=EffectChoice("auto"))
ALL = Variant("effects-all", "all", effects=EffectChoice("all"))
NONE = Variant("effects-none", "none", effects=EffectChoice("none"))
WITHOUT = {
    name: Variant(f"effects-no-{name}", f"auto, without {name}", effects=EffectChoice("auto", dropped={name}))
    for name in EFFECT_NAMES
}

QUESTIONS = (
    Question(
        "effects",
        "Only the detected effects",
        "`--effects auto`, the default, against all of them in every frame. Where a camera is corrected, and where SH "
        "beyond degree 0 is left out, the row has a keyframe of its own.",
        (AUTO, ALL, NONE),
        (("psnr", "psnr_aligned", "psnr_dynamic", "psnr_static", "mtv"), ("selected", "seconds", "cpu", "megabytes")),
        AUTO,
    ),
    Question(
        "without",
        "One effect wrongly left out",
        "A row equal to auto's is the same run: the scene does not call for that effect.",
        (AUTO, *WITHOUT.values()),
        (("psnr", "psnr_aligned", "psnr_dynamic", "psnr_static", "selected", "cpu", "megabytes"),),
        AUTO,
    ),
)
