"""The keyframe: 3D Gaussian Splatting on the training views of one frame (Kerbl 2023).

Chosen, measured on `workbench` with cam00 held out (figures in the README): a dense cloud from the
rig itself, small first Gaussians of opacity 0.2 (larger
and fainter where no view confirms a point), rates above 3DGS's that fall to a fifth by the end, SH raised step
by step. A dozen views overfit, so a few 16x16 pixel tiles of every training view are left out of the loss and say
when to stop: nothing outside the training views is needed. Rejected: dropping random Gaussians (-0.5 dB at 10 %),
opacity or scale penalties (no gain), MCMC noise (no gain). Opacity resets were not tried.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from decogs.codec.scene.lattice import Lattice, default_lattice, dequantise, quantise, robust_extent
from decogs.codec.scene.state import Attributes
from decogs.decoder.cameras.resizing import resized, resized_plane
from decogs.formats.errors import TrainingError
from decogs.formats.splats import FloatArray, Splats, join_splats, round_splats, sigmoid, take_splats
from decogs.rig.pictures.ingest import View, scene_extent
from decogs.rig.stage.stage import Stage

from ..backends import Colour, LossValue, RenderedPicture, TrainingKernel
from ..backends.psnr import psnr_of
from ..backends.tiles import tiles_with
from ..input.compensation import Corrector
from ..output.reports import OnKeyframeStep
from ..settings.keyframe import KeyframeSettings
from ..settings.optimiser import LearningRates
from ..training.densification import clone_and_split
from ..training.losses import PhotometricLoss, whole_picture_loss
from ..training.rate_distortion import cheapest
from ..training.schedule import WHOLE, StoppingRule, TargetWatch
from ..training.significance import picture_weight
from ..training.view_order import view_order
from .border_extrapolation import border_extrapolation
from .few_views import DISSIMILARITY, dissimilarity_for
from .first_points import FirstPoints
from .large_pictures import PictureFit, fit_to_pictures, shrunk_camera, shrunk_weights, unscaled_schedule
from .missed_surfaces import missed_surfaces

_START_OPACITY, _START_SIGMA_SPACINGS = 0.2, 0.5
"""Of the first Gaussians; sigma in units of the points' spacing."""
_GUESS_OPACITY, _GUESS_SIGMA_SPACINGS = 0.1, 1.0
"""The same of points that no view confirms, which stand for what is not known: large and faint ones spread over it,
small and opaque ones leave holes that needles fill."""
_CORRECTION_INTERVAL, _CORRECTION_BEGIN, _CORRECTION_END = 0.04, 0.05, 0.6
"""Shares of the schedule: interval, begin and end of the estimates of camera drift. At the end, the scene's depth and
the poses of rotated cameras are known."""

_PREALIGNMENT_STEPS = 100
"""Steps after which a rotated camera's pose is known to a twentieth of a pixel."""

_CLEAR_EVERY_STEPS = 50
"""Steps after which a stage's free space is cleared."""

_SEARCH_STEPS = 50
"""Steps at least before what is still missed has no Gaussian near."""

_BACKGROUNDS_SPREAD = 1.5
"""By which the loss of a round over some backgrounds may exceed that over others, of the same Gaussians."""

_REPORT_EVERY_STEPS = 10
"""Steps after which progress shows another loss: reading one waits for the device."""


@dataclass(frozen=True)
class Tuning:
    """What is the same for all keyframes.

    ``grow_begin``, ``grow_end``: shares of the schedule between which Gaussians are added: later ones are not trained
    to the end. ``grow_gradient``: mean view gradient from which a Gaussian is split, ``prune_opacity``: below which one
    is removed (both 3DGS's). ``search_at``: share of the schedule after which what views miss gets Gaussians, above 1
    for never. ``max_stretch``: largest ratio of a Gaussian's largest to its middle size: needles are wrong from other
    viewpoints. ``patience_checks``: checks without a new best after which training stops: the score of few tiles is
    noisy. ``rates``: step sizes at the start, two to four times 3DGS's, since a keyframe has a twentieth of its steps;
    that of means is in units of the rig's extent. ``means_decay``, ``late_decay``: what is left of them at the end, of
    positions over the schedule and of all over its second half.
    """

    grow_begin: float = 0.15
    grow_end: float = 0.6
    grow_gradient: float = 2e-4
    prune_opacity: float = 0.005
    search_at: float = 1 / 3
    max_stretch: float = 10.0
    patience_checks: int = 4
    rates: LearningRates = LearningRates(  # noqa: RUF009 (frozen)
        means=4e-4, log_scales=1e-2, quaternions=3e-3, opacity_logits=0.05, sh_dc=1e-2, sh_rest=5e-4
    )
    means_decay: float = 0.05
    late_decay: float = 0.2


TUNING = Tuning()


@dataclass(frozen=True)
class TrainedKeyframe:
    """The trained scene, its lattice, the steps of training, and the PSNR of the tiles kept back at every check."""

    splats: Splats
    lattice: Lattice
    steps: int
    checks: tuple[float, ...] = ()


def splats_from_points(points: FirstPoints, sh_degree: int) -> Splats:
    """One round Gaussian per first point, of its colour and of a size in proportion to the points' spacing.

    Points whose places are not known get a size and an opacity of their own.
    """
    sizes = np.where(points.placed, _START_SIGMA_SPACINGS, _GUESS_SIGMA_SPACINGS).astype(np.float32)
    opacities = np.where(points.placed, _START_OPACITY, _GUESS_OPACITY)
    return round_splats(points.xyz, points.rgb, points.spacing * sizes, opacities, sh_degree)


def _first_splats(points: FirstPoints, sh_degree: int, stage: Stage | None) -> Splats:
    """The first Gaussians of points, and of a stage's backdrop, which may be all; raises TrainingError without any."""
    splats = splats_from_points(points, sh_degree)
    if stage is not None:
        splats = join_splats(splats, stage.backdrop(sh_degree))
    if not len(splats):
        raise TrainingError("point initialisation found no points; check the poses, or give the rig COLMAP points")
    return splats


def train_keyframe(
    kernel: TrainingKernel,
    views: Sequence[View],
    pictures: Sequence[FloatArray],
    points: FirstPoints,
    settings: KeyframeSettings,
    *,
    seed: int,
    lattice: Lattice | None = None,
    lattice_scale: float = 1.0,
    corrector: Corrector | None = None,
    on_step: OnKeyframeStep | None = None,
    stopping: StoppingRule = WHOLE,
    stage: Stage | None = None,
    alphas: Sequence[FloatArray] = (),
    fit: PictureFit | None = None,
    tuning: Tuning = TUNING,
) -> TrainedKeyframe:
    """Trains the first frame's Gaussians on ``pictures`` (3, H, W) of ``views``; the same seed gives the same bits.

    ``lattice``: the one to settle on; None makes one for the scene, as coarse as ``lattice_scale`` says in units of the
    default one's steps. ``corrector``: of the cameras whose drift is estimated and compensated during training.
    ``stopping``: a target in the whole pictures, but for the tiles kept out of the loss, ends training before the
    settings' iterations; deadlines are for later frames. ``stage``: whose backdrop is there from the start, and whose
    free space stays free. ``alphas``: (H, W) of a subject alone, whose pictures are over the kernel's background; each
    step sees it over another, so that no Gaussian passes for a background. ``fit``: None is the one for the pictures'
    size. Raises TrainingError without Gaussians or when the loss stops being finite.
    """
    random = np.random.default_rng(seed)
    training = _KeyframeTraining(
        kernel,
        views,
        pictures,
        points,
        settings,
        random=random,
        dissimilarity=dissimilarity_for(points, settings.few_views_dissimilarity),
        corrector=corrector,
        lattice=lattice,
        lattice_scale=lattice_scale,
        stopping=stopping,
        fit=fit or fit_to_pictures([view.pixels for view in views], settings),
        stage=stage,
        alphas=alphas,
        tuning=tuning,
    )
    return training.run(on_step)


def prealigned_pictures(
    kernel: TrainingKernel,
    views: Sequence[View],
    pictures: Sequence[FloatArray],
    points: FirstPoints,
    settings: KeyframeSettings,
    corrector: Corrector,
    *,
    seed: int,
) -> list[FloatArray]:
    """The pictures with their cameras' drift compensated, as estimated by a short training.

    For a second point initialisation: pictures of a rotated camera match no others to the pixel.
    """
    short = replace(
        settings, iterations=_PREALIGNMENT_STEPS, validation_fraction=0.0, settle_iterations=0, surroundings=0.0
    )
    random = np.random.default_rng(seed)
    training = _KeyframeTraining(
        kernel, views, pictures, points, short, random=random, corrector=corrector, fit=unscaled_schedule(short)
    )
    training.run(None)
    return training.compensate(corrector, _PREALIGNMENT_STEPS)


class _KeyframeTraining:
    def __init__(
        self,
        kernel: TrainingKernel,
        views: Sequence[View],
        pictures: Sequence[FloatArray],
        points: FirstPoints,
        settings: KeyframeSettings,
        *,
        random: np.random.Generator,
        dissimilarity: float = DISSIMILARITY,
        corrector: Corrector | None,
        lattice: Lattice | None = None,
        lattice_scale: float = 1.0,
        stopping: StoppingRule = WHOLE,
        fit: PictureFit,
        stage: Stage | None = None,
        alphas: Sequence[FloatArray] = (),
        tuning: Tuning = TUNING,
    ) -> None:
        self._kernel, self._views, self._random = kernel, views, random
        self._settings = settings = replace(settings, iterations=fit.iterations)
        self._recorded, self._corrector, self._dissimilarity = pictures, corrector, dissimilarity
        self._lattice, self._lattice_scale, self._tuning = lattice, lattice_scale, tuning
        self._extent = scene_extent(views) or 1.0
        # Gradients are in units of the picture's size: here, of as much as was recorded.
        self._blankness = [(view.pinhole.width * view.pinhole.height / max(1, view.pixels)) ** 0.5 for view in views]
        self._pictures, self._alphas = list(pictures), alphas
        self._counted = counted = [_loss_weights(view, settings.validation_fraction, random) for view in views]
        self._stopping, self._is_good_enough = stopping, False
        self._regions = [None if c is None else c > 0 for c in counted]
        self._fit, self._factor = fit, 0
        self._values: list[list[LossValue]] = []
        self._reported_loss = float("nan")
        self._checks: list[float] = []
        self._set_picture_scale(fit.scales[0].factor)
        self._kept_back = [_validation_pixels(view, c) for view, c in zip(views, counted, strict=True)]
        self._stage = stage
        self._optimiser = kernel.optimiser(_first_splats(points, settings.sh_degree, stage))
        self._view_gradients = kernel.view_gradients(len(self._optimiser))
        self._order = view_order(len(views), random)

    def run(self, on_step: OnKeyframeStep | None) -> TrainedKeyframe:
        steps = self._train(on_step)
        self._check_learnt()  # Before extrapolating: a diverged scene would be copied into the border.
        beside = self._extrapolate_border()
        lattice = self._settle_on_lattice(steps, on_step)
        self._check_learnt()
        splats = self._optimiser.splats
        seen, trained = self._visible(splats), len(splats) - beside
        if not seen[:trained].any():
            raise TrainingError("no camera sees a Gaussian after training; lower the learning rates")
        seen[trained:] = True
        if self._stage is not None:
            seen |= self._stage.on_backdrop(splats.means)
        if not seen.all():
            splats = take_splats(splats, seen)
        return TrainedKeyframe(splats, lattice, steps, tuple(self._checks))

    def _extrapolate_border(self) -> int:
        """Adds Gaussians beside the pictures, where training leaves black; returns how many."""
        settings = self._settings
        if not settings.surroundings or (self._stage is not None and self._stage.is_closed):
            return 0
        more = border_extrapolation(
            self._kernel,
            self._views,
            self._pictures,
            self._optimiser.splats,
            reach=settings.surroundings,
            most=settings.cap - settings.seen_cap,
        )
        self._optimiser.append(more)
        self._view_gradients = self._kernel.view_gradients(len(self._optimiser))
        return len(more)

    def _check_learnt(self) -> None:
        """Raises TrainingError when training has diverged: the loss has not fallen."""
        self._check_finite()
        count = len(self._views)
        rounds = [
            [sum(v.total for v in values[i : i + count]) / count for i in range(0, len(values) - count + 1, count)]
            for values in self._values
        ]
        # Shrunk pictures have less that can be missed: the last loss may be above the first one's.
        first, last = max((each[0] for each in rounds if each), default=0.0), rounds[-1][-1:]
        allowed = first * (_BACKGROUNDS_SPREAD if self._alphas else 1)
        if sum(map(len, rounds)) > 1 and last and last[0] >= allowed:
            raise TrainingError(
                f"the keyframe's training diverged, with a loss from {first:.3f} to {last[0]:.3f}; lower the learning "
                "rates"
            )

    def _train(self, on_step: OnKeyframeStep | None) -> int:
        """Trains until schedule, target or stop, which goes back to the best; returns the steps."""
        settings = self._settings
        best, best_optimiser, waited, step = -np.inf, self._optimiser, 0, 0
        while step < settings.iterations and waited < self._tuning.patience_checks and not self._is_good_enough:
            for scale in self._fit.scales[1:]:
                if scale.begin == step:
                    self._set_picture_scale(scale.factor)
            if self._corrector is not None and self._corrects_at(step):
                self._correct(self._corrector, step)
            loss = self._step(step)
            step += 1
            self._report("keyframe", step - 1, step, loss, on_step)
            if (
                settings.validation_fraction
                and self._factor == 1
                and step % settings.validation_every == 0
                and step > settings.iterations // 2
            ):
                score = self.validation_psnr(step)
                self._checks.append(score)
                if score > best:
                    best, waited = score, 0
                    best_optimiser = self._optimiser.copy()
                else:
                    waited += 1
        if step < settings.iterations and not self._is_good_enough:
            self._optimiser = best_optimiser
            self._view_gradients = self._kernel.view_gradients(len(best_optimiser))
        return step

    def _settle_on_lattice(self, steps: int, on_step: OnKeyframeStep | None) -> Lattice:
        """Rounds one attribute after the other to the coarse lattice and trains the others around them."""
        total = self._settings.settle_iterations
        lattice = self._lattice
        if lattice is None:
            extent, centre = robust_extent(self._near_means())
            lattice = default_lattice(extent, centre=centre, scale=self._lattice_scale)
        if self._factor != 1:
            self._set_picture_scale(1)
        for more in range(total):
            if more == 0:
                self._fix(("quaternions", "sh"), self._rd_quantised(lattice), lattice)
            if more == total // 3:
                self._fix(("log_scales",), quantise(self._optimiser.splats, lattice), lattice)
            if more == 2 * total // 3:
                self._fix(("means",), quantise(self._optimiser.splats, lattice), lattice)
            loss = self._step(self._settings.iterations)
            self._report("settle", more, min(self._planned, steps + 1 + more), loss, on_step)
        return lattice

    def _near_means(self) -> FloatArray:
        """Positions of the Gaussians but those of a sky, which would make the lattice's steps coarse."""
        means, stage = self._optimiser.splats.means, self._stage
        return means if stage is None or stage.is_closed else means[~stage.on_backdrop(means)]

    def _fix(self, names: Sequence[str], points: Attributes, lattice: Lattice) -> None:
        """Sets these attributes to ``points`` of the lattice and freezes them."""
        values = dequantise(points, lattice)
        self._optimiser.put(**{name: getattr(values, name) for name in names})
        self._optimiser.freeze({name: np.ones(getattr(values, name).shape, bool) for name in names})

    def _rd_quantised(self, lattice: Lattice) -> Attributes:
        """Lattice points: rate-distortion optimised for rotations and view-dependent colours, else the nearest."""
        splats, bit = self._optimiser.splats, self._settings.rd_lambda
        points, share = quantise(splats, lattice), np.float32(picture_weight(self._losses))
        quaternions, sh = (self._optimiser.gradient_size(name) / share for name in ("quaternions", "sh"))
        row, largest = np.arange(len(splats)), np.abs(splats.quaternions).argmax(axis=1)
        # In units of the lattice, which makes the largest component one.
        one = splats.quaternions[row, largest][:, None] * np.float32(lattice.quaternions)
        points.quaternions[:] = cheapest(splats.quaternions / one, quaternions * one, bit)
        points.quaternions[row, largest] = np.rint(1 / lattice.quaternions)
        step, rest = np.float32(lattice.sh_rest), points.sh[:, 1:]
        flat = (len(splats), rest[0].size)
        rest[:] = cheapest((splats.sh[:, 1:] / step).reshape(flat), (sh[:, 1:] * step).reshape(flat), bit).reshape(
            rest.shape
        )
        return points

    @property
    def _planned(self) -> int:
        return self._settings.iterations + self._settings.settle_iterations

    def _step(self, step: int) -> LossValue:
        index = next(self._order)
        camera, (loss, background) = self._cameras[index], self._loss(index)
        degree, tiles = self._degree(step), self._tiles[index]
        picture = self._kernel.forward(self._optimiser, camera, background, sh_degree=degree, tiles=tiles)
        value = loss.evaluate(self._kernel)
        if self._target is not None:
            self._is_good_enough = self._target.update(index, picture.rgb)
        self._values[-1].append(value)
        gradients = self._kernel.backward(self._optimiser)
        self._view_gradients.add(gradients, camera, self._blankness[index])
        rates = self._rates(step / self._settings.iterations)
        reach = None if self._stage is None else self._stage.reach(self._optimiser.splats.means)
        self._optimiser.step(gradients, rates, max_stretch=self._tuning.max_stretch, reach=reach)
        self._densify(step)
        return value

    def _check_finite(self) -> None:
        """Raises TrainingError for a loss that is not finite."""
        for step, value in enumerate(value for values in self._values for value in values):
            if not np.isfinite(value.total):
                raise TrainingError(
                    f"the keyframe's loss is {value.total} at step {step}; the pictures or poses are unusable"
                )

    def _loss(self, index: int) -> tuple[PhotometricLoss, Colour | None]:
        """A view's loss, and the background that its target has, where that is not the kernel's."""
        loss = self._losses[index]
        if not self._alphas:
            return loss, None
        background = self._random.random(3).astype(np.float32)
        change = (background - np.asarray(self._kernel.background, np.float32))[:, None, None]
        target = loss.target + (1 - resized_plane(self._alphas[index], self._cameras[index])) * change
        red, green, blue = background.tolist()
        return replace(loss, target=np.clip(target, 0, 1)), (red, green, blue)

    def _clear_free_space(self) -> None:
        """Removes what has come into a stage's free space: no view misses it there, and other viewpoints see fog."""
        if self._stage is None:
            return
        free = self._stage.free(self._optimiser.splats.means)
        if free.any():
            self._optimiser.keep(~free)
            self._view_gradients = self._kernel.view_gradients(len(self._optimiser))

    def _report(self, stage: str, index: int, step: int, loss: LossValue, on_step: OnKeyframeStep | None) -> None:
        """Reports a step to observers; to read its loss waits for the device."""
        if self._stopping.on_loss is not None:
            self._stopping.on_loss(stage, index, loss.total)
        if on_step:
            if (step - 1) % _REPORT_EVERY_STEPS == 0:
                self._reported_loss = loss.total
            on_step(step, self._planned, self._reported_loss)

    def _corrects_at(self, step: int) -> bool:
        iterations = self._settings.iterations
        every = max(1, round(_CORRECTION_INTERVAL * iterations))
        return step % every == 0 and _CORRECTION_BEGIN <= step / iterations <= _CORRECTION_END

    def _correct(self, corrector: Corrector, step: int) -> None:
        """Replaces the target pictures by compensated ones; drift is estimated against the scene so far."""
        self._check_finite()
        self._pictures = self.compensate(corrector, step)
        self._set_picture_scale(self._factor)

    def _set_picture_scale(self, factor: int) -> None:
        """From now on, steps train on the pictures as compensated so far, shrunk by ``factor``."""
        if factor != self._factor:
            self._values.append([])
        self._factor = factor
        self._cameras = [shrunk_camera(view.pinhole, factor) for view in self._views]
        self._tiles = [
            None if view.valid is None else tiles_with(resized_plane(view.valid, camera) > 0)
            for view, camera in zip(self._views, self._cameras, strict=True)
        ]
        self._losses = [
            whole_picture_loss(resized(picture, camera), shrunk_weights(counted, camera), self._dissimilarity)
            for picture, counted, camera in zip(self._pictures, self._counted, self._cameras, strict=True)
        ]
        self._target = self._target_watch()

    def compensate(self, corrector: Corrector, step: int) -> list[FloatArray]:
        """The recorded pictures, compensated for drift that is estimated against the scene so far."""

        def draw(number: int) -> RenderedPicture:
            camera = self._views[number].pinhole
            return self._kernel.forward(self._optimiser, camera, sh_degree=self._degree(step), depth=True)

        return corrector.undo(self._recorded, corrector.find_jointly(self._recorded, draw))

    def _target_watch(self) -> TargetWatch | None:
        if self._stopping.target_psnr is None or self._factor > 1:
            return None
        return TargetWatch(self._stopping.target_psnr, [loss.target for loss in self._losses], self._regions)

    def _degree(self, step: int) -> int:
        """SH degree rises by one each quarter of the schedule."""
        return min(self._settings.sh_degree, step * 4 // max(1, self._settings.iterations))

    def _rates(self, progress: float) -> LearningRates:
        progress, longest = self._fit.rate_progress(progress), self._fit.longer * self._extent
        rates = self._tuning.rates.scaled(self._tuning.late_decay ** max(0.0, 2 * progress - 1))
        return replace(rates, means=self._tuning.rates.means * longest * self._tuning.means_decay**progress)

    def _densify(self, step: int) -> None:
        settings, tuning, progress = self._settings, self._tuning, step / self._settings.iterations
        if (step + 1) % _CLEAR_EVERY_STEPS == 0:
            self._clear_free_space()
        if step + 1 == max(_SEARCH_STEPS, round(tuning.search_at * settings.iterations)):
            self._add_missed()
        if (step + 1) % settings.grow_every or not tuning.grow_begin < progress < tuning.grow_end:
            return
        self._check_finite()
        splats = self._optimiser.splats
        keep = sigmoid(splats.opacity_logits) >= tuning.prune_opacity
        room = settings.seen_cap - int(keep.sum())
        growth = clone_and_split(
            splats,
            self._view_gradients.mean(),
            keep,
            threshold=tuning.grow_gradient,
            room=room,
            large=0.01 * self._extent,
            random=self._random,
        )
        parents = growth.parents
        self._optimiser.put(parents, means=growth.parent_means, log_scales=growth.parent_log_scales)
        self._optimiser.append(growth.children)
        self._optimiser.keep(np.concatenate([keep, np.ones(len(parents), bool)]))
        if not len(self._optimiser):
            raise TrainingError("every Gaussian became transparent; the pictures and poses contradict each other")
        self._view_gradients = self._kernel.view_gradients(len(self._optimiser))

    def _add_missed(self) -> None:
        """Adds Gaussians where views agree on a surface that none shows, if need be in place of the faintest.

        A closed stage's hull has given its points before.
        """
        if self._stage is not None and self._stage.is_closed:
            return
        missed = missed_surfaces(self._kernel, self._optimiser, self._views, self._pictures)
        if self._stage is not None:
            missed = take_splats(missed, ~self._stage.free(missed.means))
        if not len(missed):
            return
        most = self._settings.seen_cap - len(missed)
        if most < len(self._optimiser):
            opaque_first = np.argsort(-self._optimiser.splats.opacity_logits, kind="stable")
            self._optimiser.keep(np.sort(opaque_first[:most]))
        self._optimiser.append(missed)
        self._view_gradients = self._kernel.view_gradients(len(self._optimiser))

    def validation_psnr(self, step: int) -> float:
        """PSNR over the tiles kept out of the loss."""
        square, pixels = 0.0, 0.0
        for view, target, kept in zip(self._views, self._pictures, self._kept_back, strict=True):
            if kept is None:
                continue
            picture = self._kernel.forward(self._optimiser, view.pinhole, sh_degree=self._degree(step))
            square += float((((np.clip(picture.rgb, 0, 1) - target) ** 2) * kept).sum())
            pixels += 3 * float(kept.sum())
        return psnr_of(square / max(pixels, 1.0))

    def _visible(self, splats: Splats) -> NDArray[np.bool_]:
        """Gaussians visible in what some view recorded; the others cost bytes and show only as floaters elsewhere."""
        seen = np.zeros(len(splats), bool)
        for view in self._views:
            if view.recorded is not None:
                seen |= self._weights(view, splats) > 0
                continue
            self._kernel.forward(splats, view.pinhole)
            seen |= np.isfinite(self._kernel.centres(len(splats))[1])
        return seen

    def _weights(self, view: View, splats: Splats) -> FloatArray:
        """Rendering weights (N,) in what the view recorded."""
        drawn = self._kernel.fixed_view(view.pinhole, view.recorded)
        drawn.set_scene(splats)
        return np.asarray(drawn.redraw()[0])


def _loss_weights(view: View, share: float, random: np.random.Generator) -> FloatArray | None:
    """1 at pixels that count in the loss: recorded ones outside the validation tiles."""
    height, width = view.pinhole.height, view.pinhole.width
    counted = np.ones((height, width), np.float32) if view.valid is None else view.valid.copy()
    if share > 0:
        tiles = random.random((-(-height // 16), -(-width // 16))) < share
        counted[np.repeat(np.repeat(tiles, 16, 0), 16, 1)[:height, :width]] = 0
    return None if counted.all() else counted


def _validation_pixels(view: View, counted: FloatArray | None) -> FloatArray | None:
    if counted is None:
        return None
    recorded = np.ones_like(counted) if view.valid is None else view.valid
    return recorded - counted
