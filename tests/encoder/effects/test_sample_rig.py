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

from decogs.decoder.reading.info import info
from decogs.decoder.reading.stream import open_stream
from decogs.decoder.rendering.views import render_view
from decogs.encoder.analysis.analyse import Analysis, analyse
from decogs.encoder.analysis.effect import Decision
from decogs.encoder.settings.effects import CAMERA_EFFECTS
from decogs.formats.rigs import open_rig, read_frames
from encode_rig import encode_rig

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


def flickering(name: str, frame: int, picture: np.ndarray) -> np.ndarray:
    """Lamps at 100 Hz light what cam01 and cam04 read in 16 ms, and cam05 from below, by a display's curve."""
    readout = {"cam01": 0.016, "cam04": 0.014, "cam05": -0.018}.get(name)
    if readout is None:
        return picture
    rows = (np.arange(len(picture)) + 0.5) / len(picture)
    light = 1 + 0.15 * np.sin(2 * np.pi * 100 * (frame / 30 + readout * rows) + int(name[-1]))
    return 255 * ((picture / 255) ** 2.2 * light[:, None, None]) ** (1 / 2.2)


def lit(name: str, frame: int, picture: np.ndarray) -> np.ndarray:
    """All cameras see it grow brighter by 4% a frame."""
    return picture * 1.04**frame


def as_recorded(name: str, frame: int, picture: np.ndarray) -> np.ndarray:
    return picture


CLIPS: dict[str, tuple[bool, Shown]] = {
    "moving": (True, as_recorded),
    "faulty": (True, faulty),
    "unlike": (True, unlike),
    "flickering": (True, flickering),
    "lit": (False, lit),
    "still": (False, as_recorded),
}
"""Whether the scene moves, as it does in the sample, or stays at its first frame; and what is done to the pictures."""


BLAMED = {
    "faulty": {"exposure_drift": {"cam01"}, "white_balance_drift": {"cam02"}, "camera_shake": {"cam03"}},
    "unlike": {"colour_mismatch": {"cam02", "cam05"}},
    "flickering": {"lamp_flicker": {"cam01", "cam04", "cam05"}},
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


@pytest.fixture(scope="module")
def steady_and_flickering(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Streams of the clip without and with lamps, by name, beside the clips."""
    folder, streams = tmp_path_factory.mktemp("lamps"), {}
    for name in ("moving", "flickering"):
        write_clip(folder / name, *CLIPS[name])
        streams[name] = folder / f"{name}.dgs"
        encode_rig(folder / name, streams[name], "live", holdout=[HELD_OUT], scale=0.4, effects="auto", threads=1)
    return streams


@pytest.mark.slow
def test_lamps_cost_next_to_nothing(steady_and_flickering: dict[str, Path]) -> None:
    """Neither keyframes nor pictures, and the bytes of phases and strengths."""
    steady, lit = (info(path) for path in steady_and_flickering.values())
    assert [frame.kind for frame in steady.frames] == [frame.kind for frame in lit.frames]
    later = [sum(frame.bytes for frame in info.frames[1:]) for info in (steady, lit)]
    assert later[1] < 1.1 * later[0] + 12 * (FRAMES - 1)
    assert lit.header.corrected.lamp_flicker == ("cam01", "cam04", "cam05")
    assert "lamp_flicker" in lit.header.effects
    assert lit.header.camera_effects("cam05") == ("lamp_flicker",)


@pytest.mark.slow
def test_a_recorded_view_shows_the_bands_and_a_free_one_none(steady_and_flickering: dict[str, Path]) -> None:
    path = steady_and_flickering["flickering"]
    rig = open_rig(path.with_name("flickering"))
    recorded = [pictures[0] for _, pictures in read_frames(rig, names=["cam04"])]
    with open_stream(path) as stream:
        for frame, picture in zip(stream.frames(), recorded, strict=True):
            corrections = frame.corrections, None
            seen = [
                render_view(stream.header, frame.splats, "cam04", scale=0.4, corrections=told).image
                for told in corrections
            ]
            small = cv2.resize(picture, seen[0].shape[1::-1], interpolation=cv2.INTER_AREA) / 255
            kept, free = (float(np.square(each - small).mean()) for each in seen)
            assert kept < 0.8 * free


@pytest.mark.slow
def test_an_encode_of_lamps_goes_on_where_it_was_broken_off(
    steady_and_flickering: dict[str, Path], tmp_path: Path
) -> None:
    whole = steady_and_flickering["flickering"]
    cut = tmp_path / "cut.dgs"
    cut.write_bytes(whole.read_bytes()[: -info(whole).frames[-1].bytes])
    rig = whole.with_name("flickering")
    encode_rig(rig, cut, "live", holdout=[HELD_OUT], scale=0.4, effects="auto", threads=1, resume=True)
    assert cut.read_bytes() == whole.read_bytes()


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
