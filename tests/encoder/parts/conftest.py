"""A take with a camera that is compensated, in one go and in parts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from decogs.encoder import CorrectionSettings, EncodeSettings
from decogs.encoder.settings.frame import SignificanceSettings
from encode_rig import encode_rig as encode
from part_takes import MOMENTS, SEGMENT, Make, drifting


@pytest.fixture(scope="session")
def rig(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_rig.write(tmp_path_factory.mktemp("rigs") / "take", frames=MOMENTS, faults=drifting)


@pytest.fixture(scope="session")
def settings(tiny_settings: EncodeSettings) -> EncodeSettings:
    """With all that goes from frame to frame, and a camera that is compensated."""
    masks = replace(tiny_settings.frame.masks, since_trained=True)
    significance = SignificanceSettings(threshold=1.0)
    frame = replace(tiny_settings.frame, masks=masks, joint_iterations=20, significance=significance)
    corrections = CorrectionSettings(exposure=("cam01",))
    return replace(tiny_settings, frame=frame, detect_per_frame=True, corrections=corrections)


@pytest.fixture(scope="session")
def make(rig: Path, settings: EncodeSettings) -> Make:
    """``make(output, only)``: a part of the take, or all of it."""

    def run(output: Path, only: tuple[int, int] | None = None, **options: Any) -> Path:
        given: dict[str, Any] = {"settings": settings, "segment": SEGMENT, "closed": True, "threads": 1} | options
        encode(given.pop("rig", rig), output, only=None if only is None else range(*only), **given)
        return output

    return run


@pytest.fixture(scope="session")
def whole(make: Make, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("whole") / "scene.dgs")


@pytest.fixture(scope="session")
def key(make: Make, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make(tmp_path_factory.mktemp("key") / "key.dgs", (0, 1))


@pytest.fixture(scope="session")
def parts(make: Make, key: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("parts")
    spans = [(0, 2), (2, 4), (4, 7)]
    return [make(folder / f"{a}-{b}.dgs", (a, b), keyframe=key) for a, b in spans]
