"""Where something may stand: what views that show the backdrop deny, and how many must look."""

from __future__ import annotations

import numpy as np
import pytest

from decogs.decoder.subject.hull import Hull, SubjectView, hull_of_mattes, recorded_pixels, with_margin, without_margin
from decogs.formats.cameras import Camera


def view(angle: float, subject: np.ndarray | None = None) -> SubjectView:
    """From 4 units off, all of whose picture, 2 units wide at the middle, shows a subject unless told."""
    pose = np.eye(4)
    turned = np.radians(angle)
    pose[0, 0] = pose[2, 2] = np.cos(turned)
    pose[0, 2], pose[2, 0] = np.sin(turned), -np.sin(turned)
    pose[2, 3] = 4
    shown = np.ones((20, 20), bool) if subject is None else subject
    return SubjectView(Camera(f"at {angle}", 20, 20, 40.0, 40.0, 10.0, 10.0, pose), shown)


RIGHT = np.broadcast_to(np.arange(20) >= 10, (20, 20))
POINTS = np.array([[0.5, 0, 0], [-0.5, 0, 0], [0, 0, 0.4], [0, 3, 0]])


def test_a_view_that_shows_the_backdrop_denies_and_one_that_does_not_look_says_nothing() -> None:
    hull = Hull([view(0, RIGHT), view(90)])
    np.testing.assert_array_equal(hull.denies(POINTS), [False, True, False, False])
    np.testing.assert_array_equal(hull.holds(POINTS), [True, False, True, False])
    assert hull.share == 0.75


@pytest.mark.parametrize(("count", "least"), [(1, 1), (2, 2), (3, 3), (5, 3)])
def test_up_to_three_views_of_mattes_must_look(count: int, least: int) -> None:
    """Near a camera, where the others do not look, a hull of one would reach on for ever."""
    views = [view(36.0 * number) for number in range(count)]
    assert hull_of_mattes(views).least == least
    near = np.array([[0, 0, -3.5]])
    assert hull_of_mattes(views).holds(near).all() == (count == 1)
    assert hull_of_mattes(views).holds(np.zeros((1, 3))).all()


def test_a_margin_is_two_pixels_round() -> None:
    point = np.zeros((9, 9), bool)
    point[4, 4] = True
    grown = with_margin(point)
    np.testing.assert_array_equal(grown[4], np.abs(np.arange(9) - 4) <= 2)
    assert not grown[2, 2]


def test_without_its_margin_a_subject_is_what_it_was() -> None:
    subject = np.zeros((20, 20), bool)
    subject[6:14, 8:11] = True
    np.testing.assert_array_equal(without_margin(with_margin(subject)), subject)


def test_a_pixel_counts_as_recorded_where_all_of_it_was() -> None:
    camera = view(0).camera
    assert recorded_pixels(None, camera).all()
    recorded = np.ones((40, 40), np.float32)
    recorded[7, 9] = 0
    found = recorded_pixels(recorded, camera)
    assert not found[3, 4]
    assert found.sum() == 399
