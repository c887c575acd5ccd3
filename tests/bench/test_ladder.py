"""More never costs: each preset of the ladder is at least as good as the one before it, on views it never saw."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from decogs.bench.estimates import estimate
from decogs.bench.questions.variants import Variant
from decogs.bench.runs.rig_bench import RigBench
from decogs.bench.runs.run import BenchOptions, Run
from decogs.bench.tables.differences import MEASURES
from decogs.encoder import PRESETS, EffectChoice

SEEDS = (0, 1, 2)
RIGS = {
    "workbench": ("cam00", "cam03", "cam09"),
    "popup": ("cam00", "cam03", "cam09"),
    "stage": ("cam00", "cam04", "cam08"),
}
LADDER = ("draft", "standard", "high", "archive")


def test_the_upper_presets_begin_with_one_keyframe() -> None:
    """Which is why they are compared from one."""
    assert PRESETS["standard"].keyframe == PRESETS["high"].keyframe == PRESETS["archive"].keyframe


@pytest.mark.slow
@pytest.mark.parametrize("rig", RIGS)
def test_each_preset_is_as_good_as_the_one_before(rig: str, shared_data: Any, tmp_path: Path) -> None:
    """Mean of three cameras left out, three seeds, a keyframe and two frames in small pictures; within two errors."""
    start = 9 if rig == "popup" else 0
    frames = slice(start, start + 3)
    options = BenchOptions(holdout=RIGS[rig], frames=frames, scale=0.35, threads=2, seeds=SEEDS)
    bench = RigBench(shared_data(f"rigs/{rig}"), tmp_path, options)
    runs: dict[str, dict[int, Run]] = {name: {} for name in LADDER}
    for variant in bench.seeded([_variant(name) for name in LADDER]):
        assert variant.seed is not None
        runs[variant.name][variant.seed] = bench.run(variant)
    for faster, slower in pairwise(LADDER):
        for measure in MEASURES[:2]:
            found = estimate(measure.paired(runs[slower], runs[faster]).values())
            assert found is not None
            assert found.error is not None
            assert found.mean > -2 * found.error, f"{slower} against {faster}: {measure.write(found)} {measure.heading}"


def _variant(name: str) -> Variant:
    return Variant(name, name, preset=name, effects=EffectChoice("auto"), own_keyframe=name == "draft")
