"""Videos of a board that moves before three cameras, as folders of drawn pictures or with sound."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from decogs.rig.calibration.boards import Charuco
from videos_with_sound import claps, write_video

BOARD = "charuco:5x4:0.05:0.0375:DICT_4X4_50"
FOCAL, SIZE = 500.0, (640, 480)
POSES = [np.array([0, turn, 0, -turn, 0, 0.1 * turn]) for turn in (0.0, 0.3, -0.3)]
"""Rotation vectors and translations of the cameras."""
_DOT = 0.0005
"""Metres a pixel of the drawn board."""


PHONES = {"a": 0, "b": 5, "c": 2}
"""Frames by which phones start later."""


def write_board_videos(folder: Path, *, mirrored: str = "", frames: int = 24) -> None:
    """Three cameras, ``a``, ``b`` and ``c``; the video of ``mirrored`` is turned left to right."""
    for frame, shown in enumerate(board_pictures(frames)):
        for name, picture in shown.items():
            path = folder / name / f"{frame:04d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), picture[:, ::-1] if name == mirrored else picture)


def write_phone_videos(folder: Path, frames: int = 40) -> None:
    """The same as videos of this length with two claps, started as PHONES says; the board is elsewhere every frame."""
    folder.mkdir(parents=True)
    shown = list(board_pictures(frames + max(PHONES.values())))
    for number, (name, start) in enumerate(PHONES.items()):
        heard = claps(
            frames / 30, [each - start / 30 for each in (0.4, 1.1)], np.random.default_rng(number), rate=48000
        )
        pictures = [cv2.cvtColor(each[name], cv2.COLOR_GRAY2RGB) for each in shown[start : start + frames]]
        write_video(folder / f"{name}.mp4", np.stack(pictures), heard)


def board_pictures(frames: int) -> Iterator[dict[str, np.ndarray]]:
    """Of every frame the pictures (H, W) of the cameras."""
    drawn = np.asarray(Charuco(5, 4, 0.05, 0.0375, "DICT_4X4_50").made().generateImage((500, 400)))
    drawn = cv2.copyMakeBorder(drawn, 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=255)
    to_board = np.array([[_DOT, 0, -19.5 * _DOT], [0, _DOT, -19.5 * _DOT], [0, 0, 1]])
    matrix = np.array([[FOCAL, 0, 319.5], [0, FOCAL, 239.5], [0, 0, 1]])
    draw = np.random.default_rng(3)
    for _ in range(frames):
        place = np.array([*draw.uniform(-0.25, 0.05, 2), draw.uniform(0.5, 0.7)])
        board = draw.uniform(-0.6, 0.6, 3), place
        pictures = {}
        for name, pose in zip("abc", POSES, strict=True):
            parts = [part.reshape(3, 1) for part in (*board, pose[:3], pose[3:])]
            rotation, translation = cv2.composeRT(*parts)[:2]
            turned = cv2.Rodrigues(rotation)[0]
            homography = matrix @ np.column_stack([turned[:, 0], turned[:, 1], translation]) @ to_board
            pictures[name] = cv2.warpPerspective(drawn, homography, SIZE, flags=cv2.INTER_AREA, borderValue=128)
        yield pictures
