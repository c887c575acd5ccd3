"""Short settings for whole reports, and runs made by hand for the tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from decogs.bench.runs.run import Run, RunFrame
from decogs.encoder import PRESETS, EncodeSettings
from decogs.encoder.settings.frame import MaskSettings, SelectionSettings
from encoder_fixtures import encoder_conftest

tiny_rig, tiny_settings = encoder_conftest.tiny_rig, encoder_conftest.tiny_settings
moving_rig, still_rig = encoder_conftest.moving_rig, encoder_conftest.still_rig
encode, moving, dense = encoder_conftest.encode, encoder_conftest.moving, encoder_conftest.dense
shared_data = encoder_conftest.shared_data


@pytest.fixture
def short_presets(monkeypatch: pytest.MonkeyPatch, tiny_settings: EncodeSettings) -> None:
    """Presets "tiny" and "paper" whose frames take a few steps only."""
    selection = SelectionSettings(rule="paper")
    paper = replace(tiny_settings.frame, masks=MaskSettings(), selection=selection, joint_iterations=5)
    monkeypatch.setitem(PRESETS, "tiny", tiny_settings)
    monkeypatch.setitem(PRESETS, "paper", replace(tiny_settings, method="paper", frame=paper))


@pytest.fixture(scope="session")
def three_frames(tiny_rig: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A rig of which the square moves in both later frames."""
    return tiny_rig.write(tmp_path_factory.mktemp("rigs") / "three", frames=[0, 1, 3])  # type: ignore[no-any-return]


FrameOf = Callable[..., RunFrame]
RunOf = Callable[..., Run]


@pytest.fixture(scope="session")
def frame_of() -> FrameOf:
    def make(index: int, **values: Any) -> RunFrame:
        plain: dict[str, Any] = {
            "kind": "delta", "bytes": 2000, "gaussians": 10, "selected": 0.25, "training_psnr": 31.0,
            "seconds": {"masks": 0.25, "training": 1.5}, "cpu_seconds": 3.0, "psnr": 30.0, "psnr_dynamic": 25.0,
            "psnr_static": 32.0, "ssim": 0.9, "ssim_dynamic": 0.8, "ssim_static": 0.95, "lpips": None,
            "variation": 0.001,
        }  # fmt: skip
        return RunFrame(frame=index, **(plain | values))

    return make


@pytest.fixture(scope="session")
def run_of() -> RunOf:
    def make(frames: list[RunFrame], **values: Any) -> Run:
        plain: dict[str, Any] = {
            "rig": "rig", "variant": "v", "description": "a variant", "key": "0123456789", "code": "0.1.0+abc",
            "date": "2026-01-01T00:00:00+00:00", "machine": {"cpu": "abacus", "cores": 2}, "load": [0.5, 1.5],
            "camera": "cam00", "span": [0, len(frames), 1], "scale": 1.0, "seed": 0, "threads": 2, "preset": "standard",
            "command": "decogs-encode rig", "changed": {}, "settings": {}, "masks": "by hand", "lpips_network": None,
            "render_seconds": 0.004, "read_seconds": 0.001, "stream_bytes": 9000, "column": 0,
        }  # fmt: skip
        return Run(frames=frames, **(plain | values))

    return make
