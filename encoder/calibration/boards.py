"""A ChArUco board and where cameras see it; printed inverted, or seen mirrored, as from its back through glass.

A flat board seen from behind is the same plane of points: corners found in the flipped picture and turned back are
where those points are. A video that is itself mirrored looks the same, but fits no other camera while the board moves.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from decogs.formats.errors import UsageError

from .features import F64, I64
from .footage import U8

MIN_CORNERS = 6
"""Of one view of the board: below, a pose from them is a guess."""
_PATTERN = re.compile(
    r"charuco:([0-9]{1,3})x([0-9]{1,3}):([0-9.]{1,12}):([0-9.]{1,12})(?::([A-Z0-9_]{1,40}))?", re.ASCII
)
_DICTIONARY = "DICT_4X4_1000"


@dataclass(frozen=True)
class Board:
    """A ChArUco board: squares along its sides, sides of a square and a marker in metres, OpenCV's dictionary."""

    columns: int
    rows: int
    square: float
    marker: float
    dictionary: str

    def corners(self) -> F64:
        """Places (N, 3) of the inner corners on the board, metres."""
        return np.asarray(self._made().getChessboardCorners(), np.float64)

    def detector(self) -> Any:
        """OpenCV's detector of it."""
        return cv2.aruco.CharucoDetector(self._made())

    def _made(self) -> Any:
        words = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        return cv2.aruco.CharucoBoard((self.columns, self.rows), self.square, self.marker, words)


@dataclass(frozen=True)
class BoardView:
    """One sight of the board: corners' numbers (N,), pixels (N, 2) from the picture's corner, whether mirrored."""

    numbers: I64
    pixels: F64
    mirrored: bool


def parse_board(text: str) -> Board:
    """``charuco:COLSxROWS:SQUARE:MARKER[:DICT]``. Raises UsageError, naming what is wrong."""
    match = _PATTERN.fullmatch(text)
    if match is None:
        raise UsageError(
            f"`board` {text!r}: expected charuco:COLSxROWS:SQUARE:MARKER[:DICT], such as "
            f"charuco:4x5:0.054:0.0405:{_DICTIONARY}"
        )
    try:
        square, marker = float(match[3]), float(match[4])
    except ValueError:
        raise UsageError(f"`board` {text!r}: squares and markers are lengths in metres, such as 0.054") from None
    columns, rows, dictionary = int(match[1]), int(match[2]), match[5] or _DICTIONARY
    if min(columns, rows) < 3:
        raise UsageError(f"`board` {text!r}: needs at least 3 x 3 squares")
    if not 0 < marker < square:
        raise UsageError(f"`board` {text!r}: a marker is smaller than its square; give SQUARE, then MARKER, in metres")
    if not (dictionary.startswith("DICT_") and hasattr(cv2.aruco, dictionary)):
        raise UsageError(f"`board` {text!r}: OpenCV has no dictionary {dictionary}; give one such as {_DICTIONARY}")
    if len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList) < columns * rows // 2:
        raise UsageError(f"`board` {text!r}: {dictionary} has too few markers for {columns} x {rows} squares")
    return Board(columns, rows, square, marker, dictionary)


class BoardFinder:
    """Finds a board in pictures; remembers whether its print is inverted, which one sight of it tells."""

    def __init__(self, board: Board) -> None:
        self._detector = board.detector()
        self._prints = [False, True]

    def __call__(self, picture: U8) -> BoardView | None:
        """The board in a picture (H, W, 3); None where fewer than 6 of its corners are found."""
        grey = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), np.uint8)
        for inverted in self._prints:
            for mirrored in (False, True):
                view = self._found(255 - grey if inverted else grey, mirrored)
                if view is not None:
                    self._prints = [inverted]
                    return view
        return None

    def _found(self, grey: U8, mirrored: bool) -> BoardView | None:
        seen = np.ascontiguousarray(grey[:, ::-1]) if mirrored else grey
        corners, numbers, _, _ = self._detector.detectBoard(seen)
        if numbers is None or len(numbers) < MIN_CORNERS:
            return None
        pixels = corners.reshape(-1, 2).astype(np.float64) + 0.5
        if mirrored:
            pixels[:, 0] = grey.shape[1] - pixels[:, 0]
        return BoardView(numbers.ravel().astype(np.int64), pixels, mirrored)


def board_views(pictures: Iterable[U8], find: BoardFinder) -> dict[int, BoardView]:
    """Where one camera sees the board, by the number of the instant."""
    found = ((number, find(picture)) for number, picture in enumerate(pictures))
    return {number: view for number, view in found if view is not None}
