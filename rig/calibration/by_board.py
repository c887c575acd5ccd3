"""Lenses, and cameras, by a board that moves through the take."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, repeat

import cv2
import numpy as np

from decogs.formats.errors import UsageError

from ..parallel import Each
from .board_rig import BoardRig, place_by_board
from .boards import Board, BoardFinder, BoardView, board_views
from .features import F64
from .footage import Footage, instants_of, pictures_at
from .given import Given
from .lenses import Lens, board_error, focal_deviation, focal_that_fits, lens_from_board
from .placed import MAX_ERROR, Calibration, OnStep, Placed, inaccurate

_INSTANTS = 120
_UNSEEN = 4
"""Frames of each camera, at least, that are asked for other markers where none shows the board."""
_MAX_FOCAL_DEVIATION, _NAMED_FOCAL_DEVIATION = 0.02, 0.01
"""Of a focal length that a board gave, as its share: what is left out, and what is named. On `desk_charuco_4cam`, where
the board is in the middle of the pictures, deviations of .002, .015 and .016 come with focal lengths off by 1 to 3 %,
and .044 with one off by 16 %."""
_MAX_OFF = 0.3
"""Share of a camera's sights with too large an error, which do not count: of one that is knocked in the middle of a
take a half, of the webcam of `desk_charuco_4cam` that is most out of step .7, of the others .2."""
_STILL = "hold the board and the camera still, and synchronise the videos"
_CONTRADICTED = 1.2
"""Times the least error that a given lens may have. Lenses from other takes have up to 1.02 of it on
`desk_charuco_4cam`; with a focal length 5 % off, 1.27 where the board is seen well, 1.02 where it is far and flat."""


@dataclass(frozen=True)
class BoardLenses:
    """Sights of the board by camera and instant, lenses with their errors, px, why others have none, and doubts.

    ``way``: the board that was seen, in words.
    """

    views: Mapping[int, Mapping[int, BoardView]]
    lenses: Mapping[int, Lens]
    errors: Mapping[int, float]
    reasons: Mapping[int, str]
    doubts: Mapping[int, str]
    way: str


def lenses_by_board(
    footage: Sequence[Footage], board: Board, frames: int | None, given: Given | None, each: Each, on_step: OnStep
) -> BoardLenses:
    """Each camera's lens from its own sights of the board, or the given one, which these must not contradict.

    Raises UsageError where no camera sees such a board.
    """
    find, corners, instants = BoardFinder(board), board.corners(), instants_of(footage, frames or _INSTANTS)

    def looked_at(camera: Footage) -> Mapping[int, BoardView]:
        return board_views(pictures_at(camera, instants), find)

    seen_boards: list[Mapping[int, BoardView]] = []
    while not find.is_sure and len(seen_boards) < len(footage):  # the first that sees it tells what print it is
        seen_boards.append(looked_at(footage[len(seen_boards)]))
        on_step(len(seen_boards), len(footage))
    if find.board != board:
        seen_boards = []  # of which some may be taken for those of the first pattern
    for seen in each(looked_at, footage[len(seen_boards) :]):
        seen_boards.append(seen)
        on_step(len(seen_boards), len(footage))
    views = dict(enumerate(seen_boards))
    if not any(views.values()):
        some = instants[:: max(1, len(instants) // _UNSEEN)]
        word = board.why_unseen(picture for camera in footage for picture in pictures_at(camera, some))
        raise UsageError(f"`board`: no camera shows it in {len(instants)} frames looked at; {word}")
    every = [list(seen.values()) for seen in seen_boards]
    sizes = [camera.size for camera in footage]
    own = [(lens, "") for lens in given.lenses] if given is not None else each(_own_lens, every, repeat(corners), sizes)
    lenses: dict[int, Lens] = {}
    reasons: dict[int, str] = {}
    doubts: dict[int, str] = {}
    for number, (lens, word) in enumerate(own):
        if lens is None or not every[number]:
            few = f"sees the board in {len(every[number])} of {len(instants)} frames looked at"
            reasons[number] = word or f"{few}; show it the board more often"
        else:
            lenses[number] = lens
            doubts |= {number: word} if word else {}
    sights = {number: every[number] for number in lenses}
    if given is not None and (misfits := _misfits(given, sights, corners)):
        raise given.contradicted(footage, misfits)
    errors = {number: board_error(lens, sights[number], corners) for number, lens in lenses.items()}
    return BoardLenses(views, lenses, errors, reasons, doubts, str(find.board))


def _own_lens(views: Sequence[BoardView], corners: F64, size: tuple[int, int]) -> tuple[Lens | None, str]:
    """A camera's lens, and a doubt of it; without a lens, why, where anything but the number of views is wrong."""
    lens = lens_from_board(views, corners, size)
    if lens is None or lens.kind == "fisheye":  # of which OpenCV does not tell the deviation
        return lens, ""
    deviation = focal_deviation(views, corners, size)
    certainty = f"known to {100 * deviation:.1f} % only" if np.isfinite(deviation) else "not known"
    doubt = f"its focal length is {certainty}; show it the board tilted, and all over its picture"
    if deviation > _MAX_FOCAL_DEVIATION:
        return None, doubt
    return lens, doubt if deviation > _NAMED_FOCAL_DEVIATION else ""


def _misfits(given: Given, sights: Mapping[int, Sequence[BoardView]], corners: F64) -> dict[int, float]:
    """Focal lengths, px, that fit clearly better than those given."""
    fits = {number: focal_that_fits(given.lenses[number], views, corners) for number, views in sights.items()}
    return {
        number: focal
        for number, (focal, error) in fits.items()
        if not given.fits(number, focal)
        and error * _CONTRADICTED < board_error(given.lenses[number], sights[number], corners)
    }


def place_with_board(
    footage: Sequence[Footage], board: Board, frames: int | None, given: Given | None, each: Each, on_step: OnStep
) -> Calibration:
    """Cameras that see the board together, in metres."""
    lenses = lenses_by_board(footage, board, frames, given, each, on_step)
    rig, left_out = _placed_accurately(lenses.lenses, lenses.views, board.corners(), footage)
    reasons = {**lenses.reasons, **left_out}
    placed = []
    for number in sorted(rig.poses):
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rig.poses[number][0])[0], rig.poses[number][1]
        camera = lenses.lenses[number].camera(footage[number].name, footage[number].size, pose)
        placed.append(Placed(camera, rig.errors[number], footage[number]))
    for number in range(len(footage)):
        if number not in rig.poses and number not in reasons:
            reasons[number] = _disconnected(lenses.views[number], number in rig.inconsistent)
    names = [one.name for one in footage]
    doubts = {number: doubt for number, doubt in lenses.doubts.items() if number in rig.poses}
    for number, off in rig.sights.items():
        share = float((off > MAX_ERROR * footage[number].size[0]).mean())
        if share > _MAX_OFF:
            doubts.setdefault(number, f"{share:.0%} of its sights of the board are off; {_STILL}")
    common = {
        pair: len(lenses.views[pair[0]].keys() & lenses.views[pair[1]].keys())
        for pair in combinations(sorted(rig.poses), 2)
    }
    return Calibration(
        tuple(placed),
        {names[number]: reasons[number] for number in sorted(reasons)},
        lenses.way,
        "metre",
        {names[number]: doubt for number, doubt in sorted(doubts.items())},
        {(names[a], names[b]): count for (a, b), count in common.items() if count},
        rig.points,
    )


def _placed_accurately(
    lenses: Mapping[int, Lens],
    views: Mapping[int, Mapping[int, BoardView]],
    corners: F64,
    footage: Sequence[Footage],
    place: Callable[..., BoardRig] = place_by_board,
) -> tuple[BoardRig, dict[int, str]]:
    """Cameras placed by the board, without those whose error is too large: the worst is left out, the rest placed anew.

    Also why those were left out, by number.
    """
    left_out: dict[int, str] = {}
    while True:
        rig = place({number: lenses[number] for number in lenses if number not in left_out}, views, corners)
        excess = {number: error / (MAX_ERROR * footage[number].size[0]) for number, error in rig.errors.items()}
        worst = max(excess, key=lambda number: excess[number], default=None)
        if worst is None or excess[worst] <= 1:
            return rig, left_out
        left_out[worst] = inaccurate(rig.errors[worst], _STILL)


def _disconnected(views: Mapping[int, BoardView], inconsistent: bool) -> str:
    """Why the board does not place a camera whose lens is known."""
    if inconsistent and any(view.mirrored for view in views.values()):
        return "sees the board mirrored, where other cameras do not have it; is its video mirrored?"
    if inconsistent:
        return "sees the board elsewhere than other cameras at the same frame; synchronise the videos"
    return "never sees the board together with a placed camera; hold it where both see it"
