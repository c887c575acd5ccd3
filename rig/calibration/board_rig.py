"""Cameras by a board that moves through the take: poses over pairs that see it at once, then all poses adjusted.

Lenses are those that each camera's own views gave, and stay: of webcams, which are milliseconds out of step, an
adjustment with free lenses bends these to make up for it (`desk_charuco_4cam`: worst camera 6 to 13 degrees off, not
3.4).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from .boards import BoardView
from .features import F64
from .lenses import Lens

_STEPS = 30
_SIGHT_PIXELS = 0.3
"""Error of a sight from which it counts half: OpenCV's corners are as exact. Cameras that are out of step disagree
about a board that moves."""
_CONVERGED = 1e-7
"""Relative decrease of the cost at which the adjustment ends."""
_MIN_COMMON = 3
"""Instants at which two cameras have to see the board."""
_AGREES_DEGREES = 5.0
"""Within which poses of two cameras from single sights of the board agree: a small far board is that uncertain."""
_MIN_AGREEING = 0.5
"""Share of the common instants that has to agree; of a mirrored video or cameras out of step few do."""

Pose = tuple[F64, F64]
"""Rotation vector (3,) and translation (3,)."""


@dataclass(frozen=True)
class BoardRig:
    """Placed cameras: poses from the world to the camera, and the RMS error of each, px, by number.

    An error is of the sights that count. ``sights``: how far each one is off (RMS, px). ``inconsistent``: numbers of
    cameras that see the board with others, but not where these see it. ``points`` (P, 3): where its corners were.
    """

    poses: Mapping[int, Pose]
    errors: Mapping[int, float]
    inconsistent: tuple[int, ...]
    sights: Mapping[int, F64] = field(default_factory=dict)
    points: F64 = field(default_factory=lambda: np.zeros((0, 3)))


def place_by_board(
    lenses: Mapping[int, Lens],
    views: Mapping[int, Mapping[int, BoardView]],
    corners: F64,
) -> BoardRig:
    """Places the cameras that share sights of the board with one another.

    ``views``: by camera and instant. The world is that of the first camera placed.
    """
    sights = _sights(lenses, views, corners)
    links, doubtful = _links(sights)
    tree = _tree(links, sights)
    poses = {camera: pose for camera, pose in tree.items() if camera in sights}
    inconsistent = tuple(sorted(camera for camera in doubtful if camera not in poses))
    if len(poses) < 2:
        return BoardRig({}, {}, inconsistent)
    state = _State(dict(lenses), poses, _boards(poses, sights))
    observed = {
        (camera, instant): views[camera][instant]
        for camera in poses
        for instant in sights[camera]
        if instant in state.boards
    }
    state = _adjusted(state, observed, corners)
    points = [corners @ cv2.Rodrigues(board[0])[0].T + board[1] for board in state.boards.values()]
    errors, off = _errors(state, observed, corners), _sight_errors(state, observed, corners)
    return BoardRig(state.poses, errors, inconsistent, off, np.concatenate(points))


def _sights(
    lenses: Mapping[int, Lens], views: Mapping[int, Mapping[int, BoardView]], corners: F64
) -> dict[int, dict[int, Pose]]:
    """Poses of the board before each camera, by camera and instant."""
    sights: dict[int, dict[int, Pose]] = {}
    for camera, lens in lenses.items():
        poses = {instant: lens.pose(corners[v.numbers], v.pixels - 0.5) for instant, v in views[camera].items()}
        sights[camera] = {instant: pose for instant, pose in poses.items() if pose is not None}
    return sights


def _links(sights: Mapping[int, Mapping[int, Pose]]) -> tuple[dict[tuple[int, int], tuple[int, Pose]], set[int]]:
    """For pairs of cameras: at how many instants they agree, and the second's pose from the first.

    Also the cameras of pairs that see the board together, but do not agree.
    """
    links: dict[tuple[int, int], tuple[int, Pose]] = {}
    doubtful: set[int] = set()
    for one in sights:
        for two in sights:
            common = sorted(sights[one].keys() & sights[two].keys())
            if one >= two or len(common) < _MIN_COMMON:
                continue
            relative = [_composed(_inverse(sights[one][i]), sights[two][i]) for i in common]
            angles = _angles(np.array([pose[0] for pose in relative]))
            middle = int(np.median(angles, axis=1).argmin())
            agreeing = int((angles[middle] < _AGREES_DEGREES).sum())
            if agreeing < max(_MIN_COMMON, _MIN_AGREEING * len(common)):
                doubtful |= {one, two}
            else:
                links[one, two] = agreeing, relative[middle]
    return links, doubtful


def _angles(rotations: F64) -> F64:
    """Degrees (N, N) between rotation vectors (N, 3)."""
    matrices = np.stack([cv2.Rodrigues(rotation)[0] for rotation in rotations])
    cosines = (np.einsum("aij,bij->ab", matrices, matrices) - 1) / 2
    return np.asarray(np.degrees(np.arccos(np.clip(cosines, -1, 1))))


def _tree(
    links: Mapping[tuple[int, int], tuple[int, Pose]], sights: Mapping[int, Mapping[int, Pose]]
) -> dict[int, Pose]:
    """Poses of the largest group of linked cameras, over the links of most instants (Prim)."""
    best: dict[int, Pose] = {}
    for start in sights:
        if start in best:
            continue
        placed: dict[int, Pose] = {start: (np.zeros(3), np.zeros(3))}
        while True:
            leading = [
                (count, one, two) for (one, two), (count, _) in links.items() if (one in placed) != (two in placed)
            ]
            if not leading:
                break
            _, one, two = max(leading, key=lambda link: (link[0], -link[1], -link[2]))
            relative = links[one, two][1]
            if one in placed:
                placed[two] = _composed(placed[one], relative)
            else:
                placed[one] = _composed(placed[two], _inverse(relative))
        best = placed if len(placed) > len(best) else best
    return best


def _boards(poses: Mapping[int, Pose], sights: Mapping[int, Mapping[int, Pose]]) -> dict[int, Pose]:
    """The board's pose in the world at each instant, by the first camera that sees it."""
    boards: dict[int, Pose] = {}
    for camera in poses:
        for instant, sight in sights[camera].items():
            boards.setdefault(instant, _composed(sight, _inverse(poses[camera])))
    return boards


def _composed(first: Pose, second: Pose) -> Pose:
    """One motion after another."""
    rotation, translation = cv2.composeRT(*(part.reshape(3, 1) for part in (*first, *second)))[:2]
    return np.asarray(rotation, np.float64).ravel(), np.asarray(translation, np.float64).ravel()


def _inverse(pose: Pose) -> Pose:
    rotation = cv2.Rodrigues(pose[0])[0]
    return -pose[0], -rotation.T @ pose[1]


# --- bundle adjustment ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _State:
    """Lenses and poses by camera, poses of the board by instant."""

    lenses: Mapping[int, Lens]
    poses: Mapping[int, Pose]
    boards: Mapping[int, Pose]


def _adjusted(state: _State, observed: Mapping[tuple[int, int], BoardView], corners: F64) -> _State:
    """Levenberg-Marquardt over poses of cameras and boards; the first camera stays in place.

    Sights that do not fit count less (Cauchy's loss of their mean squared residual). Normal equations are summed sight
    by sight, since each knows one camera and one board.
    """
    places, count = _places(state)
    damping, cost = 1e-3, _cost(state, observed, corners)
    for _ in range(_STEPS):
        matrix, gradient = _normal_equations(state, observed, corners, places, count)
        while damping < 1e9:
            step = np.asarray(
                np.linalg.solve(matrix + damping * np.diag(matrix.diagonal() + 1e-9), -gradient), np.float64
            )
            stepped = _moved(state, places, step)
            lower = _cost(stepped, observed, corners)
            if lower < cost:
                break
            damping *= 10
        else:
            break
        gain, state, cost, damping = (cost - lower) / cost, stepped, lower, max(damping / 10, 1e-9)
        if gain < _CONVERGED:
            break
    return state


Places = Mapping[tuple[str, int], NDArray[np.int64]]


def _places(state: _State) -> tuple[Places, int]:
    """Which unknowns are each camera's and board's."""
    first = next(iter(state.poses))
    sizes = {("camera", camera): 6 for camera in state.poses if camera != first}
    sizes |= {("board", instant): 6 for instant in state.boards}
    ends = np.cumsum(list(sizes.values()))
    return {key: np.arange(end - sizes[key], end) for key, end in zip(sizes, ends, strict=True)}, int(ends[-1])


def _residuals(state: _State, key: tuple[int, int], view: BoardView, corners: F64) -> tuple[F64, F64]:
    """Residuals (N, 2), and derivatives (N, 2, 12) by the board's and the camera's pose."""
    camera, instant = key
    parts = [part.reshape(3, 1) for part in (*state.boards[instant], *state.poses[camera])]
    rotation, translation, *by = (np.asarray(part, np.float64) for part in cv2.composeRT(*parts))
    pixels, jacobian = state.lenses[camera].project(rotation, translation, corners[view.numbers])
    # dr/d(r1, t1, r2, t2), then dt/d(the same)
    chain = np.block([[by[0], by[1], by[2], by[3]], [by[4], by[5], by[6], by[7]]])
    return pixels - (view.pixels - 0.5), jacobian @ chain


def _normal_equations(
    state: _State, observed: Mapping[tuple[int, int], BoardView], corners: F64, places: Places, count: int
) -> tuple[F64, F64]:
    matrix, gradient = np.zeros((count, count)), np.zeros(count)
    for (camera, instant), view in observed.items():
        residuals, by_poses = _residuals(state, (camera, instant), view, corners)
        blocks = [
            (("board", instant), by_poses[:, :, :6]),
            (("camera", camera), by_poses[:, :, 6:]),
        ]
        free = [(places[key], block) for key, block in blocks if key in places]
        weight = np.sqrt(_weight(residuals))
        rows = np.concatenate([columns for columns, _ in free])
        derivatives = np.concatenate([block * weight for _, block in free], axis=2)
        derivatives = derivatives.reshape(-1, len(rows))
        matrix[np.ix_(rows, rows)] += derivatives.T @ derivatives
        gradient[rows] += derivatives.T @ (residuals * weight).ravel()
    return matrix, gradient


def _weight(residuals: F64) -> float:
    """What a sight with residuals (N, 2) counts, 0..1."""
    return float(1 / (1 + (residuals**2).sum(axis=1).mean() / _SIGHT_PIXELS**2))


def _cost(state: _State, observed: Mapping[tuple[int, int], BoardView], corners: F64) -> float:
    """Sum of Cauchy's losses of the sights; infinite where a lens cannot project."""
    residuals = (_residuals(state, key, view, corners)[0] for key, view in observed.items())
    squares = np.array([(len(offsets), (offsets**2).sum(axis=1).mean()) for offsets in residuals])
    cost = float((squares[:, 0] * np.log1p(squares[:, 1] / _SIGHT_PIXELS**2)).sum())
    return cost if np.isfinite(cost) else float(np.inf)


def _moved(state: _State, places: Places, step: F64) -> _State:
    def pose(kind: str, number: int, old: Pose) -> Pose:
        columns = places.get((kind, number))
        return old if columns is None else (old[0] + step[columns[:3]], old[1] + step[columns[3:]])

    return replace(
        state,
        poses={number: pose("camera", number, old) for number, old in state.poses.items()},
        boards={number: pose("board", number, old) for number, old in state.boards.items()},
    )


def _errors(state: _State, observed: Mapping[tuple[int, int], BoardView], corners: F64) -> dict[int, float]:
    """Root mean square residual of each camera, px, over its sights as they count."""
    sums: dict[int, F64] = {camera: np.zeros(2) for camera in state.poses}
    for key, view in observed.items():
        residuals = _residuals(state, key, view, corners)[0]
        sums[key[0]] += _weight(residuals) * np.array([(residuals**2).sum(), len(residuals)])
    return {camera: float(np.sqrt(total / max(count, 1e-12))) for camera, (total, count) in sums.items()}


def _sight_errors(state: _State, observed: Mapping[tuple[int, int], BoardView], corners: F64) -> dict[int, F64]:
    """Root mean square residuals of each camera's sights, px."""
    by_camera: dict[int, list[float]] = {camera: [] for camera in state.poses}
    for key, view in observed.items():
        by_camera[key[0]].append(float(np.sqrt((_residuals(state, key, view, corners)[0] ** 2).sum(axis=1).mean())))
    return {camera: np.array(errors) for camera, errors in by_camera.items()}
