"""What happened since the frame before: nothing, a change, a full-frame change, a cut, or the end of a flash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from decogs.codec.corrections import Corrections
from decogs.formats.splats import FloatArray

from ..change.cuts import shows_another_scene
from ..change.flashes import MAX_FLASH_FRAMES, changes_most, is_missed, matches, may_be_flash
from ..change.masks import PixelChange, usable_views
from ..coding.scene import Scene
from ..input.ingest import RigFrame
from ..stopwatch import Stopwatch
from .context import Context
from .memory import BeforeFlash, Memory


class Kind(Enum):
    """What a frame shows, against the scene before it."""

    NOTHING = "no effect is enabled that could change the scene"
    CHANGE = "the scene, in part of which something changed, or in none"
    EVERYTHING = "a change of most of the picture, which no mask finds, or a method that trains everything"
    CUT = "another scene"


@dataclass(frozen=True)
class PendingFrame:
    """A frame to encode: as recorded, compensated (``pictures``), and the corrections between the two.

    ``restarted``: the scene before it is the first keyframe's, since the frame begins a closed segment.
    """

    recorded: RigFrame
    compensated: RigFrame
    corrections: Corrections
    restarted: bool = False

    @property
    def pictures(self) -> Sequence[FloatArray]:
        """The training views' pictures (3, H, W), compensated."""
        return self.compensated.training


@dataclass(frozen=True)
class Event:
    """What happened, with the ``scene`` and ``memory`` that the frame goes on from.

    ``changes``: where each picture changed. ``is_return``: a flash is over, so that the decoder's state is another than
    that of ``scene``.
    """

    kind: Kind
    scene: Scene
    memory: Memory
    changes: Sequence[PixelChange]
    is_return: bool = False


def what_happened(context: Context, scene: Scene, memory: Memory, frame: PendingFrame, watch: Stopwatch) -> Event:
    """What a frame shows, and the scene that it goes on from: the one before a flash, once that is over."""
    settings = context.settings
    lost = frame.recorded.lost_views(context.ingest.views)
    if context.method.dense:
        kind = Kind.NOTHING if len(lost) == len(frame.pictures) else Kind.EVERYTHING
        return Event(kind, scene, memory, [])
    with watch.stage("masks"):
        scene, memory, is_return = _after_flash(scene, memory, frame, context)
        if not settings.frame_effects:
            return Event(Kind.NOTHING, scene, memory, [], is_return)
        changes = memory.masks.pixel_changes(frame.pictures, settings.frame.masks, context.threads, lost=lost)
        kind = Kind.CHANGE
        if is_missed(memory.masks, frame.pictures, context.views.pictures(scene.splats), changes):
            kind = Kind.EVERYTHING
        elif changes_most(changes):
            if _is_cut(context, memory, frame, changes):
                return Event(Kind.CUT, scene, memory, changes, is_return)
            if memory.before_flash is None and may_be_flash(memory.masks, frame.pictures, settings.frame.masks):
                before = BeforeFlash(frame.recorded.index, scene.state, memory.motion, memory.masks)
                memory = replace(memory, before_flash=before)
    return Event(kind, scene, memory, changes, is_return)


def _after_flash(scene: Scene, memory: Memory, frame: PendingFrame, context: Context) -> tuple[Scene, Memory, bool]:
    """Scene and memory from before a flash if the pictures are those again; and whether they are."""
    kept = memory.before_flash
    if kept is None:
        return scene, memory, False
    frames = frame.recorded.index - kept.since
    if matches(kept.masks, frame.pictures, context.settings.frame.masks):
        # What moved before the flash has moved on.
        motion = kept.motion.defer(frames)
        return scene.roll_back(kept.state), replace(memory, motion=motion, masks=kept.masks, before_flash=None), True
    if frames > MAX_FLASH_FRAMES:
        memory = replace(memory, before_flash=None)
    return scene, memory, False


def _is_cut(context: Context, memory: Memory, frame: PendingFrame, changes: Sequence[PixelChange]) -> bool:
    used = usable_views(changes)
    # A keyframe needs every camera; a segment may start from one that is there.
    if not context.settings.cuts or context.settings.time_budget is not None:
        return False
    if len(used) < len(changes) and not frame.restarted:
        return False
    # References whose pixels are of several frames have edges of their own.
    now, *before = (
        [pictures[i] for i in used] for pictures in (frame.pictures, memory.masks.references, memory.masks.previous)
    )
    return all(shows_another_scene(now, pictures) for pictures in before)
