"""What happened since the frame before: nothing, a change, a full-frame change, a cut, or the end of a flash."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

from decogs.codec.packets.corrections import Corrections
from decogs.codec.scene.state import State
from decogs.formats.splats import FloatArray
from decogs.rig.pictures.ingest import RigFrame

from ..change.cuts import shows_another_scene
from ..change.flashes import MAX_FLASH_FRAMES, changes_most, is_missed, matches, may_be_flash
from ..change.masks import PixelChange, usable_views
from ..coding.scene import Scene
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
    """A frame to encode: as recorded, compensated, the corrections between the two, and what happened in it.

    ``scene``, ``memory``: what it goes on from. ``changes``: where each picture changed. ``restarted``: the scene is
    the first keyframe's, since the frame begins a closed segment. ``is_return``: a flash is over, so that the decoder's
    state is another than that of ``scene``. ``replayed``: the state after it, where an earlier encode wrote it.
    """

    recorded: RigFrame
    compensated: RigFrame
    corrections: Corrections
    scene: Scene
    memory: Memory
    kind: Kind = Kind.CHANGE
    changes: Sequence[PixelChange] = ()
    restarted: bool = False
    is_return: bool = False
    replayed: State | None = None

    @property
    def index(self) -> int:
        """Its number within the stream."""
        return self.recorded.index - self.scene.header.first_frame

    @property
    def pictures(self) -> Sequence[FloatArray]:
        """The training views' pictures (3, H, W), compensated."""
        return self.compensated.training


def what_happened(context: Context, frame: PendingFrame, watch: Stopwatch) -> PendingFrame:
    """The frame with what it shows, and the scene that it goes on from: the one before a flash, once that is over."""
    settings = context.settings
    lost = frame.recorded.lost_views(context.ingest.views)
    if context.method.dense:
        kind = Kind.NOTHING if len(lost) == len(frame.pictures) else Kind.EVERYTHING
        return replace(frame, kind=kind)
    with watch.stage("masks"):
        frame = _after_flash(frame, context)
        if not settings.frame_effects:
            return replace(frame, kind=Kind.NOTHING)
        scene, memory = frame.scene, frame.memory
        look = memory.first_look(frame.pictures)
        if look is not None and not lost:
            changes = look.changes
        else:
            changes = memory.masks.pixel_changes(frame.pictures, settings.frame.masks, context.threads, lost=lost)
        kind = Kind.CHANGE
        if is_missed(memory.masks, frame.pictures, lambda: memory.views.pictures(scene.splats), changes):
            kind = Kind.EVERYTHING
        elif changes_most(memory.masks, changes):
            if _is_cut(context, frame, changes):
                return replace(frame, kind=Kind.CUT, changes=changes)
            if memory.before_flash is None and may_be_flash(memory.masks, frame.pictures, settings.frame.masks):
                before = BeforeFlash(frame.recorded.index, scene.state, memory.masks)
                memory = replace(memory, before_flash=before)
    return replace(frame, kind=kind, memory=memory, changes=changes)


def _after_flash(frame: PendingFrame, context: Context) -> PendingFrame:
    """The frame with scene and memory from before a flash if its pictures are those again."""
    memory, kept = frame.memory, frame.memory.before_flash
    if kept is None:
        return frame
    frames = frame.recorded.index - kept.since
    if matches(kept.masks, frame.pictures, context.settings.frame.masks):
        memory = replace(memory, masks=kept.masks, before_flash=None)
        return replace(frame, scene=frame.scene.roll_back(kept.state), memory=memory, is_return=True)
    if frames > MAX_FLASH_FRAMES:
        return replace(frame, memory=replace(memory, before_flash=None))
    return frame


def _is_cut(context: Context, frame: PendingFrame, changes: Sequence[PixelChange]) -> bool:
    # A keyframe takes the time of many frames.
    if context.settings.time_budget is not None:
        return False
    # It needs every camera; a segment may start from one that is there.
    used = usable_views(changes)
    if len(used) < len(changes) and not frame.restarted:
        return False
    # References whose pixels are of several frames have edges of their own.
    masks = frame.memory.masks
    now, *before = ([shown[i] for i in used] for shown in (frame.pictures, masks.references, masks.previous))
    return all(shows_another_scene(now, pictures) for pictures in before)
