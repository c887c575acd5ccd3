"""What the paper leaves open, and every default of ours, as questions: one row per answer, measured alike.

To ask something new, add a Question here. A Variant's ``settings`` are dotted paths into EncodeSettings; everything
else stays the report's preset. A row that is the preset itself is run once for the whole report and marked in each
table.
"""

from __future__ import annotations

from ..transformation_cache import CacheSettings
from .variants import Question, Times, Variant

_QUALITY = ("psnr", "psnr_dynamic", "psnr_static", "last_dynamic", "slope_dynamic", "mtv")
_COST = ("selected", "seconds", "cpu", "megabytes")
_BOTH = (_QUALITY + _COST,)
_KEYFRAME = (("psnr", "ssim", "training", "gaussians", "keyframe_seconds", "keyframe_bytes"),)

_SMALL_CACHE = CacheSettings(levels=8, features=2, table_log2=13)
_FAST_CACHE = CacheSettings(learning_rate=1e-2)


def _caches() -> tuple[Variant, ...]:
    rows = [Variant(f"cache-none-warm{w:g}", f"none, warm start {w:g}", _cache(None, False, w)) for w in (0.0, 0.9)]
    kinds = (
        ("", "3DGStream's", CacheSettings()),
        ("-small", "small", _SMALL_CACHE),
        ("-fast", "rate x 5", _FAST_CACHE),
    )
    for suffix, words, cache in kinds:
        for carry in (False, True):
            for warm in (0.0, 0.9):
                kept = "carried" if carry else "fresh"
                rows.append(
                    Variant(
                        f"cache-{kept}{suffix}-warm{warm:g}",
                        f"{words}, {kept}, warm start {warm:g}",
                        _cache(cache, carry, warm),
                    )
                )
    return tuple(rows)


def _cache(cache: CacheSettings | None, carry: bool, warm: float) -> dict[str, object]:
    return {"frame.cache": cache, "frame.carry_cache": carry, "frame.warm_start": warm}


QUESTIONS = (
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
        "The share of its last displacement that a Gaussian begins the next frame with.",
        tuple(
            Variant(f"warm{w:g}", f"{w:g}", {"frame.cache": None, "frame.warm_start": w}) for w in (0.0, 0.5, 0.9, 1.0)
        ),
        _BOTH,
    ),
    Question(
        "cache",
        "Neural transformation cache",
        "None, anew in every frame, or carried over; with and without the warm start; its size and its rate. "
        "Stage 1 takes the preset's cache_iterations, stage 2 its joint_iterations.",
        _caches(),
        _BOTH,
    ),
    Question(
        "iterations",
        "Iterations of stage 2",
        "",
        tuple(Variant(f"iterations{n}", f"{n}", {"frame.joint_iterations": n}) for n in (30, 60, 100, 200)),
        _BOTH,
    ),
    Question(
        "emergence",
        "Seeds for what newly appears",
        "",
        (
            Variant("emergence-off", "off", {"frame.emergence.most": 0}),
            Variant("emergence-on", "on, at most 2000 a frame", {"frame.emergence.most": 2000}),
        ),
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
        tuple(Variant(f"share{s:g}", f"{s:g}", {"frame.selection.least_share": s}) for s in (0.1, 0.3, 0.5)),
        _BOTH,
    ),
    Question(
        "start-opacity",
        "First opacity of the keyframe's Gaussians",
        "The keyframe alone, trained anew for every row.",
        tuple(
            Variant(f"opacity{o:g}", f"{o:g}", {"keyframe.start_opacity": o}, frames=1, own_keyframe=True)
            for o in (0.1, 0.2, 0.3)
        ),
        _KEYFRAME,
    ),
)
