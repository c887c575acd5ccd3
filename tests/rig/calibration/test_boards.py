"""A board in pictures drawn from a known camera, and cameras placed by exact sights of it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from decogs.formats.errors import UsageError
from decogs.rig.calibration.board_rig import place_by_board
from decogs.rig.calibration.boards import BoardFinder, BoardView, Charuco, parse_board
from decogs.rig.calibration.lenses import Lens, lens_from_board

BOARD = "charuco:5x4:0.05:0.0375:DICT_4X4_50"
LENS = Lens("opencv", (500.0, 500.0), (319.5, 239.5), (-0.1, 0.02, 0.0, 0.0))


def _picture(*, inverted: bool = False, mirrored: bool = False, board: Charuco | None = None) -> np.ndarray:
    board = board or Charuco(5, 4, 0.05, 0.0375, "DICT_4X4_50")
    drawn = np.asarray(board.made().generateImage((100 * board.columns, 100 * board.rows)))
    picture = cv2.copyMakeBorder(drawn, 60, 60, 60, 60, cv2.BORDER_CONSTANT, value=255)
    picture = 255 - picture if inverted else picture
    picture = picture[:, ::-1] if mirrored else picture
    return np.repeat(np.ascontiguousarray(picture)[..., None], 3, axis=2)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_a_board_is_found_inverted_and_mirrored(inverted: bool, mirrored: bool) -> None:
    view = BoardFinder(parse_board(BOARD))(_picture(inverted=inverted, mirrored=mirrored))
    assert view is not None
    assert view.mirrored == mirrored
    squares = parse_board(BOARD).corners()[view.numbers][:, :2] / 0.05 * 100 + 60
    x = 620 - squares[:, 0] if mirrored else squares[:, 0]
    # Corners lie between pixels; OpenCV finds them to a tenth of a pixel.
    np.testing.assert_allclose(view.pixels, np.stack([x, squares[:, 1]], axis=1), atol=0.6)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize(("columns", "rows"), [(5, 4), (4, 4), (4, 5), (5, 5)])
def test_a_board_of_opencv_before_4_6_is_found(columns: int, rows: int, inverted: bool) -> None:
    """With an even number of rows it begins with a marker; with an odd one it is as today."""
    find = BoardFinder(parse_board(f"charuco:{columns}x{rows}:0.05:0.0375:DICT_4X4_50"))
    older = Charuco(columns, rows, 0.05, 0.0375, "DICT_4X4_50", is_legacy=True)
    view = find(_picture(board=older, inverted=inverted))
    assert view is not None
    assert len(view.numbers) == (columns - 1) * (rows - 1)
    np.testing.assert_allclose(view.pixels, older.corners()[view.numbers][:, :2] / 0.05 * 100 + 60, atol=0.6)
    assert ("before 4.6" in str(find.board)) == (rows % 2 == 0)
    newer = replace(older, is_legacy=False)
    assert (find(_picture(board=newer, inverted=inverted)) is not None) == (rows % 2 == 1), "one sight tells"


def test_the_middle_of_a_board_tells_no_pattern() -> None:
    """It fits both, a square apart; the first sight of an edge tells, and sights of the whole board are not lost."""
    older = Charuco(11, 8, 0.05, 0.0375, "DICT_4X4_50", is_legacy=True)
    whole = _picture(board=older)
    find = BoardFinder(replace(older, is_legacy=False))
    assert find(whole[160:760, 260:960]) is not None
    assert not find.is_sure
    view = find(whole)
    assert view is not None
    assert find.is_sure
    assert find.board == older
    assert len(view.numbers) == 70


@pytest.mark.parametrize(
    ("shown", "word"),
    [
        (Charuco(4, 6, 0.05, 0.0375, "DICT_4X4_50"), "its markers are seen, but not as a board of 5 x 4"),
        (Charuco(5, 4, 0.05, 0.0375, "DICT_5X5_50"), "markers of DICT_5X5_1000 are seen, not of DICT_4X4_50"),
        (Charuco(5, 4, 0.05, 0.0375, "DICT_APRILTAG_36h11"), "markers of DICT_APRILTAG_36h11 are seen"),
        (None, "and its dictionary of markers, or show it"),
    ],
)
def test_what_is_seen_of_a_board_that_is_not_found_is_named(shown: Charuco | None, word: str) -> None:
    picture = np.full((400, 500, 3), 128, np.uint8) if shown is None else _picture(board=shown)
    board = parse_board(BOARD)
    assert BoardFinder(board)(picture) is None
    assert word in board.why_unseen([picture])


@pytest.mark.parametrize("turns", [0, 1, 2, 3])
def test_a_chessboard_s_corners_are_the_same_however_it_is_turned(turns: int) -> None:
    board = parse_board("chessboard:6x5:0.04")
    squares = np.indices((5, 6)).sum(axis=0) % 2 * 200 + 20
    drawn = np.kron(squares, np.ones((40, 40))).astype(np.uint8)
    picture = np.rot90(np.pad(drawn, 60, constant_values=220), turns)
    view = BoardFinder(board)(np.repeat(np.ascontiguousarray(picture)[..., None], 3, axis=2))
    assert view is not None
    seen = view.pixels - np.array(picture.shape[::-1]) / 2
    turned = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), turns) @ seen.T
    places = board.corners()[:, :2] / 0.04 * 40 - [80, 60]
    np.testing.assert_allclose(turned.T, places, atol=0.2)  # a tenth of a pixel on each side


@pytest.mark.parametrize(
    "text",
    [
        "chessboard:6x6:0.04",
        "chessboard:6x5",
        "chessboard:6x5:0",
        "chessboard:6x5:40",
        "charuco:5x4:5:3.75",
        "charuco:5x4:1",
        "charuco:5x4:0.03:0.05",
        "charuco:9x9:0.05:0.03:DICT_NONE",
        "x",
    ],
)
def test_a_board_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="`board`"):
        parse_board(text)


def _sights(*, mirrored: bool = False) -> tuple[dict[int, dict[int, BoardView]], list[np.ndarray]]:
    """Exact sights of a moving board by three cameras; the last one's video mirrored or not."""
    corners, draw = parse_board(BOARD).corners(), np.random.default_rng(3)
    poses = [np.array([0, turn, 0, -turn, 0, 0.1 * turn]) for turn in (0.0, 0.4, -0.5)]
    views: dict[int, dict[int, BoardView]] = {0: {}, 1: {}, 2: {}}
    for instant in range(12):
        board = np.concatenate([draw.uniform(-0.5, 0.5, 3), draw.uniform(-0.1, 0.1, 2), [0.8]])
        for number, pose in enumerate(poses):
            parts = [part.reshape(3, 1) for part in (board[:3], board[3:], pose[:3], pose[3:])]
            pixels = LENS.project(*cv2.composeRT(*parts)[:2], corners)[0] + 0.5
            if mirrored and number == 2:
                pixels[:, 0] = 640 - pixels[:, 0]
            views[number][instant] = BoardView(np.arange(len(corners)), pixels, mirrored and number == 2)
    return views, poses


def test_cameras_are_placed_by_exact_sights() -> None:
    views, poses = _sights()
    rig = place_by_board(dict.fromkeys(range(3), LENS), views, parse_board(BOARD).corners())
    assert set(rig.poses) == {0, 1, 2}
    seen = LENS.project(np.zeros(3), np.zeros(3), rig.points)[0] + 0.5  # the world is the first camera's
    np.testing.assert_allclose(seen, np.concatenate([view.pixels for view in views[0].values()]), atol=0.05)
    for number, pose in enumerate(poses):
        # Sights are exact; what remains is where the steps end.
        np.testing.assert_allclose(np.concatenate(rig.poses[number]), pose, atol=1e-4)


def test_a_fisheye_is_told_from_other_lenses_by_exact_sights() -> None:
    lens = Lens("fisheye", (260.0, 265.0), (325.0, 236.0), (0.05, 0.01, 0.0, 0.0))
    corners, draw, views = parse_board(BOARD).corners(), np.random.default_rng(3), list[BoardView]()
    while len(views) < 8:
        place = np.append(draw.uniform(-0.4, 0.2, 2), 0.2)
        pixels = lens.project(draw.uniform(-0.4, 0.4, 3), place, corners)[0] + 0.5
        if (pixels > 0).all() and (pixels < (640, 480)).all():
            views.append(BoardView(np.arange(len(corners)), pixels, False))
    found = lens_from_board(views, corners, (640, 480))
    assert found is not None
    assert found.kind == "fisheye"
    # Sights are exact, but in single precision.
    assert (*found.focal, *found.centre) == pytest.approx((*lens.focal, *lens.centre), abs=0.01)
    assert found.distortion == pytest.approx(lens.distortion, abs=1e-3)


def test_a_mirrored_video_is_not_placed() -> None:
    views, _ = _sights(mirrored=True)
    rig = place_by_board(dict.fromkeys(range(3), LENS), views, parse_board(BOARD).corners())
    assert set(rig.poses) == {0, 1}
    assert rig.inconsistent == (2,)
