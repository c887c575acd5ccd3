"""Outlines of a subject follow the picture; chroma beside its place is put back before a key decides by it."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from decogs.rig.mattes import outlines
from decogs.rig.mattes.chroma_key import key_axis, keyed
from decogs.rig.mattes.chroma_siting import centred_chroma
from decogs.rig.mattes.mattes import linear
from stages.make import coded, light_on_backdrop, look, render
from stages.scenes import STAGES, cameras, on_stage

_Y_CBCR = np.array([[0.299, 0.587, 0.114], [-0.168736, -0.331264, 0.5], [0.5, -0.418688, -0.081312]])


def dense_laplacian(picture: np.ndarray) -> np.ndarray:
    """The matrix of Levin, Lischinski and Weiss 2008, equation 12, window by window."""
    height, width = picture.shape[:2]
    index, total = np.arange(height * width).reshape(height, width), np.zeros((height * width,) * 2)
    for y, x in np.ndindex(height - 2, width - 2):
        colours = picture[y : y + 3, x : x + 3].reshape(9, 3).astype(np.float64)
        apart = colours - colours.mean(axis=0)
        covariance = apart.T @ apart / 9 + outlines._NOISE * np.eye(3)
        own = index[y : y + 3, x : x + 3].ravel()
        total[np.ix_(own, own)] += np.eye(9) - (1 + apart @ np.linalg.inv(covariance) @ apart.T) / 9
    return total


def test_alpha_is_that_of_the_matrix_written_out() -> None:
    random = np.random.default_rng(3)
    picture = cv2.GaussianBlur(random.uniform(0, 1, (14, 17, 3)).astype(np.float32), (0, 0), 1)
    guess = random.uniform(0, 1, (14, 17)).astype(np.float32)
    free = np.zeros((14, 17), np.bool_)
    free[4:10, 5:13] = random.uniform(0, 1, (6, 8)) < 0.8
    loose, laplacian = free.ravel(), dense_laplacian(picture)
    pull = laplacian + outlines._TRUST * np.eye(loose.size)
    known = laplacian[np.ix_(loose, ~loose)] @ guess.ravel()[~loose]
    exact = guess.copy()
    right = outlines._TRUST * guess.ravel()[loose] - known
    exact[free] = np.linalg.solve(pull[np.ix_(loose, loose)], right)
    found = outlines.fitted(picture, guess, free)
    np.testing.assert_array_equal(found[~free], guess[~free])
    assert np.abs(exact - guess)[free].mean() > 0.1
    # So few steps of conjugate gradients: measured .006 after 6, .00003 after 12.
    assert np.abs(found - exact).max() < 0.01


@pytest.mark.parametrize("free", [np.zeros((5, 6), np.bool_), np.ones((5, 6), np.bool_)])
def test_any_pixels_may_be_free(free: np.ndarray) -> None:
    guess = np.linspace(0, 1, 30, dtype=np.float32).reshape(5, 6)
    grey = np.full((5, 6, 3), 0.5, np.float32)
    assert np.isfinite(outlines.fitted(grey, guess, free)).all()
    assert np.isfinite(outlines.fitted(grey[:2, :2], guess[:2, :2], free[:2, :2])).all()


def on_green(height: int = 160) -> tuple[np.ndarray, np.ndarray]:
    """A picture (H, W, 3) with 8 bits and the matte (H, W) of all that stands before the screen."""
    stage, acting = STAGES["green"], on_stage(0)[:-4]  # without the stool, which is in no matte
    view = look(cameras((height * 3 // 4, height))[7], stage)
    picture, matte = render(view, acting, light_on_backdrop(stage, acting, height))
    return coded(picture, np.random.default_rng(1)), matte


def with_half_size_chroma(picture: np.ndarray, *, stated: bool) -> np.ndarray:
    """As read from a video whose chroma lies where it is ``stated``, else midway between two columns."""
    planes = picture @ _Y_CBCR.T
    across = [0.25, 0.5, 0.25] if stated else [0, 0.5, 0.5]
    shrunk = cv2.sepFilter2D(planes[..., 1:], -1, np.array(across), np.ones(1), borderType=cv2.BORDER_REPLICATE)
    shrunk = (shrunk[::2, ::2] + shrunk[1::2, ::2]) / 2
    back = np.array([[0.5, 0, 0], [0, 0.5, -0.25]])
    size, how = picture.shape[1::-1], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    planes[..., 1:] = cv2.warpAffine(shrunk, back, size, flags=how, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(np.clip(np.rint(planes @ np.linalg.inv(_Y_CBCR).T), 0, 255), np.uint8)


def iou(picture: np.ndarray, matte: np.ndarray) -> float:
    found = keyed(linear(picture), key_axis("green"))
    assert found is not None
    # Half covered is either: rays are 2 x 2 a pixel.
    told = np.abs(matte - 0.5) > 0.01
    one, other = found.subject.alpha[told] > 0.5, matte[told] > 0.5
    return float((one & other).sum() / (one | other).sum())


def test_chroma_half_a_pixel_off_is_put_back() -> None:
    picture, matte = on_green()
    right, beside = (with_half_size_chroma(picture, stated=stated) for stated in (True, False))
    for untouched in (picture, right, np.full_like(picture, 90), linear(beside)):
        assert centred_chroma(untouched) is untouched
    mended = centred_chroma(beside)
    # Measured, in squared levels: 1.6 and 3.6, as both were resampled; IoU .966, .938, and .959 in place.
    assert np.square(mended - right.astype(float)).mean() < np.square(beside - right.astype(float)).mean() / 2
    assert iou(mended, matte) > iou(beside, matte) + 0.015
    assert iou(mended, matte) > iou(right, matte) - 0.005


@pytest.mark.parametrize("lie", ["across", "down"])
def test_edges_across_tell_where_chroma_lies_and_edges_down_do_not(lie: str) -> None:
    """Bars of 8 columns, or rows: of rows, half a column is no difference."""
    bars = np.where((np.arange(64) // 8 % 2)[None, :, None], [200.0, 60, 40], [20.0, 160, 60]).repeat(64, 0)
    bars = bars if lie == "across" else bars.transpose(1, 0, 2)
    beside = with_half_size_chroma(np.ascontiguousarray(bars), stated=False)
    assert (centred_chroma(beside) is beside) == (lie == "down")


def test_outlines_follow_the_picture() -> None:
    picture, matte = on_green()
    # Measured: .981 and .959; .973 and .954 where outlines are as the key guesses them.
    assert iou(picture, matte) > 0.977
    assert iou(with_half_size_chroma(picture, stated=True), matte) > 0.9565
