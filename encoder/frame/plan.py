"""A frame's plan: its masks, S_t, effects, steps, thresholds and time, all decided here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.rig.stage.stage import BackdropStage
from decogs.rig.stage.subject import SubjectAlone

from ..analysis.enabled import enabled_effects
from ..analysis.moving_regions import moving_regions
from ..backends import FixedView
from ..change.flashes import changes_most
from ..change.masks import FrameMask, usable_views
from ..change.selection import select, view_evidence
from ..coding.rate_control import scaled_significance
from ..settings.frame import FrameSettings, SelectionSettings
from ..stopwatch import Stopwatch
from ..training.schedule import missed_share
from .context import Context
from .cross_fade import CrossFade, with_exact_changes
from .events import Kind, PendingFrame
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
class FramePlan:
    """How a frame is trained and coded: S_t, its effects by name, none where nothing is selected, and its settings.

    ``masks``: the regions of interest, one a view, none for a dense method. ``selected``: S_t, (N,). ``light_only``:
    those of S_t, (N,), that light alone changes, in a frame in which others move; else None. ``relit``: light has
    changed more than steps follow. ``deferred``: it is not trained; the next frame gets its time.
    """

    masks: Sequence[FrameMask]
    selected: NDArray[np.bool_]
    effects: tuple[str, ...]
    settings: FrameSettings
    light_only: NDArray[np.bool_] | None = None
    relit: bool = False
    deferred: bool = False

    @property
    def share(self) -> float:
        """Share of selected Gaussians, 0 to 1."""
        return float(self.selected.mean()) if len(self.selected) else 0.0

    @property
    def trains(self) -> bool:
        """Whether the frame is trained."""
        return bool(self.effects) and not self.deferred


def find_masks(context: Context, frame: PendingFrame, watch: Stopwatch) -> Sequence[FrameMask]:
    """The regions of interest around what changed."""
    if frame.kind is Kind.EVERYTHING:
        return frame.memory.masks.full_masks(frame.changes)
    if frame.kind is Kind.NOTHING:
        return []
    with watch.stage("masks"):
        settings, look = context.settings.frame.masks, frame.memory.first_look(frame.pictures)
        if look is not None and look.changes is frame.changes:
            return look.masks
        return frame.memory.masks.masks(frame.pictures, frame.changes, settings, threads=context.threads)


def find_selected(
    context: Context, frame: PendingFrame, masks: Sequence[FrameMask], watch: Stopwatch
) -> NDArray[np.bool_]:
    """S_t, (N,): the Gaussians of the frame's scene that its ``masks`` select."""
    population = len(frame.scene.state)
    if frame.kind is Kind.EVERYTHING:
        return np.ones(population, bool)
    if not any(mask.dilated.any() for mask in masks):
        return np.zeros(population, bool)
    with watch.stage("selection"):
        return _select(context, frame, masks)


def plan_frame(
    context: Context,
    frame: PendingFrame,
    masks: Sequence[FrameMask],
    selected: NDArray[np.bool_],
    fade: CrossFade | None,
    watch: Stopwatch,
) -> FramePlan:
    """The settings with which a frame is trained and coded."""
    settings, memory = context.settings, frame.memory
    effects, by_light = settings.frame_effects if selected.any() else (), None
    relit = bool(effects) and changes_most(memory.masks, frame.changes) and _is_missed(frame, masks)
    if relit:
        # Light reaches what a single view sees; where it clips, it changes edges, too.
        selected = np.ones(len(selected), bool)
    if effects and settings.detect_per_frame and masks and not relit:
        with watch.stage("effects"):
            look = memory.first_look(frame.pictures)
            if look is not None and look.masks is masks:
                moving = look.moving
            else:
                moving = moving_regions(
                    frame.pictures,
                    memory.masks.references,
                    masks,
                    recorded=memory.masks.recorded,
                    threads=context.threads,
                )
            enabled = enabled_effects(settings, moving)
            effects, settings = enabled.effects, enabled.settings
            if enabled.moving is None:
                relit = _is_missed(frame, masks)
            else:
                views = memory.views.of(frame.scene.splats)
                by_light = light_only(views, masks, selected, enabled.moving, settings.frame.selection)
    now = settings.frame
    if isinstance(memory.stage, BackdropStage):
        now = replace(now, significance=scaled_significance(now.significance, _STAGE_SIGNIFICANCE))
    if memory.rate is not None:
        now = replace(now, significance=memory.rate.significance(now.significance))
    settings_now = now if fade is None else with_exact_changes(now)
    deferred = bool(effects) and _is_deferred(memory, watch)
    return FramePlan(masks, selected, effects, settings_now, by_light, relit, deferred)


def _is_missed(frame: PendingFrame, masks: Sequence[FrameMask]) -> bool:
    """Whether the scene before the frame clearly misses much of the regions of interest."""
    shown = zip(frame.memory.views.pictures(frame.scene.splats), frame.pictures, masks, strict=True)
    errors = [np.clip(drawn, 0, 1)[:, mask.dilated] - now[:, mask.dilated] for drawn, now, mask in shown]
    return missed_share(errors) > _MAX_MISSED_SHARE


def _is_deferred(memory: Memory, watch: Stopwatch) -> bool:
    """Whether a frame that needs training is deferred, so that a later one has enough time."""
    return memory.time is not None and memory.time.defers(watch.seconds, memory.time.pace.least)


def _select(context: Context, frame: PendingFrame, masks: Sequence[FrameMask]) -> NDArray[np.bool_]:
    """S_t. Of a backdrop, a stage's or the sky, whose places are known, each part may be seen by a single view."""
    used, settings = usable_views(masks), context.settings.frame.selection
    scene, stage = frame.scene.splats, frame.memory.stage
    views = frame.memory.views.of(scene)
    evidence = [view_evidence(views[i], masks[i].dilated) for i in used]
    selected = select(evidence, settings)
    if stage is not None:
        of_any_view = select(evidence, replace(settings, min_views=1))
        selected |= of_any_view & stage.on_backdrop(scene.means)
    if isinstance(stage, SubjectAlone):
        # What the subject has left behind goes, also where no picture changes: over a background of its colour.
        selected |= stage.in_frame(context.ingest.views, frame.compensated, used).free(scene.means)
    return selected


def light_only(
    views: Sequence[FixedView],
    masks: Sequence[FrameMask],
    selected: NDArray[np.bool_],
    moving: Sequence[NDArray[np.bool_]],
    settings: SelectionSettings,
) -> NDArray[np.bool_]:
    """Selected Gaussians (N,) that hardly show where things move: light changes them.

    ``moving``: the pixels of each view, (H, W), in and around what moves; the ``views`` show the scene.
    """
    used = [index for index in usable_views(masks) if moving[index].any()]
    if not used:
        return selected
    regions = [moving[index] & masks[index].dilated for index in used]
    may_move = replace(settings, rule="weight", min_fraction=_MOVING_WEIGHT_SHARE)
    return selected & ~_select_within(views, used, regions, may_move)


def _select_within(
    views: Sequence[FixedView],
    used: Sequence[int],
    regions: Sequence[NDArray[np.bool_]],
    settings: SelectionSettings,
) -> NDArray[np.bool_]:
    """The Gaussians that the rule selects for these regions (H, W) of the ``used`` views."""
    return select([view_evidence(views[i], region) for i, region in zip(used, regions, strict=True)], settings)
