"""One later frame: the selected Gaussians follow the pictures, everything else stays.

Stage 1 trains the transformation cache alone. Then densification and pruning run inside the region of interest. Stage 2
trains the selected Gaussians' own values together with the cache. Values of other Gaussians never change: gradients and
Adam's moments exist for the selected Gaussians only, so that the paper's gradient gate and its reset of stale moments
hold by construction. Equations: docs/METHOD.md, "Focus-aware loss" to "Optimiser-state reset".

Beyond the paper: emerging objects get new Gaussians (`seeding`), and ``warm_start`` starts a Gaussian from the last
displacement of its neighbourhood (`warm_start`). Without a cache (``cache`` None) there is no stage 1, and stage 2
moves the Gaussians directly.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import repeat

import numpy as np
from numpy.typing import NDArray

from decogs.formats.cameras import in_picture, project
from decogs.formats.splats import FloatArray, Splats, empty_splats, join_splats, sigmoid, take_splats

from ..backends import ATTRIBUTES, Drawable, Gradients, Optimiser, SplatGradients, TrainingKernel, ViewGradients
from ..change.masks import FrameMask, showing
from ..input.ingest import View
from ..parallel import side_by_side
from ..settings.frame import FrameSettings
from ..transformation_cache import TransformationCache
from .densification import DENSIFICATIONS
from .losses import PhotometricLoss, StepLosses, focus_loss, whole_picture_loss
from .method import FrameInput, TrainedFrame, TrainingContext
from .schedule import (
    MIN_STEPS,
    SearchTime,
    StepSchedule,
    TargetWatch,
    iteration_factor,
    search_of,
    search_seconds,
)
from .seeding import SearchView, missed, seeds, worth_a_search
from .significance import picture_weight, revert_insignificant
from .view_order import view_order
from .warm_start import shared_displacements

_DIVERGED = 1.5
"""Training that raises the squared error in focus by this factor (1.8 dB) has diverged; normally the error falls."""

_MAX_PROBES = 4
"""Views whose error is measured when time is short: each is rendered twice, which takes as long as a step."""

_MAX_HASTE = 3.0
"""Largest factor of the rates when a deadline leaves few steps, which must still cover the motion."""


class DeltaTrainer:
    """Trains the later frames of one stream. It holds the state between frames; `_DeltaTraining` trains one frame.

    ``context.static_views`` show the stream's scene, all of it static between frames.
    """

    def __init__(self, context: TrainingContext) -> None:
        self.context = context
        self.ungated: Optimiser | None = None
        self.search, self.step_seconds = SearchTime(), 0.0
        self.min_seconds = 0.0
        self._cache: TransformationCache | None = None

    def train(self, frame: FrameInput, /) -> TrainedFrame:
        """Trains the selected Gaussians; diverged training changes nothing.

        A deadline ends either stage early, a target in the regions of interest stage 2.
        """
        began = time.perf_counter()
        training = _DeltaTraining(self, frame, self._cache_of(frame.settings))
        result, schedule = training.run()
        if frame.stopping.deadline is not None:
            self.step_seconds, steps = schedule.steps_seconds
            spent = time.perf_counter() - began
            self.min_seconds = spent - training.searching - steps + MIN_STEPS * self.step_seconds
        return result

    def _cache_of(self, settings: FrameSettings) -> TransformationCache | None:
        """The cache of a frame's settings, built at first use."""
        if settings.cache is None:
            return None
        if self._cache is None and settings.cache_iterations + settings.joint_iterations > 0:
            context = self.context
            self._cache = TransformationCache(*context.box, settings.cache, context.seed, threads=context.threads)
        return self._cache


class _DeltaTraining:
    """The training of one frame. ``searching``: duration of the search for emerging objects, seconds."""

    def __init__(self, stream: DeltaTrainer, frame: FrameInput, cache: TransformationCache | None) -> None:
        context = stream.context
        self._stream, self._frame, self._cache = stream, frame, cache
        self._kernel, self._views, self._watch = context.kernel, context.views, context.static_views
        self._threads, self._extent, self._max_gaussians = context.threads, context.extent, context.max_gaussians
        self._settings, self._stopping = frame.settings, frame.stopping
        self._short = frame.stopping.deadline is not None and (
            stream.step_seconds * frame.settings.joint_iterations > frame.stopping.deadline - time.perf_counter()
        )
        self._used = showing(frame.masks)
        self._random = np.random.default_rng((context.seed, frame.index))
        self._seen = StepLosses()
        self.searching = 0.0

    def run(self) -> tuple[TrainedFrame, StepSchedule]:
        """The trained frame and its schedule."""
        scene, pictures, masks = self._frame.scene, self._frame.pictures, self._frame.masks
        before = self._squared_error(pictures, masks)
        with side_by_side(self._threads) as each:
            losses = list(each(self._loss, pictures, masks, self._views))
        work = _Working(scene, np.flatnonzero(self._frame.selected), self._kernel, self._settings)
        self._start_warm(work, self._frame.motion[work.rows])
        if self._cache is not None:
            self._cache.restart()
            self._cache.place(work.base.means, work.base.quaternions)
            self._densify(work, self._stage1(work, losses, self._cache), masks)
            self._add_emerging(work, losses, masks, self._used)
        if "gate" in self._settings.ablated:
            self._open_gate(work, scene)
        schedule = self._stage2(work, scene, losses, masks)
        self._draw_probes(work)
        if self._squared_error(pictures, masks) > _DIVERGED * before:
            return replace(work.unchanged(scene), rejected=True), schedule
        return replace(self._result(work, losses), hurried=schedule.is_cut_short), schedule

    def _probes(self) -> list[int]:
        """A sample of the used views for measuring errors: every third, fewer when time is short."""
        return self._used[:: max(3, -(-len(self._used) // _MAX_PROBES)) if self._short else 3]

    def _errors(self, pictures: Sequence[FloatArray], masks: Sequence[FrameMask]) -> list[FloatArray]:
        """Errors of some views' renderings in focus, (3, pixels) each, colours 0 to 1."""

        def missing(index: int) -> FloatArray:
            focus = np.flatnonzero(_focus(self._views[index], masks[index]))
            return np.clip(_pixels(self._watch[index].rgb, focus), 0, 1) - _pixels(pictures[index], focus)

        with side_by_side(self._threads) as each:
            return list(each(missing, self._probes()))

    def _squared_error(self, pictures: Sequence[FloatArray], masks: Sequence[FrameMask]) -> float:
        return sum(float(np.square(errors).sum(dtype=np.float64)) for errors in self._errors(pictures, masks))

    def _draw_probes(self, work: _Working) -> None:
        for index in self._probes():
            self._watch[index].draw(work.drawn, work.rows)

    def _iteration_factor(self, work: _Working, losses: Sequence[PhotometricLoss], masks: Sequence[FrameMask]) -> float:
        """Factor of this frame's iterations in stage 2."""
        if not self._settings.adaptive_iterations.usual_miss:
            return 1.0
        self._draw_probes(work)
        return iteration_factor(
            self._settings.adaptive_iterations, self._errors([loss.target for loss in losses], masks)
        )

    def _start_warm(self, work: _Working, motion: FloatArray) -> None:
        share = np.float32(self._settings.warm_start)
        if share and motion.any():
            means = work.base.means
            work.optimiser.put(
                means=means + share * shared_displacements(means, motion, self._settings.warm_neighbours)
            )

    def _loss(self, picture: FloatArray, mask: FrameMask, view: View) -> PhotometricLoss:
        weights = self._settings.focus
        if "focus" in self._settings.ablated:
            return whole_picture_loss(picture, view.valid, weights.dissimilarity)
        return focus_loss(picture, mask.dilated, view.valid, weights)

    def _stage1(self, work: _Working, losses: Sequence[PhotometricLoss], cache: TransformationCache) -> ViewGradients:
        """Trains the cache alone; the last third gathers the gradients for densification."""
        gathered = self._kernel.view_gradients(len(work.rows))
        iterations = self._settings.cache_iterations
        schedule = StepSchedule(iterations, self._stopping.deadline_before(iterations, self._settings.joint_iterations))
        for step, index in self._views_at_random():
            if schedule.is_over:
                break
            work.show(*cache.moved())
            gradients = self._gradients(work, losses, index, ("cache", step)).host()
            cache.backward(gradients.means, gradients.quaternions)
            cache.step()
            if 3 * schedule.position >= 2 * iterations:
                self._gather(gathered, gradients, losses, index)
            schedule.step()
        work.show(*cache.moved())
        return gathered

    def _stage2(
        self,
        work: _Working,
        scene: Splats,
        losses: Sequence[PhotometricLoss],
        masks: Sequence[FrameMask],
    ) -> StepSchedule:
        """Trains the Gaussians' own values, with the cache if there is one; without it, includes densification."""
        settings = self._settings
        rates = replace(settings.rates, means=settings.rates.means * self._extent)
        gathered = self._kernel.view_gradients(len(work.rows))
        grow_from, grow_at = settings.joint_iterations // 4, settings.joint_iterations // 2
        decide_at = max(grow_at + 1, round(settings.significance.decide_at * settings.joint_iterations))
        judged = self._cache is not None or settings.significance.threshold == 0
        factor = self._iteration_factor(work, losses, masks)
        schedule = StepSchedule(settings.joint_iterations, self._stopping.deadline, factor=factor)
        target = self._target(losses, masks)
        for step, index in self._views_at_random():
            if schedule.is_over:
                break
            if self._cache is None and schedule.reaches(grow_at):
                self._densify(work, gathered, masks)
            self._show(work)
            if self._cache is None and schedule.reaches(grow_from):
                self._search_emerging(work, losses, masks, schedule)
                gathered = self._kernel.view_gradients(len(work.rows))
            gradients = self._gradients(work, losses, index, ("joint", step))
            if grow_from <= schedule.position < grow_at:
                self._gather(gathered, gradients, losses, index)
            if self._cache is not None:
                gradients = self._through_cache(work, gradients.host(), self._cache)
            if schedule.reaches(decide_at) and not judged:
                judged = True
                self._revert_insignificant(work, scene, losses)
                if target is not None:
                    target.restart()
            elif target is not None and target.saw(index, self._watch[index].rgb):
                if judged:
                    break
                schedule.skip_to(decide_at)
            late = settings.late_decay ** max(0.0, 2 * schedule.position / settings.joint_iterations - 1)
            rates_now = rates.scaled(late * min(schedule.hurry**0.5, _MAX_HASTE))
            work.optimiser.step(gradients, rates_now, max_stretch=settings.max_stretch)
            schedule.step()
        self._seen.check()
        self._show(work)
        return schedule

    def _revert_insignificant(self, work: _Working, scene: Splats, losses: Sequence[PhotometricLoss]) -> None:
        """Reverts what hardly shows; geometry sooner where light alone changes the pictures."""
        self._seen.check()
        settings, old, factor = self._settings.significance, work.rows < len(scene), None
        if self._frame.lit is not None:
            factor = np.ones(len(work.rows), np.float32)
            factor[old] = np.where(self._frame.lit[work.rows[old]], settings.lit_factor, 1)
        threshold = settings.threshold * self._picture_weight(losses)
        revert_insignificant(work.optimiser, work.before(scene), old, threshold, factor)

    def _picture_weight(self, losses: Sequence[PhotometricLoss]) -> float:
        return picture_weight([losses[i] for i in self._used])

    def _target(self, losses: Sequence[PhotometricLoss], masks: Sequence[FrameMask]) -> TargetWatch | None:
        if self._stopping.target_psnr is None:
            return None
        regions = [_focus(view, mask) for view, mask in zip(self._views, masks, strict=True)]
        return TargetWatch(self._stopping.target_psnr, [loss.target for loss in losses], regions)

    def _show(self, work: _Working) -> None:
        """Shows the base values, moved by the cache if there is one."""
        if self._cache is None:
            work.drawn = work.optimiser
            return
        means, quaternions, rows = work.base.means.copy(), work.base.quaternions.copy(), work.selected
        self._cache.rebase(means[rows], quaternions[rows])
        means[rows], quaternions[rows] = self._cache.moved()
        work.show(means, quaternions)

    def _through_cache(self, work: _Working, gradients: SplatGradients, cache: TransformationCache) -> SplatGradients:
        """Steps the cache; the gradients of the base values."""
        means, quaternions = gradients.means.copy(), gradients.quaternions.copy()
        means[work.selected], quaternions[work.selected] = cache.backward(
            means[work.selected], quaternions[work.selected]
        )
        cache.step()
        return replace(gradients, means=means, quaternions=quaternions)

    def _gather(
        self, gathered: ViewGradients, gradients: Gradients, losses: Sequence[PhotometricLoss], index: int
    ) -> None:
        """Adds a view's gradients, rescaled to those of the plain loss, the threshold's scale."""
        gathered.add(gradients, self._views[index].pinhole, losses[index].emphasis)

    def _gradients(
        self, work: _Working, losses: Sequence[PhotometricLoss], index: int, place: tuple[str, int]
    ) -> Gradients:
        """Gradients of the drawn values, from the pixels they cover; ``place``: stage and step, for the log."""
        view = self._watch[index]
        view.draw(work.drawn, work.rows)
        value = losses[index].evaluate_drawn(view)
        self._seen.add(value, self._views[index].camera)
        if self._stopping.on_loss is not None:
            self._stopping.on_loss(*place, value.total)
        return view.backward()

    def _views_at_random(self) -> Iterator[tuple[int, int]]:
        """Endless steps, each with its view."""
        return ((step, self._used[place]) for step, place in enumerate(view_order(len(self._used), self._random)))

    def _densify(self, work: _Working, view_gradients: ViewGradients, masks: Sequence[FrameMask]) -> None:
        """Densifies ``work`` where gradients are large and prunes transparent Gaussians."""
        self._seen.check()
        settings = self._settings
        faint = work.selected & (sigmoid(work.base.opacity_logits) < settings.prune_opacity)
        room = self._max_gaussians - work.population + int(faint.sum())
        # Rounded up: a small scene that may never grow loses quality over hundreds of frames.
        room = min(math.ceil(settings.grow_fraction * work.selected.sum()), room)
        grows = room > 0 and self._grow(work, view_gradients, masks, work.selected & ~faint, room)
        work.remove(np.flatnonzero(faint))
        if grows or faint.any():
            self._replace(work)

    def _grow(
        self,
        work: _Working,
        view_gradients: ViewGradients,
        masks: Sequence[FrameMask],
        eligible: NDArray[np.bool_],
        room: int,
    ) -> bool:
        """Adds at most ``room`` Gaussians to ``work``; returns whether it added any.

        A child outside every region of interest starts at its parent's position.
        """
        settings = self._settings
        growth = DENSIFICATIONS.get(settings.densification)(
            work.base,
            view_gradients.mean(),
            eligible,
            threshold=settings.grow_gradient,
            room=room,
            large=0.01 * self._extent,
            random=self._random,
        )
        parents = growth.parents
        if not len(parents):
            return False
        shift = work.shown.means[parents] - work.base.means[parents]
        stray = ~self._inside_focus(growth.children.means + shift, masks)
        growth.children.means[stray] = work.base.means[parents[stray]]
        work.optimiser.put(parents, means=growth.parent_means, log_scales=growth.parent_log_scales)
        work.append(growth.children)
        return True

    def _replace(self, work: _Working) -> None:
        """Updates cache and shown values after a change of the set of Gaussians."""
        if self._cache is not None:
            self._cache.place(work.base.means, work.base.quaternions, same_frame=True)
        self._show(work)

    def _search_emerging(
        self, work: _Working, losses: Sequence[PhotometricLoss], masks: Sequence[FrameMask], schedule: StepSchedule
    ) -> None:
        """Adds emerging objects; with a deadline, only in some frames and from some of the views."""
        self._seen.check()
        if self._stopping.deadline is None:
            self._add_emerging(work, losses, masks, self._used)
            return
        began = time.perf_counter()
        guess = search_seconds(self._settings.emergence.max_rays, len(self._used))
        share = self._stream.search.affords(self._stopping.deadline - began, guess)
        if share:
            looked, rays = search_of(share, len(self._used))
            apart = -(-len(self._used) // looked)
            self._add_emerging(work, losses, masks, self._used[self._frame.index % apart :: apart], rays)
            self.searching = time.perf_counter() - began
            self._stream.search.took(self.searching, share)
            schedule.put_off(self.searching)

    def _add_emerging(
        self,
        work: _Working,
        losses: Sequence[PhotometricLoss],
        masks: Sequence[FrameMask],
        views: Sequence[int],
        rays: float = 1.0,
    ) -> None:
        """Adds this frame's emerging objects to ``work``, from these ``views`` and a share of the ``rays``."""
        new = self._emerging(work, losses, masks, views, rays)
        if len(new):
            work.append(new)
            self._replace(work)

    def _emerging(
        self,
        work: _Working,
        losses: Sequence[PhotometricLoss],
        masks: Sequence[FrameMask],
        views: Sequence[int],
        rays: float,
    ) -> Splats:
        """Seeds of emerging objects; a third of the views decides whether to search in all."""
        settings = self._settings.emergence
        if settings.max_seeds <= 0:
            return empty_splats(work.base.sh_degree)
        searched: dict[int, SearchView] = {}
        misses: dict[int, NDArray[np.bool_]] = {}
        for probe in (views[::3], views):
            new = [index for index in probe if index not in searched]
            for index in new:
                self._watch[index].draw(work.drawn, work.rows, depth=True)
            with side_by_side(self._threads) as each:
                found = each(lambda index: self._search_view(index, losses[index].target, masks[index]), new)
                searched |= zip(new, found, strict=True)
                misses |= zip(new, each(missed, map(searched.__getitem__, new), repeat(settings)), strict=True)
            if not worth_a_search(list(misses.values()), settings):
                return empty_splats(work.base.sh_degree)
        fewer = replace(settings, max_rays=max(1, round(rays * settings.max_rays)))
        given = [searched[i] for i in views], [misses[i] for i in views]
        return seeds(*given, fewer, work.base.sh_degree, threads=self._threads)

    def _search_view(self, index: int, target: FloatArray, mask: FrameMask) -> SearchView:
        """What view ``index`` was last drawn with, beside its picture."""
        view, drawn = self._views[index], self._watch[index]
        return SearchView(view.pinhole, target, drawn.rgb, drawn.alpha, drawn.depth, _focus(view, mask))

    def _open_gate(self, work: _Working, scene: Splats) -> None:
        """Ablation: steps every Gaussian from here on, with the momentum of previous frames."""
        others = np.setdiff1d(np.arange(len(scene)), work.detached)
        for view in self._watch:
            view.detach(others)
        work.admit(others, take_splats(scene, others), self._stream.ungated)

    def _result(self, work: _Working, losses: Sequence[PhotometricLoss]) -> TrainedFrame:
        result = replace(work.result(), sensitivity=work.sensitivity(self._picture_weight(losses)))
        if "gate" in self._settings.ablated:
            lasting = work.lasting()
            self._stream.ungated = work.optimiser
            work.optimiser.keep(lasting)
        return result

    def _inside_focus(self, means: FloatArray, masks: Sequence[FrameMask]) -> NDArray[np.bool_]:
        """Points (P, 3) that project into the region of interest of at least one view."""
        inside = np.zeros(len(means), bool)
        for view, mask in zip(self._views, masks, strict=True):
            u, v, depth = project(view.pinhole, means)
            rows = np.flatnonzero(in_picture(view.pinhole, u, v, depth))
            inside[rows] |= mask.dilated[v[rows].astype(np.int64), u[rows].astype(np.int64)]
        return inside


def _pixels(picture: FloatArray, places: NDArray[np.int64]) -> FloatArray:
    """Colours (3, P) at flat pixels of a picture (3, H, W)."""
    return np.take(picture.reshape(3, -1), places, axis=1)


def _focus(view: View, mask: FrameMask) -> NDArray[np.bool_]:
    """The recorded part of a view's region of interest, (H, W)."""
    return mask.dilated if view.valid is None else mask.dilated & (view.valid > 0)


class _Working:
    """The Gaussians under training in a frame, separate from their scene.

    ``rows`` (M,), ascending, are their rows in the scene; new Gaussians get rows behind its last. ``base``: their own
    values; ``drawn``: what views draw, these in place or, moved by the cache, in the host's memory; ``shown``: its
    values. ``selected`` (M,): all, except in an ablation.
    """

    def __init__(self, scene: Splats, rows: NDArray[np.int64], kernel: TrainingKernel, settings: FrameSettings) -> None:
        self._population = self._next_row = len(scene)
        self._prune_opacity = settings.prune_opacity
        self.detached = self.rows = rows
        self.optimiser = kernel.optimiser(take_splats(scene, rows), beta1=settings.beta1, beta2=settings.beta2)
        self.selected = np.ones(len(rows), bool)
        self.drawn: Drawable = self.optimiser

    @property
    def base(self) -> Splats:
        return self.optimiser.splats

    @property
    def shown(self) -> Splats:
        return self.drawn if isinstance(self.drawn, Splats) else self.drawn.splats

    @property
    def population(self) -> int:
        """Current number of Gaussians in the scene."""
        return self._population - len(self.detached) + len(self.rows)

    def show(self, means: FloatArray, quaternions: FloatArray) -> None:
        self.drawn = replace(self.base, means=means, quaternions=quaternions)

    def append(self, children: Splats) -> None:
        """Appends Gaussians; every per-Gaussian buffer grows (docs/METHOD.md, "Selective densification")."""
        self.optimiser.append(children)
        self.rows = np.concatenate([self.rows, np.arange(self._next_row, self._next_row + len(children))])
        self.selected = np.concatenate([self.selected, np.ones(len(children), bool)])
        self._next_row += len(children)
        self.drawn = self.optimiser

    def remove(self, positions: NDArray[np.int64]) -> None:
        """Removes the Gaussians at ``positions`` of ``rows`` from training and scene."""
        stays = np.ones(len(self.rows), bool)
        stays[positions] = False
        self.rows, self.selected = self.rows[stays], self.selected[stays]
        self.optimiser.keep(stays)
        self.drawn = self.optimiser

    def admit(self, rows: NDArray[np.int64], splats: Splats, momentum: Optimiser | None) -> None:
        """Adds unselected ``rows`` of the scene to the training."""
        joined = np.concatenate([self.rows, rows])
        order = np.argsort(joined)
        self.rows = joined[order]
        self.selected = np.concatenate([self.selected, np.zeros(len(rows), bool)])[order]
        self.detached = np.sort(np.concatenate([self.detached, rows]))
        self.optimiser.append(splats)
        self.optimiser.keep(order)
        if momentum is not None:
            old = self.rows[self.rows < self._population]
            self.optimiser.remember(momentum, np.arange(len(old)), old)
        self.drawn = self.optimiser

    def before(self, scene: Splats) -> Splats:
        """Values of ``rows`` in the ``scene``; new Gaussians have their current ones."""
        old = self.rows < self._population
        return join_splats(take_splats(scene, self.rows[old]), take_splats(self.base, ~old))

    def lasting(self) -> NDArray[np.bool_]:
        """Which of ``rows`` outlive the frame: all except transparent new ones."""
        return (self.rows < self._population) | (sigmoid(self.base.opacity_logits) >= self._prune_opacity)

    def result(self) -> TrainedFrame:
        """Bakes the cache's motion in (docs/METHOD.md, "Commit")."""
        old = self.rows < self._population
        return TrainedFrame(
            self.rows[old],
            take_splats(self.shown, old),
            np.setdiff1d(self.detached, self.rows),
            take_splats(self.shown, ~old & self.lasting()),
        )

    def sensitivity(self, picture_weight: float) -> Splats:
        """Change of a picture's mean loss, in millionths, per unit of each value of `result`'s old rows."""
        old = self.rows < self._population
        sizes = (self.optimiser.gradient_size(name)[old] / np.float32(picture_weight) for name in ATTRIBUTES)
        return Splats(*sizes)

    def unchanged(self, scene: Splats) -> TrainedFrame:
        """The frame without any change to the ``scene``."""
        nothing = empty_splats(scene.sh_degree)
        return TrainedFrame(self.detached, take_splats(scene, self.detached), np.zeros(0, np.int64), nothing)
