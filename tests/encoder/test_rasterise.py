"""Gradients of the native training kernel against automatic differentiation of the float64 twin, and what must not
change a bit: threads, instruction sets."""

from __future__ import annotations

import numpy as np
import pytest

import rasterise_cases as cases
from decogs.decoder.rasterise import render
from decogs.encoder.backends import SplatGradients
from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.formats.splats import Splats, empty_splats, join_splats
from decogs.formats.system.kernels import INSTRUCTION_SETS
from gradient_twin import FIELDS, compare_gradient, kernel_gradients, twin_gradients
from instruction_sets import printed_on


@pytest.mark.parametrize("name", cases.CASES)
def test_gradients_are_the_twins(name: str) -> None:
    case = cases.CASES[name]()
    book = cases.textbook(case)
    assert book.fragile == []
    assert book.doubtful.sum() <= max(1, 0.03 * book.doubtful.size)
    planes = cases.cotangents(case, book.doubtful)  # a pixel on a threshold says nothing about gradients
    expected = twin_gradients(case, *planes)
    actual = kernel_gradients(case, planes)
    for field in (*FIELDS, "view"):
        compare_gradient(getattr(actual, field), expected[field])
    unseen = book.weights.max((1, 2)) == 0
    for field in FIELDS:
        assert not getattr(actual, field)[unseen & ~book.doubtful.any()].any()


@pytest.mark.parametrize("plane", [0, 1, 2])
def test_each_plane_has_its_own_gradient(plane: int) -> None:
    case = cases.CASES["degree-3"]()
    planes = tuple(
        v if k == plane else np.zeros_like(v)
        for k, v in enumerate(cases.cotangents(case, cases.textbook(case).doubtful))
    )
    expected, actual = twin_gradients(case, *planes), kernel_gradients(case, planes)
    for field in (*FIELDS, "view"):
        if plane > 0 and field == "sh":
            assert not actual.sh.any()
        else:
            compare_gradient(getattr(actual, field), expected[field])
    kernel = CpuKernel(1)
    if plane == 0:  # planes that are not asked for change nothing
        kernel.forward(case.splats, case.camera, case.background)
        bare = kernel.backward(case.splats, planes[0])
        for field in (*FIELDS, "view"):
            compare_gradient(getattr(bare, field), expected[field])


def test_gradient_comparator_finds_faults() -> None:
    expected = np.random.default_rng(0).normal(size=(20, 3))
    expected[7] *= 0.01
    compare_gradient(expected * (1 + 1e-6), expected)
    for row, factor in ((3, 1.001), (7, 1.001), (3, -1.0), (3, np.nan)):
        wrong = expected.copy()
        wrong[row] *= factor
        with pytest.raises(AssertionError):
            compare_gradient(wrong, expected)


@pytest.mark.parametrize("name", ["degree-3", "around", "needles", "stack"])
def test_twins_gradients_are_its_finite_differences(name: str) -> None:
    # Central differences in float64: rounding 2e-16 * loss / step, and curvature * step^2, both below 1e-6.
    case = cases.CASES[name]()
    planes = cases.cotangents(case, cases.textbook(case).doubtful)
    gradients = twin_gradients(case, *planes)
    arrays = {f: getattr(case.splats, f).astype(float) for f in FIELDS}

    def loss() -> float:
        shown = cases.twin(case, np, list(arrays.values()))
        return float(sum((a * v).sum() for a, v in zip(shown, planes, strict=False)))

    rng = np.random.default_rng(5)
    for field, array in arrays.items():
        flat, expected = array.reshape(-1), gradients[field].reshape(-1)
        visible = np.flatnonzero(np.abs(expected) > 1e-3 * np.abs(expected).max())
        for k in rng.choice(visible, 4, replace=False):
            value, step = flat[k], 1e-6
            flat[k] = value + step
            above = loss()
            flat[k] = value - step
            below = loss()
            flat[k] = value
            assert abs((above - below) / (2 * step) - expected[k]) < 1e-5 * np.abs(expected).max(), (field, k)


def test_lower_degree_ignores_the_higher_coefficients() -> None:
    case = cases.CASES["degree-3"]()
    planes = cases.cotangents(case)
    low = cases.edited(case.splats, sh=case.splats.sh[:, :4])
    kernel = CpuKernel(1)
    picture = kernel.forward(case.splats, case.camera, case.background, sh_degree=1, depth=True)
    g = kernel.backward(case.splats, planes[0], v_alpha=planes[1], v_depth=planes[2])
    expected_picture = kernel.forward(low, case.camera, case.background, depth=True)
    expected = kernel.backward(low, planes[0], v_alpha=planes[1], v_depth=planes[2])
    np.testing.assert_array_equal(picture.rgb, expected_picture.rgb)
    np.testing.assert_array_equal(g.means, expected.means)
    np.testing.assert_array_equal(g.sh[:, :4], expected.sh)
    assert not g.sh[:, 4:].any()


def test_the_decoder_shows_the_same_bits() -> None:
    kernel = CpuKernel(1)
    for case in [make() for make in cases.CASES.values()] + [cases.large_case()]:
        picture = kernel.forward(case.splats, case.camera, case.background, depth=True)
        shown = render(case.splats, case.camera, case.background, threads=1)
        np.testing.assert_array_equal(picture.rgb.transpose(1, 2, 0), shown.image)
        np.testing.assert_array_equal(picture.alpha, shown.alpha)
        assert picture.depth is not None
        depth = np.divide(picture.depth, picture.alpha, out=np.zeros_like(shown.depth), where=picture.alpha > 0)
        np.testing.assert_array_equal(depth, shown.depth)
        np.testing.assert_array_equal(kernel.forward(case.splats, case.camera, case.background).rgb, picture.rgb)


def test_any_number_of_threads_gives_the_same_bits() -> None:
    digests = {threads: cases.encoder_digest(threads) for threads in (1, 2, 5)}
    assert len(set(digests.values())) == 1, digests


@pytest.mark.parametrize("instruction_set", INSTRUCTION_SETS)
def test_any_instruction_set_gives_the_same_bits(instruction_set: str) -> None:
    assert printed_on(instruction_set, cases.__file__, "encoder", "2") == cases.encoder_digest(1)


def test_gradients_land_in_the_given_arrays() -> None:
    case = cases.CASES["degree-1"]()
    planes = cases.cotangents(case)
    expected = kernel_gradients(case, planes)
    out = SplatGradients(*(np.full_like(getattr(expected, f), np.nan) for f in (*FIELDS, "view")))
    kernel = CpuKernel(1)
    kernel.forward(case.splats, case.camera, case.background, depth=True)
    assert kernel.backward(case.splats, planes[0], v_alpha=planes[1], v_depth=planes[2], out=out) is out
    for field in (*FIELDS, "view"):
        np.testing.assert_array_equal(getattr(out, field), getattr(expected, field))


def test_centres_are_the_projections_of_what_was_drawn() -> None:
    case = cases.CASES["around"]()
    kernel = CpuKernel(1)
    kernel.forward(case.splats, case.camera, case.background)
    centres, depths = kernel.centres(len(case.splats))
    seen = cases.textbook(case).weights.max((1, 2)) > 0
    expected = cases.twin(case)[3]
    z = case.splats.means @ case.camera.world_to_camera[2, :3] + case.camera.world_to_camera[2, 3]
    # Ten roundings of the coordinates in front of the division, of which the largest drawn here is some 4 * focal / z.
    np.testing.assert_allclose(centres[seen], expected[seen], rtol=0, atol=20 * cases.ROUNDING * 400)
    np.testing.assert_allclose(depths[seen], z[seen], rtol=0, atol=10 * cases.ROUNDING * 8)
    behind = z <= 0
    assert behind.any()
    assert np.isnan(centres[behind]).all()
    assert np.isnan(depths[behind]).all()


def test_no_gaussians_and_none_in_sight() -> None:
    kernel = CpuKernel(2)
    nothing = empty_splats(2)
    camera = cases.pinhole(19, 7, 12.0)
    picture = kernel.forward(nothing, camera, (0.5, 0.25, 1.0), depth=True)
    assert (picture.rgb == np.float32([0.5, 0.25, 1.0])[:, None, None]).all()
    g = kernel.backward(nothing, np.ones_like(picture.rgb))
    assert g.sh.shape == (0, 9, 3)
    case = cases.CASES["degree-1"]()
    hidden = cases.edited(case.splats, means=case.splats.means - np.float32([0, 0, 50]))
    kernel.forward(hidden, cases.pinhole(19, 7, 12.0))
    g = kernel.backward(hidden, np.ones((3, 7, 19), np.float32))
    for field in (*FIELDS, "view"):
        assert not getattr(g, field).any()


@pytest.mark.parametrize(
    ("field", "value"),
    [("means", np.nan), ("means", 3e38), ("log_scales", np.inf), ("log_scales", -200.0), ("quaternions", 0.0)],
)
def test_spoilt_gaussians_leave_the_others_gradients_alone(field: str, value: float) -> None:
    case = cases.CASES["17x13"]()
    planes = cases.cotangents(case)
    spoilt = cases.scene(77, 19, 1)
    array = getattr(spoilt, field).copy()
    array[...] = value
    spoilt = cases.edited(spoilt, **{field: array})
    mixed = cases.Case(join_splats(case.splats, spoilt), case.camera, case.background)
    g = kernel_gradients(mixed, planes)
    for name in FIELDS:
        assert np.isfinite(getattr(g, name)).all()
    if field != "quaternions":  # drawn by none of these
        alone = kernel_gradients(case, planes)
        for name in (*FIELDS, "view"):
            np.testing.assert_array_equal(getattr(g, name)[: len(case.splats)], getattr(alone, name))
            assert not getattr(g, name)[len(case.splats) :].any()
    else:
        assert not g.quaternions[len(case.splats) :].any()


def test_a_kernel_serves_one_scene_after_another() -> None:
    # Buffers shrink, grow and are used again: nothing of a scene may show in the next one's gradients.
    kernel = CpuKernel(2)
    for name in ("crowd", "one-pixel", "degree-3", "stack", "17x13", "crowd"):
        case = cases.CASES[name]()
        planes = cases.cotangents(case)
        kernel.forward(case.splats, case.camera, case.background, depth=True)
        g = kernel.backward(case.splats, planes[0], v_alpha=planes[1], v_depth=planes[2])
        fresh = kernel_gradients(case, planes)
        for field in (*FIELDS, "view"):
            np.testing.assert_array_equal(getattr(g, field), getattr(fresh, field))


def test_misuse_is_refused() -> None:
    case = cases.CASES["17x13"]()
    v_rgb, v_alpha, _ = cases.cotangents(case)
    kernel = CpuKernel(1)
    with pytest.raises(ValueError, match="forward"):
        kernel.backward(case.splats, v_rgb)
    kernel.forward(case.splats, case.camera)

    def scene_of(count: int) -> Splats:
        return cases.scene(1, count, 1)

    with pytest.raises(ValueError, match="last forward"):
        kernel.backward(scene_of(3), v_rgb)
    with pytest.raises(ValueError, match="cotangent"):
        kernel.backward(case.splats, v_rgb[:, 1:])
    with pytest.raises(ValueError, match="cotangent"):
        kernel.backward(case.splats, v_rgb, v_alpha=v_alpha.T.copy())
    with pytest.raises(ValueError, match="float32"):
        kernel.backward(case.splats, v_rgb.astype(np.float64))


def test_a_fixed_view_has_its_kernel_s_background_in_pictures_and_gradients() -> None:
    """The same as a whole rendering over it: what is transparent shows it, and the gradient of opacity knows it."""
    case = cases.large_case()
    background = (0.1, 0.9, 0.4)
    kernel, rows = CpuKernel(1, background), np.arange(len(case.splats))
    cotangent = np.random.default_rng(0).normal(size=(3, case.camera.height, case.camera.width)).astype(np.float32)
    whole = kernel.forward(case.splats, case.camera)
    expected = kernel.backward(case.splats, cotangent)
    np.testing.assert_array_equal(whole.rgb, CpuKernel(1).forward(case.splats, case.camera, background).rgb)
    view = kernel.fixed_view(case.camera)
    view.set_scene(case.splats)
    view.redraw()
    np.testing.assert_array_equal(view.rgb, whole.rgb)
    view.detach(rows)
    view.draw(case.splats, rows)
    actual = view.backward(cotangent)
    for field in FIELDS:
        np.testing.assert_array_equal(getattr(actual, field), getattr(expected, field))
