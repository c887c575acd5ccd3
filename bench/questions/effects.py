"""What effects cost and what they gain: the detected ones, all, none, and each one wrongly disabled."""

from __future__ import annotations

from collections.abc import Sequence

from decogs.encoder.analysis import EffectChoice
from decogs.encoder.settings.effects import EFFECT_NAMES

from ..estimates import NOTHING, estimate
from ..runs.results import RigResults
from ..tables.columns import markdown
from ..tables.differences import MOVING, Measure
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


def matrix(results: Sequence[RigResults]) -> list[str]:
    """Scene by effect: what PSNR loses without an effect, dB, whole picture / dynamic region, colours aligned."""
    rows = [[name, *(_loss(result, variant) for result in results)] for name, variant in WITHOUT.items()]
    return [
        "## What a scene loses without an effect",
        "",
        "PSNR of the held-out view once its colours are brought to the recording's, dB against auto: whole picture / "
        "dynamic region. “not detected”: the same run as auto.",
        "",
        *markdown(["without", *(result.bench.name for result in results)], rows),
        "",
    ]


def _loss(result: RigResults, variant: Variant) -> str:
    bench, runs, auto = result.bench, result.runs_of(variant), result.runs_of(AUTO)
    if not runs or not auto:
        return NOTHING
    if bench.key(variant) == bench.key(AUTO):
        return "not detected"
    measures = (Measure("psnr_aligned", "aligned"), MOVING)
    return " / ".join(measure.write(estimate(measure.paired(runs, auto).values())) for measure in measures)
