"""The next frame is looked at while one trains, where that leaves the processor idle; streams keep their bits."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.frame.first_look import FirstLook


class IdleKernel(CpuKernel):
    leaves_processor_idle = True


def look_of(frame: Any, pictures: Sequence[Any]) -> FirstLook | None:
    """The look that an encoded frame hands to the one with these pictures."""
    return frame.memory.first_look(pictures)  # type: ignore[no-any-return]


def test_a_look_ahead_changes_no_bit_and_is_of_the_next_frame_alone(encode: Any, moving_rig: Path, moving: Any) -> None:
    """Frame 2 shows nothing new and trains nothing, so that frame 3 is looked at when its turn comes."""
    looked = encode(moving_rig, keyframe=moving.path, kernel=IdleKernel(2), threads=2)
    assert looked.data == moving.data
    first, second, third = (frame.pictures.training for frame in looked.frames[1:])
    assert [look_of(frame, first) is None for frame in looked.frames[:1]] == [True]
    assert look_of(looked.frames[1], second) is not None
    assert look_of(looked.frames[1], third) is None, "as where frames come in another order"
    assert look_of(looked.frames[1], [picture.copy() for picture in second]) is None, "compared as what they are"
    assert looked.frames[2].memory.looking is None
