"""Emerging objects of a later frame: the search in its views, within its deadline."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from decogs.decoder.cameras.resizing import resized, resized_plane
from decogs.formats.splats import Splats, empty_splats, round_splats, take_splats
from decogs.rig.parallel import side_by_side
from decogs.rig.stage.views import StageView, stage_view

from ..backends import FixedView
from .frame_training import FrameTraining
from .hull_points import Rule, hull_points, rule_of, subject_pixels
from .schedule import SearchTime, StepSchedule, search_of, search_seconds
from .seeding import SearchView, enough_missed_pixels, find_seeds, missed_pixels
from .working_set import WorkingSet

_MAX_UNDRAWN_SHARE = 0.1
"""Of the Gaussians, how many a frame may add where its drawing lacks subject."""
_DRAWN_ALPHA = 0.85
"""Alpha below which a pixel of the subject is not drawn yet. With .5 fewer points come, and a take thins out again."""
_UNDRAWN_LEVELS = 25.0
"""8-bit levels by which a pixel before a backdrop is missed: its alpha is 1 either way."""
_UNDRAWN_OPACITY, _UNDRAWN_SIGMA_SPACINGS = 0.5, 0.5
"""Of the new Gaussians, the size in units of their distance."""


def add_emerging(training: FrameTraining, work: WorkingSet, views: Sequence[int], rays: float = 1.0) -> None:
    """Adds the frame's emerging objects to ``work``, from these ``views`` and a share of the ``rays``."""
    emerging = _find_emerging(training, work, views, rays)
    emerging = take_splats(emerging, ~training.is_free(emerging.means))
    if len(emerging):
        work.append(emerging)


def add_undrawn(training: FrameTraining, work: WorkingSet) -> None:
    """Adds Gaussians to ``work`` where a stage's hull shows subject that the drawing lacks, as far as there is room.

    A thing that flies further in a frame than it is wide leaves its Gaussians behind, in free space, where they go.
    """
    frame, used = training.frame, training.used
    rule = rule_of(frame.stage)
    if frame.stage is None or rule is None:
        return
    if not rule.has_backdrop:
        # What was left behind would still be drawn over what is lacking.
        work.remove(np.flatnonzero(training.is_free(work.values.means)))
    room = min(round(_MAX_UNDRAWN_SHARE * work.population), training.context.population - work.population)
    if room <= 0:
        return
    views = [stage_view(training.context.views[i], frame.pictures[i]) for i in used]
    training.draw(used, work, work.optimiser)
    lacking = [_lacking(training.context.static_views[i], view, rule) for i, view in zip(used, views, strict=True)]
    missing = [subject & lack for subject, lack in zip(subject_pixels(frame.stage), lacking, strict=True)]
    points = hull_points(frame.stage, views, missing, rule, most=room, threads=training.context.threads)
    if len(points):
        opacities = np.full(len(points), _UNDRAWN_OPACITY)
        sigmas = _UNDRAWN_SIGMA_SPACINGS * points.spacing
        work.append(round_splats(points.xyz, points.rgb, sigmas, opacities, work.values.sh_degree))


def _lacking(drawn: FixedView, view: StageView, rule: Rule) -> NDArray[np.bool_]:
    """Pixels (H, W) of a view that the drawing leaves open or, before a backdrop, draws in another colour."""
    if not rule.has_backdrop:
        return np.asarray(resized_plane(drawn.alpha, view.camera) < _DRAWN_ALPHA)
    shown = np.clip(resized(drawn.rgb, view.camera).transpose(1, 2, 0), 0, 1)
    wrong = np.abs(shown - view.picture).max(axis=2) > _UNDRAWN_LEVELS / 255
    return cv2.morphologyEx(wrong.view(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)).view(np.bool_)


def add_emerging_in_time(
    training: FrameTraining, work: WorkingSet, schedule: StepSchedule, search: SearchTime
) -> tuple[float, SearchTime]:
    """Adds emerging objects as far as the frame's deadline allows; the seconds that it took, 0 without a deadline.

    With one, only some frames search, in some of the views, and ``search`` is what is left for later ones.
    """
    used, deadline = training.used, training.frame.stopping.deadline
    if deadline is None:
        add_emerging(training, work, used)
        return 0.0, search
    began = time.perf_counter()
    guess = search_seconds(training.settings.emergence.max_rays, len(used))
    search = search.save(deadline - began, guess)
    share = search.affordable_share(guess)
    if not share:
        return 0.0, search
    views, rays = search_of(share, len(used))
    every = -(-len(used) // views)
    add_emerging(training, work, used[training.frame.index % every :: every], rays)
    seconds = time.perf_counter() - began
    schedule.extend_deadline(seconds)
    return seconds, search.spend(seconds, share)


def _find_emerging(training: FrameTraining, work: WorkingSet, views: Sequence[int], rays: float) -> Splats:
    """Seeds of emerging objects, as far as there is room; a third of the views decides whether to search in all."""
    training.seen.check()
    settings, degree = training.settings.emergence, work.values.sh_degree
    most = min(settings.max_seeds, training.context.max_gaussians - work.population)
    if most <= 0:
        return empty_splats(degree)
    threads = training.context.threads
    searched: dict[int, SearchView] = {}
    misses: dict[int, NDArray[np.bool_]] = {}
    for probe in (views[::3], views):
        new = [index for index in probe if index not in searched]
        for index in new:
            training.context.static_views[index].draw(work.optimiser, work.rows, depth=True)
        with side_by_side(threads) as each:
            searched |= zip(new, each(lambda index: _search_view(training, index), new), strict=True)
            misses |= zip(new, each(missed_pixels, map(searched.__getitem__, new)), strict=True)
        if not enough_missed_pixels(list(misses.values())):
            return empty_splats(degree)
    fewer = replace(settings, max_seeds=most, max_rays=max(1, round(rays * settings.max_rays)))
    return find_seeds([searched[i] for i in views], [misses[i] for i in views], fewer, degree, threads=threads)


def _search_view(training: FrameTraining, index: int) -> SearchView:
    """What a view was last drawn with, beside its picture."""
    drawn, picture = training.context.static_views[index], training.frame.pictures[index]
    view = training.context.views[index]
    return SearchView(view.pinhole, picture, drawn.rgb, drawn.alpha, drawn.depth, training.focus(index), view.recorded)
