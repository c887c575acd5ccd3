"""Keyframe training: the cap, the stop that needs no held-out view, the SH schedule, and what may never count."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from decogs.codec.scene.lattice import dequantise, quantise
from decogs.codec.scene.state import Attributes
from decogs.encoder.backends import Drawable
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.optimiser import drawn_splats
from decogs.encoder.backends.cpu.stretch import stretches
from decogs.encoder.backends.psnr import mean_psnr, psnr_of
from decogs.encoder.keyframe.first_points import FirstPoints
from decogs.encoder.keyframe.large_pictures import PictureFit, PictureScale
from decogs.encoder.keyframe.train import (
    TUNING,
    Tuning,
    splats_from_points,
    train_keyframe,
)
from decogs.encoder.settings.keyframe import KeyframeSettings
from decogs.encoder.training.schedule import StoppingRule
from decogs.formats.cameras import in_picture, project
from decogs.formats.errors import TrainingError
from decogs.formats.rigs import open_rig
from decogs.formats.splats import Splats
from decogs.rig.pictures.ingest import Ingest, View, scene_extent

SHORT = KeyframeSettings(iterations=60, cap=500, sh_degree=1, grow_every=10, validation_every=20, settle_iterations=5)


@dataclass(frozen=True)
class Case:
    """Frame 0 of a rig: training views with their pictures, and the held-out view with its own."""

    views: list[View]
    pictures: list[np.ndarray]
    held_out_views: list[View]
    held_out: list[np.ndarray]


def case_of(rig: Path, holdout: list[str]) -> Case:
    ingest = Ingest(open_rig(rig), holdout=holdout)
    frame = next(ingest.frames(0, 1))
    return Case(ingest.views, frame.training, ingest.held_out_views, frame.held_out)


@pytest.fixture(scope="module")
def case(moving_rig: Path) -> Case:
    return case_of(moving_rig, ["cam02"])


def points(count: int = 400, seed: int = 3) -> FirstPoints:
    """Grey points spread over the wall and before it."""
    random = np.random.default_rng(seed)
    xyz = random.uniform([-1.5, -1.2, -0.2], [1.5, 1.2, 0.6], (count, 3)).astype(np.float32)
    rgb = np.full((count, 3), 0.5, np.float32)
    return first_points(xyz, rgb, np.full(count, 0.15, np.float32))


def first_points(xyz: np.ndarray, rgb: np.ndarray, spacing: np.ndarray) -> FirstPoints:
    """With full confidence."""
    everywhere = np.ones(len(xyz), bool)
    return FirstPoints(xyz, rgb, spacing, everywhere.astype(np.float32), everywhere[None], everywhere)


def trained(
    case: Case,
    settings: KeyframeSettings = SHORT,
    *,
    seed: int = 0,
    first: FirstPoints | None = None,
    kernel: CpuKernel | None = None,
    **tuning: Any,
) -> Any:
    return train_keyframe(
        kernel or CpuKernel(2), case.views, case.pictures, first or points(), settings, seed=seed,
        tuning=Tuning(**{"search_at": 2.0, **tuning}),
    )  # fmt: skip


def equal_bits(first: Splats, second: Splats) -> bool:
    return all(array.tobytes() == getattr(second, name).tobytes() for name, array in vars(first).items())


def test_first_gaussians_are_round_and_have_colour_opacity_and_size_of_their_points() -> None:
    given = first_points(
        np.array([[0, 0, 1], [2, 3, 4]], np.float32),
        np.array([[0.1, 0.5, 0.9], [1.0, 0.0, 0.3]], np.float32),
        np.array([0.2, 0.4], np.float32),
    )
    splats = splats_from_points(given, sh_degree=2)
    np.testing.assert_array_equal(splats.means, given.xyz)
    assert splats.sh.shape == (2, 9, 3)
    np.testing.assert_allclose(0.5 + 0.28209479177387814 * splats.sh[:, 0], given.rgb, atol=1e-6)
    assert not splats.sh[:, 1:].any()
    np.testing.assert_allclose(np.exp(splats.log_scales), [[0.1] * 3, [0.2] * 3], rtol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-splats.opacity_logits)), [0.2, 0.2], rtol=1e-6)
    np.testing.assert_array_equal(splats.quaternions, [[1, 0, 0, 0]] * 2)


def test_training_learns_the_pictures(case: Case) -> None:
    before = mean_psnr(CpuKernel(2), splats_from_points(points(), SHORT.sh_degree), case.views, case.pictures)
    result = trained(case, replace(SHORT, iterations=200, validation_fraction=0.0))
    after = mean_psnr(CpuKernel(2), result.splats, case.views, case.pictures)
    assert after > before + 3.0
    assert result.steps == 200


def test_the_same_seed_gives_the_same_bits_and_another_does_not(case: Case) -> None:
    first, second, other = (trained(case, seed=seed).splats for seed in (5, 5, 6))
    assert equal_bits(first, second)
    assert not equal_bits(first, other)


def test_growth_respects_the_cap(case: Case) -> None:
    eager = replace(SHORT, cap=430)

    def count(settings: KeyframeSettings) -> int:
        return len(trained(case, settings, grow_gradient=0.0).splats)

    assert 400 < count(eager) <= 430
    assert count(replace(eager, surroundings=0.5)) <= 430, "with those beside the pictures"
    assert count(replace(eager, grow_every=1000)) <= 400


def test_transparent_gaussians_are_pruned(case: Case) -> None:
    # Opacity starts at 0.2; at 100 % every Gaussian is below the limit, which cannot end well and is said so.
    with pytest.raises(TrainingError, match="every Gaussian became transparent"):
        trained(case, grow_gradient=1e9, prune_opacity=1.0)
    pruned, kept = (trained(case, grow_gradient=1e9, prune_opacity=opacity) for opacity in (0.1, 0.0))
    assert 0 < len(pruned.splats) < len(kept.splats)


def test_three_noisy_views_overfit_and_the_kept_back_tiles_say_when_to_stop(tmp_path: Path, tiny_rig: Any) -> None:
    case = case_of(tiny_rig.write(tmp_path / "noisy", frames=[0], noise=40.0), ["cam01", "cam03"])
    assert len(case.views) == 3
    settings = replace(SHORT, iterations=500, cap=2000, validation_fraction=0.1)
    stopped = trained(case, settings, first=points(2000))
    # Checks begin past the middle; the best state is kept, so the stop comes so many checks after it at least.
    assert stopped.steps >= 250 + TUNING.patience_checks * settings.validation_every
    to_the_end = trained(case, settings, first=points(2000), patience_checks=10**6)
    assert stopped.steps < to_the_end.steps == 500
    kernel = CpuKernel(2)
    fitted = [mean_psnr(kernel, result.splats, case.views, case.pictures) for result in (stopped, to_the_end)]
    assert fitted[0] < fitted[1], "it did overfit: more steps fit the training views better"
    held_out = [
        mean_psnr(kernel, result.splats, case.held_out_views, case.held_out) for result in (stopped, to_the_end)
    ]
    assert held_out[0] > held_out[1], "and the views not trained on worse"


class Worsening(CpuKernel):
    """Shows the tiles kept back darker at every check, and notes the positions checked."""

    def __init__(self) -> None:
        super().__init__(2)
        self._is_checking = False
        self.checked: list[np.ndarray] = []

    def forward(self, splats: Drawable, camera: Any, *background: Any, **options: Any) -> Any:
        picture = super().forward(splats, camera, *background, **options)
        was_checking, self._is_checking = self._is_checking, not background and "sh_degree" in options
        if not self._is_checking:
            return picture  # of a step of training, or of what is seen when it is over
        if not was_checking:
            self.checked.append(drawn_splats(splats).means.copy())
        return replace(picture, rgb=picture.rgb * np.float32(0.5 ** len(self.checked)))


def test_an_early_stop_goes_back_to_the_best_state(case: Case) -> None:
    """The tiles kept back are shown best at the first check; what was trained after it is undone."""
    kernel = Worsening()
    settings = replace(SHORT, validation_every=10, settle_iterations=0)
    result = trained(case, settings, kernel=kernel, patience_checks=1)
    assert (result.steps < SHORT.iterations, len(kernel.checked)) == (True, 2)
    best, later = ({row.tobytes() for row in means} for means in kernel.checked)
    kept = {row.tobytes() for row in result.splats.means}
    assert kept <= best
    assert len(kept & later) < len(kept) / 2, "what no camera sees stays where it is"


def test_an_early_stop_goes_back_over_growth_and_settles(case: Case) -> None:
    """The best state has fewer Gaussians than the last one; it ended in a traceback."""
    kernel = Worsening()
    growing = replace(SHORT, validation_every=10, cap=10_000)
    result = trained(case, growing, kernel=kernel, patience_checks=1, grow_end=1.0, grow_gradient=0.0)
    best, later = map(len, kernel.checked)
    assert best < later
    assert len(result.splats) <= best


def test_a_target_counts_in_pictures_of_their_own_size(case: Case) -> None:
    """Shrunk ones are easier: a target that any scene reaches ends training once all views have had their own size."""
    fit = PictureFit(60, (PictureScale(0, 4), PictureScale(20, 2), PictureScale(40, 1)), 400, 1.0)
    stopping = StoppingRule(target_psnr=1.0)
    result = train_keyframe(
        CpuKernel(2), case.views, case.pictures, points(), SHORT, seed=0, stopping=stopping, fit=fit
    )
    assert result.steps == 40 + len(case.views)


def test_drift_is_estimated_from_a_twentieth_to_three_fifths_of_the_schedule(case: Case) -> None:
    """Earlier the scene is too rough; later it would follow the estimates, and they it."""
    steps, told = [], [0]

    def find(recorded: Any, draw: Any) -> None:
        assert recorded is case.pictures, "as recorded, not as compensated so far"
        steps.append(told[-1])

    corrector: Any = SimpleNamespace(find_jointly=find, undo=lambda recorded, _: list(recorded))
    train_keyframe(
        CpuKernel(2), case.views, case.pictures, points(), replace(SHORT, iterations=100), seed=0, corrector=corrector,
        on_step=lambda step, *_: told.append(step),
    )  # fmt: skip
    assert steps == list(range(8, 61, 4))


def test_without_kept_back_tiles_there_is_no_stop(case: Case) -> None:
    result = trained(case, replace(SHORT, validation_fraction=0.0))
    assert result.steps == SHORT.iterations


class Listening(CpuKernel):
    """Notes the SH degree of every picture rendered for training."""

    def __init__(self) -> None:
        super().__init__(2)
        self.degrees: list[int | None] = []

    def forward(self, *arguments: Any, **options: Any) -> Any:
        self.degrees.append(options.get("sh_degree"))
        return super().forward(*arguments, **options)


@pytest.mark.parametrize(("degree", "expected"), [(0, [0] * 40), (3, [0] * 10 + [1] * 10 + [2] * 10 + [3] * 10)])
def test_sh_degree_rises_by_one_each_quarter(case: Case, degree: int, expected: list[int]) -> None:
    kernel = Listening()
    settings = replace(SHORT, iterations=40, sh_degree=degree, validation_fraction=0.0, settle_iterations=0)
    result = train_keyframe(kernel, case.views, case.pictures, points(), settings, seed=0)
    assert kernel.degrees[:40] == expected
    assert result.splats.sh.shape[1] == (degree + 1) ** 2
    assert all(result.splats.sh[:, k].any() for k in range((degree + 1) ** 2))


class Watching(CpuKernel):
    """A kernel that notes positions and sizes at every picture drawn."""

    def __init__(self) -> None:
        super().__init__(2)
        self.means: list[np.ndarray] = []
        self.log_scales: list[np.ndarray] = []

    def forward(self, splats: Drawable, *arguments: Any, **options: Any) -> Any:
        values = drawn_splats(splats)
        self.means.append(values.means.copy())
        self.log_scales.append(values.log_scales.copy())
        return super().forward(splats, *arguments, **options)


def moves(drawn: list[np.ndarray]) -> np.ndarray:
    """Mean distance that values go from each picture to the next."""
    return np.array([np.abs(after - before).mean() for before, after in pairwise(drawn)])


STEADY = replace(SHORT, validation_fraction=0.0, grow_every=1000)


def test_positions_go_ever_shorter_ways(case: Case) -> None:
    ways = {}
    for decay in (0.05, 1.0):
        kernel = Watching()
        trained(case, replace(STEADY, settle_iterations=0), kernel=kernel, means_decay=decay)
        way = moves(kernel.means[:60])
        ways[decay] = way[-10:].mean() / way[:10].mean()
    # Over the last ten of 60 steps the rate is .05 to the power of 10 / 12 of the first ones', .08 of it.
    assert ways[0.05] < 0.2 * ways[1.0], "and by much more than what is nearly learned moves less anyway"


def test_sizes_are_learned_for_a_third_of_the_settling_and_positions_for_two(case: Case) -> None:
    kernel, settings = Watching(), replace(STEADY, iterations=20, settle_iterations=30)
    train_keyframe(kernel, case.views, case.pictures, points(), settings, seed=0)
    settling = slice(20, 50)
    last = [np.flatnonzero(moves(drawn[settling]))[-1] + 1 for drawn in (kernel.log_scales, kernel.means)]
    assert last == [10, 20], "the last change is the one to the nearest point of the lattice"


def test_pixels_that_were_not_recorded_never_matter(case: Case) -> None:
    """Neither to what is trained nor to when it stops."""
    valid = np.ones((case.views[0].pinhole.height, case.views[0].pinhole.width), np.float32)
    valid[:, :9] = 0
    views = [replace(case.views[0], valid=valid), *case.views[1:]]
    poisoned = case.pictures[0].copy()
    poisoned[:, :, :9] = 1 - poisoned[:, :, :9]
    masked = replace(case, views=views)
    clean = trained(masked)
    dirty = trained(replace(masked, pictures=[poisoned, *case.pictures[1:]]))
    assert equal_bits(clean.splats, dirty.splats)
    assert len(clean.checks) == 2
    assert clean.checks == dirty.checks
    seen = trained(replace(case, pictures=[poisoned, *case.pictures[1:]]))
    assert not equal_bits(trained(case).splats, seen.splats), "the same pixels do matter where they were recorded"


def test_every_gaussian_kept_is_drawn_in_some_training_view_or_lies_beside_the_pictures(case: Case) -> None:
    behind = points(50)
    behind.xyz[:] = [0, 0, -8]
    first = points()
    joined = first_points(
        *(np.concatenate([getattr(p, n) for p in (first, behind)]) for n in ("xyz", "rgb", "spacing"))
    )
    result = trained(case, replace(SHORT, grow_every=1000), first=joined)
    kernel, drawn = CpuKernel(1), np.zeros(len(result.splats), bool)
    for view in case.views:
        kernel.forward(result.splats, view.pinhole)
        drawn |= np.isfinite(kernel.centres(len(result.splats))[1])
    assert drawn.all()
    assert len(result.splats) <= 400
    wider = trained(case, replace(SHORT, grow_every=1000, surroundings=0.5), first=joined).splats
    beside = len(wider) - len(result.splats)
    assert 0 < beside <= 0.025 * SHORT.cap
    for view in case.views:
        assert not in_picture(view.pinhole, *project(view.pinhole, wider.means[-beside:])).any()


def test_the_pictures_of_the_training_views_are_learned_as_well_with_gaussians_beside_them(case: Case) -> None:
    kernel, settings = CpuKernel(2), replace(SHORT, iterations=200, settle_iterations=60)
    without, beside = (
        mean_psnr(kernel, trained(case, replace(settings, surroundings=reach)).splats, case.views, case.pictures)
        for reach in (0.0, 0.5)
    )
    assert beside > without - 0.3  # dB; what other seeds differ by


def test_steps_are_reported(case: Case) -> None:
    told: list[tuple[int, int, float]] = []
    train_keyframe(
        CpuKernel(2), case.views, case.pictures, points(), SHORT, seed=0, on_step=lambda *step: told.append(step)
    )
    assert [step for step, _, _ in told] == list(range(1, 66))
    assert {planned for _, planned, _ in told} == {65}
    assert all(np.isfinite(loss) and loss > 0 for _, _, loss in told)


def test_all_but_opacities_end_on_the_lattice_one_after_the_other(case: Case) -> None:
    nearest = replace(SHORT, rd_lambda=0.0)
    result, before = trained(case, nearest), trained(case, replace(nearest, settle_iterations=0))
    on_lattice = dequantise(quantise(result.splats, result.lattice), result.lattice)
    rounded = dequantise(quantise(before.splats, before.lattice), before.lattice)
    for name in ("quaternions", "sh", "log_scales", "means"):
        held = getattr(result.splats, name)
        np.testing.assert_array_equal(held, getattr(on_lattice, name))
        assert (held != getattr(before.splats, name)).any()
    for name in ("quaternions", "sh"):
        np.testing.assert_array_equal(getattr(result.splats, name), getattr(rounded, name))
    for name in ("log_scales", "means", "opacity_logits"):
        made_up_for_others = getattr(result.splats, name) != getattr(rounded, name)
        assert made_up_for_others.any()


def test_bits_of_rotations_and_view_dependent_colours_must_be_worth_it(
    case: Case,
) -> None:
    points: dict[float, Attributes] = {}
    rates = replace(TUNING.rates, sh_rest=0.02)
    for rd_lambda in (0.0, 10.0, 1e9):
        result = trained(case, replace(SHORT, rd_lambda=rd_lambda), rates=rates)
        points[rd_lambda] = quantise(result.splats, result.lattice)
        for name in ("quaternions", "sh"):
            on_lattice = dequantise(points[rd_lambda], result.lattice)
            np.testing.assert_array_equal(getattr(result.splats, name), getattr(on_lattice, name))
    nearest, judged = points[0.0], points[10.0]
    np.testing.assert_array_equal(judged.sh[:, 0], nearest.sh[:, 0], "base colours show everywhere")
    for columns in ([p.quaternions for p in points.values()], [p.sh[:, 1:].reshape(-1, 9) for p in points.values()]):
        kinds = [len(np.unique(rows, axis=0)) for rows in columns]
        assert kinds[0] > kinds[1] > kinds[2] == 1, "where no bit is worth it, each channel's commonest is left"


def test_no_gaussian_is_longer_than_the_limit_on_stretch(case: Case) -> None:
    longest = {}
    for max_stretch in (0.0, 1.1):
        result = trained(case, max_stretch=max_stretch)
        longest[max_stretch] = np.exp(stretches(result.splats.log_scales).max())
    # Two sizes are each rounded by half a step of the lattice after training.
    assert longest[1.1] <= 1.1 * np.exp(result.lattice.log_scales) * (1 + 1e-5)
    assert longest[0.0] > 1.3


def test_the_lattice_is_as_coarse_as_asked_for(case: Case) -> None:
    options = {"seed": 0, "settings": replace(SHORT, settle_iterations=0)}
    fine, coarse = (
        train_keyframe(CpuKernel(2), case.views, case.pictures, points(), lattice_scale=scale, **options).lattice
        for scale in (1.0, 3.0)
    )
    assert coarse.means == pytest.approx(3 * np.array(fine.means))
    assert coarse.sh_dc == 3 * fine.sh_dc


def test_what_cannot_be_trained_is_said_in_one_line(case: Case) -> None:
    with pytest.raises(TrainingError, match="point initialisation found no points"):
        trained(case, first=points(0))
    broken = [np.full_like(picture, np.nan) for picture in case.pictures]
    with pytest.raises(
        TrainingError, match=r"the keyframe's loss is nan at step 0; the pictures or poses are unusable"
    ):
        trained(replace(case, pictures=broken))


def test_psnr_is_over_recorded_pixels_of_clipped_pictures(case: Case, tiny_rig: Any) -> None:
    bright = tiny_rig.patch((0, 0, 0.5), 40, 30, 0.11, 1)
    bright.sh[:] = 5.0  # far above white
    kernel, view = CpuKernel(1), case.views[0]
    picture = np.clip(kernel.forward(bright, view.pinhole).rgb.astype(np.float64), 0, 1)
    square = (picture - case.pictures[0]) ** 2
    assert mean_psnr(kernel, bright, [view], [case.pictures[0]]) == pytest.approx(
        -10 * np.log10(square.mean()), abs=1e-4
    )
    valid = np.zeros(square.shape[1:], np.float32)
    valid[10:20, 5:50] = 1
    masked = mean_psnr(kernel, bright, [replace(view, valid=valid)], [case.pictures[0]])
    assert masked == pytest.approx(-10 * np.log10(square[:, 10:20, 5:50].mean()), abs=1e-4)
    assert np.isnan(mean_psnr(kernel, bright, [], []))
    assert psnr_of(0.01) == pytest.approx(20.0)


def test_extent_is_1_1_times_the_farthest_camera_from_their_middle(case: Case) -> None:
    from decogs.formats.cameras import camera_centre

    centres = np.array([camera_centre(view.pinhole) for view in case.views])
    farthest = max(np.linalg.norm(centre - centres.mean(axis=0)) for centre in centres)
    assert scene_extent(case.views) == pytest.approx(1.1 * farthest)


def test_points_whose_places_are_not_known_have_a_size_and_an_opacity_of_their_own() -> None:
    given = replace(points(3), placed=np.array([True, True, False]))
    splats = splats_from_points(given, SHORT.sh_degree)
    np.testing.assert_allclose(np.exp(splats.log_scales[:, 0]), given.spacing * [0.5, 0.5, 1.0], rtol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-splats.opacity_logits)), [0.2, 0.2, 0.1], rtol=1e-6)
