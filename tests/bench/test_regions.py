"""Static and dynamic pixels: the rig's own masks, or determined from what was recorded."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from decogs.bench.measures.regions import (
    Regions,
    find_regions,
    held_out_pictures,
    masked_pixels,
    recorded_regions,
    static_column,
)
from decogs.formats.errors import RigError
from decogs.formats.rigs import open_rig


def clip(levels: dict[tuple[int, int], tuple[int, ...]], frames: int = 3) -> list[np.ndarray]:
    """Grey pictures of 20 x 30; ``levels``: what the 3x3 pixels around a place are in each frame."""
    pictures = [np.full((20, 30, 3), 100, np.uint8) for _ in range(frames)]
    for (row, column), values in levels.items():
        for picture, value in zip(pictures, values, strict=True):
            picture[row - 1 : row + 2, column - 1 : column + 2, 1] = value
    return pictures


def regions_of(pictures: list[np.ndarray]) -> Regions:
    return recorded_regions(iter(pictures), masked_pixels(iter(pictures)))


def test_recorded_changes_by_their_span() -> None:
    """Centres of the patches: 3x3 means span exactly what one channel of the patch spans."""
    regions = regions_of(clip({(5, 5): (100, 106, 100), (5, 20): (100, 107, 112), (14, 12): (87, 100, 100)}))
    assert regions.static[5, 5]
    assert not regions.dynamic[5, 5]
    assert not regions.static[5, 20], "12 levels are no longer static"
    assert not regions.dynamic[5, 20], "nor clearly dynamic"
    assert regions.dynamic[14, 12]
    assert not (regions.static & regions.dynamic).any()


def test_static_pixels_keep_away_from_change() -> None:
    regions = regions_of(clip({(10, 15): (100, 200, 100)}))
    # The patch reaches 1 pixel from its centre, its trace in 3x3 means 1 more, and the margin 2.
    rows, columns = np.nonzero(~regions.static)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (6, 14, 11, 19)


def test_undisturbed_pixels_keep_away_from_the_papers_masks() -> None:
    """The threshold is 25 levels; the dilation .0355 of 30 pixels, which is 1."""
    regions = regions_of(clip({(10, 6): (100, 125, 100), (10, 22): (100, 126, 100)}))
    assert masked_pixels(iter(clip({(10, 6): (100, 125, 100)}))).sum() == 0
    rows, columns = np.nonzero(masked_pixels(iter(clip({(10, 22): (100, 126, 100)}))))
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (8, 12, 20, 24)
    assert not (regions.undisturbed & ~regions.static).any()
    assert not regions.undisturbed[10, 22]


def test_single_noisy_pixels_are_static() -> None:
    pictures = clip({})
    pictures[1][8, 8] = 130  # 30 levels in one pixel are 3.3 in the mean
    assert regions_of(pictures).static.all()


@pytest.fixture
def rig_with_truth(three_frames: Path, tiny_rig: Any, tmp_path: Path) -> Path:
    folder = tmp_path / "rig"
    shutil.copytree(three_frames, folder)
    (folder / "truth").mkdir()
    static = np.zeros((tiny_rig.height, tiny_rig.width), np.uint8)
    static[:, :32] = 255
    changing = np.zeros_like(static)
    changing[:, 40:44] = 255
    cv2.imwrite(str(folder / "truth" / "static_cam02.png"), static)
    cv2.imwrite(str(folder / "truth" / "changing_cam02.png"), changing)
    return folder


def test_the_rigs_own_masks_come_first(rig_with_truth: Path) -> None:
    regions = find_regions(open_rig(rig_with_truth), "cam02", range(3), 1.0)
    assert "static_cam02.png" in regions.about
    assert regions.static[:, :32].all()
    assert not regions.static[:, 32:].any()
    assert np.flatnonzero(regions.dynamic[0]).tolist() == [40, 41, 42, 43]
    half = find_regions(open_rig(rig_with_truth), "cam02", range(3), 0.5)
    assert half.static.shape == (24, 32)
    assert np.flatnonzero(half.dynamic[0]).tolist() == [20, 21]


def test_a_camera_without_masks_is_judged_by_its_pictures(rig_with_truth: Path) -> None:
    regions = find_regions(open_rig(rig_with_truth), "cam01", range(3), 1.0)
    assert "determined from the recorded frames" in regions.about
    assert regions.dynamic.any(), "the square moves"
    assert regions.static.any(), "the wall stays"


def test_masks_of_another_size_are_refused(rig_with_truth: Path) -> None:
    cv2.imwrite(str(rig_with_truth / "truth" / "static_cam02.png"), np.zeros((10, 10), np.uint8))
    with pytest.raises(RigError, match=r"static_cam02\.png: 10 x 10 pixels, but cam02 has 64 x 48; "):
        find_regions(open_rig(rig_with_truth), "cam02", range(3), 1.0)


def test_recorded_pictures_of_a_strided_range(three_frames: Path) -> None:
    every_other = list(held_out_pictures(open_rig(three_frames), "cam02", range(0, 3, 2), 1.0))
    for picture, index in zip(every_other, (0, 2), strict=True):
        stored = cv2.imread(str(three_frames / "cam02" / f"{index:04d}.png"))[..., ::-1]
        np.testing.assert_array_equal(picture, stored)


def test_the_column_is_static_and_has_detail() -> None:
    pictures = clip({(10, 20): (0, 255, 0)})
    pictures[0][::2, 9] = 0  # detail, static
    pictures[0][::2, 20] = 0  # more of it, but where things move
    pictures[0][:, 0] = np.arange(20)[:, None] * 12  # more still, but at the picture's side
    regions = regions_of(clip({(10, 20): (0, 255, 0)}))
    assert static_column(regions, pictures[0]) == 9
