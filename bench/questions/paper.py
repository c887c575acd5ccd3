"""The paper's tables and figures, asked of any rig."""

from __future__ import annotations

from dataclasses import replace

from decogs.encoder.analysis import EffectChoice
from decogs.encoder.settings.optimiser import LearningRates

from .variants import Question, Times, Variant

DECOGS = Variant("decogs", "DecoGS, all effects in every frame")
DECOGS_AUTO = Variant("decogs-auto", "DecoGS, detected effects (the default)", effects=EffectChoice("auto"))
DECOGS_PAPER = Variant("decogs-paper", "DecoGS, the paper's recipe (preset paper)", preset="paper")
BASELINE = Variant("3dgstream", "3DGStream baseline, dense", method="3dgstream")
METHODS = (DECOGS_AUTO, DECOGS, DECOGS_PAPER, BASELINE)
HELD = Variant(
    "keyframe-held",
    "the keyframe alone, nothing sent after it",
    {"frame.masks.threshold": 255.0, "frame.masks.light_threshold": 0.0},
)
"""No pixel changes by more than 255 levels, and no light is faint. What its static PSNR loses, the recording itself has
changed."""
FRESH = Variant("fresh-keyframe", "a keyframe trained on the last frame", frames=-1, own_keyframe=True)

TAUS = (10.0, 25.0, 50.0)
RADII = (0.5, 1.0, 2.0)
STRIDES = (1, 5, 10)
SWEEP_FRAMES = 16
"""Nine runs a rig: the first frames suffice."""
RECIPE_FRAMES = 9
"""A keyframe and eight frames, so that three seeds of a dozen rows take half an hour."""

_ONE_STAGE = {"frame.joint_iterations": 250}
_SEEDS = {"frame.emergence.max_seeds": 2000}
_3DGS_RATES = LearningRates(1.6e-4, 5e-3, 1e-3, 0.05, 2.5e-3, 1.25e-4)

_COST = ("seconds", "cpu", "fps", "megabytes", "megabytes_all", "selected")
_BRIEF = ("psnr", "psnr_dynamic", "psnr_static", "last_dynamic", "mtv", "selected", "cpu", "megabytes")


def _sweep() -> tuple[Variant, ...]:
    return tuple(
        Variant(
            f"tau{tau:g}-r{radius:g}",
            f"τ = {tau:g}, r × {radius:g}",
            {"frame.masks.threshold": tau, "frame.masks.radius_fraction": Times(radius)},
            frames=SWEEP_FRAMES,
        )
        for tau in TAUS
        for radius in RADII
    )


_RECIPE = (
    Variant("recipe-region", "focus terms are means over the region", {"frame.focus.over": "region"}, preset="paper"),
    Variant("recipe-weight", "selection by rendering weight", preset="paper", selection="weight"),
    Variant("recipe-4-views", "selection in 4 views", {"frame.selection.min_views": 4}, preset="paper"),
    Variant("recipe-8-views", "selection in 8 views", {"frame.selection.min_views": 8}, preset="paper"),
    Variant("recipe-dilation", "half the dilation", {"frame.masks.radius_fraction": Times(0.5)}, preset="paper"),
    Variant("recipe-no-cache", "no cache, 250 steps", _ONE_STAGE, preset="paper", method="decogs"),
    Variant(
        "recipe-emergence", "no cache, new objects get points", _ONE_STAGE | _SEEDS, preset="paper", method="decogs"
    ),
    Variant("recipe-rates", "stage 2 at 3DGS's learning rates", {"frame.rates": _3DGS_RATES}, preset="paper"),
    Variant("recipe-no-growth", "no densification", {"frame.grow_fraction": 0.0}, preset="paper"),
    Variant("recipe-reference", "compared as last trained", {"frame.masks.since_trained": True}, preset="paper"),
    Variant(
        "recipe-weight-rates", "by weight, 3DGS's rates", {"frame.rates": _3DGS_RATES}, "paper", selection="weight"
    ),
)
"""The paper's recipe with one of its choices made otherwise."""

QUESTIONS = (
    Question(
        "default",
        "The default",
        "The preset with the detected effects.",
        (DECOGS_AUTO,),
        (("first", "psnr", "last", "psnr_dynamic", "last_dynamic"), ("keyframe_bytes", "megabytes", "cpu", "selected")),
    ),
    Question(
        "methods",
        "Methods side by side",
        "The same keyframe, views and rasteriser for all. The last row sends nothing: what its static PSNR loses over "
        "time is the recording's own (noise, video coding), not a method's.",
        (*METHODS, HELD),
        (
            ("psnr", "psnr_dynamic", "psnr_static", "slope", "slope_dynamic", "static_change"),
            ("ssim", "ssim_dynamic", "ssim_static", "lpips", "st_lpips", "flip"),
            ("psnr_worst_camera", "psnr_worst_frame", "psnr_worst_5", "psnr_change", "mtv", "mtv_undisturbed"),
            _COST,
        ),
    ),
    Question(
        "fresh",
        "The last frame, against a keyframe trained on it",
        "What training from scratch would reach there, with the preset's keyframe settings.",
        (*METHODS, FRESH),
        (("last", "last_dynamic", "last_static", "gaussians"),),
    ),
    Question(
        "components",
        "Components",
        "In the paper's order, each row with one part more; then the two rules of selection. Without any part it is "
        "fine-tuning of all Gaussians frame by frame, not yet the 3DGStream baseline.",
        (
            Variant("no-parts", "none", ablate=("select", "focus", "gate")),
            Variant("select", "+ selection", ablate=("focus", "gate")),
            Variant("select-focus", "+ focus loss", ablate=("gate",)),
            Variant("select-focus-gate", "+ gate: DecoGS"),
            Variant("selection-paper", "DecoGS, selection by centre (the paper's)", selection="paper"),
            Variant("selection-weight", "DecoGS, selection by rendering weight", selection="weight"),
        ),
        (_BRIEF,),
    ),
    Question(
        "recipe",
        "The paper's recipe, taken apart",
        "Each row is preset `paper` with one choice made otherwise. It flickers where the paper does not; this shows "
        "which of its choices does it. The focus terms of its loss are means over the whole picture, as the text has "
        f"them; the second row has the other reading. The first {RECIPE_FRAMES} frames.",
        tuple(
            replace(variant, name=f"{variant.name}-{RECIPE_FRAMES}", frames=RECIPE_FRAMES)
            for variant in (DECOGS_PAPER, *_RECIPE, DECOGS)
        ),
        (("psnr_dynamic", "psnr_static", "last_dynamic", "mtv", "mtv_undisturbed", "selected", "cpu", "megabytes"),),
    ),
    Question(
        "frame-rate",
        "Frame rate",
        "Every frame, every 5th, every 10th: what lies between two frames grows. The frames measured are those "
        "encoded; the second column compares the frames that all rows have. mTV is from one encoded frame to the next.",
        (
            *(
                Variant(f"every-{k}", "DecoGS, every frame" if k == 1 else f"DecoGS, every {k}th frame", stride=k)
                for k in STRIDES
            ),
            Variant("baseline-every-1", "3DGStream baseline, every frame", method="3dgstream"),
        ),
        (("psnr", "psnr_common", "psnr_dynamic", "mtv", "selected", "cpu", "megabytes"),),
    ),
    Question(
        "sweep",
        "Sensitivity to τ and r",
        "τ is the threshold of the difference mask in 8-bit levels, r its dilation, here in units of the preset's "
        f"(a share of the picture's width, so it goes with the size). The first {SWEEP_FRAMES} frames.",
        _sweep(),
        (_BRIEF,),
    ),
)

TIME, SCANLINES, ERRORS = "time", "scanlines", "errors"
FIGURES = {TIME: METHODS, SCANLINES: (DECOGS_AUTO, BASELINE), ERRORS: (DECOGS_AUTO, DECOGS_PAPER, BASELINE)}
"""Keys of the figures, for ``--only``, and the variants they show."""
