"""What covers the whole scene is not lost to the threshold against noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from canary.figures import keyframe_of
from canary.rigs import HELD_OUT, write_rig
from decogs.encoder import EffectChoice
from decogs.encoder.analysis import building
from decogs.encoder.settings.presets import preset
from encode_rig import encode_rig as encode

WHOLE_SCENE = {
    "a wave": lambda p, frame: p * (1 + 0.3 * np.sin(np.arange(p.shape[0])[:, None, None] / 6 + frame)),
    "dimmed to a third": lambda p, frame: p / 3,
    "inverted": lambda p, frame: 255.0 - p,
    "a pan": lambda p, frame: np.roll(p, 2 * frame, axis=1),
}


LONG = ("inverted", "dimmed to a third")


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name in LONG)) for name in WHOLE_SCENE]
)
def test_an_encode_loses_nothing_of_it_to_the_noise_threshold(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Training views within 1 dB of the same encode without the threshold."""
    monkeypatch.setitem(building._WITHOUT, "sensor_noise", lambda settings: settings)
    rig = write_rig("arc", tmp_path / "rig")
    for path in sorted(rig.glob("cam*/*.png")):
        if int(path.stem):
            changed = WHOLE_SCENE[name](cv2.imread(str(path)).astype(np.float64), int(path.stem))
            cv2.imwrite(str(path), np.clip(np.rint(changed), 0, 255).astype(np.uint8))
    live, psnr = preset("live"), []
    for multiple in (0.0, 6.0):
        masks = replace(live.frame.masks, noise_multiple=multiple)
        report = encode(
            rig,
            tmp_path / "scene.dgs",
            settings=replace(live, frame=replace(live.frame, masks=masks)),
            keyframe=keyframe_of("arc"),
            holdout=[HELD_OUT],
            effects=EffectChoice("none", {"motion", "appearance_change", "emergence", "disappearance"}),
        )
        psnr.append(min(frame.training_psnr for frame in report.frames[1:]))
        assert report.frames[1].kind != "skip"
        assert not any(frame.full_frame_change for frame in report.frames), "the masks themselves see it"
    assert psnr[1] > psnr[0] - 1
