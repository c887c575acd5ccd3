"""A board and where cameras see it; printed inverted, or, a ChArUco, seen mirrored, as from its back through glass.

A ChArUco with an even number of rows begins with a dark square since OpenCV 4.6, with a marker before, and as calib.io
sells it (opencv/opencv_contrib#3291): either is found.

A flat board seen from behind is the same plane of points: corners found in the flipped picture and turned back are
where those points are. A video that is itself mirrored looks the same, but fits no other camera while the board moves.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, ClassVar, Protocol

import cv2
import numpy as np

from decogs.formats.errors import UsageError

from .features import F64, I64
from .footage import U8

MIN_CORNERS = 6
"""Of one view of the board: below, a pose from them is a guess."""
_CHARUCO = re.compile(
    r"charuco:([0-9]{1,3})x([0-9]{1,3}):([0-9.]{1,12}):([0-9.]{1,12})(?::([A-Z0-9_]{1,40}))?", re.ASCII
)
_CHESSBOARD = re.compile(r"chessboard:([0-9]{1,3})x([0-9]{1,3}):([0-9.]{1,12})", re.ASCII)
_DICTIONARY = "DICT_4X4_1000"
_FAMILIES = (
    *(f"DICT_{n}X{n}_1000" for n in (4, 5, 6, 7)), "DICT_ARUCO_ORIGINAL", "DICT_ARUCO_MIP_36h12",
    *(f"DICT_APRILTAG_{kind}" for kind in ("16h5", "25h9", "36h10", "36h11")),
)  # fmt: skip
"""OpenCV's dictionaries of markers; those of 50 to 250 words are beginnings of those of 1000."""
_MIN_MARKERS = 4
"""Of one dictionary, in one picture: fewer are seen where none is."""
_MAX_SQUARE = 1.0
"""Metres: no print has larger ones, and whoever states millimetres, centimetres or inches states more."""
_WINDOW = 0.25
"""Of the distance of two corners: half the side of the window that a chessboard's corner is refined in. On the photos
of `quartet_4cam` corners are exact to .17 pixels; in OpenCV's usual 11 pixels to .2."""
_WITHIN = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 50, 1e-3)

Corners = tuple[I64, F64]
"""Numbers (N,) of corners, and their pixels (N, 2), from the centre of the first pixel."""


class Board(Protocol):
    """A flat board with corners of known place. ``is_chiral``: a sight of it tells whether it is mirrored."""

    is_chiral: ClassVar[bool]

    def patterns(self) -> Sequence[Board]:
        """The boards that are described alike, and have their corners in the same places."""
        ...

    def corners(self) -> F64:
        """Places (N, 3) of the inner corners on the board, metres."""
        ...

    def find_corners(self, grey: U8) -> Corners | None:
        """The corners that a picture (H, W) shows."""
        ...

    def why_unseen(self, pictures: Iterable[U8]) -> str:
        """What to check where none of the pictures (H, W, 3) shows its corners."""
        ...


@dataclass(frozen=True)
class Charuco:
    """A ChArUco board: squares along its sides, sides of a square and a marker in metres, OpenCV's dictionary.

    ``is_legacy``: begins with a marker, as boards with an even number of rows did before OpenCV 4.6.
    """

    is_chiral: ClassVar[bool] = True
    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str
    is_legacy: bool = False

    def __str__(self) -> str:
        return "ChArUco board" + (", pattern of OpenCV before 4.6" if self.is_legacy else "")

    def patterns(self) -> Sequence[Board]:
        """As described, and, where the number of rows is even, as OpenCV before 4.6 has it."""
        return (self,) if self.rows % 2 else (self, replace(self, is_legacy=True))

    def corners(self) -> F64:
        """Places (N, 3) of the inner corners on the board, metres."""
        return np.asarray(self.made().getChessboardCorners(), np.float64)

    def find_corners(self, grey: U8) -> Corners | None:
        """The corners that a picture (H, W) shows, whichever part of the board is in it."""
        # A detector for each call takes microseconds, and none is shared by threads.
        corners, numbers, _, _ = cv2.aruco.CharucoDetector(self.made()).detectBoard(grey)
        return None if numbers is None else (numbers.ravel().astype(np.int64), np.asarray(corners.reshape(-1, 2)))

    def why_unseen(self, pictures: Iterable[U8]) -> str:
        """Whether the pictures show its markers elsewhere on a board, or those of another dictionary, or none."""
        for picture in pictures:
            grey = cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)
            seen = {family: self._markers(grey, family) for family in _FAMILIES}
            family = max(seen, key=seen.__getitem__)
            if seen[family] < _MIN_MARKERS:
                continue
            if self.dictionary.startswith(family.removesuffix("_1000")):
                return (
                    f"its markers are seen, but not as a board of {self.columns} x {self.rows} squares has them; check "
                    "how many it has along each side, columns first"
                )
            return f"markers of {family} are seen, not of {self.dictionary}; state the dictionary of its markers"
        return "check how many squares it has along each side, and its dictionary of markers, or show it to the cameras"

    def _markers(self, grey: Any, dictionary: str) -> int:
        """How many markers a picture shows that a board of so many squares has."""
        words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary))
        numbers = cv2.aruco.ArucoDetector(words).detectMarkers(grey)[1]
        return 0 if numbers is None else len({n for n in numbers.ravel().tolist() if n < self.columns * self.rows // 2})

    def made(self) -> Any:
        """OpenCV's board."""
        words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, words)
        board.setLegacyPattern(self.is_legacy)
        return board


@dataclass(frozen=True)
class Chessboard:
    """A chessboard: squares along its sides, and the side of a square in metres. A picture shows all of it or none.

    Its first corner is the one at a dark square of the outermost, where there are dark ones at one end only.
    """

    is_chiral: ClassVar[bool] = False
    columns: int
    rows: int
    square: float

    def __str__(self) -> str:
        return "chessboard"

    def patterns(self) -> Sequence[Board]:
        """This one."""
        return (self,)

    def why_unseen(self, pictures: Iterable[U8]) -> str:
        """Nothing on it tells."""
        return "check how many squares it has along each side, or show all of it to the cameras"

    def corners(self) -> F64:
        """Places (N, 3) of the inner corners on the board, metres."""
        rows, columns = np.mgrid[: self.rows - 1, : self.columns - 1]
        return np.stack([columns.ravel(), rows.ravel(), np.zeros(rows.size)], axis=1) * self.square

    def find_corners(self, grey: U8) -> Corners | None:
        """The corners that a picture (H, W) shows; counted as seen from the board's front."""
        seen, corners = cv2.findChessboardCorners(grey, (self.columns - 1, self.rows - 1))
        if not seen:
            return None
        shape = self.rows - 1, self.columns - 1, 2
        grid = np.asarray(corners, np.float64).reshape(shape)
        apart = min(np.linalg.norm(np.diff(grid, axis=k), axis=2).min() for k in (0, 1))
        window = max(2, int(_WINDOW * apart))
        corners = cv2.cornerSubPix(grey, corners, (window, window), (-1, -1), _WITHIN)
        grid = np.asarray(corners, np.float64).reshape(shape)
        across, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
        if across[0] * down[1] < across[1] * down[0]:
            grid = grid[:, ::-1]
        if _beyond(grey, grid) > _beyond(grey, grid[::-1, ::-1]):
            grid = grid[::-1, ::-1]
        return np.arange(grid[..., 0].size), grid.reshape(-1, 2)


def _beyond(grey: U8, grid: F64) -> float:
    """Brightness of the square beyond the first corner of a grid (R, C, 2)."""
    x, y = 1.5 * grid[0, 0] - 0.5 * grid[1, 1]
    rows, columns = grey.shape
    return float(grey[int(np.clip(y, 0, rows - 1)), int(np.clip(x, 0, columns - 1))])


@dataclass(frozen=True)
class BoardView:
    """One sight of the board: corners' numbers (N,), pixels (N, 2) from the picture's corner, whether mirrored."""

    numbers: I64
    pixels: F64
    mirrored: bool


def parse_board(text: str) -> Board:
    """``charuco:COLSxROWS:SQUARE:MARKER[:DICT]`` or ``chessboard:COLSxROWS:SQUARE``; both count squares.

    Raises UsageError, naming what is wrong.
    """
    charuco, chessboard = _CHARUCO.fullmatch(text), _CHESSBOARD.fullmatch(text)
    match = charuco or chessboard
    if match is None:
        raise UsageError(
            f"`board` {text!r}: expected charuco:COLSxROWS:SQUARE:MARKER[:DICT], such as "
            f"charuco:4x5:0.054:0.0405:{_DICTIONARY}, or chessboard:COLSxROWS:SQUARE"
        )
    columns, rows = int(match[1]), int(match[2])
    if min(columns, rows) < 3:
        raise UsageError(f"`board` {text!r}: needs at least 3 x 3 squares")
    try:
        lengths = [float(length) for length in match.groups()[2:4]]
    except ValueError:
        raise UsageError(f"`board` {text!r}: squares and markers are lengths in metres, such as 0.054") from None
    if lengths[0] >= _MAX_SQUARE:
        raise UsageError(f"`board` {text!r}: squares of {lengths[0]:g} metres; give lengths in metres, such as 0.054")
    if charuco is None:
        return _chessboard(text, columns, rows, lengths[0])
    return _charuco(text, columns, rows, lengths[0], lengths[1], charuco[5] or _DICTIONARY)


def _chessboard(text: str, columns: int, rows: int, square: float) -> Chessboard:
    if square <= 0:
        raise UsageError(f"`board` {text!r}: the side of a square is a length in metres, such as 0.054")
    if (columns + rows) % 2 == 0:
        raise UsageError(
            f"`board` {text!r}: {columns} x {rows} squares look the same turned by half; use a board with an odd "
            "number of squares along one side and an even one along the other, all squares counted"
        )
    return Chessboard(columns, rows, square)


def _charuco(text: str, columns: int, rows: int, square: float, marker: float, dictionary: str) -> Charuco:
    if not 0 < marker < square:
        raise UsageError(f"`board` {text!r}: a marker is smaller than its square; give SQUARE, then MARKER, in metres")
    if not (dictionary.startswith("DICT_") and hasattr(cv2.aruco, dictionary)):
        raise UsageError(f"`board` {text!r}: OpenCV has no dictionary {dictionary}; give one such as {_DICTIONARY}")
    if len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList) < columns * rows // 2:
        raise UsageError(f"`board` {text!r}: {dictionary} has too few markers for {columns} x {rows} squares")
    return Charuco(columns, rows, square, marker, dictionary)


class BoardFinder:
    """Finds a board in pictures; remembers which pattern it has and whether its print is inverted.

    ``board``: the one that was seen. One sight tells, as a rule; but the middle of a ChArUco board fits both patterns,
    with a square between them. Then both are kept, and the first is taken until another shows more corners.
    """

    def __init__(self, board: Board) -> None:
        self.board = board
        self._prints = [(each, inverted, 0) for each, inverted in product(board.patterns(), (False, True))]

    @property
    def is_sure(self) -> bool:
        """Whether it has seen the board, and nothing else fits."""
        return len(self._prints) == 1

    def __call__(self, picture: U8) -> BoardView | None:
        """The board in a picture (H, W, 3); None where fewer than 6 of its corners are found."""
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)
        views = [_either_way(board, 255 - grey if inverted else grey) for board, inverted, _ in self._prints]
        if self.is_sure:
            return views[0]
        counts = [
            count + (0 if view is None else len(view.numbers))
            for (*_, count), view in zip(self._prints, views, strict=True)
        ]
        best = [k for k, count in enumerate(counts) if count == max(counts)]
        self._prints = [(*self._prints[k][:2], counts[k]) for k in best]
        self.board = self._prints[0][0]
        return views[best[0]]


def _either_way(board: Board, grey: U8) -> BoardView | None:
    ways = (_view(board, grey, mirrored) for mirrored in ((False, True) if board.is_chiral else (False,)))
    return next((view for view in ways if view is not None), None)


def _view(board: Board, grey: U8, mirrored: bool) -> BoardView | None:
    corners = board.find_corners(np.ascontiguousarray(grey[:, ::-1]) if mirrored else grey)
    if corners is None or len(corners[0]) < MIN_CORNERS:
        return None
    pixels = corners[1] + 0.5
    if mirrored:
        pixels[:, 0] = grey.shape[1] - pixels[:, 0]
    return BoardView(corners[0], pixels.astype(np.float64), mirrored)


def board_views(pictures: Iterable[U8], find: BoardFinder) -> dict[int, BoardView]:
    """Where one camera sees the board, by the number of the instant."""
    views = ((number, find(picture)) for number, picture in enumerate(pictures))
    return {number: view for number, view in views if view is not None}
