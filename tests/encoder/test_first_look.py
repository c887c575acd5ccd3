"""The next frame is looked at while one trains, where that leaves the processor idle; streams keep their bits."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import pytest

from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.change.masks import MaskMemory


def test_a_look_ahead_changes_no_bit_and_is_used(
    encode: Any, moving_rig: Path, moving: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Frame 2 shows nothing new and trains nothing, so that frame 3 is looked at when its turn comes."""
    asked, pixel_changes = [], MaskMemory.pixel_changes

    def noted(*given: Any, **named: Any) -> Any:
        asked.append(threading.current_thread() is threading.main_thread())
        return pixel_changes(*given, **named)

    monkeypatch.setattr(MaskMemory, "pixel_changes", noted)
    monkeypatch.setattr(CpuKernel, "leaves_processor_idle", True)
    looked = encode(moving_rig, threads=2)
    assert looked.data == moving.data
    assert asked == [True, False, True]


def test_a_look_at_another_frame_is_not_used(
    encode: Any, moving_rig: Path, moving: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As where frames come in another order than they were read in."""
    monkeypatch.setattr(CpuKernel, "leaves_processor_idle", True)
    monkeypatch.setattr("decogs.rig.parallel.Ahead.peek", lambda ahead: [])
    assert encode(moving_rig, threads=2).data == moving.data
