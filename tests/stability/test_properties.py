"""Random scenes and cameras, drawn by hypothesis: finite, equal for any thread count, and with gradients that are the
finite differences of the float64 twin.

What an example shows wrong is shrunk to the smallest such scene, which is printed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

import rasterise_cases as cases
from decogs.decoder.rasterise.native import render_planes
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.formats.splats import take_splats
from gradient_twin import FIELDS, kernel_gradients

FEW = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
MANY = settings(FEW, max_examples=1000)

cameras = st.builds(
    lambda width, height, focal, turn, nod, distance, near: replace(
        cases.pinhole(width, height, focal * max(width, height), turn=turn, nod=nod, offset=(0.1, -0.2, distance)),
        near=near,
    ),
    st.integers(1, 40),
    st.integers(1, 40),
    st.floats(0.2, 3.0),
    st.floats(-3.2, 3.2),
    st.floats(-1.5, 1.5),
    st.floats(-1.0, 6.0),
    st.sampled_from([0.0, 0.0, 1.5]),
)


@st.composite
def wild_scenes(draw: st.DrawFn) -> cases.Case:
    """Any stored values that a stream can hold: log scales to 40, logits to 80, colours and places anywhere."""
    seed, count = draw(st.integers(0, 2**32 - 1)), draw(st.integers(0, 80))
    random = np.random.default_rng(seed)
    spread = 10.0 ** draw(st.floats(-6, 6))
    low = draw(st.floats(-40, 10))
    splats = cases.scene(seed, count, draw(st.integers(0, 3)), spread=spread, colour=10.0 ** draw(st.floats(-2, 4)))
    splats = cases.edited(
        splats,
        log_scales=random.uniform(low, min(40, low + draw(st.floats(0, 40))), (count, 3)),
        opacity_logits=random.uniform(-80, 80, count),
        quaternions=random.normal(size=(count, 4)) * 10.0 ** random.uniform(-25, 25, (count, 1)),
    )
    return cases.Case(splats, draw(cameras))


@st.composite
def ordinary_scenes(draw: st.DrawFn) -> cases.Case:
    """What a rig sees, small enough for the twin."""
    seed = draw(st.integers(0, 2**32 - 1))
    thin = draw(st.floats(0.01, 0.3))
    splats = cases.scene(seed, draw(st.integers(1, 12)), draw(st.integers(0, 3)), sigma=(thin, 0.5))
    return cases.Case(splats, draw(cameras))


def everything(case: cases.Case, threads: int) -> list[np.ndarray]:
    """Pictures, gradients, and what a fixed view makes of them, whole and with a third of the Gaussians detached."""
    kernel, planes = CpuKernel(threads), cases.cotangents(case)
    gradients = kernel_gradients(case, planes, threads)
    view, third = CpuFixedView(kernel, case.camera), np.arange(0, len(case.splats), 3)
    view.set_scene(case.splats)
    weights = view.redraw(planes[1] > 0)
    view.detach(third)
    view.draw(take_splats(case.splats, third), third)
    detached = view.backward(planes[0])
    some = [getattr(g, name) for g in (gradients, detached) for name in (*FIELDS, "view")]
    return [*render_planes(case.splats, case.camera, case.background, threads), weights, view.rgb.copy(), *some]


def check_finite_and_equal_for_any_thread_count(case: cases.Case) -> None:
    alone, together = everything(case, 1), everything(case, 3)
    for one, three in zip(alone, together, strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_array_equal(one, three)


def check_gradients_are_finite_differences(case: cases.Case, seed: int) -> None:
    """Along a random direction in all stored values at once, in float64 by the twin, central differences.

    Bound: the kernel's sum of a few hundred terms is off by 200 roundings of their absolute sum (the gradient's own
    length times the direction's is no bound: terms cancel), the difference quotient by 1e-5 of it.
    """
    book = cases.textbook(case)
    assume(not book.fragile)
    planes = cases.cotangents(case, book.doubtful)
    gradients = kernel_gradients(case, planes)
    random = np.random.default_rng(seed)
    arrays = {name: getattr(case.splats, name).astype(float) for name in FIELDS}
    step = 1e-6
    slopes, sizes = [], []
    for name in FIELDS:
        direction = random.normal(size=arrays[name].shape)

        def loss(share: float, name: str = name, direction: np.ndarray = direction) -> float:
            values = {**arrays, name: arrays[name] + share * step * direction}
            shown = cases.twin(case, np, list(values.values()))
            return float(sum((plane * v).sum() for plane, v in zip(planes, shown, strict=False)))

        slope, half = (loss(share) - loss(-share) for share in (1.0, 0.5))
        # A Gaussian that begins to be drawn in between is a jump, a 255th of a colour: no derivative.
        assume(abs(slope - 2 * half) < 1e-4 / 255)
        slope /= 2 * step
        gradient = getattr(gradients, name)
        slopes.append((name, slope, float((gradient * direction).sum(dtype=np.float64))))
        sizes.append(float(np.abs(gradient * direction).sum(dtype=np.float64)))
    largest = max(sizes)
    for (name, slope, kernels), size in zip(slopes, sizes, strict=True):
        bound = (200 * cases.ROUNDING + 1e-5) * max(
            size, 1e-2 * largest
        ) + 1e-7 * case.camera.width * case.camera.height
        assert abs(slope - kernels) <= bound, (
            f"{name}: {kernels} instead of {slope}, {abs(slope - kernels) / bound:.3g}"
        )


@FEW
@given(wild_scenes())
def test_any_scene_is_finite_and_equal_for_any_thread_count(case: cases.Case) -> None:
    check_finite_and_equal_for_any_thread_count(case)


@FEW
@given(ordinary_scenes(), st.integers(0, 2**32 - 1))
def test_gradients_are_the_twins_finite_differences(case: cases.Case, seed: int) -> None:
    check_gradients_are_finite_differences(case, seed)


@FEW
@given(ordinary_scenes())
def test_pictures_are_the_twins(case: cases.Case) -> None:
    book = cases.textbook(case)
    assume(not book.fragile)
    shown = render_planes(case.splats, case.camera, case.background, 1)
    for actual, expected in zip(shown, (book.rgb, book.alpha, book.depth), strict=True):
        tolerance = cases.picture_tolerance(replace(case, roundings=200), expected.max())
        cases.compare(actual, expected, tolerance, except_at=book.doubtful, most_excepted=0.1)


@pytest.mark.soak
@MANY
@given(wild_scenes())
def test_a_thousand_scenes_are_finite_and_equal_for_any_thread_count(case: cases.Case) -> None:
    check_finite_and_equal_for_any_thread_count(case)


@pytest.mark.soak
@MANY
@given(ordinary_scenes(), st.integers(0, 2**32 - 1))
def test_a_thousand_gradients_are_the_twins_finite_differences(case: cases.Case, seed: int) -> None:
    check_gradients_are_finite_differences(case, seed)
