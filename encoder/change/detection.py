"""Change detection: a frame's masks and selected Gaussians, with the state between frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.state import State
from decogs.formats.splats import FloatArray

from ..backends import FixedView
from ..settings.encode import EncodeSettings
from ..settings.frame import SelectionSettings
from ..stopwatch import Stopwatch
from .cuts import shows_another_scene
from .flashes import BeforeFlash, may_be_flash
from .masks import FrameMask, MaskMemory, showing
from .selection import select, view_evidence

_MOVING_FRACTION = 0.1
"""Share of its rendering weight where things move from which a Gaussian may move."""


@dataclass(frozen=True)
class Change:
    """Change in a frame: one mask for each view, none for a dense method, and S_t, (N,).

    ``overlooked``: the masks missed a change of most of the pictures; everything is selected. ``cut``: the pictures
    show another scene, of which there are no Gaussians yet.
    """

    masks: Sequence[FrameMask]
    selected: NDArray[np.bool_]
    overlooked: bool = False
    cut: bool = False

    @property
    def share(self) -> float:
        """Share of selected Gaussians, 0 to 1."""
        return float(self.selected.mean()) if len(self.selected) else 0.0


class ChangeDetector:
    """Masks and selection of a stream's later frames; ``pictures`` are the first frame's, (3, H, W) each.

    ``views``: the training views as they show the scene, none for a dense method, which selects every Gaussian.
    """

    def __init__(
        self, pictures: Sequence[FloatArray], views: Sequence[FixedView], settings: EncodeSettings, *, threads: int
    ) -> None:
        self._views, self._settings = views, settings
        self._before_flash: BeforeFlash | None = None
        self._memory = MaskMemory(pictures, settings.frame.masks, self._shown_on_budget(), threads=threads)

    @property
    def references(self) -> Sequence[FloatArray]:
        """Reference pictures of the next frame, (3, H, W) each."""
        return self._memory.references

    def detect(
        self, frame: int, pictures: Sequence[FloatArray], state: State, motion: FloatArray, watch: Stopwatch
    ) -> Change:
        """Change of ``frame`` (the rig's index) against the scene before it: ``state``, its last ``motion``."""
        if not self._views:
            return Change([], np.ones(len(state), bool))
        nothing = np.zeros(len(state), bool)
        if not self._settings.frame_effects:
            return Change([], nothing)
        shown = [view.rgb for view in self._views]
        with watch.stage("masks"):
            masks = self._memory.masks(pictures, shown)
        selected = nothing
        if any(mask.dilated.any() for mask in masks):
            everywhere = may_be_flash(masks)
            if everywhere and self._is_cut(pictures, masks, watch):
                return Change(masks, ~nothing, cut=True)
            if self._before_flash is None and everywhere:
                self._before_flash = BeforeFlash(frame, state, motion, self._memory.copy())
            with watch.stage("selection"):
                selected = self._select(masks, len(state))
        if not selected.any() and (everything := self._memory.whole(pictures, shown)):
            return Change(everything, ~nothing, overlooked=True)
        return Change(masks, selected)

    def lit(self, change: Change, moving: Sequence[NDArray[np.bool_]]) -> NDArray[np.bool_]:
        """Selected Gaussians (N,) that hardly show where things ``move`` (of each view, (H, W)): light changes them.

        The views must show the scene of the `detect` that found the ``change``.
        """
        used = [index for index in showing(change.masks) if moving[index].any()]
        if not used:
            return change.selected
        regions = [moving[index] & change.masks[index].dilated for index in used]
        settings = replace(self._settings.frame.selection, rule="weight", min_fraction=_MOVING_FRACTION)
        return change.selected & ~self._inside(used, regions, settings)

    def select_again(self, change: Change, population: int) -> Change:
        """The same change with S_t of the scene that the views show now, so many Gaussians."""
        if change.overlooked or not self._views:
            return replace(change, selected=np.ones(population, bool))
        return replace(change, selected=self._select(change.masks, population))

    def flash_is_over(self, frame: int, pictures: Sequence[FloatArray]) -> BeforeFlash | None:
        """The state before a flash if the pictures match it again; the masks' state returns to it as well."""
        kept = self._before_flash
        if kept is None:
            return None
        over = kept.is_over(pictures)
        if over or kept.stays(frame):
            self._before_flash = None
        if not over:
            return None
        self._memory = kept.masks
        return kept

    def trained(
        self, pictures: Sequence[FloatArray], masks: Sequence[FrameMask], *, moved: bool, hurried: bool
    ) -> None:
        """Records that the scene follows the frame; ``hurried``: except where it still clearly misses."""
        self._memory.trained(pictures, masks, moved=moved, shown=self._shown_on_budget() if hurried else None)

    def passed(self, pictures: Sequence[FloatArray], *, held: bool) -> None:
        """Goes on to the next frame; ``held``: this one waits to be trained."""
        self._memory.passed(pictures, held=held)

    def _is_cut(self, pictures: Sequence[FloatArray], masks: Sequence[FrameMask], watch: Stopwatch) -> bool:
        # A keyframe needs every camera.
        if not self._settings.cuts or self._settings.time_budget is not None or len(showing(masks)) < len(masks):
            return False
        with watch.stage("masks"):
            return shows_another_scene(pictures, self._memory.references)

    def _shown_on_budget(self) -> list[FloatArray] | None:
        """The views' renderings under a time budget, which may leave a frame unfinished; else None."""
        if self._settings.time_budget is None or not self._views:
            return None
        return [view.rgb for view in self._views]

    def _select(self, masks: Sequence[FrameMask], population: int) -> NDArray[np.bool_]:
        used, settings = showing(masks), self._settings.frame.selection
        if "select" in self._settings.frame.ablated:
            return np.ones(population, bool)
        selected = self._inside(used, [masks[i].changing for i in used], settings)
        if any(masks[i].refines for i in used):
            stricter = replace(settings, min_fraction=settings.refine_fraction)
            selected |= self._inside(used, [masks[i].dilated for i in used], stricter)
        return selected

    def _inside(
        self, used: Sequence[int], regions: Sequence[NDArray[np.bool_]], settings: SelectionSettings
    ) -> NDArray[np.bool_]:
        """The Gaussians that the rule selects for these regions (H, W) of the ``used`` views."""
        views = [view_evidence(self._views[i], region) for i, region in zip(used, regions, strict=True)]
        return select(views, settings)
