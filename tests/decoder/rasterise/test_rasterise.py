"""The native renderer against its float64 twin, the twin against matrix algebra, and what must not change a bit."""

from __future__ import annotations

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

import rasterise_cases as cases
from decogs.decoder.rasterise import render
from decogs.decoder.rasterise.incremental_view import IncrementalView
from decogs.decoder.rasterise.native import render_planes
from decogs.formats.cameras import Camera, scale_camera
from decogs.formats.errors import UsageError
from decogs.formats.splats import Splats, empty_splats, join_splats, take_splats
from decogs.formats.system.kernels import INSTRUCTION_SETS
from decogs.formats.system.threads import thread_count
from instruction_sets import printed_on


@pytest.mark.parametrize("name", cases.CASES)
def test_twin_is_the_textbook_calculation(name: str) -> None:
    # Both are float64; 1e-11 leaves room for the inverse of a needle's covariance (condition 1e6 * 2e-16 * exponent).
    case = cases.CASES[name]()
    book = cases.textbook(case)
    rgb, alpha, depth, _ = cases.twin(case)
    cases.compare(rgb, book.rgb, 1e-11)
    cases.compare(alpha, book.alpha, 1e-11)
    cases.compare(depth, book.depth, 1e-10)


@pytest.mark.parametrize("name", cases.CASES)
def test_picture_is_the_twins(name: str) -> None:
    case = cases.CASES[name]()
    book = cases.textbook(case)
    assert book.fragile == []
    rgb, alpha, depth, _ = cases.twin(case)
    planes = render_planes(case.splats, case.camera, case.background, 2)
    for actual, expected in zip(planes, (rgb, alpha, depth), strict=True):
        cases.compare(actual, expected, cases.picture_tolerance(case, expected.max()), except_at=book.doubtful)


def test_cases_reach_what_they_are_for() -> None:
    books = {name: cases.textbook(make()) for name, make in cases.CASES.items()}
    assert books["stack"].clamped > 0
    assert books["stack"].finished == books["stack"].alpha.size
    assert books["crowd"].finished > 0
    batch = 256  # kernel/composite.h
    assert (books["crowd"].weights.max((1, 2)) > 0).sum() > 2 * batch
    around = cases.CASES["around"]()
    z = (around.splats.means @ around.camera.world_to_camera[:3, :3].T + around.camera.world_to_camera[:3, 3])[:, 2]
    assert (z < 0).sum() > 10
    centres = cases.twin(around)[3]
    outside = (centres[:, 0] < -0.15 * 45) | (centres[:, 0] > 1.15 * 45)
    assert (books["around"].weights.max((1, 2))[outside & (z > 0)] > 0).sum() > 5
    near = cases.CASES["near"]()
    hidden = (
        near.splats.means @ near.camera.world_to_camera[2, :3] + near.camera.world_to_camera[2, 3] < near.camera.near
    )
    assert 10 < hidden.sum() < 50
    assert not books["near"].weights[hidden].any()
    scales = np.exp(cases.CASES["needles"]().splats.log_scales)
    assert (scales.max(1) / scales.min(1) > 999).all()


def test_comparator_finds_faults() -> None:
    expected = np.linspace(0, 1, 3 * 8 * 9).reshape(3, 8, 9)
    nowhere = np.zeros((8, 9), bool)
    cases.compare(expected.astype(np.float32), expected, 1e-7, except_at=nowhere)
    off = expected.copy()
    off[2, 3, 4] += 1e-3
    with pytest.raises(AssertionError, match=r"at \(2, 3, 4\)"):
        cases.compare(off, expected, 9e-4)
    cases.compare(off, expected, 1.1e-3)
    excepted = nowhere.copy()
    excepted[3, 4] = True
    cases.compare(off, expected, 1e-9, except_at=excepted)
    with pytest.raises(AssertionError, match="at"):
        cases.compare(off, expected, 1e-9, except_at=np.roll(excepted, 1))
    with pytest.raises(AssertionError, match="72 of 72 pixels excepted"):
        cases.compare(off, expected, 1e-9, except_at=~nowhere)
    off[2, 3, 4] = np.nan
    with pytest.raises(AssertionError, match="not finite"):
        cases.compare(off, expected, 1.0)
    with pytest.raises(AssertionError, match="shape"):
        cases.compare(expected[:1], expected, 1.0)


def test_doubt_is_where_a_threshold_is() -> None:
    # One Gaussian whose peak, in the centre of the only pixel, is 1/255 to within the band, then clearly off it.
    camera = Camera("one", 1, 1, 10.0, 10.0, 0.5, 0.5, np.eye(4))
    splats = cases.edited(cases.scene(1, 1, 0), means=[[0, 0, 1]], log_scales=np.log([[1.0, 1.0, 1.0]]) - 1.5)
    for factor, doubtful in ((1 + 5e-5, True), (1 - 5e-5, True), (1 + 3e-4, False), (1 - 3e-4, False)):
        half = np.exp(-1.5) * 10
        compensation = half**2 / (half**2 + 0.3)
        peak = factor / 255 / compensation
        book = cases.textbook(cases.Case(cases.edited(splats, opacity_logits=[np.log(peak / (1 - peak))]), camera))
        assert bool(book.doubtful[0, 0]) is doubtful


def test_any_number_of_threads_gives_the_same_bits() -> None:
    digests = {threads: cases.decoder_digest(threads) for threads in (1, 2, 5)}
    assert len(set(digests.values())) == 1, digests


@pytest.mark.parametrize("instruction_set", INSTRUCTION_SETS)
def test_any_instruction_set_gives_the_same_bits(instruction_set: str) -> None:
    assert printed_on(instruction_set, cases.__file__, "decoder", "2") == cases.decoder_digest(1)


def test_unknown_instruction_set_is_one_clear_line() -> None:
    program = "from decogs.formats.system.kernels import best_instruction_set; best_instruction_set()"
    env = {**os.environ, "DECOGS_INSTRUCTION_SET": "sse9"}
    run = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, check=False)
    assert "DECOGS_INSTRUCTION_SET=sse9: this machine runs" in run.stderr.splitlines()[-1]


def test_python_threads_may_render_at_once() -> None:
    jobs = [cases.CASES[name]() for name in ("degree-3", "stack", "edges", "needles")] * 5
    alone = [render(job.splats, job.camera, job.background, threads=2) for job in jobs]
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(lambda job: render(job.splats, job.camera, job.background, threads=2), jobs))
    for a, b in zip(alone, together, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        np.testing.assert_array_equal(a.depth, b.depth)


def test_render_is_the_planes_turned() -> None:
    case = cases.CASES["around"]()
    rgb, alpha, depth_sum = render_planes(case.splats, case.camera, case.background, 1)
    rendering = render(case.splats, case.camera, case.background, threads=1)
    np.testing.assert_array_equal(rendering.image, rgb.transpose(1, 2, 0))
    assert rendering.image.flags.c_contiguous
    np.testing.assert_array_equal(rendering.alpha, alpha)
    seen = alpha > 0
    np.testing.assert_array_equal(rendering.depth[seen], (depth_sum[seen] / alpha[seen]))
    assert (rendering.depth[~seen] == 0).all()


def test_depth_is_the_distance_along_the_view_axis() -> None:
    # One wide, opaque disc at depth 3: every pixel shows it alone. Tolerance: alpha is one less transmittance, a
    # rounding of 1 that counts 2.5-fold at 0.4, and three more.
    camera = Camera("ahead", 20, 10, 30.0, 30.0, 10.0, 5.0, np.eye(4))
    disc = cases.edited(cases.scene(1, 1, 0), means=[[0, 0, 3]], log_scales=np.log([[0.8, 0.8, 0.01]]))
    disc = cases.edited(disc, quaternions=[[1, 0, 0, 0]], opacity_logits=[4])
    rendering = render(disc, camera)
    assert (rendering.alpha > 0.4).all()
    np.testing.assert_allclose(rendering.depth, 3.0, rtol=6 * cases.ROUNDING)


def test_background_shows_through_by_what_is_left() -> None:
    case = cases.CASES["degree-2"]()
    black = render(case.splats, case.camera)
    tinted = render(case.splats, case.camera, (0.25, 0.5, 1.0))
    left = (1 - black.alpha)[..., None] * np.array([0.25, 0.5, 1.0])
    cases.compare(tinted.image - black.image, left, 4 * cases.ROUNDING)


@pytest.mark.parametrize("size", [(1, 1), (1, 64), (16, 16), (17, 15), (61, 3)])
def test_no_gaussians_give_the_background(size: tuple[int, int]) -> None:
    rendering = render(empty_splats(0), cases.pinhole(*size, 20.0), (0.25, 0.5, 0.75))
    assert rendering.image.shape == (size[1], size[0], 3)
    np.testing.assert_array_equal(rendering.image, np.broadcast_to(np.float32([0.25, 0.5, 0.75]), (*size[::-1], 3)))
    assert not rendering.alpha.any()
    assert not rendering.depth.any()


def _spoilt(splats: Splats, field: str, value: float) -> Splats:
    array = getattr(splats, field).copy()
    array[...] = value
    return cases.edited(splats, **{field: array})


@pytest.mark.parametrize(
    ("field", "value"),
    [
        *[(f, v) for f in ("means", "log_scales", "quaternions") for v in (np.nan, np.inf, -np.inf, 3e38, -3e38)],
        *[("opacity_logits", v) for v in (np.nan, np.inf, -np.inf, 3e38, -3e38)],
        *[("sh", v) for v in (np.nan, -np.inf, -3e38)],
        ("quaternions", 0.0),
        ("log_scales", -200.0),
        ("log_scales", 200.0),
    ],
)
def test_spoilt_gaussians_leave_a_finite_picture_and_the_others_alone(field: str, value: float) -> None:
    # Non-finite and absurd values, mixed with sound Gaussians. Means and scales that are not numbers draw nothing.
    case = cases.CASES["17x13"]()
    spoilt = _spoilt(cases.scene(77, 19, 1), field, value)
    mixed = render_planes(join_splats(spoilt, case.splats), case.camera, case.background, 1)
    for plane in mixed:
        assert np.isfinite(plane).all()
    if field == "means" or (field == "log_scales" and (value > 0 or value <= -200)):
        alone = render_planes(case.splats, case.camera, case.background, 1)
        for plane, expected in zip(mixed, alone, strict=True):
            np.testing.assert_array_equal(plane, expected)


def test_zero_quaternion_stands_for_no_rotation() -> None:
    case = cases.CASES["17x13"]()
    none = cases.edited(case.splats, quaternions=np.zeros((len(case.splats), 4)))
    unit = cases.edited(case.splats, quaternions=np.tile([2.0, 0, 0, 0], (len(case.splats), 1)))
    np.testing.assert_array_equal(render(none, case.camera).image, render(unit, case.camera).image)


def test_gaussians_behind_the_camera_are_not_drawn() -> None:
    case = cases.CASES["degree-1"]()
    behind = replace(case.camera, world_to_camera=np.diag([1.0, 1.0, 1.0, 1.0]) @ case.camera.world_to_camera)
    behind.world_to_camera[2, 3] = -10.0
    assert not render(case.splats, behind).alpha.any()


def test_order_of_the_scene_matters_only_at_equal_depth() -> None:
    case = cases.CASES["degree-1"]()
    shuffled = take_splats(case.splats, np.random.default_rng(0).permutation(len(case.splats)))
    np.testing.assert_array_equal(render(case.splats, case.camera).image, render(shuffled, case.camera).image)
    clones = cases.CASES["clones"]()
    swapped = take_splats(clones.splats, np.r_[30:60, 0:30])
    assert (render(clones.splats, clones.camera).image != render(swapped, clones.camera).image).any()


def test_lens_distortion_is_refused() -> None:
    camera = replace(cases.pinhole(8, 8, 8.0), distortion_model="opencv", distortion=(0.1, 0.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="camera case"):
        render(empty_splats(0), camera)


def test_a_scene_that_covers_the_picture_thousands_of_times_is_refused() -> None:
    """2^27 pairs of a tile and a Gaussian are the most: a small stream must not be able to claim all memory."""
    count = 2**27 // 256**2 + 1
    row = np.float32([[0, 0, 2]]), np.ones((1, 3)), np.float32([[1, 0, 0, 0]]), np.full(1, 5.0), np.zeros((1, 1, 3))
    splats = Splats(*(np.repeat(value, count, axis=0).astype(np.float32) for value in row))
    wide = Camera("wide", 4096, 4096, 4e3, 4e3, 2048.0, 2048.0, np.eye(4))
    view = IncrementalView(wide, (0.0, 0.0, 0.0))
    with pytest.raises(UsageError, match="4096x4096 is covered too many times"):
        view.set_scene(splats)
    with pytest.raises(ValueError, match="the last scene was refused"):
        view.redraw()
    with pytest.raises(UsageError, match="4096x4096 is covered too many times by the scene's Gaussians; choose a smal"):
        render(splats, wide)
    assert render(splats, scale_camera(wide, 1 / 64)).alpha.min() > 0.9, "and the renderer is as good as new"


def test_malformed_arrays_are_refused() -> None:
    splats, camera = cases.scene(1, 5, 1), cases.pinhole(8, 8, 8.0)
    for field, bad in (
        ("means", splats.means.astype(np.float64)),
        ("means", splats.means[:, ::-1]),
        ("log_scales", splats.log_scales[:4]),
        ("quaternions", splats.quaternions[:, :3].copy()),
        ("sh", splats.sh[:, :, :2].copy()),
    ):
        with pytest.raises(ValueError, match="float32"):
            render(replace(splats, **{field: bad}), camera)


def test_thread_counts_out_of_range_are_refused() -> None:
    here = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert thread_count(0) == here
    assert thread_count(3) == 3
    for threads in (-1, 1025):
        with pytest.raises(UsageError, match="`threads`"):
            thread_count(threads)
