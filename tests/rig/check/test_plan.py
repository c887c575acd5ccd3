"""A rig drawn for a page: what is in the picture, and how large."""

from __future__ import annotations

import re

import numpy as np
import pytest

from decogs.formats.cameras import Camera
from decogs.rig.check.plan import plan


def camera(name: str, across: float) -> Camera:
    pose = np.eye(4)
    pose[0, 3] = -across
    return Camera(name, 64, 48, 60.0, 60.0, 32.0, 24.0, pose)


CAMERAS = [camera("one", 0.0), camera("two", 2.0)]
COLOURS = {"one": "green", "two": "orange"}


def middle(svg: str, colour: str) -> np.ndarray:
    """Of a camera's outline, pixels (2,)."""
    found = re.search(rf"points='([^']*)' fill='{colour}'", svg)
    assert found is not None
    return np.array([tuple(map(float, place.split(","))) for place in found[1].split()]).mean(axis=0)


def apart(points: np.ndarray | None) -> float:
    """Pixels between the two cameras."""
    svg = plan(CAMERAS, COLOURS, {}, points)
    return float(np.linalg.norm(middle(svg, "orange") - middle(svg, "green")))


def test_cameras_without_points_fill_the_plan() -> None:
    assert apart(None) == pytest.approx(440, abs=0.2)  # 560 pixels less two margins of 60; written to a tenth


@pytest.mark.parametrize("side", [-1, 1])
def test_points_are_shown_as_far_as_three_times_the_cameras_distance(side: int) -> None:
    """Two units between the cameras, then 2 + 6 from one end to the other, however far the points are."""
    at, begin = np.linspace(0, 1, 101)[:, None] * [side, 0.0, 0.0], [2.0 * (side > 0), 0.0, 1.0]
    near, beyond = (apart(begin + reach * at) for reach in (4.0, 1000.0))
    # Of the points a twentieth at either end is not shown.
    assert near == pytest.approx(440 * 2 / (2 + 3.8), abs=0.2)
    assert beyond == pytest.approx(440 * 2 / (2 + 6), abs=0.2)


def test_links_are_thicker_for_more_and_names_are_text() -> None:
    svg = plan(
        [*CAMERAS, camera("<three>", 4.0)], COLOURS | {"<three>": "red"}, {("one", "two"): 40, ("two", "<three>"): 10}
    )
    assert [float(width) for width in re.findall(r"stroke-width='([\d.]+)'", svg)] == [5.0, 1.2]
    assert ">&lt;three&gt;</text>" in svg
