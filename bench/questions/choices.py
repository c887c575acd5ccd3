"""What the paper leaves open, and every default of ours, as questions: one row per answer, measured alike.

To ask something new, add a Question here. A Variant's ``settings`` are dotted paths into EncodeSettings; everything
else stays the report's preset. A row that is the preset itself is run once for the whole report and marked in each
table.
"""

from __future__ import annotations

from decogs.encoder.analysis import EffectChoice
from decogs.encoder.settings.frame import IterationSettings, SignificanceSettings

from ..timing import TIMINGS
from .variants import Question, Times, Variant

_QUALITY = ("psnr", "psnr_dynamic", "psnr_static", "last_dynamic", "slope_dynamic", "mtv")
_COST = ("selected", "seconds", "cpu", "megabytes")
_BOTH = (_QUALITY + _COST,)


def _warm(share: float) -> dict[str, object]:
    return {"frame.warm_start": share}


_AUTO = EffectChoice("auto")
_DEFAULT = Variant("heuristics-all", "all of them", effects=_AUTO)


def _off(name: str, description: str, settings: dict[str, object]) -> Variant:
    return Variant(f"no-{name}", description, settings, effects=_AUTO)


QUESTIONS = (
    Question(
        "heuristics",
        "Each heuristic left out",
        "One that gains two standard errors on two rigs, or 5 % of the bytes, or 5 % of the time stays; the others go "
        "unless a hard case needs them.",
        (
            _DEFAULT,
            _off("specks", "specks are no change", {"frame.masks.speck_area": 0}),
            _off("since-trained", "compared as last trained", {"frame.masks.since_trained": False}),
            _off("light", "faint light", {"frame.masks.light_threshold": 0.0}),
            _off("pace", "steps by the missed share", {"frame.adaptive_iterations": IterationSettings()}),
            _off("warm", "warm start", {"frame.warm_start": 0.0}),
            _off("emergence", "seeds for new objects", {"frame.emergence.max_seeds": 0}),
            _off("growth", "densification", {"frame.grow_fraction": 0.0}),
            _off("short-memory", "Adam's short memory", {"frame.beta1": 0.9, "frame.beta2": 0.999}),
            _off("focus", "the focus of the loss", {"frame.focus.whole": 1.0, "frame.focus.focus": 0.0}),
            _off("structure", "structure in the loss", {"frame.focus.dissimilarity": 0.0}),
            _off("significance", "significance", {"frame.significance.threshold": 0.0}),
            _off(
                "rd",
                "rate-distortion optimisation",
                {"frame.significance.rd_lambda": 0.0, "frame.significance.colour_rd_lambda": 0.0},
            ),
        ),
        _BOTH,
        _DEFAULT,
    ),
    Question(
        "beta",
        "Loss weights β1 (whole picture) and β2 (focus)",
        "Not published. Only their ratio matters: Adam does not see the loss's scale.",
        tuple(
            Variant(
                f"beta{whole:g}-{focus:g}",
                f"β1 = {whole:g}, β2 = {focus:g}",
                {"frame.focus.whole": whole, "frame.focus.focus": focus},
            )
            for whole, focus in ((1.0, 0.0), (0.5, 0.5), (0.2, 0.8), (0.0, 1.0))
        ),
        _BOTH,
    ),
    Question(
        "selection",
        "Rule of selection",
        "Centre in the masks of two views (the paper's), or share of the rendering weight inside the masks.",
        tuple(Variant(f"selection-{rule}", rule, selection=rule) for rule in ("paper", "weight")),
        _BOTH,
    ),
    Question(
        "warm-start",
        "Warm start, without a transformation cache",
        "The share of the displacement shown by optical flow that a Gaussian begins the next frame with.",
        tuple(Variant(f"warm{w:g}", f"{w:g}", {"frame.warm_start": w}) for w in (0.0, 0.5, 1.0)),
        _BOTH,
    ),
    Question(
        "cache",
        "Neural transformation cache",
        "None, with and without the warm start; or the paper's two stages (method paper) on the preset's masks and "
        "selection, with its joint_iterations. The paper's method seeds no new objects and reverts no insignificant "
        "change, so that its row has more bytes.",
        (
            *(Variant(f"cache-none-warm{w:g}", f"none, warm start {w:g}", _warm(w)) for w in (0.0, 1.0)),
            Variant("cache-paper", "the paper's method", method="paper"),
        ),
        _BOTH,
    ),
    Question(
        "timing",
        "Where the cache might help: motion that turns back or speeds up",
        "The same recording, every second frame to its end and back over those between, and in steps of 1, 1, 2, 2, 3, "
        "3, ... frames; each without warm start, with it, and by the paper's method, which has a cache instead.",
        tuple(
            Variant(
                f"{timing}-{name}", f"{timing.replace('-', ' ')}, {words}", _warm(warm), method=method, timing=timing
            )
            for timing in TIMINGS
            for name, words, warm, method in (
                ("cold", "no cache, no warm start", 0.0, None),
                ("warm", "no cache, warm start", 1.0, None),
                ("cache", "the paper's method", 0.0, "paper"),
            )
        ),
        (("psnr", "psnr_dynamic", "psnr_static", "last_dynamic", "mtv", "selected", "cpu", "megabytes"),),
    ),
    Question(
        "iterations",
        "Iterations of stage 2",
        "",
        tuple(Variant(f"iterations{n}", f"{n}", {"frame.joint_iterations": n}) for n in (60, 90, 120, 200)),
        _BOTH,
    ),
    Question(
        "pace",
        "Iterations by what a frame misses",
        "The share of the region of interest that a frame misses at its start for the iterations to be those of the "
        "preset; one that misses more runs as many times more, at most 3, and one that misses less at least the share "
        "in the row.",
        tuple(
            Variant(
                f"pace{usual:g}-{least:g}",
                f"{usual:g}, at least {least:g}" if usual else "the same for every frame",
                {"frame.adaptive_iterations": IterationSettings(usual, min_factor=least)},
            )
            for usual, least in ((0.0, 1.0), (0.1, 1.0), (0.15, 0.6), (0.15, 1.0), (0.25, 1.0))
        ),
        _BOTH,
    ),
    Question(
        "attributes",
        "What stage 2 trains",
        "Places, sizes and turns always; opacity and colour as the row says.",
        (
            Variant("attributes-all", "opacity and colour too"),
            Variant("attributes-no-opacity", "not opacity", {"frame.rates.opacity_logits": 0.0}),
            Variant("attributes-no-colour", "not colour", {"frame.rates.sh_dc": 0.0, "frame.rates.sh_rest": 0.0}),
            Variant(
                "attributes-places",
                "neither",
                {"frame.rates.sh_dc": 0.0, "frame.rates.sh_rest": 0.0, "frame.rates.opacity_logits": 0.0},
            ),
        ),
        _BOTH,
    ),
    Question(
        "adam",
        "Adam's memory in stage 2",
        "",
        tuple(
            Variant(f"adam{b1:g}-{b2:g}", f"β1 {b1:g}, β2 {b2:g}", {"frame.beta1": b1, "frame.beta2": b2})
            for b1, b2 in ((0.9, 0.999), (0.8, 0.99), (0.7, 0.99))
        ),
        _BOTH,
    ),
    Question(
        "reference",
        "What a frame is compared with",
        "The frame before, or for every pixel the picture on which it was last trained.",
        (
            Variant("reference-before", "the frame before", {"frame.masks.since_trained": False}),
            Variant("reference-trained", "last trained", {"frame.masks.since_trained": True}),
        ),
        _BOTH,
    ),
    Question(
        "faint-light",
        "From what change on light counts over much of the picture; half of it where light alone changes",
        "In 8-bit levels of the mean over 7 x 7 pixels; with the detected effects.",
        tuple(
            Variant(
                f"light{t:g}",
                f"{t:g}" if t else "as everything else",
                {"frame.masks.light_threshold": t},
                effects=EffectChoice("auto"),
            )
            for t in (0.0, 2.5, 4.0, 6.0)
        ),
        _BOTH,
    ),
    Question(
        "noise",
        "Threshold by the camera's own noise",
        "τ 4 without and with a floor of so many standard deviations of the camera's frame-to-frame noise; no specks "
        "are dropped, so that the threshold alone decides.",
        (
            Variant("noise-preset", "τ 10, specks dropped, no floor"),
            *(
                Variant(
                    f"noise{m:g}",
                    f"τ 4, {m:g} standard deviations" if m else "τ 4, no floor",
                    {"frame.masks.threshold": 4.0, "frame.masks.speck_area": 0, "frame.masks.noise_multiple": m},
                )
                for m in (0.0, 4.0, 6.0)
            ),
        ),
        _BOTH,
    ),
    Question(
        "emergence",
        "Seeds for what newly appears",
        "",
        (
            Variant("emergence-off", "off", {"frame.emergence.max_seeds": 0}),
            *(
                Variant(f"emergence{n}", f"on, from at most {n} rays", {"frame.emergence.max_rays": n})
                for n in (250, 500, 2000)
            ),
        ),
        _BOTH,
    ),
    Question(
        "structure",
        "Weight of structure in later frames",
        "Lambda of the focus-aware loss: the share of 1 - SSIM.",
        tuple(Variant(f"structure{d:g}", f"{d:g}", {"frame.focus.dissimilarity": d}) for d in (0.0, 0.05, 0.1, 0.2)),
        _BOTH,
    ),
    Question(
        "rates",
        "Learning rates of stage 2",
        "All of them, in units of the preset's.",
        tuple(Variant(f"rates{f:g}", f"× {f:g}", {"frame.rates": Times(f)}) for f in (0.5, 1.0, 2.0)),
        _BOTH,
    ),
    Question(
        "tau",
        "Threshold τ of the difference mask",
        "In 8-bit levels.",
        tuple(Variant(f"tau{t:g}", f"{t:g}", {"frame.masks.threshold": t}) for t in (5.0, 10.0, 25.0)),
        _BOTH,
    ),
    Question(
        "least-share",
        "Least share of the rendering weight inside the masks",
        "For the selection by weight.",
        tuple(
            Variant(f"share{s:g}", f"{s:g}", {"frame.selection.min_fraction": s}) for s in (0.1, 0.3, 0.5, 0.65, 0.8)
        ),
        _BOTH,
    ),
    Question(
        "worth",
        "Significance threshold",
        "By how many millionths it must move a picture's mean loss to be sent; 0 sends everything. The first row sends "
        "everything on a lattice 128 times as fine, which is as good as floats: what significance and rounding cost.",
        (
            Variant("exact", "everything, unrounded", {"frame.significance": SignificanceSettings()}, refined=128),
            *(Variant(f"worth{w:g}", f"{w:g}", {"frame.significance.threshold": w}) for w in (0.0, 0.075, 0.15, 0.3)),
        ),
        _BOTH,
    ),
    Question(
        "rd-lambda",
        "What a bit of a change is worth",
        "Positions, sizes and rotations / colours and opacities, in squared millionths of a picture's loss.",
        tuple(
            Variant(
                f"rd{geometry:g}-{colour:g}",
                f"{geometry:g} / {colour:g}",
                {"frame.significance.rd_lambda": geometry, "frame.significance.colour_rd_lambda": colour},
            )
            for geometry, colour in ((0.0, 0.0), (0.00125, 0.00125), (0.005, 0.00125), (0.005, 0.005), (0.02, 0.005))
        ),
        _BOTH,
    ),
    Question(
        "grow-share",
        "Most Gaussians that a frame may add",
        "As a share of the selected.",
        tuple(Variant(f"grow{g:g}", f"{g:g}", {"frame.grow_fraction": g}) for g in (0.0, 0.003, 0.01, 0.03)),
        _BOTH,
    ),
)
