"""Emerging objects of a later frame: the search in its views, within its deadline."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from decogs.formats.splats import Splats, empty_splats, take_splats
from decogs.rig.parallel import side_by_side

from .frame_training import FrameTraining
from .schedule import SearchTime, StepSchedule, search_of, search_seconds
from .seeding import SearchView, enough_missed_pixels, find_seeds, missed_pixels
from .working_set import WorkingSet


def add_emerging(training: FrameTraining, work: WorkingSet, views: Sequence[int], rays: float = 1.0) -> None:
    """Adds the frame's emerging objects to ``work``, from these ``views`` and a share of the ``rays``."""
    emerging = _find_emerging(training, work, views, rays)
    emerging = take_splats(emerging, ~training.is_free(emerging.means))
    if len(emerging):
        work.append(emerging)


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
    """Seeds of emerging objects; a third of the views decides whether to search in all."""
    training.seen.check()
    settings, degree = training.settings.emergence, work.values.sh_degree
    if settings.max_seeds <= 0:
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
    fewer = replace(settings, max_rays=max(1, round(rays * settings.max_rays)))
    return find_seeds([searched[i] for i in views], [misses[i] for i in views], fewer, degree, threads=threads)


def _search_view(training: FrameTraining, index: int) -> SearchView:
    """What a view was last drawn with, beside its picture."""
    drawn, picture = training.context.static_views[index], training.frame.pictures[index]
    view = training.context.views[index]
    return SearchView(view.pinhole, picture, drawn.rgb, drawn.alpha, drawn.depth, training.focus(index), view.recorded)
