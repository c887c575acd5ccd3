"""The first look at the next frame, taken while this one trains: its masks, and where things move in it.

They need the frame before only for what its masks hand on, which is known before it is trained, unless training fails.
Where training leaves the processor idle, they cost nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from decogs.formats.splats import FloatArray
from decogs.rig.pictures.ingest import RigFrame

from ..analysis.moving_regions import moving_regions
from ..backends import TrainingKernel
from ..change.masks import BoolArray, FrameMask, MaskMemory, PixelChange
from ..settings.encode import EncodeSettings

Upcoming = Callable[[], "Sequence[RigFrame]"]
"""Waits for the next frame, none after the last."""


@dataclass(frozen=True)
class FirstLook:
    """What is seen of the ``pictures`` of a frame, if the one before it hands on ``memory``.

    ``moving``: of each view, the pixels (H, W) in and around what moves; None where light alone changes.
    """

    memory: MaskMemory
    pictures: Sequence[FloatArray]
    changes: Sequence[PixelChange]
    masks: Sequence[FrameMask]
    moving: Sequence[BoolArray] | None

    def is_of(self, memory: MaskMemory, pictures: Sequence[FloatArray]) -> bool:
        """Whether these are what it was taken of."""
        return memory is self.memory and len(pictures) == len(self.pictures) and all(map(_is, pictures, self.pictures))


@dataclass(frozen=True)
class Looking:
    """A first look that is being taken: what the frame before hands on, and then the look itself."""

    memory: Future[MaskMemory]
    look: Future[FirstLook | None]

    def taken(self) -> FirstLook | None:
        """The look; None where there is no next frame, or none that can be looked at."""
        return None if self.look.cancelled() or self.look.exception() else self.look.result()


def begin_looking(
    hand_on: Callable[[], MaskMemory],
    upcoming: Upcoming,
    kernel: TrainingKernel,
    settings: EncodeSettings,
    threads: int,
) -> Looking:
    """Looks at the ``upcoming`` frame, which is compared with what this one hands on and brought to the ``kernel``."""
    worker = ThreadPoolExecutor(1)
    memory = worker.submit(hand_on)
    look = worker.submit(lambda: _look(memory.result(), upcoming(), kernel, settings, threads))
    worker.shutdown(wait=False)
    return Looking(memory, look)


def _look(
    memory: MaskMemory, coming: Sequence[RigFrame], kernel: TrainingKernel, settings: EncodeSettings, threads: int
) -> FirstLook | None:
    if not coming or coming[0].lost:
        return None
    pictures = coming[0].training
    kernel.bring(*pictures)
    changes = memory.pixel_changes(pictures, settings.frame.masks, threads)
    masks = memory.masks(pictures, changes, settings.frame.masks, threads)
    moving = moving_regions(pictures, memory.references, masks, recorded=memory.recorded, threads=threads)
    return FirstLook(memory, pictures, changes, masks, moving)


def _is(a: object, b: object) -> bool:
    return a is b
