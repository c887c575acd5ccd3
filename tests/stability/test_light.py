"""A light that comes on, or goes out, for good: three frames later the scene is about as good as a new keyframe of it.

On the canary's arc of six 88x66 cameras, cam02 held out; colours clip at white, as cameras' do.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from canary.rigs import (
    FRAMES,
    HELD_OUT,
    RIGS,
    CanaryRig,
    arc_cameras,
    cube_before_wall,
    lit_by,
    rig_document,
    write_rig,
)
from decogs.encoder import EncodeSettings
from decogs.encoder.settings.presets import LADDER, preset
from decogs.formats.cameras import scale_camera
from decogs.formats.rigs import open_rig
from encode_rig import encode_rig

LAST = FRAMES - 1
KEYFRAMES = {"high": "standard"}
"""Presets whose keyframes are those of another one."""

LAMP, EVERYWHERE = 0.8, 1e6
"""Distances from the lamp up to which its light reaches."""

Check = Callable[..., None]


LEFT_OUT = ["cam00", "cam04", "cam09"]


def of_each_frame(name: str, cap: int = 1500) -> EncodeSettings:
    """The preset with few Gaussians; each frame is trained for what it shows, as the command does."""
    settings = preset(name)
    return replace(settings, keyframe=replace(settings.keyframe, cap=cap), detect_per_frame=True)


def lit_anew(rig: Path, gain: float, folder: Path) -> Path:
    """The first frames of a rig of videos in 88x66, from the second on with the gain; one level of noise."""
    random, cameras = np.random.default_rng(7), []
    for camera in open_rig(rig).cameras:
        (folder / camera.name).mkdir(parents=True)
        video = cv2.VideoCapture(str(rig / f"{camera.name}.mp4"))
        for frame in range(FRAMES):
            small = cv2.resize(video.read()[1].astype(np.float32), (88, 66), interpolation=cv2.INTER_AREA)
            shown = np.clip(small * (gain if frame else 1), 0, 255) + random.normal(0, 1, small.shape)
            picture = np.clip(np.rint(shown), 0, 255).astype(np.uint8)
            assert cv2.imwrite(str(folder / camera.name / f"{frame:04d}.png"), picture)
        cameras.append(scale_camera(camera, 0.25))
    (folder / "rig.json").write_text(json.dumps(rig_document(cameras)))
    return folder


@pytest.fixture(scope="module")
def is_reached(tmp_path_factory: pytest.TempPathFactory) -> Check:
    """``is_reached(name, gain, reach)``: from frame 1 on light has this gain up to ``reach`` from the lamp.

    The last frame has at most 1 dB less than its own keyframe.
    """
    folder = tmp_path_factory.mktemp("light")

    @cache
    def rig(gain: float, reach: float) -> Path:
        scenes = [cube_before_wall(0)] + [lit_by(cube_before_wall(0), [gain - 1] * 3, reach)] * LAST
        with pytest.MonkeyPatch.context() as patched:
            patched.setitem(RIGS, "lamp", CanaryRig(arc_cameras(), scenes.__getitem__))
            return write_rig("lamp", folder / f"{gain}-{reach}")

    @cache
    def keyframe(name: str, rig: Path, frame: int) -> tuple[Path, float]:
        output = folder / f"{rig.name}-{name}-{frame}.dgs"
        report = encode_rig(
            rig, output, of_each_frame(name), frames=slice(frame, frame + 1), holdout=[HELD_OUT], threads=1
        )
        return output, report.frames[0].held_out_psnr or 0.0

    def check(name: str, gain: float, reach: float) -> None:
        lit, alike = rig(gain, reach), KEYFRAMES.get(name, name)
        before, _ = keyframe(alike, rig(1.0, 1.0), 0)
        _, fresh = keyframe(alike, lit, LAST)
        output = folder / f"{lit.name}-{name}.dgs"
        report = encode_rig(lit, output, of_each_frame(name), holdout=[HELD_OUT], keyframe=before, threads=1)
        assert [frame.kind for frame in report.frames].count("key") == 1
        assert (report.frames[LAST].held_out_psnr or 0.0) > fresh - 1

    return check


@pytest.mark.parametrize(("gain", "reach"), [(8, EVERYWHERE), (1 / 8, EVERYWHERE), (8, LAMP)])
def test_light_that_comes_on_for_good_is_reached_within_three_frames(
    is_reached: Check, gain: float, reach: float
) -> None:
    is_reached("live", gain, reach)


@pytest.mark.slow
@pytest.mark.parametrize("reach", [EVERYWHERE, LAMP])
@pytest.mark.parametrize("gain", [1 / 8, 1 / 4, 1 / 2, 2, 4, 8])
@pytest.mark.parametrize("name", LADDER)
def test_light_of_any_gain_is_reached_by_every_preset(is_reached: Check, name: str, gain: float, reach: float) -> None:
    is_reached(name, gain, reach)


@pytest.mark.slow
@pytest.mark.parametrize("gain", [8, 1 / 8])
def test_light_over_things_that_move_is_reached(
    tmp_path: Path, shared_data: Callable[[str], Path], gain: float
) -> None:
    """Three left-out cameras of `workbench`: 1 dB, since seeds differ by .1, and what is left of it is .6."""
    rig = lit_anew(shared_data("rigs/workbench"), gain, tmp_path / "rig")
    settings = of_each_frame("standard", 6000)

    def psnr(name: str, last: int, **given: Any) -> float:
        report = encode_rig(rig, tmp_path / name, settings, holdout=LEFT_OUT, threads=1, **given)
        return report.frames[last].held_out_psnr or 0.0

    psnr("before.dgs", 0, frames=slice(1))
    fresh = psnr("fresh.dgs", 0, frames=slice(LAST, FRAMES))
    assert psnr("lit.dgs", LAST, keyframe=tmp_path / "before.dgs") > fresh - 1
