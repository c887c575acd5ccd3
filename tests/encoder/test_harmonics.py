"""The keyframe decides which SH degrees a stream has: those that rounding by what shows has left."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from decogs.codec.scene.state import Attributes
from decogs.decoder import open_stream
from decogs.encoder.analysis import EffectChoice
from decogs.encoder.keyframe import first_frame
from decogs.encoder.keyframe.harmonics import MIN_SH_SHARE, trim_sh_degree
from decogs.encoder.keyframe.train import TUNING, train_keyframe
from encode_rig import encode_rig as encode

COUNT = 1000
FEW, ENOUGH = round(MIN_SH_SHARE * COUNT) - 1, round(MIN_SH_SHARE * COUNT)


def keyframe_with(shares: tuple[int, ...]) -> Attributes:
    """Values of degree ``len(shares)``: so many Gaussians, chosen at random, have one harmonic of each degree."""
    random = np.random.default_rng(5)
    sh = np.zeros((COUNT, (len(shares) + 1) ** 2, 3), np.int32)
    sh[:, 0] = random.integers(-100, 100, (COUNT, 3))
    for degree, count in enumerate(shares, start=1):
        rows = random.permutation(COUNT)[:count]
        sh[rows, random.integers(degree**2, (degree + 1) ** 2, count), random.integers(0, 3, count)] = -1
    shapes = ((3,), (3,), (4,), ())
    return Attributes(*(random.integers(-9, 9, (COUNT, *shape), np.int32) for shape in shapes), sh)


@pytest.mark.parametrize(
    ("shares", "degree"),
    [((), 0), ((0,), 0), ((FEW,), 0), ((ENOUGH,), 1), ((COUNT, FEW), 1), ((COUNT, ENOUGH), 2), ((0, ENOUGH), 2),
     ((FEW // 2, 0, FEW // 2), 0), ((ENOUGH, 0, FEW), 1)],
)  # fmt: skip
def test_a_degree_that_hardly_any_gaussian_shows_goes(shares: tuple[int, ...], degree: int) -> None:
    values = keyframe_with(shares)
    trimmed = trim_sh_degree(values)
    assert trimmed.coefficients == (degree + 1) ** 2
    np.testing.assert_array_equal(trimmed.sh, values.sh[:, : (degree + 1) ** 2])
    for name in ("means", "log_scales", "quaternions", "opacity_logits"):
        assert getattr(trimmed, name) is getattr(values, name)


@pytest.mark.parametrize(
    ("effects", "degree"),
    [(EffectChoice("auto"), 0), (EffectChoice("none", {"motion", "view_dependence"}), 1)],
    ids=["auto", "named"],
)
def test_only_auto_asks_the_keyframe(
    moving_rig: Path,
    tiny_rig: Any,
    tiny_settings: Any,
    tmp_path: Path,
    effects: EffectChoice,
    degree: int,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where harmonics are hardly trained, none is worth its bytes. An encode cut off goes on with its degree."""
    output, again = tmp_path / "scene.dgs", tmp_path / "again.dgs"
    flat = replace(TUNING, rates=replace(TUNING.rates, sh_rest=1e-9))
    monkeypatch.setattr(first_frame, "train_keyframe", partial(train_keyframe, tuning=flat))
    options = {"holdout": [tiny_rig.held_out], "settings": tiny_settings, "effects": effects}
    encode(moving_rig, output, **options)
    with open_stream(output) as stream:
        assert stream.header.sh_degree == degree
        assert ("view_dependence" in stream.header.effects) == bool(degree)
        assert json.loads(stream.header.to_bytes())["settings"]["keyframe"]["sh_degree"] == 1, "as it was trained"
        offset = [frame.packet_bytes for frame in stream.frames()][-1]
    again.with_name("again.dgs.part").write_bytes(output.read_bytes()[: -offset - 100])
    encode(moving_rig, again, resume=True, **options)
    assert again.read_bytes() == output.read_bytes()
