"""Which way is up in a rig's world, and the turn that brings it to where a file, a viewer or a camera has it.

This is the one place that decides. Chosen for ``auto``: the direction about which no camera rolls, nerfstudio's
"vertical" (``auto_orient_and_center_poses``), with the cameras' mean up for its sign and where cameras do roll.

* The mean up alone, as nerfstudio's default and instant-ngp have it, leans with cameras that look down from one side:
  by 14 to 16 degrees in ``workbench``, ``candle`` and ``still``, whose floors are level; this, by 0.5 to 1.5.
* The nearest axis, which viewers with a fixed turn come to, is wrong by 28 degrees in ``popup``, a turned world,
  and by 17 in ``desk_charuco_4cam``, whose doors stand as this says. It is taken near an axis only: a world that is
  level keeps its bits.
* Where cameras roll (``balance_4cam``: 8 degrees, and as much between their mean up and the floor's), an axis is the
  better guess within more degrees. Where they look down and roll as they like (``mouse_cage_8cam``), none of this holds
  and a user has to say which way is up.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..cameras import Camera

Up = Literal["auto", "X", "-X", "Y", "-Y", "Z", "-Z", "none"]
UPS: tuple[Up, ...] = get_args(Up)

Vector = NDArray[np.float64]

AXES: dict[str, Vector] = {
    f"{sign}{name}": np.eye(3)[axis] * (-1 if sign else 1) for axis, name in enumerate("XYZ") for sign in ("", "-")
}

_NEAR_AN_AXIS, _NEAR_AN_AXIS_BY_THE_MEAN = np.cos(np.radians(5)), np.cos(np.radians(15))
_MAX_ROLL = np.sin(np.radians(8))
"""Root mean square of the cameras' roll beyond which no common horizon is there to go by; of rigs on tripods it was
1 to 3 degrees, of hand-placed ones that look down steeply 9 to 16."""
_SPREAD = 0.17
"""Of nerfstudio: the least second singular value, of one camera, with which x axes span a plane."""


def up_of(cameras: Sequence[Camera]) -> Vector:
    """The world's up, a unit vector, from the cameras; -Y, as in COLMAP's worlds, where they leave it open."""
    rotations = np.array([camera.world_to_camera[:3, :3] for camera in cameras]).reshape(-1, 3, 3)
    mean = -rotations[:, 1].sum(axis=0)
    if np.linalg.norm(mean) < 1e-6 * max(1, len(rotations)):
        return AXES["-Y"]
    mean /= np.linalg.norm(mean)
    level = _level_with(rotations[:, 0], mean)
    up = mean if level is None else level
    nearest = max(AXES.values(), key=lambda axis: float(axis @ up))
    return nearest if nearest @ up > (_NEAR_AN_AXIS_BY_THE_MEAN if level is None else _NEAR_AN_AXIS) else up


def up_vector(up: Up, cameras: Sequence[Camera]) -> Vector | None:
    """The direction asked for; None where nothing shall be turned."""
    if up == "none":
        return None
    return up_of(cameras) if up == "auto" else AXES[up]


def turn_between(up: Vector, to: Vector) -> NDArray[np.float64]:
    """The rotation (3, 3) of the smallest angle that takes one unit vector to another.

    For opposite ones it is half a turn about X, as between OpenCV's axes and OpenGL's (about Y for +-X).
    """
    cosine = float(up @ to)
    if cosine < -1 + 1e-12:
        about = np.array([0.0, 1.0, 0.0] if abs(up[0]) > 0.5 else [1.0, 0.0, 0.0])
        about -= up * (about @ up)
        about /= np.linalg.norm(about)
        return np.asarray(2 * np.outer(about, about) - np.eye(3))
    x, y, z = np.cross(up, to)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + skew + skew @ skew / (1 + cosine))


def up_text(up: Vector) -> str:
    """The direction as a user reads it: an axis by its name, or three components."""
    for name, axis in AXES.items():
        if np.array_equal(axis, up):
            return name
    return "(" + ", ".join(f"{part:.2f}" for part in up) + ")"


def _level_with(x_axes: NDArray[np.float64], mean_up: Vector) -> Vector | None:
    """The direction to which all cameras' x axes are most nearly perpendicular, on the side of the mean up.

    None where cameras roll, so that they have no such direction.
    """
    _, spread, directions = np.linalg.svd(x_axes, full_matrices=True)
    spread = np.append(spread, np.zeros(3 - len(spread))) / np.sqrt(len(x_axes))
    if spread[1] > _SPREAD:
        if spread[2] > _MAX_ROLL:
            return None
        up = directions[2] if directions[2] @ mean_up > 0 else -directions[2]
    else:
        # All look the same way: level with their x axis is a plane, of which the mean up says the rest.
        up = mean_up - directions[0] * (directions[0] @ mean_up)
    return np.asarray(up / np.linalg.norm(up))
