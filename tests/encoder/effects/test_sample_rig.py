"""The whole analysis on clips made of the sample rig's pictures, each with known effects and nothing else.

Small twins of test_rigs.py: seven cameras and six frames instead of thirteen and up to forty.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from decogs.encoder.analysis.analyse import Analysis, analyse
from decogs.encoder.analysis.effect import Decision
from decogs.encoder.settings.effects import CAMERA_EFFECTS
from decogs.formats.rigs import open_rig, read_frames

SAMPLE = Path(__file__).resolve().parents[2] / "demo" / "workbench"
HELD_OUT, *CAMERAS = NAMES = [f"cam{index:02d}" for index in range(7)]
FRAMES = 6
LATER = (1, FRAMES - 1)
Shown = Callable[[str, int, np.ndarray], np.ndarray]


def faulty(name: str, frame: int, picture: np.ndarray) -> np.ndarray:
    """cam01 brightens by 2% a frame, cam02 grows warmer by 2%, cam03 shakes by 1.5 pixels."""
    if name == "cam01":
        return picture * 1.02**frame
    if name == "cam02":
        return picture * np.float32([1.02**frame, 1, 1.02**-frame])
    if name == "cam03":
        by = np.random.default_rng(frame).normal(0, 1.5 * (frame > 0), (2, 1))
        size, moved = picture.shape[1::-1], np.hstack([np.eye(2), by])
        return cv2.warpAffine(picture, moved, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return picture


def unlike(name: str, frame: int, picture: np.ndarray) -> np.ndarray:
    """cam02 is darker by a tenth in every frame, cam05 warmer."""
    gains = {"cam02": [0.9, 0.9, 0.9], "cam05": [1.08, 1, 0.93]}
    return picture * np.float32(gains.get(name, [1, 1, 1]))


def lit(name: str, frame: int, picture: np.ndarray) -> np.ndarray:
    """All cameras see it grow brighter by 4% a frame."""
    return picture * 1.04**frame


def as_recorded(name: str, frame: int, picture: np.ndarray) -> np.ndarray:
    return picture


CLIPS: dict[str, tuple[bool, Shown]] = {
    "moving": (True, as_recorded),
    "faulty": (True, faulty),
    "unlike": (True, unlike),
    "lit": (False, lit),
    "still": (False, as_recorded),
}
"""Whether the scene moves, as it does in the sample, or stays at its first frame; and what is done to the pictures."""


BLAMED = {
    "faulty": {"exposure_drift": {"cam01"}, "white_balance_drift": {"cam02"}, "camera_shake": {"cam03"}},
    "unlike": {"colour_mismatch": {"cam02", "cam05"}},
}
"""The cameras of the effects that are cameras' faults."""


def write_clip(folder: Path, moves: bool, change: Shown) -> None:
    """rig.json and PNG; a still scene's pictures get fresh noise."""
    rig, random = open_rig(SAMPLE), np.random.default_rng(5)
    recorded = [pictures for _, pictures in read_frames(rig, names=NAMES)][:FRAMES]
    for index, name in enumerate(NAMES):
        (folder / name).mkdir(parents=True)
        for frame in range(FRAMES):
            picture = recorded[frame if moves else 0][index].astype(np.float32)
            noise = 0.0 if moves else random.normal(0, 1.2, picture.shape)
            seen = np.clip(np.rint(change(name, frame, picture) + noise), 0, 255).astype(np.uint8)
            assert cv2.imwrite(str(folder / name / f"{frame:04d}.png"), seen[..., ::-1])
    cameras = [
        {
            "name": camera.name,
            "file": camera.name,
            **{field: getattr(camera, field) for field in ("width", "height", "fx", "fy", "cx", "cy")},
            "world_to_camera": np.asarray(camera.world_to_camera).tolist(),
        }
        for camera in rig.cameras
        if camera.name in NAMES
    ]
    convention = "the centre of the top-left pixel is (0.5, 0.5)"
    (folder / "rig.json").write_text(json.dumps({"pixel_convention": convention, "fps": 30, "cameras": cameras}))


@pytest.fixture(scope="module", params=CLIPS)
def clip(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> tuple[str, Analysis]:
    folder = tmp_path_factory.mktemp("clips") / request.param
    write_clip(folder, *CLIPS[request.param])
    return request.param, analyse(folder, holdout=[HELD_OUT])


def test_every_effect_is_found_where_it_is_and_nowhere_else(clip: tuple[str, Analysis]) -> None:
    """One test for all: the analysis of a clip is what takes time."""
    name, analysis = clip
    decisions: dict[str, Decision] = {finding.decision.effect: finding.decision for finding in analysis.findings}
    assert decisions["sensor_noise"].detected
    blamed = {effect: set(decisions[effect].cameras) for effect in CAMERA_EFFECTS}
    to_blame = BLAMED.get(name, {})
    assert blamed == {effect: to_blame.get(effect, set()) for effect in CAMERA_EFFECTS}
    for effect, decision in decisions.items():
        if effect == "colour_mismatch":
            assert decision.frames == (((0, FRAMES - 1),) if decision.detected else ())
        elif effect in to_blame:
            assert abs(decision.frames[0][0] - LATER[0]) <= 1
            assert abs(decision.frames[-1][1] - LATER[1]) <= 1
        assert HELD_OUT not in decision.cameras
