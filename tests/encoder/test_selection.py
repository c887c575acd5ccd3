"""Selection: who may change in a frame. Both rules on figures made by hand, and visibility on rendered scenes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from decogs.encoder.backends.cpu.cpu_kernel import CpuKernel
from decogs.encoder.backends.cpu.fixed_view import CpuFixedView
from decogs.encoder.backends.scene_views import SceneViews
from decogs.encoder.change.masks import FrameMask
from decogs.encoder.change.selection import ViewEvidence, select, view_evidence
from decogs.encoder.frame.plan import light_only
from decogs.encoder.settings.frame import SelectionSettings
from decogs.formats.cameras import Camera
from decogs.formats.splats import Splats, join_splats

PAPER = SelectionSettings(rule="paper", min_views=2)
WEIGHT = SelectionSettings(rule="weight", min_views=2, min_fraction=0.3)


def evidence(inside: list[int] | None, weight: list[float], masked: list[float]) -> ViewEvidence:
    def centres() -> np.ndarray:
        assert inside is not None, "centres cost a projection and are asked for by the paper's rule only"
        return np.array(inside, bool)

    return ViewEvidence(np.array(weight, np.float32), np.array(masked, np.float32), centres)


def test_paper_rule_counts_views_in_which_the_centre_is_inside_and_visible() -> None:
    #          in all three, in two, in one, in two but hidden in one of them, in none
    views = [
        evidence([1, 1, 1, 1, 0], [1, 1, 1, 1.000, 1], [0] * 5),
        evidence([1, 1, 0, 1, 0], [1, 1, 1, 0.019, 1], [0] * 5),
        evidence([1, 0, 0, 0, 0], [1, 1, 1, 1.000, 1], [0] * 5),
    ]
    for kappa, expected in ((1, [1, 1, 1, 1, 0]), (2, [1, 1, 0, 0, 0]), (3, [1, 0, 0, 0, 0])):
        settings = SelectionSettings(rule="paper", min_views=kappa)
        np.testing.assert_array_equal(select(views, settings), np.array(expected, bool))


def test_weight_rule_asks_for_a_share_of_what_is_seen_and_for_views() -> None:
    #          29 %, 31 %, 31 % in one view only, 90 % where it is hidden, no weight at all
    views = [
        evidence(None, [10, 10, 10, 0.01, 0], [2.9, 3.1, 6.2, 0.009, 0]),
        evidence(None, [10, 10, 10, 5.00, 0], [2.9, 3.1, 0.0, 0.000, 0]),
    ]
    np.testing.assert_array_equal(select(views, WEIGHT), np.array([0, 1, 0, 0, 0], bool))
    one_view = SelectionSettings(rule="weight", min_views=1, min_fraction=0.3)
    np.testing.assert_array_equal(select(views, one_view), np.array([0, 1, 1, 0, 0], bool))


@pytest.mark.parametrize(("settings", "inside"), [(PAPER, [1, 0]), (WEIGHT, None)])
def test_a_rig_of_one_view_asks_for_that_view_only(settings: SelectionSettings, inside: list[int] | None) -> None:
    np.testing.assert_array_equal(select([evidence(inside, [1, 1], [1, 0])], settings), [True, False])


@pytest.fixture(scope="module")
def hidden_scene(tiny_rig: Any) -> Splats:
    """Row 0: alone and in the open; row 1: beside the mask; row 2: behind an opaque wall; the rest: the wall."""
    spot = tiny_rig.patch((0.3, 0.0, 0.0), 1, 1, 0.1, 1)
    aside = tiny_rig.patch((0.3, 0.35, 0.0), 1, 1, 0.1, 2)
    behind = tiny_rig.patch((-0.3, 0.0, 0.4), 1, 1, 0.1, 3)
    scene = join_splats(join_splats(spot, aside), behind)
    for layer in range(3):  # one lets through up to 6 % between its Gaussians
        scene = join_splats(scene, tiny_rig.patch((-0.35, 0.01 * layer, 0.2 + 0.02 * layer), 13, 13, 0.06, 4))
    return scene


def watching(splats: Splats, camera: Camera) -> CpuFixedView:
    view = CpuFixedView(CpuKernel(1), camera)
    view.set_scene(splats)
    return view


def masked_views(tiny_rig: Any, splats: Splats, *, where: tuple[int, ...] = (0, 1, 2, 3, 4)) -> list[ViewEvidence]:
    """The mask is a band of 12 pixels about the middle row, in the views ``where``."""
    views = []
    for index in range(5):
        mask = np.zeros((tiny_rig.height, tiny_rig.width), bool)
        mask[18:30] = index in where
        views.append(view_evidence(watching(splats, tiny_rig.camera(index)), mask))
    return views


@pytest.mark.parametrize("rule", ["paper", "weight"])
def test_a_gaussian_hidden_behind_an_opaque_one_is_not_selected(tiny_rig: Any, hidden_scene: Splats, rule: Any) -> None:
    selected = select(masked_views(tiny_rig, hidden_scene), SelectionSettings(rule=rule))
    np.testing.assert_array_equal(selected[:3], [True, False, False])
    assert selected[3:].any()
    # The hidden one's centre does fall in the mask: it is visibility that keeps it out.
    open_air = select(masked_views(tiny_rig, Splats(*(a[:3] for a in vars(hidden_scene).values()))), PAPER)
    np.testing.assert_array_equal(open_air, [True, False, True])


def test_kappa_views_of_the_rendered_scene(tiny_rig: Any, hidden_scene: Splats) -> None:
    for where, expected in (((2,), False), ((2, 3), True), ((), False)):
        assert select(masked_views(tiny_rig, hidden_scene, where=where), PAPER)[0] == expected


def test_what_is_behind_the_camera_or_outside_the_picture_is_not_selected(tiny_rig: Any) -> None:
    splats = join_splats(tiny_rig.patch((0, 0, -4.0), 1, 1, 0.1, 1), tiny_rig.patch((9.0, 0, 0), 1, 1, 0.1, 2))
    everywhere = np.ones((tiny_rig.height, tiny_rig.width), bool)
    for settings in (PAPER, WEIGHT):
        views = [view_evidence(watching(splats, tiny_rig.camera(i)), everywhere) for i in range(5)]
        assert not select(views, settings).any()


def test_weights_are_alpha_times_transmittance_summed_over_pixels(tiny_rig: Any, hidden_scene: Splats) -> None:
    # The weights of all Gaussians add up to the picture's alpha, and those inside the mask to alpha inside it.
    kernel, camera = CpuKernel(1), tiny_rig.camera(1)
    mask = np.zeros((tiny_rig.height, tiny_rig.width), bool)
    mask[10:30, 5:40] = True
    found = view_evidence(watching(hidden_scene, camera), mask)
    alpha = kernel.forward(hidden_scene, camera).alpha
    assert found.weight.sum() == pytest.approx(alpha.sum(), rel=1e-5)
    assert found.masked_weight.sum() == pytest.approx(alpha[mask].sum(), rel=1e-5)


def test_what_light_alone_changes_is_the_selected_away_from_what_moves(tiny_rig: Any) -> None:
    """Two spots change in every view; things move around the left one only."""
    scene = join_splats(tiny_rig.patch((-0.4, 0.0, 0.0), 1, 1, 0.1, 1), tiny_rig.patch((0.4, 0.0, 0.0), 1, 1, 0.1, 2))
    views = SceneViews(CpuKernel(1), lambda: [tiny_rig.camera(index) for index in range(5)]).of(scene)
    shape = tiny_rig.height, tiny_rig.width
    everywhere, nowhere, left = np.ones(shape, bool), np.zeros(shape, bool), np.zeros(shape, bool)
    left[:, : tiny_rig.width // 2] = True
    masks, both = [FrameMask(everywhere, everywhere) for _ in views], np.ones(2, bool)
    np.testing.assert_array_equal(light_only(views, masks, both, [left] * 5, WEIGHT), [False, True])
    np.testing.assert_array_equal(light_only(views, masks, both, [nowhere] * 5, WEIGHT), [True, True])
    only_moving = np.array([True, False])
    assert not light_only(views, masks, only_moving, [left] * 5, WEIGHT).any()
