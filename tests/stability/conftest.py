"""The encoder tests' tiny rig and observed encode, and what is done to the rig's pictures here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.encoder import PRESETS, EncodeSettings
from encoder_fixtures import encoder_conftest as _tiny

tiny_rig, encode, shared_data = _tiny.tiny_rig, _tiny.encode, _tiny.shared_data

SETTINGS: EncodeSettings = replace(
    _tiny.TINY,
    keyframe=replace(_tiny.TINY.keyframe, iterations=300, cap=2500),
    frame=replace(PRESETS["standard"].frame, joint_iterations=40),
)
"""Later frames as the standard preset trains them, in fewer steps."""

Edit = Callable[[np.ndarray], np.ndarray]


@pytest.fixture(scope="session")
def settings() -> EncodeSettings:
    return SETTINGS


@pytest.fixture(scope="session")
def edit_picture() -> Callable[..., None]:
    """``edit_picture(rig, camera, frame, change)``: the picture (H, W, 3), 8 bit, as ``change`` makes it."""

    def edit(rig: Path, camera: str, frame: int, change: Edit) -> None:
        path = rig / camera / f"{frame:04d}.png"
        changed = np.clip(np.rint(change(cv2.imread(str(path)).astype(float))), 0, 255)
        assert cv2.imwrite(str(path), changed.astype(np.uint8))

    return edit


@pytest.fixture(scope="session")
def noisy_rig(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """``noisy_rig(moments)``: the tiny rig at these moments, with sensor noise, as no real camera is without."""

    def write(moments: list[int], **options: Any) -> Path:
        folder = tmp_path_factory.mktemp("rigs") / "rig"
        path: Path = _tiny.TinyRig.write(folder, frames=moments, noise=1.2, **options)
        return path

    return write
