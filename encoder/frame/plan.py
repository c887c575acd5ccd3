"""A frame's plan: its masks, S_t, effects, steps, thresholds and time, all decided here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..analysis.enabled import enabled_effects
from ..analysis.moving_regions import moving_regions
from ..backends import FixedView
from ..change.flashes import changes_most
from ..change.masks import FrameMask, full_masks, usable_views
from ..change.selection import select, view_evidence
from ..coding.rate_control import scaled_significance
from ..coding.scene import Scene
from ..keyframe.backdrop.stage import BackdropStage, Stage
from ..settings.frame import FrameSettings, SelectionSettings
from ..stopwatch import Stopwatch
from ..training.schedule import missed_share
from .context import Context
from .cross_fade import CrossFade, with_exact_changes
from .events import Event, Kind, PendingFrame
from .memory import Memory

_MOVING_WEIGHT_SHARE = 0.1
"""Share of its rendering weight where things move from which a Gaussian may move."""

_STAGE_SIGNIFICANCE = 0.5
"""Of the losses from which a change is coded, on a plain stage: they are of whole pictures, most of which is backdrop.
`grey` gains .23 dB where things move, for a fifth more bytes."""


_MAX_MISSED_SHARE = 0.45
"""Of the regions of interest: steps follow a light that makes the scene miss less. Relighting such frames, too, takes 3
% more bytes on `candle`, and gains nothing."""


@dataclass(frozen=True)
class Selection:
    """A frame's regions of interest, one mask a view (none for a dense method), and S_t, (N,)."""

    masks: Sequence[FrameMask]
    selected: NDArray[np.bool_]

    @property
    def share(self) -> float:
        """Share of selected Gaussians, 0 to 1."""
        return float(self.selected.mean()) if len(self.selected) else 0.0


@dataclass(frozen=True)
class FramePlan:
    """How a frame is trained and coded: what is selected, its effects by name, none where nothing is, and its settings.

    ``light_only`` (N,): the selected Gaussians that light alone changes, in a frame in which others move; else None.
    ``relit``: light has changed more than steps follow. ``deferred``: it is not trained; the next frame gets its time.
    """

    selection: Selection
    effects: tuple[str, ...]
    settings: FrameSettings
    light_only: NDArray[np.bool_] | None = None
    relit: bool = False
    deferred: bool = False

    @property
    def trains(self) -> bool:
        """Whether the frame is trained."""
        return bool(self.effects) and not self.deferred


def find_selection(context: Context, event: Event, frame: PendingFrame, watch: Stopwatch) -> Selection:
    """The masks around what changed, and the Gaussians that they select."""
    population = len(event.scene.state)
    if event.kind is Kind.EVERYTHING:
        return Selection(full_masks(event.changes), np.ones(population, bool))
    if event.kind is Kind.NOTHING:
        return Selection([], np.zeros(population, bool))
    with watch.stage("masks"):
        look = event.memory.first_look(frame.pictures)
        if look is not None and look.changes is event.changes:
            masks = look.masks
        else:
            masks = event.memory.masks.masks(
                frame.pictures, event.changes, context.settings.frame.masks, threads=context.threads
            )
    if not any(mask.dilated.any() for mask in masks):
        return Selection(masks, np.zeros(population, bool))
    with watch.stage("selection"):
        return Selection(masks, _select(context, event.scene, event.memory.stage, masks))


def select_again(context: Context, scene: Scene, event: Event, selection: Selection) -> Selection:
    """The same masks with S_t of a scene that was trained since."""
    if event.kind is Kind.EVERYTHING:
        return replace(selection, selected=np.ones(len(scene.state), bool))
    return replace(selection, selected=_select(context, scene, event.memory.stage, selection.masks))


def plan_frame(
    context: Context, event: Event, selection: Selection, frame: PendingFrame, fade: CrossFade | None, watch: Stopwatch
) -> FramePlan:
    """The settings with which a frame is trained and coded."""
    settings, memory = context.settings, event.memory
    effects, by_light = settings.frame_effects if selection.selected.any() else (), None
    relit = bool(effects) and changes_most(event.changes) and _is_missed(context, event.scene, selection, frame)
    if relit:
        # Light reaches what a single view sees; where it clips, it changes edges, too.
        selection = replace(selection, selected=np.ones(len(selection.selected), bool))
    if effects and settings.detect_per_frame and selection.masks and not relit:
        with watch.stage("effects"):
            look = memory.first_look(frame.pictures)
            if look is not None and look.masks is selection.masks:
                moving = look.moving
            else:
                references = memory.masks.references
                moving = moving_regions(frame.pictures, references, selection.masks, threads=context.threads)
            found = enabled_effects(settings, moving)
            effects, settings = found.effects, found.settings
            if found.moving is None:
                relit = _is_missed(context, event.scene, selection, frame)
            else:
                views = context.views.of(event.scene.splats)
                by_light = light_only(views, selection, found.moving, settings.frame.selection)
    now = settings.frame
    if isinstance(memory.stage, BackdropStage):
        now = replace(now, significance=scaled_significance(now.significance, _STAGE_SIGNIFICANCE))
    if memory.rate is not None:
        now = replace(now, significance=memory.rate.significance(now.significance))
    settings_now = now if fade is None else with_exact_changes(now)
    deferred = bool(effects) and _is_deferred(memory, watch)
    return FramePlan(selection, effects, settings_now, by_light, relit, deferred)


def _is_missed(context: Context, scene: Scene, selection: Selection, frame: PendingFrame) -> bool:
    """Whether the ``scene`` clearly misses much of the regions of interest."""
    shown = zip(context.views.pictures(scene.splats), frame.pictures, selection.masks, strict=True)
    errors = [np.clip(drawn, 0, 1)[:, mask.dilated] - now[:, mask.dilated] for drawn, now, mask in shown]
    return missed_share(errors) > _MAX_MISSED_SHARE


def _is_deferred(memory: Memory, watch: Stopwatch) -> bool:
    """Whether a frame that needs training is deferred, so that a later one has enough time."""
    return memory.time is not None and memory.time.defers(watch.seconds, memory.trainer.min_seconds)


def _select(context: Context, scene: Scene, stage: Stage | None, masks: Sequence[FrameMask]) -> NDArray[np.bool_]:
    """S_t. Of a plain stage's backdrop, whose places are known, each part may be seen by a single view."""
    used, settings = usable_views(masks), context.settings.frame.selection
    views = context.views.of(scene.splats)
    evidence = [view_evidence(views[i], masks[i].dilated) for i in used]
    selected = select(evidence, settings)
    if stage is not None:
        of_any_view = select(evidence, replace(settings, min_views=1))
        selected |= of_any_view & stage.on_backdrop(scene.splats.means)
    return selected


def light_only(
    views: Sequence[FixedView],
    selection: Selection,
    moving: Sequence[NDArray[np.bool_]],
    settings: SelectionSettings,
) -> NDArray[np.bool_]:
    """Selected Gaussians (N,) that hardly show where things move: light changes them.

    ``moving``: the pixels of each view, (H, W), in and around what moves; the ``views`` show the scene.
    """
    used = [index for index in usable_views(selection.masks) if moving[index].any()]
    if not used:
        return selection.selected
    regions = [moving[index] & selection.masks[index].dilated for index in used]
    may_move = replace(settings, rule="weight", min_fraction=_MOVING_WEIGHT_SHARE)
    return selection.selected & ~_select_within(views, used, regions, may_move)


def _select_within(
    views: Sequence[FixedView],
    used: Sequence[int],
    regions: Sequence[NDArray[np.bool_]],
    settings: SelectionSettings,
) -> NDArray[np.bool_]:
    """The Gaussians that the rule selects for these regions (H, W) of the ``used`` views."""
    return select([view_evidence(views[i], region) for i, region in zip(used, regions, strict=True)], settings)
